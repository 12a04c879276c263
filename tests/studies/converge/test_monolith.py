"""Components stepped by hand, whatever Python is told of asserts."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.errors import ComponentFailed
from twin.robot.plant.encoder import Scale
from twin.studies.converge.monolith import ComponentStepper

STEPPED = """
import numpy as np
from twin.studies.converge.monolith import ComponentStepper
from twin.robot.plant.encoder import Scale
print(ComponentStepper(Scale(0.005 * 9.81))(np.array([0.0, 0.0, -5.0]))[0])
"""


@pytest.mark.slow
def test_without_asserts_a_component_moves_all_the_same(root: Path):
    command = [sys.executable, "-O", "-c", STEPPED]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    assert float(done.stdout) == ComponentStepper(Scale(0.005 * 9.81))(np.array([0.0, 0.0, -5.0]))[0] > 4.9


def test_another_number_of_inputs_is_an_error():
    with pytest.raises(ValueError, match=r"^scale: 2 inputs; expected 3$"):
        ComponentStepper(Scale(0.05))(np.zeros(2))


class Broken:
    """Always fails."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    sampled = True

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        raise RuntimeError("no more")


def test_a_step_that_fails_is_an_error():
    with pytest.raises(ComponentFailed, match=r"^part raised RuntimeError: no more \(test_monolith\.py, line \d+\)$"):
        ComponentStepper(PythonComponent("part", Broken()))(np.zeros(1))
