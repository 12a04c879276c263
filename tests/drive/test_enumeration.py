"""Parameters whose values have names."""

from pathlib import Path

import pytest

from tests.drive.archives import redescribed
from twin.drive.description import described
from twin.errors import InputRefused
from twin.experiment.drive_files import lone_drive
from twin.runs.assembly.drives import planned

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
    plan = planned(lone_drive(str(mapping), mapping.parent))
    ((variable, value),) = plan.settings[""]
    assert isinstance(value, float)
    assert (variable.name, variable.told(value)) == ("mode", "torque")
