import numpy as np
import pytest

from examples.native_component import lagging_drive
from examples.python_component import LaggingDrive, step_response
from tests.cosim.models import U, continuous, sampled
from twin.cosim.python_component import PythonComponent
from twin.cosim.simulation import Simulation
from twin.cosim.system import System


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
