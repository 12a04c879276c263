"""The coupling error falls with the first power of the communication step, in both schemes; with the second where
inputs are interpolated.

The force loop is off, because its latched trigger snaps to a tick; backlash is 0, because the time at which it is
crossed snaps likewise; T_s stays 2 ms, so only the coupling changes. The error is the largest |F_z - F_z of the
reference| over the controller's ticks of the descent and the touch-down: F_z is the quantity the twin is for, the
maximum admits no cancellation of signs, and the touch-down is where the robot is fastest.
"""

import numpy as np
import pytest

from tests.coupling.monolith import monolithic_run
from tests.laws.runs import EXACT_ENCODERS, FORCE, POSITION, co_simulated, shipped

DURATION = 7.0
STEPS_MS = (2.0, 1.0, 0.5, 0.25)
SMOOTH = (*EXACT_ENCODERS, "plant.backlash_deg=0")


@pytest.fixture(scope="module")
def reference():
    return monolithic_run(shipped(POSITION, *SMOOTH), DURATION)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["gauss_seidel", "jacobi"])
def test_error_of_the_pressing_force_is_of_order_one(reference, scheme):
    errors = []
    for step in STEPS_MS:
        experiment = shipped(POSITION, *SMOOTH, f"cosim.tick_ms={step}", f"cosim.scheme={scheme}")
        F_z = co_simulated(experiment, DURATION)["plant.F_ee_B"][:: experiment.controller_ticks, 2]
        errors.append(np.abs(F_z - reference["F_ee_B_z"]).max())
    slope = np.polyfit(np.log(STEPS_MS), np.log(errors), 1)[0]
    # measured 0.99 and 0.99; an error of order zero or two is far outside
    assert slope == pytest.approx(1.0, abs=0.15)


JUMP = (*SMOOTH, "contact.friction=0", "controller.force.trigger_N=1e9", "controller.force.trigger_time_s=5.6")
"""The force loop comes on at a time, not at a force, and nothing sticks or slips: what excites the coupling is a jump
of the command at a tick, far larger than what the touch-down does."""
JUMP_DURATION = 6.5


@pytest.fixture(scope="module")
def jump_reference():
    return monolithic_run(shipped(FORCE, *JUMP), JUMP_DURATION)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["gauss_seidel", "jacobi"])
@pytest.mark.parametrize(
    ("inputs", "iterations", "expected"), [("hold", 1, 1.0), ("linear", 1, 2.0), ("linear", 2, 2.0), ("linear", 3, 2.0)]
)
def test_held_inputs_are_of_order_one_and_interpolated_ones_of_order_two(
    jump_reference, scheme, inputs, iterations, expected
):
    errors = []
    for step in STEPS_MS:
        options = (f"tick_ms={step}", f"scheme={scheme}", f"inputs={inputs}", f"iterations={iterations}")
        experiment = shipped(FORCE, *JUMP, *(f"cosim.{option}" for option in options))
        F_z = co_simulated(experiment, JUMP_DURATION)["plant.F_ee_B"][:: experiment.controller_ticks, 2]
        errors.append(np.abs(F_z - jump_reference["F_ee_B_z"]).max())
    slope = np.polyfit(np.log(STEPS_MS), np.log(errors), 1)[0]
    # measured 0.99 and 1.01, 2.00 everywhere
    assert slope == pytest.approx(expected, abs=0.15)


@pytest.mark.parametrize("scheme", ["gauss_seidel", "jacobi"])
def test_at_the_shipped_step_interpolation_costs_a_hundredth_of_the_error(reference, scheme):
    def error(inputs):
        experiment = shipped(POSITION, *SMOOTH, f"cosim.scheme={scheme}", f"cosim.inputs={inputs}")
        F_z = co_simulated(experiment, DURATION)["plant.F_ee_B"][:: experiment.controller_ticks, 2]
        return np.abs(F_z - reference["F_ee_B_z"]).max()

    # measured 320 and 470
    assert error("hold") > 100.0 * error("linear")
