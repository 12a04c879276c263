"""Units of variables, and values that have names."""

import math
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.kernel.fmi.archives import redescribed
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.description import described
from twin.kernel.fmi.variable import KNOWN_UNITS, RAD_PER_TURN, SPEED_DIMENSION, conversion
from twin.kernel.units import CURRENT, NUMBER, POWER, TEMPERATURE, TORQUE, VOLTAGE, Dimension
from twin.robot.assembly.drives import plan_drive
from twin.robot.experiment.drive_files import load_drive

BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


def defined(name: str, factor: float = 1.0, offset: float = 0.0, **exponents: int) -> SimpleNamespace:
    """A unit definition as FMPy reads it."""
    base = SimpleNamespace(**{b: exponents.get(b, 0) for b in BASES}, factor=factor, offset=offset)
    return SimpleNamespace(name=name, baseUnit=base)


def times_pi(numerator: int, denominator: int = 1) -> float:
    return float(Fraction(numerator, denominator)) * math.pi


BY_DEFINITION = {
    "1": (NUMBER, 1.0), "": (NUMBER, 1.0), "rad": (NUMBER, 1.0),
    # a turn is 2 pi rad, 360 degrees
    **dict.fromkeys(("rev", "r", "turn"), (NUMBER, times_pi(2))),
    **dict.fromkeys(("deg", "degree", "\N{DEGREE SIGN}"), (NUMBER, times_pi(1, 180))),
    "rad/s": (SPEED_DIMENSION, 1.0),
    "deg/s": (SPEED_DIMENSION, times_pi(1, 180)),
    # turns per second, and per 60 seconds
    **dict.fromkeys(("rev/s", "r/s", "rps", "Hz"), (SPEED_DIMENSION, times_pi(2))),
    "kHz": (SPEED_DIMENSION, times_pi(2000)),
    **dict.fromkeys(("rpm", "1/min", "rev/min", "r/min", "U/min"), (SPEED_DIMENSION, times_pi(1, 30))),
    # a centimetre is a hundredth, milli a thousandth
    **dict.fromkeys(("N.m", "N m", "Nm", "N*m"), (TORQUE, 1.0)),
    **dict.fromkeys(("N.cm", "Ncm"), (TORQUE, 1 / 100)),
    **dict.fromkeys(("mN.m", "mN m", "mNm", "mN*m"), (TORQUE, 1 / 1000)),
    "A": (CURRENT, 1.0), "mA": (CURRENT, 1 / 1000),
    "W": (POWER, 1.0),
    "V": (VOLTAGE, 1.0), "mV": (VOLTAGE, 1 / 1000),
    # the only ones with another zero
    **dict.fromkeys(("K", "degC", "\N{DEGREE SIGN}C"), (TEMPERATURE, 1.0)),
}  # fmt: skip
"""Dimension, and the SI value of one of each: SI Brochure, 9th edition."""


@pytest.mark.parametrize("unit", sorted({*KNOWN_UNITS, *BY_DEFINITION}))
def test_a_well_known_name_means_what_the_si_says(unit: str):
    dimension, one = BY_DEFINITION[unit]
    found = conversion(unit, [])
    assert found is not None and found.dimension == dimension
    # rounding of pi and of one product
    assert found.factor == pytest.approx(one, rel=1e-15)
    assert found.offset == (273.15 if "C" in unit else 0.0)


def test_hertz_counts_turns_though_it_is_defined_as_one_per_second():
    assert conversion("Hz", [defined("Hz", s=-1)]) == conversion("rev/s", [])


def test_an_energy_is_no_torque_though_it_has_the_same_base_units():
    assert conversion("N.m", [defined("N.m", kg=1, m=2, s=-2)]) == conversion("N.m", [])
    assert conversion("J", [defined("J", kg=1, m=2, s=-2)]) is None


def test_the_models_own_definition_decides():
    definition = defined("tick", factor=0.5, rad=1, s=-1)
    assert conversion("tick", [definition]) == (SPEED_DIMENSION, 0.5, 0.0)


def test_a_temperature_in_celsius_has_an_offset():
    found = conversion("degC", [defined("degC", offset=273.15, K=1)])
    assert found is not None and found.dimension == TEMPERATURE
    assert 25.0 * found.factor + found.offset == 298.15


