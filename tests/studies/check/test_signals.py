"""Signals by the names that measures use."""

import numpy as np
import pytest

from tests.laws.runs import shipped
from tests.studies.check.traces import measuring, t, trace
from twin.errors import InputRefused
from twin.experiment.variation import shortened
from twin.robot.inverse_kinematics import joint_angles
from twin.runs.assembly.assemble import assemble
from twin.runs.assembly.beliefs import geometry_of
from twin.runs.trace import run_in_memory
from twin.studies.check.signals import REFERENCE_THETA_L, Signals, refuse_unknown

FAULT = "fault=[{kind='belief_eta', onset_s=0.2, magnitude_factor=0.9}]"


def test_an_index_picks_a_component_and_a_minus_turns_it_round():
    p_B = np.stack([t, 2.0 * t, 3.0 * t], axis=1)
    run = trace({"plant.p_B": p_B, "controller.on": t > 1.0}, {"plant.p_B": "m", "controller.on": "1"})
    np.testing.assert_array_equal(run["-plant.p_B[2]"], -3.0 * t)
    np.testing.assert_array_equal(run["plant.p_B"], p_B)
    assert (run.unit("-plant.p_B[2]"), run.unit("controller.on"), run.unit(f"{REFERENCE_THETA_L}[0]")) == (
        "m",
        "1",
        "rad",
    )


def test_of_a_sampled_component_there_is_what_held_at_every_tick_as_a_number():
    experiment = shortened(shipped("step_z_air"), 0.2)
    run = run_in_memory(experiment)
    signals = Signals(run, geometry_of(experiment.controller.model))
    assert signals["controller.triggered"].dtype == float
    assert len(signals["-controller.triggered"]) == len(signals["controller.F_z"]) == len(signals.t) == 201
    expected = joint_angles(geometry_of(experiment.controller.model), run.held("controller.p_ref_B"))
    np.testing.assert_array_equal(signals[f"{REFERENCE_THETA_L}[1]"], expected[:, 1])


def refuse(signal: str) -> None:
    spread = {"kind": "spread", "name": "s", "signal": signal}
    with assemble(shipped("pressing", FAULT)) as assembly:
        refuse_unknown(measuring(spread), assembly.system)


@pytest.mark.parametrize("signal", ["plant.p_B[2]", "drive/1.theta_m", "fault/1.value", "reference.theta_l[0]"])
def test_what_a_recording_of_the_run_names_can_be_measured(signal: str):
    refuse(signal)


@pytest.mark.parametrize(
    ("signal", "said"),
    [
        ("fault/2.value", "no such signal; did you mean 'fault/1.value'?"),
        ("plant.p_B", r"it has 3 components; expected \[0\] to \[2\]"),
        ("controller.F_z[0]", "it has 1 components; expected no index"),
    ],
)
def test_what_it_does_not_name_is_refused(signal: str, said: str):
    with pytest.raises(InputRefused, match=said):
        refuse(signal)
