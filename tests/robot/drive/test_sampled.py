"""FMUs for sampled parts of the robot: which variable is which value of a port."""

import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.fmi.archives import altered
from twin.kernel.cosim.delay import play
from twin.kernel.errors import InputRefused
from twin.robot.assembly.roles import CONTRACTS
from twin.robot.drive.sampled import SampledFmu, sampled_fmu

WAY = {"p_ref_B": ("way_1", "way_2", "way_3")}
ARRAYS = """<?xml version="1.0"?>
<fmiModelDescription fmiVersion="3.0" modelName="arrays" instantiationToken="x">
<CoSimulation modelIdentifier="torque_motor_fmi3"/>
<UnitDefinitions>
<Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>
<Unit name="rad/s"><BaseUnit rad="1" s="-1"/></Unit>
</UnitDefinitions>
<ModelVariables>
<Float64 name="p_B" valueReference="1" causality="input" start="0 0 0" unit="mm"><Dimension start="3"/></Float64>
<Float64 name="jacobi" valueReference="2" causality="input" start="0 0 0 0 0 0 0 0 0"><Dimension start="3"/>
<Dimension start="3"/></Float64>
<Float64 name="n" valueReference="3" causality="output" unit="rad/s"><Dimension start="3"/></Float64>
<Boolean name="triggered" valueReference="4" causality="output"/>
</ModelVariables>
<ModelStructure><Output valueReference="3"/><Output valueReference="4"/></ModelStructure>
</fmiModelDescription>"""


@pytest.fixture
def law(root: Path) -> Path:
    return root / "fmus" / "parts" / "paper_law" / "paper_law.fmu"


def planned(file: Path, inputs: Any = WAY, outputs: Any = None, **parameters: float) -> SampledFmu:
    contract = CONTRACTS["controller"]
    ports, said = (contract.inputs, contract.outputs), (inputs, outputs or {})
    return sampled_fmu(file, "controller", ports, contract.required, said, parameters, None)


def with_description(law: Path, target: Path, old: str, new: str) -> Path:
    def edit(name: str, content: bytes) -> tuple[str, bytes]:
        if name == "modelDescription.xml":
            assert old.encode() in content
            content = content.replace(old.encode(), new.encode())
        return name, content

    return altered(law, target, edit)


def test_ports_of_several_values_are_found_by_the_names_that_tools_give_them(law: Path):
    plan = planned(law)
    assert [port.name for port in plan.inputs] == [port.name for port in CONTRACTS["controller"].inputs]
    assert {b.role.port.name: b.name for b in plan.bindings if b.name.startswith("J")} == {
        f"J[{n}]": f"J_{n}" for n in range(1, 10)
    }


@pytest.mark.parametrize("spelled", ["p_B[{}]", "p_B({})", "p_B{}"])
def test_other_ways_to_flatten_an_array_are_known(law: Path, tmp_path: Path, spelled: str):
    file = law
    for n in (1, 2, 3):
        file = with_description(file, tmp_path / f"{n}.fmu", f'"p_B_{n}"', f'"{spelled.format(n)}"')
    assert planned(file).inputs == planned(law).inputs


@pytest.mark.parametrize("spelled", ["J[{},{}]", "J({},{})", "J_{}{}"])
def test_a_matrix_may_be_flattened_with_row_and_column(law: Path, tmp_path: Path, spelled: str):
    file = law
    for n in range(9):
        file = with_description(
            file, tmp_path / f"{n}.fmu", f'"J_{n + 1}"', f'"{spelled.format(n // 3 + 1, n % 3 + 1)}"'
        )
    assert planned(file).inputs == planned(law).inputs


def test_arrays_of_fmi_3_are_ports_as_a_whole_and_units_become_si(root: Path, tmp_path: Path):
    good = root / "fmus" / "torque_motor_fmi3" / "torque_motor_fmi3.fmu"
    file = altered(
        good, tmp_path / "arrays.fmu", lambda n, c: (n, ARRAYS.encode() if n == "modelDescription.xml" else c)
    )
    plan = planned(file, {"J": "jacobi"}, {"omega_ref": "n"})
    assert [(p.name, p.size) for p in plan.inputs] == [("p_B", 3), ("J", 9)]
    assert [(p.name, p.size) for p in plan.outputs] == [("omega_ref", 3), ("triggered", 1)]
    assert plan.bindings[0].gain == pytest.approx(1e-3)
    with pytest.raises(InputRefused, match=r"p_B has 3 values, and \"jacobi\" 9; give one for each"):
        planned(file, {"p_B": "jacobi"}, {"omega_ref": "n"})


def test_a_list_of_one_variable_says_what_the_variable_says(law: Path):
    assert planned(law, outputs={"dp_z": ("dp_z",)}).bindings == planned(law, outputs={"dp_z": "dp_z"}).bindings


