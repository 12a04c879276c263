"""The drives of fmus/, as `twin drive list` and `twin doctor` see them."""

import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from twin.kernel.errors import InputRefused
from twin.robot.assembly.drives import plan_drive
from twin.robot.experiment.drive_files import load_drive
from twin.studies.qualify import drive_list
from twin.studies.qualify.drive_list import ListedDrive, drive_text, drives_text, listed_drives

DRIVE = "brushed_dc"


@pytest.fixture
def place(root: Path, tmp_path: Path) -> Path:
    """A folder with a fmus/ of one drive with its mapping."""
    shutil.copytree(root / "fmus" / DRIVE, tmp_path / "here" / "fmus" / DRIVE)
    return tmp_path / "here"


def test_a_drive_that_fits_is_described(place: Path):
    (drive,) = listed_drives(place)
    assert (drive.name, drive.kind, drive.command, drive.problem) == (DRIVE, "motor", "voltage", "")
    assert json.loads(json.dumps(listed_drives(place))) == [list(drive)]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda here: (here / f"{DRIVE}.fmu").write_bytes(b"PK"), "not a complete FMU"),
        (lambda here: (here / "mapping.toml").write_text(f'fmu = "{DRIVE}.fmu"\nsing = -1\n'), "sing"),
        (lambda here: (here / "mapping.toml").write_text('fmu = "nowhere.fmu"'), "nowhere.fmu"),
    ],
)
def test_why_a_drive_does_not_fit_is_its_problem(change: Callable[[Path], object], problem: str, place: Path):
    change(place / "fmus" / DRIVE)
    (drive,) = listed_drives(place)
    assert problem in drive.problem and drive.kind == ""


def test_each_drive_has_one_line_and_a_problem_is_printed_whole(root: Path):
    drives = [*listed_drives(root), ListedDrive("broken", problem=f"broken.fmu: {'not a complete FMU ' * 8}".strip())]
    lines = drives_text(drives).splitlines()
    assert max(map(len, lines)) <= 80
    assert [line.split()[0] for line in lines[1 : 1 + len(drives)]] == [drive.name for drive in drives]
    assert "broken: broken.fmu: not a complete FMU" in lines[2 + len(drives)]
    assert " ".join(" ".join(lines).split()).count("not a complete FMU") == 8


def test_a_violated_schema_is_a_warning_with_file_and_line_and_no_message_of_lxml(place: Path, tmp_path: Path):
    fmu = tmp_path / "odd.fmu"
    with zipfile.ZipFile(place / "fmus" / DRIVE / f"{DRIVE}.fmu") as source, zipfile.ZipFile(fmu, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            odd = content.replace(b"<ScalarVariable ", b'<ScalarVariable odd="1" ', 1)
            target.writestr(name, odd if name == "modelDescription.xml" else content)
    shutil.copy(fmu, place / "fmus" / DRIVE / f"{DRIVE}.fmu")
    text = " ".join(drive_text(plan_drive(load_drive(str(place / "fmus" / DRIVE), place))).split())
    assert "ERROR" not in text
    assert "violates the standard's schema: Element 'ScalarVariable', attribute 'odd'" in text


def test_no_shelf_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(drive_list, "locate_file", lambda name, start: start / name)
    with pytest.raises(InputRefused, match="no such folder"):
        listed_drives(tmp_path)
