import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import examples
from tests.laws.runs import PARAMETERS, ComponentStepper
from tests.robot.plant.states import share
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.robot.plant.component import Plant, rest_state
from twin.robot.plant.surface_motion import Body, Motion, MotionKind

BREATHING, SHIFT = MotionKind.BREATHING, MotionKind.SHIFT

LIFT = (0.0, 0.0, 0.003)
times = st.integers(0, 12_000).map(lambda milliseconds: milliseconds / 1000.0)


def at(body, t):
    """Displacement and velocity, (3,) each."""
    y = ComponentStepper(body)(np.empty(0), t)
    return y[:3], y[3:]


@st.composite
def motions(draw: st.DrawFn) -> Motion:
    vector = (0.01 * draw(share), 0.01 * draw(share), 0.01 * draw(share))
    onset, lasting = draw(st.floats(0.0, 3.0)), draw(st.floats(0.0, 6.0))
    rate, rise = draw(st.floats(0.1, 2.0)), draw(st.floats(0.1, 2.0))
    return Motion(draw(st.sampled_from([BREATHING, SHIFT])), vector, onset, onset + lasting, rate, rise)


@examples(40)
@given(st.lists(motions(), min_size=1, max_size=3), times)
def test_velocity_is_the_rate_of_the_displacement_and_neither_jumps(table, t):
    body, step = Body(table), 1e-5
    s, v = at(body, t)
    before, after = at(body, t - step), at(body, t + step)
    # accelerations: 3 breathings of 0.017 m at 2 Hz stay below 9 m/s2, 3 shifts of 0.017 m in 0.1 s below 31 m/s2
    largest = 40.0
    np.testing.assert_allclose((after[0] - before[0]) / (2.0 * step), v, rtol=0, atol=largest * step)
    assert np.abs(after[1] - v).max() <= largest * step
    assert np.abs(after[0] - s).max() <= (np.abs(v).max() + largest * step) * step


