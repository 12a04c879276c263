"""The bounds of the engine's yardsticks can be exceeded, and its robot is the one that they are about."""

from functools import cache
from math import radians
from pathlib import Path

import numpy as np
import pytest

from twin.kernel.cosim.observers import simulate
from twin.kernel.cosim.python_class import PythonComponent
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.build import plant_parameters
from twin.robot.assembly.load import load_experiment
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.plant.component import rest_state
from twin.robot.plant.dynamics import PlantParameters
from twin.robot.run.trace import Trace, run_in_memory
from validation.engine.bodies import initial_angle
from validation.engine.constrained import Constrained, Numbers
from validation.engine.plant import EnginesPlant
from validation.engine.robots import State, TwinsRobot, differences, holding, states
from validation.masters.robot import ROOT
from validation.yardsticks.mujoco import ALIKE, HEAVIER, HOME, SAME_RUN, apart, experiment, parameters
from validation.yardsticks.other_robots import (
    OTHER_ROBOTS,
    differences_from_engine,
    file_parameters,
    robot_file_text,
)

AT_HOME = State(HOME, np.array([0.1, -0.2, 0.3]), np.array([0.8, 0.7, 0.6]), np.array([0.1, 0.2, 0.3]))


class Spoiled:
    """A robot that does not know one of its answers."""

    def __init__(self, robot: TwinsRobot, key: str, value: Numbers):
        self._robot, self._key, self._value = robot, key, value

    def answers(self, state: State) -> dict[str, Numbers]:
        return {**self._robot.answers(state), self._key: self._value}


@cache
def given() -> list[State]:
    return states(parameters(), 5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "more", "noticed"),
    [
        ("m_b", 1e-6, {"mass matrix", "gravity", "acceleration", "rods"}),
        ("m_a", 1e-6, {"mass matrix", "gravity", "acceleration", "rods"}),
        ("m_p", 1e-6, {"mass matrix", "gravity", "acceleration", "force on what it presses"}),
        ("I_r", 1e-5, {"mass matrix", "acceleration"}),
        ("b_j", 1e-6, {"acceleration"}),
        ("l_b", 1e-7, {"joint angles", "Jacobian", "mass matrix", "rods, weightless"}),
        ("a", 1e-7, {"joint angles", "Jacobian", "mass matrix", "rods, weightless"}),
    ],
)
def test_a_robot_that_is_a_little_another_one_exceeds_the_bound(name: str, more: float, noticed: set[str]):
    own = parameters()
    other = own._replace(**{name: getattr(own, name) * (1.0 + more)})
    found = differences(TwinsRobot(other), TwinsRobot(own), given())
    assert noticed <= {key for key, off in found.items() if off > ALIKE}


def test_rods_as_two_point_masses_exceed_it_by_far():
    c = parameters()
    J = jacobian(Geometry(c.a, c.b, c.l_a, c.l_b), HOME)
    half = (c.m_p + 1.5 * c.m_b) * np.eye(3) + ((c.m_a / 3.0 + c.m_b / 2.0) * c.l_a**2 + c.I_r) * J.T @ J
    own = TwinsRobot(c)
    found = differences(Spoiled(own, "mass matrix", half), own, [AT_HOME])
    assert found["mass matrix"] > 1e6 * ALIKE
    assert half[0, 0] / own.answers(AT_HOME)["mass matrix"][0, 0] - 1.0 == pytest.approx(HEAVIER, abs=5e-4)


def test_an_answer_that_is_no_number_is_no_difference_that_holds():
    own = TwinsRobot(parameters())
    found = differences(Spoiled(own, "gravity", np.full(3, np.nan)), own, [AT_HOME])
    assert np.isnan(found["gravity"])
    assert found["acceleration"] == 0.0


def test_poses_are_all_over_the_workspace_and_clear_of_singularities():
    points = np.array([state.p_B for state in states(parameters(), 100)])
    # mm: half a robot each way at least
    assert (np.ptp(points, axis=0) > 0.1).all()
    c = parameters()
    geometry = Geometry(c.a, c.b, c.l_a, c.l_b)
    assert np.isfinite(joint_angles(geometry, points)).all()
    assert holding(jacobian(geometry, points)).min() > 0.1


def test_parallelograms_do_not_hold_a_platform_when_two_of_them_lie_flat():
    """Two rod pairs lie flat, so that their normals are both vertical; no other singularity is near."""
    J = np.array([[0.0, -1.0, 0.0], [0.8, 0.6, 0.0], [-0.5, 0.3, -0.8]])
    assert holding(J) == pytest.approx(0.0, abs=1e-15)
    assert abs(np.linalg.det(J)) > 0.5


