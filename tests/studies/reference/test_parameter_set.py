from pathlib import Path

import pytest

from twin.cosim.ssp.ssv import parameter_set
from twin.drive.description import FmuDescription, described
from twin.errors import InputRefused
from twin.studies.reference.parameter_set import settings

SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"


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
    given = [real("J_m", "1e-4"), real("omega_max", "60", "rpm")]
    with pytest.raises(InputRefused, match="T_m in 'ms'; expected 's'"):
        settings(parameter_set(ssv(real("T_m", "20", "ms"), *given), "x"), servo, "x")
    assert settings(parameter_set(ssv(*given), "x"), servo, "x") == pytest.approx(
        {"J_m": 1e-4, "omega_max": 6.283185307179586}
    )


def test_a_unit_that_the_file_defines_is_converted_by_what_it_says(servo: FmuDescription):
    unit = '<ssc:Unit name="ms"><ssc:BaseUnit s="1" factor="0.001"/></ssc:Unit>'
    file = ssv(real("T_m", "20", "ms")).replace(
        b"</ssv:ParameterSet>",
        f'<ssv:Units xmlns:ssc="{SSC}">{unit}</ssv:Units></ssv:ParameterSet>'.encode(),
    )
    assert settings(parameter_set(file, "x"), servo, "x") == {"T_m": 0.02}


def test_names_and_values_that_the_fmu_does_not_know_are_refused(servo: FmuDescription):
    for parameter, told in (
        (real("drop", "1"), "no parameter 'drop' in velocity_servo.fmu; did you mean 'droop'?"),
        (real("omega_m", "1"), "no parameter 'omega_m'"),
        (real("J_m", "-1"), "J_m = -1: expected 1e-09"),
        (real("J_m", "1", "N.m"), "J_m in 'N.m'; expected 'kg.m2'"),
        (real("J_m", "1 2 3"), "J_m: 3 values; expected 1"),
        ('name="J_m"><ssv:String value="1"/>', "J_m"),
        ('name="J_m"><ssv:Binary value="00"/>', "J_m is binary"),
        ('name="J_m"><ssv:String value="file:/etc/passwd"/>', "may not name files of this machine"),
    ):
        with pytest.raises(InputRefused, match=r"a\.ssv: ") as refused:
            settings(parameter_set(ssv(parameter), "a.ssv"), servo, "a.ssv")
        assert told in str(refused.value)
