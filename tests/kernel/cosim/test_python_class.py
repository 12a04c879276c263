"""A user's class as a part of the robot: what it says is checked, what it returns is, and mistakes name the line."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from examples.native_component import lagging_drive
from examples.python_component import LaggingDrive, step_response
from tests.kernel.cosim.models import U, continuous, sampled
from twin.kernel.cosim.component import Component
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import NamedPorts, PythonComponent, PythonSource, declared_ports, make_instance
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, InputRefused


def test_the_example_reaches_its_reference_without_overshoot():
    t, theta_m = step_response()
    # the slowest pole of s (T_m s + 1) + kp is -13.8 1/s: after 1 s 1e-6 of the step is left
    assert theta_m[-1] == pytest.approx(0.5, abs=1e-5)
    assert np.all(np.diff(theta_m) >= 0.0)
    assert (t[0], t[-1], len(t)) == (0.0, 1.0, 1001)


def test_a_native_and_a_python_component_of_the_same_law_agree():
    def angles(drive):
        speed = sampled("speed", lambda t, h, u: 1.0 if t < 0.05 else -2.0)
        system = System([speed, drive], [("speed.y", f"{drive.name}.omega_ref")], 1e-3)
        return Simulation(system, 200).run()[:, 1]

    in_python = angles(PythonComponent("drive", LaggingDrive(T_m=0.02)))
    # two libraries' expm1 may differ in the last bit, 200 times over
    np.testing.assert_allclose(angles(lagging_drive("drive", 0.02)), in_python, rtol=0, atol=200 * 2**-52)
    assert np.ptp(in_python) > 0.1


def test_outputs_start_at_zero_unless_told_otherwise():
    assert continuous("a", lambda t, h, u: 0.0).initial_outputs.tolist() == [0.0]
    assert continuous("a", lambda t, h, u: 0.0, initial_outputs=[3.0]).initial("y").tolist() == [3.0]


def test_outputs_that_a_step_leaves_alone_keep_their_value():
    class Silent:
        inputs, outputs, sampled = (), continuous("a", lambda t, h, u: 0.0).outputs, False

        def step(self, t, h, u, y):
            pass

    system = System([PythonComponent("a", Silent(), initial_outputs=[3.0])], [], 1e-3)
    assert Simulation(system, 3).run().ravel().tolist() == [3.0] * 4


def test_a_component_can_take_part_in_one_simulation_after_another():
    part = continuous("a", lambda t, h, u: u + 1.0, U)
    for _ in range(3):
        rows = Simulation(System([part], [("a.y", "a.u")], 1e-3), 3).run()
        assert rows.ravel().tolist() == [0.0, 1.0, 2.0, 3.0]


def test_an_error_sentence_calls_a_python_component_by_its_class():
    assert continuous("a", lambda t, h, u: 0.0).label == "Model"


INPUTS = (Port("p", 3, "m"), Port("on", 1, "1", kind="bool"))
OUTPUTS = (Port("v", 3, "m/s"), Port("F", 1, "N"))
HEAD = """
class Part:
    inputs = ("p",)
    outputs = ("v",)
"""


def part_of(folder: Path, text: str, **parameters: float) -> Component:
    """The class Part of `text` as a component."""
    file = folder / "mine.py"
    file.write_text(text)
    source = PythonSource(file)
    kind = source.load_class("Part")
    wanted = declared_ports("mine.py:Part", kind, INPUTS, OUTPUTS, ("v",))
    return PythonComponent(
        "part", NamedPorts(make_instance("mine.py:Part", kind, parameters), *wanted), 2, label="mine.py:Part"
    )


def outputs_of(part: Component, ticks: int = 4) -> np.ndarray:
    """Rows of what `part` puts out where p is (1, 2, 3) t."""

    class Way:
        inputs = ()
        outputs = ("p", "on")

        def step(self, t: float, inputs: dict[str, Any]) -> dict[str, Any]:
            return {"p": np.array([1.0, 2.0, 3.0]) * t, "on": True}

    way = PythonComponent("way", NamedPorts(Way(), *declared_ports("Way", Way, INPUTS, INPUTS, ())))
    wires = [(f"way.{port.name}", f"part.{port.name}") for port in part.inputs]
    system = System([way, part], wires, 0.5)
    return Simulation(system, ticks).run()[:, system.columns(f"part.{part.outputs[0].name}")]


def test_a_step_gets_the_inputs_of_its_sample_and_its_outputs_hold_until_the_next(tmp_path: Path):
    part = part_of(tmp_path, HEAD + "    def step(self, t, inputs):\n        return {'v': inputs['p'] + t}\n")
    assert outputs_of(part)[:, 0].tolist() == [0.0, 0.0, 2.0, 2.0, 4.0]
    assert outputs_of(part)[4].tolist() == [4.0, 6.0, 8.0]


def test_units_of_a_class_become_si(tmp_path: Path):
    text = """
class Part:
    inputs = {"p": "mm"}
    outputs = {"v": "mm/s"}
    def step(self, t, inputs):
        return {"v": 2.0 * inputs["p"] / 1000.0 * 1000.0}
