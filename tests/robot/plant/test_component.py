import numpy as np
import pytest
from hypothesis import given

from tests.laws.runs import PARAMETERS, ComponentStepper, shipped
from tests.robot.plant.kinetic import mass_matrix
from tests.robot.plant.states import moving
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import ComponentFailed
from twin.robot.assembly.assemble import assemble
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.plant.component import LEFT_WORKSPACE, NO_MOTION, Plant, rest_state
from twin.robot.plant.dynamics import derivative

GEOMETRY = Geometry(*PARAMETERS[:4])


def acceleration(parameters, x, theta_m):
    dx = np.empty(8)
    derivative(parameters, x, theta_m, NO_MOTION, NO_MOTION, dx)
    return dx[3:6]


@given(moving(lowest=-0.115, highest=-0.102))
def test_what_the_robot_does_to_the_surface_the_surface_does_to_the_robot(state):
    """Newton's third law: the surface changes the platform's momentum rate by -F_ee_B."""
    x, theta_m = state
    J = jacobian(GEOMETRY, x[:3])
    M = mass_matrix(PARAMETERS, joint_angles(GEOMETRY, x[:3]), J)
    change = acceleration(PARAMETERS, x, theta_m) - acceleration(PARAMETERS._replace(K=0.0), x, theta_m)
    F_ee_B = Plant(PARAMETERS, x, theta_m).initial("F_ee_B")
    # rounding: accelerations up to 1e3 m/s2 on 0.3 kg
    np.testing.assert_allclose(M @ change, -F_ee_B, rtol=0, atol=1e-11)


@given(moving())
def test_springs_load_the_motors_with_what_they_give_the_joints_over_the_belt(state):
    plant = Plant(PARAMETERS._replace(eta=0.8), *state)
    # Eq. 18; rounding
    np.testing.assert_allclose(plant.initial("tau_l"), 2.0 * 0.8 * plant.initial("tau_load"), rtol=1e-14, atol=0)


@given(moving())
def test_link_speeds_belong_to_the_platform_velocity(state):
    plant = Plant(PARAMETERS, *state)
    expected = jacobian(GEOMETRY, state[0][:3]) @ state[0][3:6]
    # rounding
    np.testing.assert_allclose(plant.initial("omega_l"), expected, rtol=0, atol=1e-13)


def test_integration_in_air_is_of_order_four():
    x, theta_m = rest_state(PARAMETERS, (0.0, 0.01, -0.090))
    theta_m = theta_m + np.array([0.05, 0.04, 0.06])

    def end(substeps):
        return ComponentStepper(Plant(PARAMETERS._replace(backlash=0.0), x, theta_m, substeps))(theta_m, 0.0, 0.02)[:6]

    exact = end(2000)
    errors = [np.abs(end(n) - exact).max() for n in (8, 16, 32)]
    slope = np.polyfit(np.log([8, 16, 32]), np.log(errors), 1)[0]
    # a step of 2.5 ms is a quarter radian of the fastest mode, so the order is not yet sharp
    assert slope == pytest.approx(-4.0, abs=0.3)


@pytest.mark.parametrize("substeps", [1, 5])
@pytest.mark.parametrize(
    "rising", [None, np.array([0.01, -0.02, 0.05])], ids=["on the scale", "on a surface that moves"]
)
def test_in_a_ramp_the_motors_turn_and_the_surface_moves_within_the_step(substeps, rising):
    """As in a thousand short steps that hold each motor half-way, the surface taken anew in each."""
    x, start = rest_state(PARAMETERS, (0.003, 0.01, -0.1045))
    turned, h, n = np.array([0.02, -0.01, 0.03]), 5e-3, 1000
    moving = rising is not None

    def surface(t):
        return [] if rising is None else [*(rising * t), *rising]

    ramp = ComponentStepper(Plant(PARAMETERS, x, start, substeps, moving, ramp=True))
    end = ramp.outputs_by_port(np.array([*(start + turned), *surface(0.0), *start]), 0.0, h)
    held = ComponentStepper(Plant(PARAMETERS, x, start, 1, moving))
    for k in range(n):
        short = held.outputs_by_port(
            np.array([*(start + (k + 0.5) / n * turned), *surface(k * h / n)]), k * h / n, h / n
        )
    # a step of 5 ms is nearly 1 rad of the contact's mode, one of 1 ms a fifth of that: (1/5)^4 of the error
    tolerance = {1: 0.02, 5: 1e-4}[substeps]
    for name in ("v_B", "omega_l", "F_ee_B"):
        change = np.abs(short[name]).max()
        np.testing.assert_allclose(end[name], short[name], rtol=0, atol=tolerance * change, err_msg=name)
    # the last short step holds its motor half of 3e-5 rad before the end
    np.testing.assert_allclose(end["tau_load"], short["tau_load"], rtol=0, atol=2e-5)


def test_a_bristle_is_on_the_cone_of_the_surface_where_that_is_at_the_end_of_the_step():
    """A surface that sinks away takes its normal force along, and with it what friction can hold."""
    x, theta_m = rest_state(PARAMETERS, (0.0, 0.0, -0.105))
    x[6] = PARAMETERS.mu * PARAMETERS.K * 0.004 / PARAMETERS.sigma_0
    plant = ComponentStepper(Plant(PARAMETERS, x, theta_m, moving=True))
    end = plant.outputs_by_port(np.array([*theta_m, *NO_MOTION, 0.0, 0.0, -0.05]), 0.0, 1e-3)
    assert 0.0 < end["F_n"][0] < 0.99 * PARAMETERS.K * 0.004
    # rounding
    assert PARAMETERS.sigma_0 * end["z_b"][0] <= PARAMETERS.mu * end["F_n"][0] * (1.0 + 1e-12)


class Runaway:
    """A drive that never stops."""

    inputs = (Port("omega_ref", 1, "rad/s"), Port("tau_load", 1, "N m"))
    outputs = (Port("theta_m", 1, "rad"), Port("omega_m", 1, "rad/s"), Port("tau_motor", 1, "N m"))
    sampled = False

    def __init__(self, theta_m):
        self.theta_m = theta_m

    def step(self, t, h, u, y):
        self.theta_m -= 50.0 * h
        y[:] = self.theta_m, -50.0, 0.0


def test_leaving_the_workspace_ends_the_run_with_a_sentence_that_says_where():
    with assemble(shipped()) as found:
        theta_m = found.system.component("drive_1").initial("theta_m")[0]
    runaway = PythonComponent("drive_1", Runaway(theta_m), initial_outputs=[theta_m, 0.0, 0.0])
    with (
        assemble(shipped(), substitutes={"drive_1": runaway}) as assembly,
        pytest.raises(ComponentFailed) as failure,
    ):
        Simulation(assembly.system, 5000).run()
    sentence = str(failure.value)
    assert sentence.startswith("plant left the workspace: a leg cannot reach the platform near (")
    assert " mm, in the step from t = " in sentence
    assert "Last inputs: theta_m = (" in sentence
    assert "nan" not in sentence.lower()
    assert failure.value.exit_code == 3


def test_the_sentence_says_in_millimetres_where_the_platform_was_before_the_step():
    plant = Plant(PARAMETERS, *rest_state(PARAMETERS, (0.0123, -0.0056, -0.1)))
    ComponentStepper(plant)(rest_state(PARAMETERS, (0.0123, -0.0056, -0.1))[1], 0.0, 1e-3)
    assert "near (12.3, -5.6, -100.0) mm" in plant.explain(LEFT_WORKSPACE)
