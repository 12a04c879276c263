import ctypes

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.conftest import examples
from tests.laws.runs import PARAMETERS, ComponentStepper
from tests.robot.plant.states import moving, positions
from twin.kernel.compiled.native import Native
from twin.kernel.cosim.port import memory_of, width
from twin.robot.mechanism.unreachable import Unreachable
from twin.robot.plant.component import NO_MOTION, PLANT_MEMORY, PLANT_OUTPUTS, Plant, rest_state
from twin.robot.plant.dynamics import PlantParameters, derivative
from twin.robot.plant.equations import REST_OUTPUTS, outputs_at_start, rest
from twin.robot.plant.joints import ANCHOR_SIZE

tilts = st.sampled_from([0.0, 0.0175, -0.3])
# 0: constant efficiency
losses = st.tuples(st.floats(0.7, 1.0), st.just(0.0) | st.floats(0.05, 2.0))


@given(positions(), tilts, losses)
def test_nothing_accelerates_at_rest(p_B, tilt, lost):
    parameters = PARAMETERS._replace(tilt=tilt, eta=lost[0], eta_rate=lost[1])
    x, theta_m = rest_state(parameters, p_B)
    dx = np.empty(8)
    derivative(parameters, x, theta_m, NO_MOTION, NO_MOTION, dx)
    # rounding: forces up to 20 N known to 1e-15, on 0.2 kg
    np.testing.assert_allclose(dx, 0.0, rtol=0, atol=1e-12)


@examples(20)
@given(positions(), tilts, losses)
def test_a_robot_at_rest_stays_at_rest(p_B, tilt, lost):
    parameters = PARAMETERS._replace(tilt=tilt, eta=lost[0], eta_rate=lost[1])
    x, theta_m = rest_state(parameters, p_B)
    # losses that turn over within 0.05 rad/s are too stiff for steps of 1 ms under 20 N
    plant = Plant(parameters, x, theta_m, substeps=10)
    start = plant.initial_outputs.copy()
    step = ComponentStepper(plant)
    for _ in range(500):
        end = step(theta_m, 0.0, 1e-3)
    # m, m/s, rad, N m, N: rounding of the balance, held by the springs for half a second
    np.testing.assert_allclose(end, start, rtol=0, atol=1e-12)


@given(positions(highest=-0.102))
def test_a_robot_that_rests_on_the_scale_presses_with_stiffness_times_depth(p_B):
    plant = Plant(PARAMETERS, *rest_state(PARAMETERS, p_B))
    # rounding of a depth of at least 1 mm
    expected = [0.0, 0.0, PARAMETERS.K * (p_B[2] - PARAMETERS.z_s)]
    np.testing.assert_allclose(plant.initial("F_ee_B"), expected, rtol=1e-12, atol=1e-12)


@given(positions(lowest=-0.099))
def test_in_air_the_springs_carry_the_weight_through_the_backlash(p_B):
    _, theta_m = rest_state(PARAMETERS, p_B)
    _, without = rest_state(PARAMETERS._replace(backlash=0.0), p_B)
    # every joint is pulled down by the weight, so every spring pulls up; rounding of angles near 1 rad
    np.testing.assert_allclose(theta_m - without, -PARAMETERS.backlash, rtol=0, atol=1e-15)


@given(positions(), st.floats(0.5, 1.0), st.floats(0.02, 2.0))
def test_losses_in_the_direction_of_the_flow_carry_nothing_at_rest(p_B, eta, eta_rate):
    """(P1) at speed zero: the springs are deflected as those of a lossless belt."""
    _, theta_m = rest_state(PARAMETERS._replace(eta=eta, eta_rate=eta_rate), p_B)
    np.testing.assert_array_equal(theta_m, rest_state(PARAMETERS._replace(eta=1.0), p_B)[1])


def test_there_is_no_rest_out_of_reach():
    with pytest.raises(Unreachable):
        rest_state(PARAMETERS, (0.0, 0.0, -0.2))


STEP = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)
TILTED = PARAMETERS._replace(mounting_tilt=0.3, mounting_tilt_x=-0.2)
STICKING = TILTED._replace(joint_friction=0.2, spring_hysteresis=0.1)


def begun(native: Native, size: int, parameters: PlantParameters, x, theta_m) -> NDArray[np.float64]:
    """What a beginning makes of a plant that was moved away from where it had stuck."""
    memory = memory_of(PLANT_MEMORY, parameters=tuple(parameters), x=x, anchors=np.full((3, ANCHOR_SIZE), 0.1))
    y = np.empty(size)
    STEP(native.address)(memory.ctypes.data, 0.0, 1e-3, np.array(theta_m).ctypes.data, y.ctypes.data)
    return y


@given(positions(), st.sampled_from([PARAMETERS, TILTED]))
def test_it_rests_where_the_plant_here_rests(p_B, parameters):
    x, theta_m = rest_state(parameters, p_B)
    found = begun(rest, width(REST_OUTPUTS), parameters, x, theta_m)
    # rounding of angles near 40 rad
    np.testing.assert_allclose(found, theta_m, rtol=1e-12, atol=0)


@examples(20)
@given(moving(STICKING))
def test_its_first_outputs_are_those_of_a_new_plant(state):
    found = begun(outputs_at_start(False, False), width(PLANT_OUTPUTS), STICKING, *state)
    np.testing.assert_array_equal(found, Plant(STICKING, *state).initial_outputs)
