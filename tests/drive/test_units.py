import math
from types import SimpleNamespace

import pytest

from twin.drive.units import NUMBER, SPEED, TEMPERATURE, TORQUE, TURN, conversion

BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


def defined(name: str, factor: float = 1.0, offset: float = 0.0, **exponents: int) -> SimpleNamespace:
    """A unit definition as FMPy reads it."""
    base = SimpleNamespace(**{b: exponents.get(b, 0) for b in BASES}, factor=factor, offset=offset)
    return SimpleNamespace(name=name, baseUnit=base)


@pytest.mark.parametrize(
    ("unit", "dimension", "factor"),
    [("rpm", SPEED, TURN / 60), ("deg", NUMBER, TURN / 360), ("mNm", TORQUE, 1e-3), ("rad/s", SPEED, 1.0)],
)
def test_well_known_names_need_no_definition(unit: str, dimension, factor: float):
    assert conversion(unit, []) == (dimension, factor, 0.0)


def test_the_models_own_definition_decides():
    definition = defined("tick", factor=0.5, rad=1, s=-1)
    assert conversion("tick", [definition]) == (SPEED, 0.5, 0.0)


def test_a_temperature_in_celsius_has_an_offset():
    found = conversion("degC", [defined("degC", offset=273.15, K=1)])
    assert found is not None and found.dimension == TEMPERATURE
    assert 25.0 * found.factor + found.offset == 298.15


def test_rpm_defined_as_a_frequency_still_counts_turns():
    found = conversion("rpm", [defined("rpm", factor=1 / 60, s=-1)])
    assert found is not None and math.isclose(found.factor, TURN / 60)


def test_a_unit_nobody_knows_is_none():
    assert conversion("furlong", []) is None


def test_the_radian_does_not_tell_dimensions_apart():
    assert conversion("w", [defined("w", s=-1)]) == conversion("w", [defined("w", s=-1, rad=1)])