def test_a_pendulum_as_a_point_on_a_rod_swings_and_pulls_as_it_should():
    """Two coordinates, one constraint: what Newton says of m l^2 theta'' = -m g l sin(theta)."""
    m, g, length, theta, omega = 0.3, 9.81, 0.7, 0.4, 1.5
    out, along = np.array([np.sin(theta), -np.cos(theta)]), np.array([np.cos(theta), np.sin(theta)])
    bound, drift = out[None, :], np.array([length * omega**2])
    bodies = Constrained(m * np.eye(2), np.array([0.0, m * g]), bound, drift, np.linalg.inv(np.array([out, along])))
    a = bodies.acceleration(np.zeros(2))
    np.testing.assert_allclose(a, -g * np.sin(theta) * along - length * omega**2 * out, rtol=1e-13)
    pull, besides = bodies.reactions(np.zeros(2), a)
    np.testing.assert_allclose(pull, -(m * g * np.cos(theta) + m * length * omega**2), rtol=1e-13)
    np.testing.assert_allclose(besides, 0.0, atol=1e-15)
    np.testing.assert_allclose(bodies.mass(1), m, rtol=1e-15)


def run(*settings: str) -> Trace:
    """Until the robot presses."""
    found = load_experiment(ROOT / "experiments" / "fig4_force_position.toml", ["duration_s=6", *settings])
    return run_in_memory(found, only=["plant.F_ee_B", "plant.p_B"])


def test_a_run_of_a_robot_that_is_a_little_heavier_exceeds_the_bound():
    found = apart(run("plant.m_b_g=30.00003"), run(), {"plant.F_ee_B": 1.0, "plant.p_B": 1e3})
    assert min(found.values()) > SAME_RUN


def test_the_engines_robot_says_the_same_at_some_poses():
    pytest.importorskip("mujoco", reason="only make validation installs it")
    from validation.engine.mechanism import Mechanism
    from validation.engine.robots import EnginesRobot

    own = parameters()
    other = PlantParameters(*own)._replace(a=0.055, b=0.028, l_a=0.065, l_b=0.118, m_a=0.3, m_b=0.2, m_p=0.05, I_r=3e-4)
    for c in (own, other):
        assert max(differences(TwinsRobot(c), EnginesRobot(Mechanism(c), c), states(c, 5)).values()) < ALIKE


def file_of(folder: Path, name: str) -> PlantParameters:
    (folder / "robot.toml").write_text(robot_file_text(OTHER_ROBOTS[name]))
    return file_parameters(folder / "robot.toml")


@pytest.mark.parametrize("name", OTHER_ROBOTS)
def test_a_robot_file_of_another_shape_agrees_with_the_engine_at_some_poses(tmp_path: Path, name: str):
    pytest.importorskip("mujoco", reason="only make validation installs it")
    found = differences_from_engine(file_of(tmp_path, name), 4)
    assert {"forward kinematics", "Jacobian", "mass matrix", "gravity"} <= found.keys()
    assert max(found.values()) < ALIKE


def test_a_robot_file_gives_the_lengths_and_masses_of_the_robot(tmp_path: Path):
    found = file_of(tmp_path, "long rods")
    assert (found.a, found.b, found.l_a, found.l_b) == (0.08, 0.035, 0.1, 0.18)
    assert (found.m_a, found.m_b, found.m_p) == pytest.approx((0.09, 0.025, 0.15))
    assert found.I_r == parameters().I_r


def test_arms_that_cannot_be_horizontal_begin_lower(tmp_path: Path):
    assert initial_angle(file_of(tmp_path, "long rods")) == 0.0
    assert initial_angle(file_of(tmp_path, "wide base")) == radians(50.0)
    with pytest.raises(ValueError, match="close no loop"):
        initial_angle(parameters()._replace(l_b=0.01))


