import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.laws.runs import ComponentStepper, shipped
from tests.robot.plant.states import positions
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed
from twin.robot.assembly.build import belief
from twin.robot.controller.controller import Estimator
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian, joint_angles, position
from twin.robot.mechanism.statics import Masses, deflection, end_effector_force, environment_force, load_torque

BELIEF = belief(shipped())._replace(motor_zero=(0.01, -0.02, 0.03), joint_zero=(-0.005, 0.002, 0.001))
GEOMETRY = Geometry(BELIEF.a, BELIEF.b, BELIEF.l_a, BELIEF.l_b)
MASSES = Masses(BELIEF.m_a, BELIEF.m_b, BELIEF.m_p, 0.0)
deflecteds = st.tuples(*[st.floats(-0.2, 0.2)] * 3).map(np.array)


def counts(p_B, deflected):
    theta_l = joint_angles(GEOMETRY, p_B)
    theta_m = BELIEF.N * theta_l + deflected
    count_m = np.round((theta_m + BELIEF.motor_zero) * BELIEF.motor_counts / (2.0 * np.pi))
    count_l = np.round((theta_l + BELIEF.joint_zero) * BELIEF.joint_counts / (2.0 * np.pi))
    return np.concatenate([count_m, count_l])


def angles(count):
    theta_m = count[:3] * 2.0 * np.pi / BELIEF.motor_counts - BELIEF.motor_zero
    return theta_m, count[3:] * 2.0 * np.pi / BELIEF.joint_counts - BELIEF.joint_zero


@given(positions(), deflecteds)
def test_estimate_is_what_the_robot_package_makes_of_the_counts(p_B, deflected):
    count = counts(p_B, deflected)
    theta_m, theta_l = angles(count)
    found = ComponentStepper(Estimator(BELIEF)).outputs_by_port(count)
    at = position(GEOMETRY, theta_l)
    tau_l = load_torque(BELIEF.k_s, BELIEF.N, BELIEF.eta, deflection(theta_m, theta_l, BELIEF.N))
    # rounding, of torques below 1 N m and forces below 20 N
    np.testing.assert_allclose(found["theta_m"], theta_m, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found["theta_l"], theta_l, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found["p_B"], at, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found["J"].reshape(3, 3), jacobian(GEOMETRY, at), rtol=0, atol=1e-10)
    np.testing.assert_allclose(found["tau_l"], tau_l, rtol=0, atol=1e-13)
    expected = environment_force(GEOMETRY, MASSES, theta_l, at, tau_l)
    np.testing.assert_allclose(found["F_ee_B"], expected, rtol=0, atol=1e-11)


@given(positions(), deflecteds)
def test_without_compensation_the_force_is_that_of_the_papers_statics(p_B, deflected):
    count = counts(p_B, deflected)
    found = ComponentStepper(Estimator(BELIEF, gravity_compensation=False)).outputs_by_port(count)
    # Eq. 21-27; rounding of forces below 20 N
    expected = end_effector_force(GEOMETRY, found["theta_l"], found["tau_l"])
    np.testing.assert_allclose(found["F_ee_B"], expected, rtol=0, atol=1e-11)


@given(positions())
def test_position_is_known_to_a_joint_count(p_B):
    found = ComponentStepper(Estimator(BELIEF)).outputs_by_port(counts(p_B, np.zeros(3)))
    # half a count of 2 pi / 16384 on each joint; |J^-1| is below 0.1 m/rad in the working range
    assert np.abs(found["p_B"] - p_B).max() < 0.1 * np.sqrt(3.0) * np.pi / BELIEF.joint_counts


FINE = BELIEF._replace(motor_counts=2.0**40, joint_counts=2.0**40)
"""With counts of 6e-12 rad."""
HALF_WIDTH = np.deg2rad(0.1)
# in steps of 1e-3 N m: at 0 the spring is anywhere in its dead zone
torques = st.tuples(*[st.integers(-300, 300).filter(bool).map(lambda whole: whole / 1000.0)] * 3).map(np.array)


