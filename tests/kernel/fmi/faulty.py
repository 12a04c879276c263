"""The drive of faulty.c."""

from pathlib import Path

from tests.kernel.fmi.compiled import compiled_drive


def faulty_drive(root: Path, folder: Path) -> Path:
    """An FMU that goes wrong after a second, as its parameter droop says."""
    return compiled_drive(root, folder, "faulty", {"model.c": Path(__file__).with_name("faulty.c").read_text()})
