import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import examples
from tests.laws.runs import PARAMETERS, Sampled
from tests.plant.states import positions
from twin.errors import Unreachable
from twin.plant.beginning import resting
from twin.plant.component import STILL, Plant
from twin.plant.dynamics import derivative

tilts = st.sampled_from([0.0, 0.0175, -0.3])
# 0: constant efficiency
losses = st.tuples(st.floats(0.7, 1.0), st.just(0.0) | st.floats(0.05, 2.0))


@given(positions(), tilts, losses)
def test_nothing_accelerates_at_rest(p_B, tilt, lost):
    parameters = PARAMETERS._replace(tilt=tilt, eta=lost[0], eta_rate=lost[1])
    x, theta_m = resting(parameters, p_B)
    dx = np.empty(8)
    derivative(parameters, x, theta_m, STILL, STILL, dx)
    # rounding: forces up to 20 N known to 1e-15, on 0.2 kg
    np.testing.assert_allclose(dx, 0.0, rtol=0, atol=1e-12)


@examples(20)
@given(positions(), tilts, losses)
def test_a_robot_at_rest_stays_at_rest(p_B, tilt, lost):
    parameters = PARAMETERS._replace(tilt=tilt, eta=lost[0], eta_rate=lost[1])
    x, theta_m = resting(parameters, p_B)
    # losses that turn over within 0.05 rad/s are too stiff for steps of 1 ms under 20 N
    plant = Plant(parameters, x, theta_m, substeps=10)
    start = plant.initial_outputs.copy()
    step = Sampled(plant)
    for _ in range(500):
        end = step(theta_m, 0.0, 1e-3)
    # m, m/s, rad, N m, N: rounding of the balance, held by the springs for half a second
    np.testing.assert_allclose(end, start, rtol=0, atol=1e-12)


@given(positions(highest=-0.102))
def test_a_robot_that_rests_on_the_scale_presses_with_stiffness_times_depth(p_B):
    plant = Plant(PARAMETERS, *resting(PARAMETERS, p_B))
    # rounding of a depth of at least 1 mm
    expected = [0.0, 0.0, PARAMETERS.K * (p_B[2] - PARAMETERS.z_s)]
    np.testing.assert_allclose(plant.initial("F_ee_B"), expected, rtol=1e-12, atol=1e-12)


@given(positions(lowest=-0.099))
def test_in_air_the_springs_carry_the_weight_through_the_backlash(p_B):
    _, theta_m = resting(PARAMETERS, p_B)
    _, without = resting(PARAMETERS._replace(backlash=0.0), p_B)
    # every joint is pulled down by the weight, so every spring pulls up; rounding of angles near 1 rad
    np.testing.assert_allclose(theta_m - without, -PARAMETERS.backlash, rtol=0, atol=1e-15)


@given(positions(), st.floats(0.5, 1.0), st.floats(0.02, 2.0))
def test_losses_in_the_direction_of_the_flow_carry_nothing_at_rest(p_B, eta, eta_rate):
    """(P1) at speed zero: the springs are wound up as those of a lossless belt."""
    _, theta_m = resting(PARAMETERS._replace(eta=eta, eta_rate=eta_rate), p_B)
    np.testing.assert_array_equal(theta_m, resting(PARAMETERS._replace(eta=1.0), p_B)[1])


def test_there_is_no_rest_out_of_reach():
    with pytest.raises(Unreachable):
        resting(PARAMETERS, (0.0, 0.0, -0.2))
