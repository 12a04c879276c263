"""Parts with one input and one output, as other tools export them, behind ports of three values."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.fmi.archives import DESCRIPTION, altered
from tests.laws.runs import FORCE, shipped
from twin.kernel.cosim.delay import play, values_by_port
from twin.kernel.cosim.port import port_slices, width
from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import read
from twin.robot.assembly.roles import ROLE_CONTRACTS, SampledFmu, sampled_fmu
from twin.robot.run.run import execute

SISO = {
    'name="omega_ref"': 'name="u"',
    'name="omega_m"': 'name="y"',
    'name="tau_load" valueReference="1" causality="input"': 'name="unused" valueReference="1" causality="local"',
    'name="theta_m" valueReference="2" causality="output"': 'name="sum" valueReference="2" causality="local"',
    '<Real start="0.0" unit="rad/s" />': '<Real start="0.0" />',
    '<Unknown index="3" dependencies="" />': "",
}


@pytest.fixture
def siso(root: Path, tmp_path: Path) -> Path:
    """y = u, without units."""

    def change(name: str, content: bytes) -> tuple[str, bytes]:
        text = content.decode() if name == DESCRIPTION else ""
        for old, new in SISO.items() if text else ():
            assert old in text, old
            text = text.replace(old, new)
        return name, text.encode() or content

    return altered(root / "fmus" / "ideal_velocity" / "ideal_velocity.fmu", tmp_path / "siso.fmu", change)


def planned(file: Path, inputs: Any, outputs: Any, role: str = "controller") -> SampledFmu:
    contract = ROLE_CONTRACTS[role]
    ports = (contract.inputs, contract.outputs)
    return sampled_fmu(file, role, ports, contract.required, (inputs, outputs), {}, None)


def test_it_hears_one_of_three_values_and_gives_one_the_others_are_0(siso: Path):
    plan = planned(siso, {"F_ee_B[2]": "-u"}, {"omega_ref[1]": "y"})
    assert plan.missing_inputs == ("F_ee_B[0]", "F_ee_B[1]") and plan.missing_outputs == (
        "omega_ref[0]",
        "omega_ref[2]",
    )
    part = plan.part("controller", 1e-3, 1, 10)
    try:
        assert [port.name for port in part.outputs] == ["omega_ref"]
        u = np.zeros((4, width(part.inputs)))
        u[:, port_slices(part.inputs)["F_ee_B"]] = np.arange(12).reshape(4, 3)
        rows, status = play(part, 1e-3 * np.arange(4.0), np.full(4, 1e-3), u)
        assert status == 0
        np.testing.assert_array_equal(
            values_by_port(part.outputs, rows)["omega_ref"], [[0, -2, 0], [0, -5, 0], [0, -8, 0], [0, -11, 0]]
        )
    finally:
        part.close()


def test_a_run_and_its_recording_say_which_values_are_0(siso: Path, tmp_path: Path):
    # a scale of one value in the robot's direction, and a controller of one joint
    scale = [f"scale.fmu={siso}", 'scale.inputs."F_ee_B[2]"="-u"', 'scale.outputs.F_z="y"']
    law = [f"controller.fmu={siso}", 'controller.inputs."F_ee_B[2]"="u"', 'controller.outputs."omega_ref[0]"="y"']
    run = execute(shipped(FORCE, "duration_s=0.1", *scale, *law), tmp_path / "run")
    recording = read(run.recording)
    assert "it does not give omega_ref[1], omega_ref[2], taken as 0" in run.parts["controller"]
    assert "taken as 0" not in run.parts["scale"]
    facts = json.loads(recording.metadata["fmu"]["controller"])
    assert facts["mapped"] == [
        "F_ee_B[2] <- u [unit not stated]",
        "omega_ref[0] -> y [unit not stated]",
        "omega_ref[1] = 0, as it does not give it",
        "omega_ref[2] = 0, as it does not give it",
    ]
    np.testing.assert_array_equal(recording["controller.omega_ref"][:, 0], recording["estimator.F_ee_B"][:, 2])
    assert not np.any(recording["controller.omega_ref"][:, 1:])
    at = np.rint(1e3 * recording.time("scale")).astype(int)
    np.testing.assert_array_equal(recording["scale.F_z"], -recording["plant.F_ee_B"][at, 2])


@pytest.mark.parametrize(
    ("inputs", "outputs", "said"),
    [
        ({"F_ee_B[3]": "u"}, {"omega_ref[0]": "y"}, "'F_ee_B[3]': F_ee_B has 3 values, counted from 0"),
        ({"F_ee[2]": "u"}, {"omega_ref[0]": "y"}, "no input 'F_ee[2]'; did you mean 'F_ee_B'"),
        ({"F_ee_B[2]": ("u", "u")}, {"omega_ref[0]": "y"}, "it is one value; expected one variable"),
        (
            {"F_ee_B[2]": "u"},
            {"omega_ref[0]": "y", "omega_ref": "y"},
            "omega_ref is mapped as a whole, too; remove one",
        ),
        ({"F_ee_B[2]": "u"}, {}, "which of its outputs is omega_ref"),
        ({}, {"omega_ref[0]": "y"}, "nothing feeds its input u; map it in [controller.inputs]"),
        ({"F_ee_B[2]": "v"}, {"omega_ref[0]": "y"}, "has no variable 'v'"),
    ],
)
def test_a_mapping_of_single_values_that_cannot_be_right_is_refused(siso: Path, inputs: Any, outputs: Any, said: str):
    with pytest.raises(InputRefused, match=re.escape(said)):
        planned(siso, inputs, outputs)
