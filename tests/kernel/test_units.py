"""Units."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.units import (
    CURRENT,
    FORCE,
    POWER,
    TEMPERATURE,
    TORQUE,
    VOLTAGE,
    Dimension,
    Unit,
    known_unit,
    parse_float,
    weight_hint,
)


def unit(text: str) -> Unit:
    found = known_unit(text)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("text", "si", "one"),
    [
        ("mm", "m", 1e-3),
        ("ms", "s", 1e-3),
        ("us", "s", 1e-6),
        ("Nm", "N m", 1.0),
        ("N m", "N m", 1.0),
        ("N*m", "N m", 1.0),
        ("mNm", "N m", 1e-3),
        ("kgf", "N", 9.80665),
        ("deg", "rad", math.pi / 180),
        ("deg/s", "rad/s", math.pi / 180),
        ("rpm", "rad/s", 2 * math.pi / 60),
        ("rev/min", "rad/s", 2 * math.pi / 60),
        ("rad_per_s", "rad/s", 1.0),
        ("mm/s^2", "m/s2", 1e-3),
        ("m/s2", "m/s2", 1.0),
        ("kg m/s2", "N", 1.0),
        ("N/mm", "N/m", 1e3),
        ("Nm/rad", "N m/rad", 1.0),
        ("mA", "A", 1e-3),
        ("V", "V", 1.0),
        ("K", "K", 1.0),
        ("%", "1", 0.01),
        ("1", "1", 1.0),
        ("1/min", "1/s", 1 / 60),
    ],
)
def test_a_unit_is_worth_what_the_si_says(text: str, si: str, one: float):
    found = unit(text)
    assert found.si == si
    assert found.in_si(1.0) == pytest.approx(one, rel=1e-15)  # one rounding


@pytest.mark.parametrize(
    ("value", "text", "si"),
    [
        (-101.0, "mm", -0.101),
        (113.9, "mm", 0.1139),
        (2.0, "ms", 0.002),
        (40.0, "g", 0.04),
        (1250.0, "N_per_m", 1250.0),
        (2.0, "mm_per_N", 0.002),
        (0.5, "mm_per_N_s", 0.0005),
        (3.0, "s_per_m", 3.0),
        (5e-3, "Nm_s_per_rad", 5e-3),
        (180.0, "deg", math.pi),
        (2e-5, "kg_m2", 2e-5),
    ],
)
def test_a_value_is_the_float_that_its_literal_in_si_would_be(value: float, text: str, si: float):
    # exact: the literal in metres is the correctly rounded quotient
    assert unit(text).in_si(value) == si


@given(st.floats(-1e6, 1e6))
def test_degrees_become_radians_as_everywhere_in_python(value: float):
    assert unit("deg").in_si(value) == math.radians(value)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=4))
def test_arrays_are_converted_item_by_item(values: list[float]):
    assert unit("mm").in_si((tuple(values),)) == (tuple(value / 1000 for value in values),)


def test_per_degree_is_the_reciprocal_of_degrees():
    assert unit("N_per_deg").in_si(1.0) == pytest.approx(180.0 / math.pi, rel=1e-15)


@pytest.mark.parametrize(
    ("dimension", "base"),
    [
        (FORCE, "kg m/s2"),
        (TORQUE, "kg m2/s2"),
        (POWER, "kg m2/s3"),
        (VOLTAGE, "W/A"),
        (CURRENT, "A"),
        (TEMPERATURE, "K"),
    ],
)  # fmt: skip
def test_a_derived_unit_is_what_the_si_makes_it_of(dimension: Dimension, base: str):
    assert unit(base).dimension == dimension


def test_a_frequency_is_no_angular_speed():
    assert unit("Hz").dimension != unit("rad/s").dimension


@pytest.mark.parametrize("text", ["", "N/", "/", "lbs", "m m m x", "per"])
def test_what_is_no_unit_is_none(text: str):
    assert known_unit(text) is None


@pytest.mark.parametrize(
    ("got", "wanted", "hinted"),
    [
        ("g", "N", True),
        ("kg", "N", True),
        ("kg/mm", "N/m", True),
        ("kg m", "N m", True),
        ("mm", "N", False),
        ("N", "N", False),
        ("g", "m", False),
        ("g", "kg", False),
    ],
)
def test_grams_of_a_force_are_answered_with_the_unit_that_was_meant(got: str, wanted: str, hinted: bool):
    hint = weight_hint(unit(got).dimension, unit(wanted).dimension)
    assert hint.endswith("did you mean gf (or kgf)?") if hinted else hint == ""
    # what is offered is such a unit
    assert unit("gf").dimension == unit("kgf").dimension == FORCE


@given(st.floats(), st.sampled_from(["{!r}", "{:+e}", " {!r}\t", "\u00a0{!r}"]))
def test_what_python_prints_is_read_again(number: float, form: str):
    read = parse_float(form.format(number))
    assert read is not None and (math.isnan(read) if math.isnan(number) else read == float(form.format(number)))


@pytest.mark.parametrize("text", ["", "1_0", "_1", "0x10", "1,5", "\u0661", "\uff11", "1e1_0", "\u22125", "1 0", "one"])
def test_text_that_is_no_plain_number_is_none(text: str):
    assert parse_float(text) is None
