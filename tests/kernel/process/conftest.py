"""The hostile drive, built once."""

from pathlib import Path

import pytest

from tests.kernel.process.hostile import Command, hostile_drive


@pytest.fixture(scope="session")
def drive(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """hostile.fmu."""
    return hostile_drive(root, tmp_path_factory.mktemp("hostile"))


@pytest.fixture
def command(root: Path, tmp_path: Path) -> Command:
    """`twin run` in a folder of its own."""
    return Command(root, tmp_path)