def test_rpm_defined_as_a_frequency_still_counts_turns():
    found = conversion("rpm", [defined("rpm", factor=1 / 60, s=-1)])
    assert found is not None and math.isclose(found.factor, RAD_PER_TURN / 60)


def test_a_unit_nobody_knows_is_none():
    assert conversion("furlong", []) is None


def test_the_radian_does_not_tell_dimensions_apart():
    assert conversion("w", [defined("w", s=-1)]) == conversion("w", [defined("w", s=-1, rad=1)])


def test_a_well_known_name_defined_as_something_else_is_what_the_model_says():
    # as many times less as a turn has radians, but per second squared: no speed, whatever it is called
    found = conversion("rpm", [defined("rpm", factor=1 / 60, s=-2)])
    assert found == (Dimension(s=-2), 1 / 60, 0.0)


SIMPLE = '<TypeDefinitions><SimpleType name="Mode"><Enumeration>{}</Enumeration></SimpleType></TypeDefinitions>'
ITEMS = '<Item name="speed" value="3"/><Item name="torque" value="5"/><Item name="broken" value="x"/>'
TYPES = {
    "velocity_servo": SIMPLE.format(ITEMS),
    "torque_motor_fmi3": f'<TypeDefinitions><EnumerationType name="Mode">{ITEMS}</EnumerationType></TypeDefinitions>',
}
VARIABLE = {
    "velocity_servo": '<ScalarVariable name="mode" valueReference="99" causality="parameter" variability="fixed">'
    '<Enumeration declaredType="Mode" start="3"/></ScalarVariable>',
    "torque_motor_fmi3": '<Enumeration name="mode" valueReference="99" causality="parameter" variability="fixed" '
    'declaredType="Mode" start="3"/>',
}


@pytest.fixture(params=TYPES)
def moded(request: pytest.FixtureRequest, root: Path, tmp_path: Path) -> Path:
    """A drive of FMI 2 and one of FMI 3 with a parameter `mode`, speed or torque."""
    name = request.param
    typed = redescribed(
        root / "fmus" / name / f"{name}.fmu", tmp_path / "typed.fmu", "<LogCategories>", f"{TYPES[name]}<LogCategories>"
    )
    return redescribed(typed, tmp_path / "moded.fmu", "</ModelVariables>", f"{VARIABLE[name]}</ModelVariables>")


@pytest.mark.parametrize(("said", "value"), [("speed", 3.0), ("torque", 5.0), (5, 5.0), (3.0, 3.0)])
def test_a_value_is_said_by_its_name_or_its_number(moded: Path, said: str | float, value: float):
    ((variable, settled),) = described(moded).settings({"mode": said})
    assert (variable.name, settled) == ("mode", value)


@pytest.mark.parametrize(
    ("said", "sentence"),
    [
        ("torqe", "parameter mode = 'torqe': did you mean 'torque'?"),
        ("x", "parameter mode = 'x': expected one of speed (3), torque (5)"),
        (4, "parameter mode = 4: expected one of speed (3), torque (5)"),
        (float("nan"), "parameter mode = nan: expected one of speed (3), torque (5)"),
        ("broken", "parameter mode = 'broken': expected one of speed (3), torque (5)"),
    ],
)
def test_what_is_no_value_is_refused_with_those_there_are(moded: Path, said: str | float, sentence: str):
    with pytest.raises(InputRefused) as refused:
        described(moded).settings({"mode": said})
    assert str(refused.value) == f"{moded}: {sentence}"


def test_a_name_is_no_number_of_another_parameter(root: Path):
    with pytest.raises(InputRefused, match=r"parameter droop = 'much': expected a number; .* no values with names"):
        described(root / "fmus/velocity_servo/velocity_servo.fmu").settings({"droop": "much"})


def test_a_name_may_stand_in_a_mapping(moded: Path):
    mapping = moded.with_name("mapping.toml")
    loop = "[velocity_loop]\nkp = 1.0\nki = 1.0\nlimit = 1.0\nperiod_ms = 1.0\n"
    torque = "tau_cmd" in described(moded).variables
    command = 'command = "torque"\n' if torque else ""
    mapping.write_text(f'fmu = "moded.fmu"\n{command}[parameters]\nmode = "torque"\n{loop if torque else ""}')
    plan = plan_drive(load_drive(str(mapping), mapping.parent))
    ((variable, value),) = plan.settings[""]
    assert isinstance(value, float)
    assert (variable.name, variable.format_value(value)) == ("mode", "torque")
