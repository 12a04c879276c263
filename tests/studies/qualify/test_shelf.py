"""The drives of fmus/ are looked at once, and again when anything of them has changed."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.installations import forget_installation
from twin.kernel.cache_folder import VARIABLE, cache_folder
from twin.kernel.errors import InputRefused
from twin.kernel.fmi import COMPILED
from twin.studies.qualify import shelf
from twin.studies.qualify.shelf import ShelvedDrive, shelved_drives

DRIVE = "brushed_dc"


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Path]:
    """Which shelves were looked at."""
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    forget_installation()
    found: list[Path] = []
    look = shelf._looked_at

    def looked_at(place: Path) -> tuple[ShelvedDrive, ...]:
        found.append(place)
        return look(place)

    monkeypatch.setattr(shelf, "_looked_at", looked_at)
    return found


@pytest.fixture
def place(root: Path, tmp_path: Path) -> Path:
    """A folder with a fmus/ of one drive with its mapping."""
    shutil.copytree(root / "fmus" / DRIVE, tmp_path / "here" / "fmus" / DRIVE)
    return tmp_path / "here"


def test_a_second_look_is_none(looks: list[Path], place: Path):
    (first,) = shelved_drives(place)
    assert (first,) == shelved_drives(place) and isinstance(first, ShelvedDrive)
    assert (first.name, first.kind, first.command, first.problem) == (DRIVE, "motor", "voltage", "")
    assert looks == [place / "fmus"]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda here: (here / f"{DRIVE}.fmu").write_bytes(b"PK"), "not a complete FMU"),
        (lambda here: (here / "mapping.toml").write_text(f'fmu = "{DRIVE}.fmu"\nsing = -1\n'), "sing"),
        (lambda here: (here / "mapping.toml").unlink(), ""),
        (lambda here: (here / "README.md").write_text("other"), ""),
    ],
)
def test_what_has_changed_is_looked_at(change: Callable[[Path], object], problem: str, looks: list[Path], place: Path):
    shelved_drives(place)
    change(place / "fmus" / DRIVE)
    (drive,) = shelved_drives(place)
    assert problem in drive.problem and len(looks) == 2


def test_one_byte_of_an_fmu_is_enough(looks: list[Path], place: Path):
    shelved_drives(place)
    fmu = place / "fmus" / DRIVE / f"{DRIVE}.fmu"
    content = bytearray(fmu.read_bytes())
    # in the middle of what is packed
    content[len(content) // 2] ^= 1
    fmu.write_bytes(content)
    (drive,) = shelved_drives(place)
    assert "damaged" in drive.problem and len(looks) == 2


def test_a_folder_that_was_moved_is_looked_at(looks: list[Path], place: Path):
    (place / "fmus" / DRIVE / "mapping.toml").write_text('fmu = "nowhere.fmu"')
    assert str(place) in shelved_drives(place)[0].problem
    moved = place.rename(place.with_name("there"))
    assert str(moved) in shelved_drives(moved)[0].problem


def test_a_new_drive_and_what_was_compiled_of_one_are_looked_at(looks: list[Path], place: Path):
    shelved_drives(place)
    shutil.copytree(place / "fmus" / DRIVE, place / "fmus" / "another")
    assert [drive.name for drive in shelved_drives(place)] == ["another", DRIVE]
    (cache_folder(COMPILED) / ("0" * 64)).mkdir()
    shelved_drives(place)
    assert len(looks) == 3


@pytest.mark.parametrize(
    "mapping",
    [
        'fmu = "../../elsewhere.fmu"',
        'fmu = "there.toml"',
        'fmu = { value = "../../elsewhere.fmu", source = "me" }',
        f'extends = "common.toml"\nfmu = "{DRIVE}.fmu"',
        f'fmu = "{DRIVE}.fmu"\nparameters.table = "file:/etc/hostname"',
        f'fmu = "{DRIVE}.fmu"\nparameters.table = ["file:../a.csv"]',
        'parts.a.fmu = "nowhere.fmu"',
        "fmu = ",
    ],
)
def test_a_drive_made_of_what_lies_elsewhere_is_looked_at_every_time(mapping: str, looks: list[Path], place: Path):
    (place / "fmus" / DRIVE / "mapping.toml").write_text(mapping)
    (place / "fmus" / DRIVE / "there.toml").write_text(f'fmu = "{DRIVE}.fmu"')
    assert shelved_drives(place) == shelved_drives(place)
    assert len(looks) == 2


def test_an_fmu_elsewhere_that_was_changed_is_seen(looks: list[Path], place: Path):
    (place / "fmus" / DRIVE / f"{DRIVE}.fmu").rename(place / "elsewhere.fmu")
    mapping = place / "fmus" / DRIVE / "mapping.toml"
    mapping.write_text(mapping.read_text().replace(f'"{DRIVE}.fmu"', '"../../elsewhere.fmu"'))
    assert shelved_drives(place)[0].problem == ""
    (place / "elsewhere.fmu").write_bytes(b"PK")
    assert "not a complete FMU" in shelved_drives(place)[0].problem


def test_no_shelf_is_told(looks: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(shelf, "located", lambda name, start: start / name)
    with pytest.raises(InputRefused, match="no such folder"):
        shelved_drives(tmp_path)


def test_an_answer_has_nothing_but_text(place: Path, looks: list[Path]):
    assert json.loads(json.dumps(shelved_drives(place))) == [list(drive) for drive in shelved_drives(place)]