def test_an_input_that_has_been_given_a_value_keeps_it_and_is_fed_by_nobody(law: Path):
    plan = planned(law, way_1=0.0, way_2=0.01, way_3=-0.1)
    assert "p_ref_B" not in [port.name for port in plan.inputs]
    component = plan.component("controller", 1e-3, 2, 10)
    try:
        rows, status = play(component, np.zeros(1), np.full(1, 2e-3), np.zeros((1, 18)))
        assert status == 0
        assert rows[0, 3:6].tolist() == [0.0, 0.01, -0.1]
    finally:
        component.close()


def test_inputs_of_a_sampled_part_are_held_where_they_could_rise_over_a_step(law: Path, tmp_path: Path):
    able = with_description(law, tmp_path / "law.fmu", "<CoSimulation ", '<CoSimulation canInterpolateInputs="true" ')
    smooth = with_description(able, tmp_path / "smooth.fmu", ' variability="discrete"', "")
    component = planned(smooth).component("controller", 1e-3, 2, 10)
    try:
        inputs = component.instance.description.offered("input")
        assert inputs and not any(map(component.instance.ramps, inputs))
    finally:
        component.close()


def test_a_single_value_may_count_the_other_way(law: Path):
    plain, turned = planned(law), planned(law, outputs={"omega_ref": ("-omega_ref_1", "omega_ref_2", "omega_ref_3")})
    gains = [next(b.gain for b in plan.bindings if b.name == "omega_ref_1") for plan in (plain, turned)]
    assert gains == [1.0, -1.0]


@pytest.mark.parametrize(
    ("inputs", "outputs", "said"),
    [
        ({}, {}, "nothing feeds its inputs way_1, way_2, way_3; say which of ours it is in [controller.inputs]"),
        ({"p": "way_1"}, {}, "[controller.inputs] no input 'p'; did you mean 'p_B'"),
        (WAY, {"omega": "omega_ref_1"}, "[controller.outputs] no output 'omega'; did you mean 'omega_ref'"),
        (WAY, {"omega_ref": ("omega_ref_1",)}, "omega_ref has 3 values; 1 variables are given for it"),
        (WAY, {"omega_ref": "omega_ref_1"}, 'omega_ref has 3 values, and "omega_ref_1" 1; give one for each'),
        (WAY, {"omega_ref": ("dp_z", "omega_ref_2", "omega_ref_3")}, "output 'dp_z' has unit 'm'; omega_ref[1] needs"),
        (WAY, {"F_z": "F_zz"}, "has no variable 'F_zz' for F_z; its outputs are omega_ref_1"),
        (WAY, {"F_z": "way_1"}, "'way_1' has causality input; F_z needs output"),
        (WAY | {"tau_l": ("tau_l_1", "tau_l_1", "tau_l_3")}, {}, "'tau_l_1' is given to tau_l[1] and tau_l[2]"),
    ],
)
def test_a_mapping_that_cannot_be_right_is_refused_in_a_sentence(law: Path, inputs: Any, outputs: Any, said: str):
    with pytest.raises(InputRefused, match=re.escape(said)):
        planned(law, inputs, outputs)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('name="p_B_1"', 'name="p_X_1"', 'p_B has 3 values, and "p_B_2", "p_B_3" 2; give one for each'),
        ('name="omega_ref_1"', 'name="speed"', "which of its outputs is omega_ref (commanded motor speeds, 3 x rad/s)"),
        ('unit="rad/m"', 'unit="rad/s"', "input 'J_1' has unit 'rad/s'; J[1] needs one like rad/m"),
        ("CoSimulation", "ModelExchange", "model exchange alone; a part is called at its samples"),
    ],
)
def test_an_fmu_that_does_not_fit_the_part_is_refused(law: Path, tmp_path: Path, old: str, new: str, said: str):
    file = with_description(law, tmp_path / "odd.fmu", old, new)
    with pytest.raises(InputRefused, match=re.escape(said)):
        planned(file)


def test_counts_have_no_unit(law: Path, tmp_path: Path):
    with zipfile.ZipFile(law) as archive:
        text = archive.read("modelDescription.xml").decode()
    line = next(part for part in text.split("<ScalarVariable") if 'name="triggered"' in part)
    file = with_description(law, tmp_path / "odd.fmu", line, line.replace('unit="1"', 'unit="deg"'))
    with pytest.raises(InputRefused, match="'triggered' has unit 'deg'; triggered has none"):
        planned(file)


def test_a_sampled_part_is_called_at_its_samples_and_told_when_the_last_step_ends(law: Path, monkeypatch: Any):
    told = []
    from twin.kernel.fmi import component

    class Told(component.CosimInstance):
        def __init__(self, *args: Any) -> None:
            told.append(args[-1].stop)
            super().__init__(*args)

    monkeypatch.setattr(component, "CosimInstance", Told)
    made = planned(law).component("controller", 1e-3, 2, 101)
    made.close()
    assert (made.sampled, made.period, told) == (True, 2, [100 * 1e-3 + 2 * 1e-3])
