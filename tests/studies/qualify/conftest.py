from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from tests.conftest import ROOT
from twin.robot.experiment.drive_files import load_drive
from twin.studies.qualify.qualification import Qualification, qualify_drive


@cache
def _done(drive: str) -> Qualification:
    return qualify_drive(load_drive(drive, ROOT))


@pytest.fixture(scope="session")
def done() -> Callable[[str], Qualification]:
    """The qualification of a drive of fmus/, run once."""
    return _done


@pytest.fixture
def velocity_servo(root: Path) -> Path:
    """A drive whose every answer is known from its equations."""
    return root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
