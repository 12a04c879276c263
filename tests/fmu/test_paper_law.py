"""The paper's law built from C takes the place of twin's own controller, and nothing changes."""

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from builder.compile import TARGETS
from builder.drive import folder_of, load_drive, part_names
from builder.model_description import model_description
from fmpy import read_model_description
from fmpy.validation import validate_fmu

from tests.fmu.paper_law import parameters
from twin.kernel.recording.reader import Recording, read
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.run import execute
from twin.robot.run.trace import Trace, run_in_memory

FMU = "fmus/parts/paper_law"
ROUNDING = 1e-12
"""In SI, of every signal: other operating systems' exp and cos may differ in the last bit. Here nothing differs."""


def with_fmu(experiment: Experiment, set_besides: Mapping[str, float] | None = None) -> Experiment:
    told = parameters(experiment) | dict(set_besides or {})
    settings = [f"controller.parameters.{name}={value!r}" for name, value in told.items()]
    return load_experiment(experiment.name, [f"controller.fmu={FMU}", *settings])


def largest_difference(one: Trace | Recording, other: Trace | Recording) -> tuple[float, str]:
    apart = {name: float(np.max(np.abs(one[name].astype(float) - other[name]))) for name in one.fields()}
    worst = max(apart, key=lambda name: apart[name])
    return apart[worst], worst


@pytest.mark.parametrize("name", part_names())
def test_the_binary_was_built_from_these_sources(name: str) -> None:
    part, file = load_drive(name), folder_of(name) / f"{name}.fmu"
    stale = f"{file.name} is stale: run python fmus/build.py {name}"
    assert read_model_description(str(file)).guid == part.guid, stale
    with zipfile.ZipFile(file) as archive:
        assert archive.read("modelDescription.xml") == model_description(part), stale
        assert archive.read("documentation/README.md") == (folder_of(name) / "README.md").read_bytes(), stale
        for source in part.sources:
            assert archive.read(f"sources/{source.name}") == source.read_bytes(), stale
        for platform, (suffix, _) in TARGETS.items():
            assert part.guid.encode() in archive.read(f"binaries/{platform}/{name}.{suffix}")
    assert validate_fmu(str(file)) == []


@pytest.mark.parametrize("name", ["fig4_force_position", "fig4_imperfect", "massage"])
def test_every_signal_is_that_of_a_run_with_twins_own_controller(name: str) -> None:
    own = load_experiment(name)
    apart, worst = largest_difference(run_in_memory(own), run_in_memory(with_fmu(own)))
    assert apart <= ROUNDING, worst


@pytest.mark.parametrize("name", ["fig4_position", "tapping", "pressing", "rolling", "pushing"])
@pytest.mark.endurance
def test_every_signal_of_every_task_too(name: str) -> None:
    own = load_experiment(name)
    apart, worst = largest_difference(run_in_memory(own), run_in_memory(with_fmu(own)))
    assert apart <= ROUNDING, worst


def test_recordings_are_equal_and_name_the_fmu(force_position: Recording, tmp_path: Path) -> None:
    own = load_experiment("fig4_force_position")
    recording = read(execute(with_fmu(own), tmp_path).recording)
    apart, worst = largest_difference(force_position, recording)
    assert apart <= ROUNDING, worst
    besides = {"reference.p_ref_B", "controller.v_ref_B", "controller.task", "controller.phase"}
    assert recording.fields().keys() - force_position.fields().keys() == besides
    assert "controller: paper_law.fmu" in recording.other_parts[0]
    assert "did not run" in recording.other_parts[0]


def test_another_gain_is_seen(force_position: Recording) -> None:
    own = load_experiment("fig4_force_position")
    other = run_in_memory(with_fmu(own, {"force_kp": 0.003}))
    assert largest_difference(force_position, other)[0] > 0.1
