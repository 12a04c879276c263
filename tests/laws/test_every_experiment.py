"""What has to hold in every run of every experiment that is shipped, to its end, and of some that are not."""

from typing import NamedTuple

import numpy as np
import pytest

from tests.laws.energy import gained_with_motors_held
from tests.laws.runs import EVERY_EXPERIMENT, FORCE, co_simulated, shipped
from twin.robot.assembly.build import plant_parameters, surface_motions
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian
from twin.robot.mechanism.statics import arm_gravity_torque, platform_weight
from twin.robot.plant.dynamics import PlantParameters
from twin.robot.run.trace import Trace

LOSSES = ("plant.eta=0.8", "plant.eta_rate_rad_per_s=0.2")
RUNS = {name: (name,) for name in EVERY_EXPERIMENT} | {
    "no friction": (FORCE, "contact.friction=0"),
    "much friction": (FORCE, "contact.friction=0.9"),
    "steep": (FORCE, "contact.tilt_deg=10"),
    "steep without friction": (FORCE, "contact.tilt_deg=10", "contact.friction=0"),
    "jacobi": (FORCE, 'cosim.scheme="jacobi"'),
    "directed efficiency": (FORCE, *LOSSES),
    "directed efficiency in the air": ("step_z_side", *LOSSES),
}
IN_AIR = ("step_joint_", "step_z_", "track_chirp", "track_circle", "track_line")
AGAIN = 6.0
"""Seconds that are run twice; most experiments touch the surface before."""


class Run(NamedTuple):
    """What was run, and its rows to the end."""

    experiment: Experiment
    rows: Trace
    in_air: bool

    @property
    def duration(self) -> float:
        """s."""
        return self.experiment.duration_ticks * self.experiment.cosim.tick

    @property
    def plant(self) -> PlantParameters:
        """What is true."""
        return plant_parameters(self.experiment.plant, self.experiment.contact)


def ran(name: str, *overrides: str) -> Run:
    experiment = shipped(name, *overrides)
    rows = co_simulated(experiment, experiment.duration_ticks * experiment.cosim.tick)
    return Run(experiment, rows, name.startswith(IN_AIR))


@pytest.fixture(scope="module", params=RUNS.values(), ids=list(RUNS))
def run(request: pytest.FixtureRequest) -> Run:
    """One after the other: pytest takes all laws of one run before it goes on, and one run is in memory."""
    return ran(*request.param)


@pytest.fixture(scope="module")
def fig4() -> Run:
    return ran(FORCE)


def surface(run: Run):
    """Normal and the two tangents of the surface, rows of (3, 3)."""
    t = run.experiment.contact.tilt
    return np.array([[np.sin(t), 0.0, np.cos(t)], [np.cos(t), 0.0, -np.sin(t)], [0.0, 1.0, 0.0]])


def test_surface_only_pushes_and_friction_stays_in_its_cone(run: Run):
    n, e_1, e_2 = surface(run)
    F = run.rows["plant.F_ee_B"]
    pressing, friction = -F @ n, np.hypot(F @ e_1, F @ e_2)
    # rounding of forces below 10 N
    np.testing.assert_allclose(pressing, run.rows["plant.F_n"], rtol=0, atol=1e-12)
    assert pressing.min() >= -1e-12
    assert np.all(friction <= run.experiment.contact.friction * pressing + 1e-12)
    assert pressing.max() == 0.0 if run.in_air else pressing.max() > 3.0


def test_at_the_start_springs_weight_and_contact_do_no_virtual_work(run: Run):
    """J^T (tau_l + g_a) = F_ee + W: the robot begins at rest, whatever its belts lose when they run."""
    plant, rows = run.plant, run.rows
    J = jacobian(Geometry(*plant[:4]), rows["plant.p_B"][0])
    arms = [arm_gravity_torque(plant, plant, theta) for theta in rows["plant.theta_l"][0]]
    left = J.T @ (rows["plant.tau_l"][0] + arms) - rows["plant.F_ee_B"][0] - [0.0, 0.0, platform_weight(plant)]
    # rounding of forces below 20 N
    np.testing.assert_allclose(left, 0.0, rtol=0, atol=1e-12)
    assert not rows["plant.v_B"][0].any()


