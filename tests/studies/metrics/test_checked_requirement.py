"""What no run can be held to is refused before one."""

import pytest

from twin.errors import InputRefused
from twin.recording.layout import Field
from twin.studies.metrics.checked_requirement import checked_requirement

FIELDS = {
    "plant.F_ee_B": Field("F_ee_B", 3, "double", "N", ""),
    "plant.p_B": Field("p_B", 3, "double", "m", ""),
    "controller.F_z": Field("F_z", 1, "double", "N", ""),
    "controller.omega_ref": Field("omega_ref", 3, "double", "rad/s", ""),
    "controller.triggered": Field("triggered", 1, "bool", "1", ""),
}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("always (plant.F_ee <= 18 N)", r"no such signal as plant.F_ee; did you mean 'plant.F_ee_B'"),
        ("always (|plant.F_ee_B| <= 18)", "N beside 1; expected the same unit"),
        ("always (|plant.F_ee_B| <= 18 mm)", "N beside m"),
        ("always (plant.F_ee_B <= 18 N)", r"a comparison of vectors; expected one component, x\[2\]"),
        ("always (1 N <= plant.F_ee_B)", "a comparison of vectors"),
        ("always (plant.F_ee_B[3] <= 18 N)", r"it has 3 components; expected \[0\] to \[2\]"),
        ("always (controller.F_z[0] <= 18 N)", "expected no index"),
        ("always (plant.p_B - controller.F_z <= 1 m)", "m beside N"),
        ("always (|plant.F_ee_B + controller.F_z| <= 1 N)", "a sum of 3 and 1 components"),
        ("controller.F_z", "is not true or false; expected a comparison"),
        ("1 N <= 2 N", "a comparison of numbers"),
        ("always (controller.F_z <= 9 N and plant.p_B[2] <= 0 mm)", "compares in N and in m"),
        ("alway (controller.F_z <= 9 N)", "unknown word 'alway'"),
    ],
)
def test_a_requirement_that_no_run_can_be_held_to_is_refused(text, told):
    with pytest.raises(InputRefused, match=told):
        checked_requirement(text, FIELDS)


def test_the_unit_of_a_distance_is_that_of_its_comparisons():
    assert checked_requirement("always (|controller.omega_ref| <= 30 rpm)", FIELDS)[1] == "rad/s"
    assert checked_requirement("eventually controller.triggered", FIELDS)[1] == "1"
