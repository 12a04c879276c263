import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.experiment.quantity import in_si
from twin.recording.logs.errors import LogRefused
from twin.recording.logs.units import known_unit, unit


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
    found = unit(text, "here")
    assert found.si == si
    assert found.in_si(1.0) == pytest.approx(one, rel=1e-15)  # one rounding


@given(
    st.sampled_from(["mm", "ms", "N", "deg", "mm_per_s", "Nm", "deg_per_s"]),
    st.floats(-1e6, 1e6, allow_subnormal=False),
)
def test_a_column_and_a_toml_key_of_one_unit_agree(text: str, value: float):
    # two roundings of deg
    assert unit(text, "").in_si(value) == pytest.approx(in_si(value, text), rel=4e-16, abs=0.0)


def test_a_frequency_is_no_angular_speed():
    assert unit("Hz", "").dimension != unit("rad/s", "").dimension


@pytest.mark.parametrize("text", ["", "N/", "/", "lbs", "m m m x", "per"])
def test_what_is_no_unit_is_none(text: str):
    assert known_unit(text) is None


def test_an_unknown_unit_is_refused_with_the_nearest():
    with pytest.raises(LogRefused, match=r"a.csv: column 'F': unknown unit 'kgff'; did you mean 'kgf'\?"):
        unit("kgff", "a.csv: column 'F'")