def test_belts_pass_on_no_more_power_than_they_get(run: Run):
    tau_l, tau_load, omega_l = (run.rows[f"plant.{name}"] for name in ("tau_l", "tau_load", "omega_l"))
    into = run.plant.N * tau_load * omega_l
    lost = into - tau_l * omega_l
    # rounding of powers below 0.1 W
    assert lost.min() >= -1e-16
    if run.plant.eta < 1.0:
        # driving or driven, a fifth at most; at full speed, which the reversals of Fig. 4 reach, most of it
        assert np.all(lost <= (1.0 / run.plant.eta - 1.0) * np.abs(into) + 1e-16)
        assert lost.sum() > 0.02 * np.abs(into).sum()
    else:
        assert lost.max() <= 1e-16


def test_nothing_but_the_motors_makes_energy(run: Run):
    """Within each tick, while the plant sees motors that stand, the robot only loses energy."""
    if surface_motions(run.experiment.contact):
        pytest.skip("a surface that moves does work")
    gained = gained_with_motors_held(run.plant, run.rows, run.experiment.cosim.scheme)
    # rounding of 0.1 J of weight and springs
    assert gained.max() <= 1e-15
    assert gained.sum() < -1e-6


def test_scale_shows_the_vertical_contact_force_to_half_a_step(run: Run):
    scale = run.experiment.scale
    if scale is None:
        pytest.skip("no scale in this experiment")
    due = slice(None, None, run.experiment.scale_ticks)
    error = run.rows["scale.F_z"] + run.rows["plant.F_ee_B"][due, 2]
    # rounding
    assert np.abs(error).max() <= scale.resolution * 9.81 / 2.0 + 1e-12


def test_commands_stay_within_their_limits(run: Run):
    controller, rows = run.experiment.controller, run.rows
    assert np.abs(rows["controller.omega_ref"]).max() <= controller.speed_limit
    assert np.abs(rows["controller.dp_z"]).max() <= controller.force.limit
    if not run.experiment.tasks:
        # latched; a task lets go of the surface, and triggers anew
        assert np.all(np.diff(rows["controller.triggered"].astype(int)) >= 0)


def test_same_experiment_gives_the_same_bits_twice_however_long_it_runs(run: Run):
    again = co_simulated(run.experiment, min(AGAIN, run.duration)).values
    assert again.tobytes() == run.rows.values[: len(again)].tobytes()


@pytest.mark.endurance
def test_same_experiment_gives_the_same_bits_twice_to_its_end(run: Run):
    assert co_simulated(run.experiment, run.duration).values.tobytes() == run.rows.values.tobytes()


def test_without_tilt_nothing_pulls_sideways_in_x(fig4: Run):
    # leg 1 stands in the plane x = 0 and legs 2 and 3 mirror each other; 0 was seen, another processor may round
    assert np.abs(fig4.rows["plant.F_ee_B"][:, 0]).max() < 1e-9


def test_a_tilted_scale_is_pushed_sideways_by_its_normal_force():
    steep = ran(*RUNS["steep without friction"])
    F = steep.rows["plant.F_ee_B"]
    # rounding: without friction the force is along the normal
    np.testing.assert_allclose(F[:, 0], np.tan(steep.experiment.contact.tilt) * F[:, 2], rtol=0, atol=1e-12)


def test_sweeping_towards_negative_y_drags_the_scale_along(fig4: Run):
    sweeping = (fig4.rows.t > 10.7) & (fig4.rows.t < 18.7)
    F = fig4.rows["plant.F_ee_B"][sweeping]
    # it slides: the friction is mu F_n, to 1e-3 of bristle oscillation in a controller that quantises
    np.testing.assert_allclose(F[:, 1], 0.22 * F[:, 2], rtol=0, atol=1e-3)
