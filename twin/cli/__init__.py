"""The command line: one file per command. Heavy packages are imported inside the commands that use them."""

from twin.cli.app import main

__all__ = ["main"]
