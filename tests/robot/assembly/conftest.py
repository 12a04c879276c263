"""The hostile drive and the command that runs it, as tests of processes have them."""

from tests.kernel.process.conftest import command, drive

__all__ = ["command", "drive"]