def estimated_force(believed, p_B, deflected):
    """F_ee_B (3,) N at `p_B` with the springs deflected by `deflected` (3,) rad, as the encoders see it."""
    theta_l = joint_angles(GEOMETRY, p_B)
    angle = np.concatenate([FINE.N * theta_l + deflected + FINE.motor_zero, theta_l + FINE.joint_zero])
    return ComponentStepper(Estimator(believed)).outputs_by_port(np.round(angle * 2.0**40 / (2.0 * np.pi)))["F_ee_B"]


@given(positions(), torques, st.sampled_from([1.0, 0.5, 0.0]))
def test_a_dead_zone_believed_too_narrow_leaves_the_missing_width_as_torque(p_B, tau_l, share):
    # on either flank the encoders see the dead zone besides the deflection
    stiffness = FINE.k_s * FINE.N * FINE.eta
    deflected = tau_l / stiffness + np.sign(tau_l) * HALF_WIDTH
    found = estimated_force(FINE._replace(backlash=share * HALF_WIDTH), p_B, deflected)
    theta_l = joint_angles(GEOMETRY, p_B)
    true = environment_force(GEOMETRY, MASSES, theta_l, p_B, tau_l)
    missing = stiffness * (1.0 - share) * HALF_WIDTH * np.sign(tau_l)
    # counts of 6e-12 rad make 1e-9 N; believed right, the force is right
    np.testing.assert_allclose(found, true + jacobian(GEOMETRY, p_B).T @ missing, rtol=0, atol=1e-8)


@given(positions(), st.tuples(*[st.integers(-999, 999)] * 3).map(np.array))
def test_inside_the_dead_zone_the_springs_are_believed_to_bear_nothing(p_B, share):
    found = estimated_force(FINE._replace(backlash=HALF_WIDTH), p_B, share / 1000.0 * HALF_WIDTH)
    weight = environment_force(GEOMETRY, MASSES, joint_angles(GEOMETRY, p_B), p_B, np.zeros(3))
    # counts of 6e-12 rad make 1e-10 N
    np.testing.assert_allclose(found, weight, rtol=0, atol=1e-8)


def test_estimate_is_held_while_counts_explain_no_pose_or_are_no_numbers():
    calibrated = BELIEF._replace(motor_zero=(0.0, 0.0, 0.0), joint_zero=(0.0, 0.0, 0.0))
    estimator = ComponentStepper(Estimator(calibrated))
    good = np.array([900.0, 900.0, 900.0, 900.0, 900.0, 900.0])
    before = estimator.outputs_by_port(good)
    # leg 1 folded inwards, the others outwards: the sphere centres lie on one line
    folded = np.array([0.0, 0.0, 0.0, BELIEF.joint_counts / 2.0, 0.0, 0.0])
    for counts in (folded, np.full(6, np.nan), [*good[:5], np.inf]):
        held = estimator.outputs_by_port(np.asarray(counts))
        assert held.pop("valid") == 0.0
        for name, value in held.items():
            np.testing.assert_array_equal(value, before[name])
    assert estimator.outputs_by_port(good)["valid"] == 1.0


def test_first_counts_that_explain_no_pose_end_the_run():
    class Folded:
        inputs, sampled = (), True
        outputs = (Port("count_m", 3), Port("count_l", 3))

        def step(self, t, h, u, y):
            y[:] = [0.0, 0.0, 0.0, BELIEF.joint_counts / 2.0, 0.0, 0.0]

    wires = [(f"encoder.{name}", f"estimator.{name}") for name in ("count_m", "count_l")]
    system = System([PythonComponent("encoder", Folded()), Estimator(BELIEF)], wires, 1e-3)
    with pytest.raises(ComponentFailed, match="estimator found no pose that fits the first encoder counts at t = 0 s"):
        Simulation(system, 3).run()
