from pathlib import Path

import pytest

from twin.errors import InputRefused
from twin.experiment.drive_files import joint_tables, lone_drive


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    """A folder with fmus/acme (with a mapping) and fmus/plain (without)."""
    for name in ("acme", "plain"):
        folder = tmp_path / "fmus" / name
        folder.mkdir(parents=True)
        (folder / f"{name}.fmu").touch()
    (tmp_path / "fmus/acme/mapping.toml").write_text(
        'fmu = "acme.fmu"\nsign = -1\n[inputs]\nomega_ref = "n"\n[parameters]\nJ = 1.0\nR = 2.0\n'
    )
    return tmp_path


def test_a_drive_folder_brings_its_mapping_and_the_experiment_has_the_last_word(shelf: Path):
    (table, *_) = joint_tables({"fmu": "fmus/acme", "parameters": {"R": 3.0}}, shelf)
    assert table == {
        "fmu": str(shelf / "fmus/acme/acme.fmu"),
        "sign": -1,
        "inputs": {"omega_ref": "n"},
        "parameters": {"J": 1.0, "R": 3.0},
    }


def test_a_mapping_file_can_be_named_itself(shelf: Path):
    (table, *_) = joint_tables({"fmu": "fmus/acme/mapping.toml"}, shelf)
    assert table["fmu"] == str(shelf / "fmus/acme/acme.fmu")


def test_a_joint_that_names_another_drive_takes_nothing_of_the_common_one(shelf: Path):
    drive = {"fmu": "fmus/acme", "sign": 1, "joint_2": {"fmu": "fmus/plain"}, "joint_3": {"sign": -1}}
    one, two, three = joint_tables(drive, shelf)
    assert two == {"fmu": str(shelf / "fmus/plain/plain.fmu")}
    assert (one["sign"], three["sign"]) == (1, -1)


def test_a_drive_can_be_named_by_its_name_on_the_shelf(shelf: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(shelf)
    assert lone_drive("acme", shelf).sign == -1
    assert lone_drive("fmus/plain", shelf).sign == 1


def test_what_is_no_drive_is_refused(shelf: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(shelf)
    with pytest.raises(InputRefused, match="no such drive"):
        lone_drive("nowhere", shelf)
    with pytest.raises(InputRefused, match="a folder without"):
        lone_drive("fmus", shelf)


def test_a_mapping_with_a_mistake_is_told(shelf: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(shelf)
    (shelf / "fmus/acme/mapping.toml").write_text('fmu = "acme.fmu"\nsigns = -1\n')
    with pytest.raises(InputRefused, match="unknown key 'signs'; did you mean 'sign'"):
        lone_drive("acme", shelf)
