from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.mistakes import error_messages
from twin.robot.plant.contact_law import Contact

SCALE: dict[str, Any] = {
    "kind": "scale",
    "height_mm": -101.0,
    "tilt_deg": 0.0,
    "stiffness_N_per_m": 1250.0,
    "damping_s_per_m": 3.0,
    "friction": 0.22,
    "bristle_N_per_m": 4000.0,
    "bristle_damping_N_s_per_m": 8.0,
}
BELLY = {**SCALE, "kind": "skin", "law": "kelvin_voigt", "damper_N_s_per_m": 15.0, "touch_depth_mm": 2.0}
del BELLY["damping_s_per_m"]


def mistakes(table: dict[str, Any], **changes: Any) -> list[str]:
    with pytest.raises(ValidationError) as refusal:
        Contact.model_validate({**table, **changes})
    return error_messages(refusal.value, Contact, "contact")


def test_a_table_of_before_is_a_level_hunt_crossley_plane_at_rest():
    contact = Contact.model_validate(SCALE)
    assert (contact.law, contact.shape, contact.tilt_x) == ("hunt_crossley", "plane", 0.0)
    assert contact.breathing is None and contact.shift is None
    assert contact.law_constants == {"damping": 3.0}


def test_values_are_si_inside():
    contact = Contact.model_validate(
        {
            **SCALE,
            "shape": "sphere",
            "radius_mm": 80.0,
            "tilt_x_deg": 30.0,
            "law": "exponential",
            "stiffening_per_mm": 0.2,
            "breathing": {"amplitude_mm": 2.0, "rate_per_min": 15.0},
            "shift": {"by_mm": (1.0, 0.0, -4.0), "start_s": 2.0, "rise_s": 0.5, "end_s": 6.0},
        }
    )
    assert (contact.radius, contact.tilt_x) == (0.08, np.radians(30.0))
    assert contact.law_constants == {"damping": 3.0, "stiffening": 200.0}
    breathing, shift = contact.breathing, contact.shift
    assert breathing is not None and shift is not None
    assert (breathing.amplitude, breathing.rate, breathing.start, breathing.end) == (0.002, 0.25, 0.0, None)
    assert (shift.by, shift.rise, shift.start, shift.end) == ((0.001, 0.0, -0.004), 0.5, 2.0, 6.0)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"law": "kelvin_voigt", "damping_s_per_m": None, "touch_depth_mm": 1.0}, "needs damper_N_s_per_m"),
        (
            {"law": "kelvin_voigt", "damper_N_s_per_m": 9.0, "touch_depth_mm": 1.0},
            '[contact] law = "kelvin_voigt": does not know damping_s_per_m; remove it or name the law it belongs to',
        ),
        ({"law": "exponential"}, '[contact] law = "exponential": needs stiffening_per_mm'),
        ({"damper_N_s_per_m": 9.0}, '[contact] law = "hunt_crossley": does not know damper_N_s_per_m'),
        ({"exponent": 1.5}, '[contact] law = "hunt_crossley": needs reference_depth_mm'),
        ({"shape": "sphere"}, "[contact] shape = \"sphere\": missing key 'radius_mm'"),
        ({"radius_mm": 50.0}, '[contact] shape = "plane": has no radius; remove radius_mm'),
        ({"kind": "skin", "stiffness_N_per_m": 0.0}, "[contact] stiffness_N_per_m = 0.0: a skin that does not resist"),
        ({"breathing": {"amplitude_mm": 2.0}}, "[contact.breathing] missing key 'rate_per_min'"),
        (
            {"shift": {"by_mm": (0.0, 0.0, 1.0), "start_s": 3.0, "rise_s": 0.0}},
            "[contact.shift] rise_s = 0.0: expected a number > 0",
        ),
        (
            {"breathing": {"amplitude_mm": 2.0, "rate_per_min": 12.0, "start_s": 3.0, "end_s": 2.0}},
            "ends at 2 s, before it starts at 3 s",
        ),
        ({"law": "hooke"}, "[contact] law = \"hooke\": expected 'hunt_crossley', 'kelvin_voigt'"),
        ({"exponent": 0.5, "reference_depth_mm": 5.0}, "[contact] exponent = 0.5: expected a number >= 1"),
    ],
)
def test_contradictions_are_told_in_one_sentence(changes, told):
    (sentence,) = mistakes(SCALE, **changes)
    assert told in sentence


def test_a_value_that_is_refused_is_not_also_called_missing():
    (sentence,) = mistakes(BELLY, damper_N_s_per_m=-1.0)
    assert sentence == "[contact] damper_N_s_per_m = -1.0: expected a number >= 0"


def test_every_kind_may_follow_every_law():
    for kind in ("scale", "skin"):
        assert Contact.model_validate({**BELLY, "kind": kind}).law_constants == {"damper": 15.0, "touch_depth": 0.002}


def test_a_scale_without_stiffness_is_free_air():
    assert Contact.model_validate({**SCALE, "stiffness_N_per_m": 0.0}).stiffness == 0.0


def test_laws_are_set_from_the_command_line(root: Path):
    fig4 = root / "experiments" / "fig4_force_position.toml"
    contact = load_experiment(fig4, ["contact.law=exponential", "contact.stiffening_per_mm=0.1"]).contact
    assert contact.law_constants == {"damping": 3.0, "stiffening": 100.0}
