from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.studies.sweep.dask.worker import Bundle, laid_out
from twin.studies.sweep.plan import Task

EXPERIMENTS = ("fig4_force_position", "fig4_imperfect", "massage", "track_breathing", "step_joint_1", "calibration")


def task(drive: str | None = None, *settings: str) -> Task:
    return Task(1, "", drive, {}, settings)


def arrived(experiment: Path, task: Task, folder: Path) -> Experiment:
    """The experiment of `task` as it is read where it has been sent."""
    bundle = Bundle(experiment)
    packed = bundle.packed(task)
    laid_out(bundle.contents, folder)
    return load_experiment(folder / bundle.experiment, packed.settings, packed.drive and str(folder / packed.drive))


def told(loaded: Experiment) -> Experiment:
    """Without where FMUs lie."""
    return replace(loaded, drives=tuple(_placeless(drive) for drive in loaded.drives), values=_named(loaded.values))  # type: ignore[arg-type]


def _placeless(drive: Any) -> Any:
    parts = {name: part.model_copy(update={"fmu": Path(part.fmu).name}) for name, part in drive.parts.items()}
    return drive.model_copy(update={"fmu": drive.fmu and Path(drive.fmu).name, "parts": parts})


def _named(values: Any) -> Any:
    if not isinstance(values, dict):
        return values
    return {key: Path(value).name if key == "fmu" else _named(value) for key, value in values.items()}


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_an_experiment_arrives_as_it_was_sent_with_its_origins(root: Path, tmp_path: Path, name: str):
    path = root / "experiments" / f"{name}.toml"
    here, there = told(load_experiment(path)), told(arrived(path, task(), tmp_path / "there"))
    assert there == here
    assert repr(there.values) == repr(here.values)


@pytest.mark.parametrize("drive", ["pmsm_foc", "brushed_dc", "torque_motor_fmi3", "fmus/stepper/stepper.fmu"])
def test_a_drive_arrives_with_its_mapping(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, drive: str):
    monkeypatch.chdir(root)
    path = root / "experiments" / "fig4_force_position.toml"
    here, there = load_experiment(path, drive=drive), arrived(path, task(drive), tmp_path / "there")
    assert told(there) == told(here)


def test_names_of_files_in_settings_arrive_and_numbers_stand_over_them(root: Path, tmp_path: Path):
    settings = (
        'contact.body="calf"',
        f'drive.joint_2.fmu="{root}/fmus/brushed_dc"',
        "drive.joint_2.velocity_loop.kp=2.5",
        "contact.stiffness_N_per_m=1234.5",
    )
    path = root / "experiments" / "massage.toml"
    here = load_experiment(path, settings)
    # not what the body says, and what only the mapping says
    assert (here.contact.stiffness, here.drives[1].command) == (1234.5, "voltage")
    assert told(arrived(path, task(None, *settings), tmp_path / "there")) == told(here)


def test_an_fmu_of_all_joints_is_packed_as_one_file(root: Path):
    bundle = Bundle(root / "experiments" / "fig4_force_position.toml")
    assert [Path(name).name for name in bundle.contents] == ["velocity_servo.fmu", "fig4_force_position.toml"]


def test_parts_of_another_make_travel_with_what_names_them(root: Path, tmp_path: Path):
    (tmp_path / "mine.py").write_text("class Controller: pass\n")
    path = tmp_path / "mine.toml"
    base = f'extends = "{root}/experiments/fig4_force_position.toml"\n'
    path.write_text(f'{base}[controller]\npython = "mine.py:Controller"\n[scale]\nperiod_ms = 10.0\n')
    there = arrived(path, task(), tmp_path / "there")
    table = there.stand_ins["controller"]
    assert table.label == "mine.py:Controller"
    assert table.file.read_text() == "class Controller: pass\n"
    assert str(table.file).startswith(str(tmp_path / "there"))
    path.write_text(base)
    fmu = 'controller.fmu="fmus/parts/paper_law"'
    there = arrived(path, task(None, fmu), tmp_path / "other")
    assert there.stand_ins["controller"].inputs == {"p_ref_B": ("way_1", "way_2", "way_3")}
    assert str(there.stand_ins["controller"].file).startswith(str(tmp_path / "other"))


def test_files_among_a_drives_parameters_travel_with_it(root: Path, tmp_path: Path):
    servo = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    mapping = tmp_path / "supplier" / "mapping.toml"
    mapping.parent.mkdir()
    (tmp_path / "supplier" / "curve.csv").write_text("0,1")
    (tmp_path / "map.bin").write_bytes(b"\x07")
    mapping.write_text(f'fmu = "{servo}"\n[parameters]\ncurves = ["file:curve.csv", "none"]\n')
    setting = f'drive.parameters.map="file:{tmp_path / "map.bin"}"'
    path = root / "experiments" / "fig4_force_position.toml"
    drive = arrived(path, task(str(mapping), setting), tmp_path / "there").drives[0]
    (curve, text), blob = drive.parameters["curves"], drive.parameters["map"]  # type: ignore[misc,str-unpack]
    there = [Path(str(name).removeprefix("file:")) for name in (curve, blob)]
    assert text == "none" and all(file.is_relative_to(tmp_path / "there") for file in there)
    assert [file.read_bytes() for file in there] == [b"0,1", b"\x07"]