def test_a_breath_lifts_by_twice_the_amplitude_and_comes_back_as_often_as_its_rate_says():
    body = Body([Motion(BREATHING, LIFT, onset=1.0, rate=0.25)])
    for breath in range(3):
        start = 1.0 + 4.0 * breath
        # rounding of the phase
        np.testing.assert_allclose(at(body, start)[0], 0.0, rtol=0, atol=1e-15)
        np.testing.assert_allclose(at(body, start + 2.0)[0], [0.0, 0.0, 0.006], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(at(body, 0.5), np.zeros((2, 3)))


def test_the_breath_that_goes_on_at_the_end_is_finished():
    body = Body([Motion(BREATHING, LIFT, onset=0.0, end=5.0, rate=0.25)])
    assert at(body, 6.0)[0][2] == pytest.approx(0.006, abs=1e-15)
    np.testing.assert_array_equal(at(body, 8.0), np.zeros((2, 3)))
    np.testing.assert_array_equal(at(body, 10.0), np.zeros((2, 3)))


def test_a_shift_stays_or_goes_back():
    way = (0.01, -0.02, 0.005)
    stays, returns = (
        Body([Motion(SHIFT, way, 1.0, rise=0.5)]),
        Body([Motion(SHIFT, way, 1.0, 3.0, rise=0.5)]),
    )
    np.testing.assert_array_equal(at(stays, 1.0), np.zeros((2, 3)))
    np.testing.assert_array_equal(at(stays, 1.5)[0], way)
    np.testing.assert_array_equal(at(stays, 1e6)[0], way)
    np.testing.assert_array_equal(at(returns, 3.0)[0], way)
    np.testing.assert_array_equal(at(returns, 3.5), np.zeros((2, 3)))


def test_a_shift_is_fastest_half_way_as_the_path_of_least_jerk_is():
    # 15/8 of the mean speed, Flash and Hogan (1985)
    v = at(Body([Motion(SHIFT, (0.01, 0.0, 0.0), 0.0, rise=0.5)]), 0.25)[1]
    assert v[0] == pytest.approx(15.0 / 8.0 * 0.01 / 0.5, rel=1e-14)


def test_motions_add_up():
    one, other = Motion(BREATHING, LIFT, 0.0, rate=0.3), Motion(SHIFT, (0.01, 0.0, -0.01), 1.0)
    both = np.array(at(Body([one, other]), 1.4))
    # rounding
    np.testing.assert_allclose(both, np.add(at(Body([one]), 1.4), at(Body([other]), 1.4)), rtol=0, atol=1e-17)


class Held:
    """Motors that stand still."""

    inputs, outputs, sampled = (), (Port("theta_m", 3, "rad"),), False

    def step(self, t, h, u, y):
        pass


def on_body(parameters, x, theta_m, table, duration, tick=1e-3):
    """The plant's outputs, one row per tick, with the motors held over a body that moves."""
    plant = Plant(parameters, x, theta_m, moving=True)
    components = [Body(table), PythonComponent("motors", Held(), initial_outputs=theta_m), plant]
    wires = [("motors.theta_m", "plant.theta_m"), ("body.s_B", "plant.s_B"), ("body.v_s_B", "plant.v_s_B")]
    system = System(components, wires, tick)
    rows = Simulation(system, round(duration / tick)).run()
    return {port.name: rows[:, system.columns(f"plant.{port.name}")] for port in plant.outputs}


def test_a_body_that_does_not_move_changes_no_bit():
    x, theta_m = rest_state(PARAMETERS, (0.0, 0.01, -0.103))
    x[3:6] = [0.02, -0.05, -0.1]
    moving, fixed = (
        ComponentStepper(Plant(PARAMETERS, x, theta_m, moving=True)),
        ComponentStepper(Plant(PARAMETERS, x, theta_m)),
    )
    assert [port.name for port in moving.component.inputs] == ["theta_m", "s_B", "v_s_B"]
    assert [port.name for port in fixed.component.inputs] == ["theta_m"]
    for _ in range(200):
        still = fixed(theta_m, 0.0, 1e-3)
        np.testing.assert_array_equal(moving(np.concatenate([theta_m, np.zeros(6)]), 0.0, 1e-3), still)
    assert still[21] > 0.1


def test_a_lifted_body_presses_like_one_that_was_higher_from_the_start():
    """After the shift, at rest: the springs and the contact share the 3 mm."""
    x, theta_m = rest_state(PARAMETERS, (0.0, 0.0, -0.103))
    rows = on_body(PARAMETERS, x, theta_m, [Motion(SHIFT, LIFT, 0.0, rise=0.3)], 1.5)
    p_B, F_n = rows["p_B"][-1], rows["F_n"][-1, 0]
    higher = PARAMETERS._replace(z_s=PARAMETERS.z_s + LIFT[2])
    expected = Plant(higher, *rest_state(higher, p_B))
    assert F_n > rows["F_n"][0, 0] + 1.0
    # the springs are deflected as far as this position and force need: rad, at rest to 1e-9 m
    np.testing.assert_allclose(rest_state(higher, p_B)[1], theta_m, rtol=0, atol=1e-7)
    assert expected.initial("F_n")[0] == pytest.approx(F_n, abs=1e-5)


def test_a_body_that_is_pulled_sideways_takes_the_robot_along_until_it_slips():
    x, theta_m = rest_state(PARAMETERS, (0.0, 0.0, -0.104))
    small = on_body(PARAMETERS, x, theta_m, [Motion(SHIFT, (2e-4, 0.0, 0.0), 0.0, rise=0.2)], 0.5)
    large = on_body(PARAMETERS, x, theta_m, [Motion(SHIFT, (1e-2, 0.0, 0.0), 0.0, rise=0.2)], 0.21)
    # the surface pulls towards +x, so the robot pulls the surface towards -x
    assert small["p_B"][-1, 0] > 2e-5
    assert -PARAMETERS.mu * small["F_n"][-1, 0] < small["F_ee_B"][-1, 0] < 0.0
    # the normal force still grows a little, and the bristle with it
    assert large["F_ee_B"][-10, 0] == pytest.approx(-PARAMETERS.mu * large["F_n"][-10, 0], rel=1e-3)


def test_moving_together_is_resting_together():
    """Galilei: surface and platform at one velocity feel what they feel at rest."""
    x, theta_m = rest_state(PARAMETERS, (0.0, 0.0, -0.104))
    v = np.array([0.02, -0.03, 0.05])
    x[3:6] = v
    moving = Plant(PARAMETERS, x, theta_m, moving=True)
    # a step of no length shows the force at this instant
    y = ComponentStepper(moving).outputs_by_port(np.concatenate([theta_m, np.zeros(3), v]), 0.0, 0.0)
    x[3:6] = 0.0
    np.testing.assert_array_equal(y["F_ee_B"], Plant(PARAMETERS, x, theta_m).initial("F_ee_B"))


def test_within_a_step_the_surface_moves_on_at_constant_velocity():
    x, theta_m = rest_state(PARAMETERS, (0.0, 0.0, -0.104))
    v = np.array([0.02, -0.01, 0.05])
    whole = ComponentStepper(Plant(PARAMETERS, x, theta_m, substeps=10, moving=True))
    parts = ComponentStepper(Plant(PARAMETERS, x, theta_m, moving=True))
    for k in range(10):
        y = parts(np.concatenate([theta_m, k * 1e-3 * v, v]), 0.0, 1e-3)
    # rounding of forces of 5 N
    np.testing.assert_allclose(whole(np.concatenate([theta_m, np.zeros(3), v]), 0.0, 1e-2), y, rtol=0, atol=1e-12)
    assert y[21] > 4.0


def test_breathing_under_the_robot_is_resolved_by_a_tick_of_a_millisecond():
    x, theta_m = rest_state(PARAMETERS, (0.0, 0.0, -0.104))
    table = [Motion(BREATHING, (0.0, 0.0, 0.002), 0.0, rate=0.3)]
    coarse = on_body(PARAMETERS, x, theta_m, table, 4.0)["F_n"][:, 0]
    fine = on_body(PARAMETERS, x, theta_m, table, 4.0, 1e-4)["F_n"][::10, 0]
    assert np.ptp(fine) > 1.0
    # N; twice what was measured: A omega^2 H = 7e-6 m/s of velocity a tick late, times K c d = 15 N s/m
    assert np.abs(coarse - fine).max() < 2.5e-4