def test_a_link_that_is_not_uniform_is_a_uniform_one_of_the_same_weight_and_inertia(monkeypatch: pytest.MonkeyPatch):
    """The formulas of docs/own_robot.md: m_a = 2 m c/l_a, I_r = I - m_a l_a^2/3."""
    pytest.importorskip("mujoco", reason="only make validation installs it")
    from validation.engine import mechanism
    from validation.engine.robots import EnginesRobot

    c = parameters()
    m, centre, inertia, pulley = 0.08, 0.3 * c.l_a, 3e-5, 2e-5
    m_a = 2.0 * m * centre / c.l_a
    equal = c._replace(m_a=m_a, I_r=inertia + m * centre**2 + pulley - m_a * c.l_a**2 / 3.0)
    uniform = f'<inertial pos="{c.l_a / 2.0!r} 0 0" mass="{c.m_a!r}"'
    described = mechanism.described

    def with_real_links(parameters: PlantParameters, rod: float) -> str:
        head, *rest = described(parameters._replace(I_r=pulley), rod).split(uniform)
        assert len(rest) == 3
        sizes = f'diaginertia="{inertia!r} {inertia!r} {inertia!r}"'
        return head + "".join(
            f'<inertial pos="{centre!r} 0 0" mass="{m!r}" {sizes}/>{text.partition("/>")[2]}' for text in rest
        )

    monkeypatch.setattr(mechanism, "described", with_real_links)
    found = differences(TwinsRobot(equal), EnginesRobot(mechanism.Mechanism(c), equal), states(c, 4))
    assert max(found[key] for key in ("mass matrix", "gravity", "acceleration", "rods")) < ALIKE


def test_no_rod_begins_to_turn_about_its_own_axis():
    pytest.importorskip("mujoco", reason="only make validation installs it")
    from validation.engine.mechanism import Mechanism

    mechanism = Mechanism(parameters())
    mechanism.move(np.array([0.01, 0.02, -0.105]))
    moving = mechanism.equations(np.array([0.5, -0.3, 0.2]))
    engine, model, data = mechanism._engine, mechanism._model, mechanism._data
    data.qacc[:] = moving.acceleration(mechanism.on_arms(np.array([0.1, 0.2, -0.3])))
    engine.mj_rnePostConstraint(model, data)
    found = np.zeros(6)
    for number in range(6):
        site = model.site(f"rod{number}").id
        engine.mj_objectAcceleration(model, data, engine.mjtObj.mjOBJ_SITE, site, found, 1)
        # in the rod's own frame, whose z axis is its axis; the others turn it over
        assert abs(found[2]) < 1e-10 * np.linalg.norm(found[:2])


def test_a_pose_beyond_reach_is_refused():
    pytest.importorskip("mujoco", reason="only make validation installs it")
    from validation.engine.mechanism import Mechanism, Unclosed

    with pytest.raises(Unclosed, match="off by"):
        Mechanism(parameters()).move(np.array([0.0, 0.0, -0.18]))


def test_the_engines_plant_runs_as_the_twins_for_a_moment():
    pytest.importorskip("mujoco", reason="only make validation installs it")
    from validation.engine.plant import run as engines_run

    short = load_experiment(ROOT / "experiments" / "fig4_force_position.toml", ["duration_s=0.05"])
    theirs, own = engines_run(short), run_in_memory(short)
    keys = {key: 1.0 for key in own.fields() if key.startswith("plant.")}
    assert max(apart(theirs, own, keys).values()) < SAME_RUN
    assert np.ptp(own["plant.p_B"]) > 0.0
    assert experiment().duration_ticks == 20_000


class TwinsMechanism:
    """The twin's own robot in the place of the engine's bodies, so that the plant around it runs without the engine."""

    platform = slice(3, 6)

    def __init__(self, c: PlantParameters):
        self._c, self._geometry = c, Geometry(c.a, c.b, c.l_a, c.l_b)

    def move(self, p_B: Numbers) -> None:
        self._p_B, self.theta_l = p_B.copy(), joint_angles(self._geometry, p_B)

    def equations(self, v_B: Numbers) -> "TwinsMechanism":
        self.omega_l = jacobian(self._geometry, self._p_B) @ v_B
        return self

    def on_arms(self, tau_l: Numbers) -> Numbers:
        return np.concatenate([tau_l, np.zeros(3)])

    def acceleration(self, forces: Numbers) -> Numbers:
        J = jacobian(self._geometry, self._p_B)
        M = (self._c.m_p + 3.0 * self._c.m_b) * np.eye(3)
        return np.concatenate([np.zeros(3), np.linalg.solve(M, J.T @ forces[:3] + forces[3:])])


def test_the_plant_around_the_engines_robot_runs_and_is_pressed_by_its_springs():
    found = load_experiment(ROOT / "experiments" / "fig4_force_position.toml", ["duration_s=0.2"])
    own = plant_parameters(found.plant, found.contact)
    x, theta_m = rest_state(own, found.start)
    plant = EnginesPlant(TwinsMechanism(own), own, x, theta_m)  # type: ignore[arg-type]
    trace = Trace()
    component = PythonComponent("plant", plant, initial_outputs=plant.first.tolist())
    with assemble(found, {"plant": component}) as assembly:
        simulate(assembly, found.duration_ticks, [trace]).require_success()
    assert np.isfinite(trace["plant.p_B"]).all() and np.ptp(trace["plant.p_B"][:, 2]) > 0.0
