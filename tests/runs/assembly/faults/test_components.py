"""Every kind has the component that does it, and what would do nothing or cannot be done is refused."""

import numpy as np
import pytest

from tests.cosim.models import sampled
from tests.faults.robot import COUNTS, SPEED_LIMIT, TICK, Robot, plant, run
from twin.errors import InputRefused
from twin.experiment.fault import Fault
from twin.experiment.fault_catalogue import CATALOGUE
from twin.faults import count_fault, drive_fault
from twin.runs.assembly.faults.components import COUNT_LAWS, DRIVE_LAWS, PARAMETERS
from twin.runs.assembly.faults.inject import inject

ONSET, END = 40, 80


@pytest.mark.parametrize(
    ("mechanism", "kinds"), [("counts", COUNT_LAWS), ("drive", DRIVE_LAWS), ("parameter", PARAMETERS)]
)
def test_each_mechanism_does_its_kinds_and_no_others(mechanism, kinds):
    assert set(kinds) == {name for name, known in CATALOGUE.items() if known.mechanism == mechanism}


@pytest.mark.parametrize(("laws", "known"), [(COUNT_LAWS, count_fault.Law), (DRIVE_LAWS, drive_fault.Law)])
def test_each_law_belongs_to_one_kind(laws, known):
    assert sorted(laws.values()) == sorted(known)


@pytest.mark.parametrize(
    ("kind", "degrees", "least"),
    [("encoder_bias", 0.04, "0.5"), ("encoder_glitch", -0.04, "0.5"), ("encoder_quantisation", 0.1, "2")],
)
def test_a_magnitude_that_changes_no_count_is_refused(kind, degrees, least):
    with pytest.raises(InputRefused, match=rf"\[\[fault\]\] 1: {kind} of .* deg changes no count .* {least} counts"):
        run(Fault(kind, "motor_encoder_1", ONSET, END, np.radians(degrees), share=0.1))


@pytest.mark.parametrize("milliseconds", [0.4, 1.5])
def test_a_delay_that_is_no_whole_tick_is_refused(milliseconds):
    with pytest.raises(InputRefused, match=rf"\[\[fault\]\] 1: sample_delay of {milliseconds} ms; expected a whole"):
        run(Fault("sample_delay", "encoder", ONSET, END, milliseconds * 1e-3))


def test_a_plant_without_the_parameter_is_refused():
    parts, wires = Robot().parts()
    ports = plant().inputs
    mute = sampled("plant", lambda t, h, u: np.zeros(19), ports, outputs=plant().outputs)
    with pytest.raises(InputRefused) as refusal:
        inject([*parts[:-1], mute], wires, [Fault("joint_friction", "joint_1", 0)], TICK, COUNTS, SPEED_LIMIT)
    assert str(refusal.value) == (
        "[[fault]] 1: joint_friction writes parameters.b_j_added in the memory of component 'plant', which has none; "
        "remove the fault or use the native plant"
    )