"""
    # mm in, mm/s out: numbers of both are 1000 times those in SI
    np.testing.assert_allclose(outputs_of(part_of(tmp_path, text))[4], [4.0, 8.0, 12.0], rtol=1e-15)


def test_what_a_step_keeps_of_its_inputs_stays_what_it_was(tmp_path: Path):
    text = HEAD + "    def __init__(self): self.seen = []\n    def step(self, t, inputs):\n"
    text += "        self.seen.append(inputs['p'])\n        return {'v': self.seen[0]}\n"
    assert outputs_of(part_of(tmp_path, text)).max() == 0.0


def test_parameters_make_the_instance(tmp_path: Path):
    text = HEAD + "    def __init__(self, k, d=1.0): self.k = k * d\n    def step(self, t, inputs):\n"
    text += "        return {'v': [self.k] * 3}\n"
    assert outputs_of(part_of(tmp_path, text, k=3.0))[0, 0] == 3.0
    with pytest.raises(InputRefused, match=r"mine.py:Part: no parameter 'q'; it has k, d"):
        part_of(tmp_path, text, k=3.0, q=1.0)
    with pytest.raises(InputRefused, match=r"takes \(k, d\); give those without a default a value"):
        part_of(tmp_path, text)


STEP = "    def step(self, t, inputs):\n        "


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (STEP + "return 1 / 0", r"raised ZeroDivisionError: division by zero \(mine.py, line 6\) at t = 0 s"),
        (STEP + "return {'v': self.missing}", r"raised AttributeError: .*missing.* \(mine.py, line 6\)"),
        (STEP + "return {'v': inputs['on']}", r"raised KeyError: 'on' \(mine.py, line 6\)"),
        (STEP + "raise SystemExit(4)", r"raised SystemExit: 4 \(mine.py, line 6\)"),
        (STEP + "return {'v': [1, 2]}", r"returned 2 values for v from step \(expected 3\) at t = 0 s"),
        (STEP + "return {'v': 'abc'}", r"returned 'abc' for v from step \(expected numbers\)"),
        (STEP + "return {'v': [1j, 0, 0]}", r"returned \[1j, 0, 0\] for v from step \(expected numbers\)"),
        (STEP + "return {'w': [1, 2, 3]}", r"returned no 'v' from step"),
        (STEP + "return {'v': [1, 2, 3], 'F': 1.0}", r"returned 'F' from step \(its outputs do not name it\)"),
        (STEP + "return [1, 2, 3]", r"returned list from step \(expected a dictionary"),
        (STEP + "return {'v': [float('nan'), 0, 0]}", r"returned NaN for v at t = 0 s, tick 0. Last inputs: p = "),
        (STEP + "return None", "returned NoneType from step"),
    ],
)
def test_a_step_that_goes_wrong_ends_the_run_in_a_sentence(tmp_path: Path, body: str, said: str):
    with pytest.raises(ComponentFailed, match=rf"mine.py:Part \(part\) {said}"):
        outputs_of(part_of(tmp_path, HEAD + body))


def test_ctrl_c_in_a_step_is_ctrl_c(tmp_path: Path):
    with pytest.raises(KeyboardInterrupt):
        outputs_of(part_of(tmp_path, HEAD + STEP + "raise KeyboardInterrupt"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("class Part:\n    def step(self) return", r"mine.py, line 2: "),
        ("\0", "mine.py"),
        ("class Other: pass", r"mine.py: has no class 'Part'; it has Other"),
        ("Part = 3", r"has no class 'Part'"),
        ("import nowhere_at_all", r"cannot be imported: it raised ModuleNotFoundError: .* \(mine.py, line 1\)"),
        ("raise SystemExit(0)", r"cannot be imported: it raised SystemExit: 0"),
        ("class Part: pass", "has no 'inputs'; expected inputs, outputs and step"),
        ("class Part:\n    inputs = outputs = ()", "has no 'step'"),
        (HEAD + "    def step(self, t): pass", r"step\(self, t\); expected step\(self, t, inputs\)"),
        (HEAD.replace('("p",)', '"p"') + STEP + "pass", "inputs = 'p'; expected names"),
        (HEAD.replace('("p",)', "7") + STEP + "pass", "inputs = 7; expected names"),
        (HEAD.replace('("p",)', '("P",)') + STEP + "pass", "inputs has 'P'; there are p, on"),
        (HEAD.replace('("p",)', '("p", "p")') + STEP + "pass", "names one port twice"),
        (HEAD.replace('("p",)', '{"p": "N"}') + STEP + "pass", "p in 'N'; expected a unit like m"),
        (HEAD.replace('("v",)', '("F",)') + STEP + "pass", "outputs lacks 'v'"),
        (HEAD + STEP + "pass\n    def __init__(self): self.x = 1 / 0", r"cannot be made: it raised Zero.* line 7"),
    ],
)
def test_a_class_that_cannot_be_meant_is_refused_before_anything_runs(tmp_path: Path, text: str, said: str):
    with pytest.raises(InputRefused, match=said):
        part_of(tmp_path, text)


def test_a_file_can_import_what_lies_beside_it_and_use_dataclasses(tmp_path: Path):
    (tmp_path / "helper_of_mine.py").write_text("GAIN = 2.0\n")
    text = "from __future__ import annotations\nfrom dataclasses import dataclass\nfrom helper_of_mine import GAIN\n"
    text += "@dataclass\nclass Part:\n    k: float = GAIN\n    inputs = ('p',)\n    outputs = ('v',)\n"
    assert outputs_of(part_of(tmp_path, text + STEP + "return {'v': [self.k] * 3}"))[0, 0] == 2.0


def test_the_hash_is_of_what_was_run(tmp_path: Path):
    file = tmp_path / "mine.py"
    file.write_text("class Part: value = 1")
    source = PythonSource(file)
    file.write_text("class Part: value = 2")
    assert source.load_class("Part").value == 1  # type: ignore[attr-defined]
    assert source.sha256 != PythonSource(file).sha256
