from pathlib import Path

import pytest

from twin.drive.description import FmuDescription, described
from twin.errors import InputRefused
from twin.studies.reference.parameter_set import parameter_set, settings


@pytest.fixture(scope="module")
def servo(root: Path) -> FmuDescription:
    return described(root / "fmus" / "velocity_servo" / "velocity_servo.fmu")


def ssv(*parameters: str) -> bytes:
    listed = "".join(f"<ssv:Parameter {one}</ssv:Parameter>" for one in parameters)
    return (
        '<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" '
        f'name="p"><ssv:Parameters>{listed}</ssv:Parameters></ssv:ParameterSet>'
    ).encode()


def real(name: str, value: str, unit: str = "") -> str:
    return f'name="{name}"><ssv:Real value="{value}" unit="{unit}"/>'


def test_values_are_in_the_units_of_the_fmu(servo: FmuDescription):
    found = parameter_set(ssv(real("T_m", "20", "ms"), real("J_m", "1e-4"), real("omega_max", "60", "rpm")), "x")
    with pytest.raises(InputRefused, match="T_m in 'ms'; expected 's'"):
        settings(found, servo, "x")
    del found["T_m"]
    assert settings(found, servo, "x") == pytest.approx({"J_m": 1e-4, "omega_max": 6.283185307179586})


def test_whole_numbers_and_truth_values_are_numbers():
    given = [
        'name="a"><ssv:Integer value="-3"/>',
        'name="b"><ssv:Boolean value="true"/>',
        'name="c"><ssv:UInt8 value="7"/>',
    ]
    assert [one.value for one in parameter_set(ssv(*given), "x").values()] == [-3.0, 1.0, 7.0]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (ssv(real("a", "1"), real("a", "2")), "given twice, a"),
        (ssv(real("", "1")), "without a name"),
        (ssv('name="a">'), "without one value, a"),
        (ssv(real("a", "NaN")), "a: Real 'NaN'; expected one finite number"),
        (ssv(real("a", "1e999")), "a: Real '1e999'"),
        (ssv(real("a", "1 2 3")), "a: Real '1 2 3'"),
        (ssv('name="a"><ssv:Integer value="1.5"/>'), "a: Integer '1.5'"),
        (ssv(f'name="a"><ssv:Integer value="{"9" * 400}"/>'), "a: Integer '999"),
        (ssv('name="a"><ssv:Boolean value="yes"/>'), "a: Boolean 'yes'"),
        (ssv('name="a"><ssv:String value="1"/>'), "a: String '1'"),
        (b"<other/>", "expected <ParameterSet>"),
    ],
)
def test_what_is_no_single_number_is_refused(content: bytes, told: str):
    with pytest.raises(InputRefused, match="x: ") as refused:
        parameter_set(content, "x")
    assert told in str(refused.value)


def test_names_and_values_that_the_fmu_does_not_know_are_refused(servo: FmuDescription):
    for parameter, told in (
        (real("drop", "1"), "no parameter 'drop' in velocity_servo.fmu; did you mean 'droop'?"),
        (real("omega_m", "1"), "no parameter 'omega_m'"),
        (real("J_m", "-1"), "J_m = -1: expected 1e-09"),
        (real("J_m", "1", "N.m"), "J_m in 'N.m'; expected 'kg.m2'"),
    ):
        with pytest.raises(InputRefused, match=r"a\.ssv: ") as refused:
            settings(parameter_set(ssv(parameter), "a.ssv"), servo, "a.ssv")
        assert told in str(refused.value)
