"""The matrix with shared pasts and without: the same bytes; and what a monitor does before it does anything."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import twin as command
from tests.kernel.fmi.archives import redescribed
from tests.laws.runs import EXPERIMENTS, shipped
from twin.kernel.atomic_write import json_text
from twin.kernel.cosim.observers import simulate
from twin.kernel.cosim.simulation import Simulation
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import FAULT_KINDS, Fault
from twin.robot.run.runs import MonitorWork
from twin.robot.run.shared_prefix import SharedPrefix
from twin.robot.run.trace import Trace
from twin.studies.faults.cases import cases, known_kinds
from twin.studies.faults.matrix import FaultRow, matrix_rows
from twin.studies.faults.stage import Stage
from twin.studies.faults.text import draw_fault_matrix, fault_matrix_result

FEW = ("encoder_glitch", "sample_jitter", "belief_k_s", "drive_runaway", "drive_failure", "brown_out", "surface_jump")
ONSETS = (0.0, 0.501, 5.531)


def rows(experiment: Experiment, kinds: Sequence[str], share: bool, onsets: Sequence[float] = ONSETS) -> list[FaultRow]:
    stage = Stage(experiment, share=share)
    return list(matrix_rows(stage, cases(experiment, known_kinds(kinds), onsets, None)))


def texts(of: list[FaultRow]) -> list[str]:
    """As they are written."""
    return [json_text(row.to_dict()) for row in of]


def assert_same(experiment: Experiment, kinds: Sequence[str], onsets: Sequence[float]) -> None:
    shared, alone = (texts(rows(experiment, kinds, share, onsets)) for share in (True, False))
    assert shared == alone


def begun(experiment: Experiment) -> Experiment:
    """Its first 0.8 s, of which slow drives make little."""
    return replace(experiment, duration_ticks=800)


def test_rows_of_a_few_kinds_are_the_same_bytes_with_and_without_sharing():
    assert_same(shipped("pressing"), ("sample_jitter", "drive_failure", "surface_jump"), (0.0, 5.531))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pressing", pytest.param("tapping", marks=pytest.mark.endurance)])
def test_rows_text_and_picture_of_all_kinds_are_the_same_bytes_with_and_without_sharing(tmp_path: Path, name: str):
    experiment = shipped(name)
    onsets = Stage(experiment).onsets
    shared, alone = (rows(experiment, tuple(FAULT_KINDS), share, onsets) for share in (True, False))
    assert texts(shared) == texts(alone)
    pictures = [tmp_path / "shared.png", tmp_path / "alone.png"]
    results = []
    for found, picture in zip((shared, alone), pictures, strict=True):
        draw_fault_matrix(name, found, picture)
        results.append(fault_matrix_result(name, found, tmp_path / "matrix.png"))
    assert results[0] == results[1]
    assert pictures[0].read_bytes() == pictures[1].read_bytes()


SCHEMES = (
    ("cosim.scheme=jacobi", "controller.delay_ticks=1", "controller.bus_delay_ticks=1"),
    ("cosim.inputs=linear", "cosim.iterations=2"),
    ("plant.motor_noise_deg=0.001", "plant.encoder_latency_ms=2"),
    ("contact.breathing={amplitude_mm=1, rate_per_min=15}",),
    ('change=[{t_s = 3.0, key = "controller.force.ki_mm_per_N_s", value = 9.0}]',),
)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(SCHEMES)))
def test_rows_are_the_same_bytes_in_every_scheme_and_with_what_else_changes(number: int):
    """Every other kind, the others in the next scheme."""
    assert_same(shipped("pressing", *SCHEMES[number]), FEW[number % 2 :: 2], (5.531,))


@pytest.mark.endurance
@pytest.mark.parametrize("number", range(len(SCHEMES)))
def test_rows_of_the_other_kinds_are_the_same_bytes_in_every_scheme(number: int):
    assert_same(shipped("pressing", *SCHEMES[number]), FEW[1 - number % 2 :: 2], (5.531,))


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["modelica_dc", "torque_motor_fmi3"])
def test_rows_are_the_same_bytes_of_drives_without_a_state_and_of_those_that_can_be_switched(drive: str):
    experiment = load_experiment(EXPERIMENTS / "pressing.toml", (), drive)
    assert_same(begun(experiment), ("encoder_glitch", "drive_runaway", "surface_jump"), (0.501,))


@pytest.mark.slow
def test_rows_are_the_same_bytes_of_drives_in_processes_of_their_own(root: Path, tmp_path: Path):
    flagged = '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" '
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    single = redescribed(good, tmp_path / "single.fmu", "<CoSimulation ", flagged)
    experiment = load_experiment(EXPERIMENTS / "pressing.toml", (), str(single))
    assert_same(begun(experiment), ("encoder_glitch", "surface_jump"), (0.501,))


@pytest.mark.slow
def test_the_study_in_a_process_of_its_own_writes_the_same_rows(tmp_path: Path):
    kinds = [word for kind in FEW for word in ("--kind", kind)]
    onsets = [word for onset in ONSETS for word in ("--onset", f"{onset}")]
    out = ("--set-of", "single", "--out", tmp_path / "out")
    line = ("faults", EXPERIMENTS / "pressing.toml", *kinds, *onsets, *out)
    done = command(*line, cwd=tmp_path, isolated=True)
    assert done.returncode in (0, 1), done.stderr
    experiment = shipped("pressing")
    alone = texts(rows(experiment, FEW, False))
    assert (tmp_path / "out" / "rows.jsonl").read_text() == "".join(f"{text}\n" for text in alone)


def test_a_state_that_is_handed_over_a_tick_late_makes_other_rows(monkeypatch: pytest.MonkeyPatch):
    experiment = shipped("pressing")
    alone = texts(rows(experiment, ("spring_softened",), False))
    take_over = Simulation.copy_from

    def late(self: Simulation, other: Simulation) -> list[str]:
        new = take_over(self, other)
        self.next_tick += 1
        return new

    monkeypatch.setattr(Simulation, "copy_from", late)
    assert texts(rows(experiment, ("spring_softened",), True)) != alone


def worked(experiment: Experiment) -> tuple[float, Trace]:
    work, trace = MonitorWork(), Trace()
    with assemble(experiment) as assembly:
        simulate(assembly, experiment.duration_ticks, [work, trace])
    return work.first, trace


@pytest.mark.parametrize(
    "fault",
    [
        Fault("encoder_bias", "joint_encoder_1", 5531, magnitude=math.radians(0.1)),
        Fault("drive_runaway", "drive_1", 5531, magnitude=2.0),
        Fault("controller_overrun", "controller", 5531, magnitude=3e-3),
    ],
    ids=lambda fault: fault.kind,
)
def test_until_the_monitor_does_something_the_robot_without_it_has_the_same_bits(fault: Fault):
    experiment = replace(shipped("pressing"), faults=(fault,))
    first, watched = worked(experiment)
    unwatched = Trace()
    with assemble(replace(experiment, monitor=None)) as assembly:
        simulate(assembly, experiment.duration_ticks, [unwatched])
    alike = len(watched.t) if first == math.inf else int(first) + 1
    for key in unwatched.fields():
        a, b = watched.held(key)[:alike], unwatched.held(key)[:alike]
        np.testing.assert_array_equal(a, b, err_msg=key)
    seen = watched.held("monitor.tripped")
    if fault.kind == "drive_runaway":
        assert first == np.argmax(seen)
    elif fault.kind == "encoder_bias":
        assert first == math.inf and not seen.any()
    else:
        # commands that come between two looks of the monitor are passed on later: something it does without a trip
        assert 5531 <= first < math.inf and not seen.any()


def test_of_a_drive_that_can_be_switched_nothing_is_said_before_the_monitor_is_gone():
    experiment = load_experiment(EXPERIMENTS / "pressing.toml", (), "torque_motor_fmi3")
    assert worked(replace(experiment, duration_ticks=10))[0] == 0


def test_a_run_that_the_monitor_never_touched_is_made_once(monkeypatch: pytest.MonkeyPatch):
    made: list[bool] = []
    go_on = SharedPrefix.run_variant

    def counted(self: SharedPrefix, experiment: Experiment, tick, observers):
        made.append(experiment.monitor is not None)
        return go_on(self, experiment, tick, observers)

    monkeypatch.setattr(SharedPrefix, "run_variant", counted)
    experiment = shipped("pressing")
    rows(experiment, ("breathing",), True)
    assert made == [True] * 9
    made.clear()
    rows(experiment, ("drive_runaway",), True)
    assert made == [True, False] * 9
