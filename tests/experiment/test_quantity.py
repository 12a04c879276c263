import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.experiment.quantity import in_si


@pytest.mark.parametrize(
    ("value", "unit", "si"),
    [
        (-101.0, "mm", -0.101),
        (113.9, "mm", 0.1139),
        (2.0, "ms", 0.002),
        (40.0, "g", 0.04),
        (1250.0, "N_per_m", 1250.0),
        (2.0, "mm_per_N", 0.002),
        (0.5, "mm_per_N_s", 0.0005),
        (3.0, "s_per_m", 3.0),
        (1.0, "Nm_per_rad", 1.0),
        (5e-3, "Nm_s_per_rad", 5e-3),
        (180.0, "deg", math.pi),
        (2e-5, "kg_m2", 2e-5),
    ],
)
def test_a_unit_in_the_key_becomes_si(value: float, unit: str, si: float):
    # exact: the literal in metres is the correctly rounded quotient
    assert in_si(value, unit) == si


def test_per_degree_is_the_reciprocal_of_degrees():
    assert in_si(1.0, "N_per_deg") == pytest.approx(180.0 / math.pi, rel=1e-15)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=4))
def test_arrays_are_converted_item_by_item(values: list[float]):
    assert in_si((tuple(values),), "mm") == (tuple(value / 1000 for value in values),)


def test_a_number_that_overflows_in_si_units_is_refused():
    with pytest.raises(ValueError, match="finite in SI units"):
        in_si(1e308, "per_mm")
