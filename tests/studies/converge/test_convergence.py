"""References: where equations are known the monolithic one, else the finest run; both say the same.

What can be said of an order, and what cannot.
"""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.laws.runs import EXPERIMENTS, FORCE, shipped
from twin.kernel.errors import InputRefused
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment, shorten, with_exact_encoders
from twin.robot.run.trace import run_in_memory
from twin.studies.converge.convergence import (
    OrderFinding,
    comparable_experiment,
    observed_order,
    without_friction,
)
from twin.studies.converge.monolith import has_monolithic_form, monolithic_rows, servos, within_limits
from twin.studies.converge.power import power_residuals
from twin.studies.converge.reference import FINEST_COUPLING, Coupling, reference_of
from twin.studies.converge.signals import largest_errors, sampled_run, signal_samples

DURATION = 2.0


@pytest.fixture(scope="module")
def descent() -> Experiment:
    """Through the air, with nothing that snaps to a tick but the controller's own commands."""
    return shorten(without_friction(with_exact_encoders(shipped(FORCE))), DURATION)


def created(experiment: Experiment, tick: float, scheme: str, inputs: str, iterations: int = 1) -> float:
    """Share of the energy through all three couplings that comes from nowhere."""
    coupling = Coupling(scheme, inputs, iterations)  # type: ignore[arg-type]
    residuals = power_residuals(coupling.apply_to(experiment, tick))
    return sum(one.energy for one in residuals) / sum(one.throughput for one in residuals)


@pytest.mark.parametrize("scheme", ["gauss_seidel", "jacobi"])
def test_held_values_create_energy_of_order_one(descent: Experiment, scheme: str):
    shares = [created(descent, tick, scheme, "hold") for tick in (2e-3, 1e-3, 5e-4)]
    assert min(shares) > 0.0
    slope = np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(shares), 1)[0]
    # an order of 0 or 2 is far outside
    assert slope == pytest.approx(1.0, abs=0.15)


def test_interpolated_values_create_a_hundredth_of_that_and_iterated_ones_next_to_nothing(descent: Experiment):
    held = created(descent, 1e-3, "gauss_seidel", "hold")
    linear = created(descent, 1e-3, "gauss_seidel", "linear")
    once, twice = (created(descent, 1e-3, "gauss_seidel", "linear", n) for n in (2, 3))
    assert abs(linear) < 1e-2 * held
    # each repetition gains a factor of some hundreds; a converged step has the same torque and angle on either side
    assert abs(once) < 1e-2 * abs(linear)
    assert abs(twice) < 1e-1 * abs(once) or abs(twice) < 1e-15


def test_a_motor_end_that_is_turned_at_once_takes_half_of_k_s_times_the_turn_squared(descent: Experiment):
    # Gauss-Seidel: the drive turns against tau_load(t_k), the spring is deflected from there by the whole turn
    held = Coupling("gauss_seidel", "hold").apply_to(descent, descent.cosim.tick)
    rows = run_in_memory(held)
    for joint, residual in enumerate(power_residuals(held), start=1):
        turns = np.diff(rows[f"drive/{joint}.theta_m"])
        expected = float(np.sum(0.5 * held.plant.k_s * turns**2))
        # differences of squares of torques: rounding of 2000 of them
        assert residual.energy == pytest.approx(expected, rel=1e-9)
        assert residual.mean == pytest.approx(expected / DURATION, rel=1e-9)


def test_energy_from_nowhere_is_energy_that_the_drives_have_to_brake(descent: Experiment):
    def works(tick: float) -> tuple[float, float]:
        residuals = power_residuals(Coupling("gauss_seidel", "hold").apply_to(descent, tick))
        return sum(one.energy for one in residuals), sum(one.throughput for one in residuals)

    (much, coarse), (little, fine) = works(2e-3), works(2.5e-4)
    assert much > little > 0.0
    # the weight pulls all the way down, so the throughput is what the drives take out; links and springs end alike. A
    # sixth was measured to go into motions that are not quite the same
    assert coarse - fine == pytest.approx(much - little, rel=0.25)


CONVERGENCE_DURATION = 1.5


def short(*overrides: str, drive: str | None = None) -> Experiment:
    loaded = load_experiment(EXPERIMENTS / f"{FORCE}.toml", overrides, drive)
    return shorten(with_exact_encoders(loaded), CONVERGENCE_DURATION)


def finest_beside_the_monolith(experiment: Experiment) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Rows of the monolithic run, and the largest errors of the finest co-simulation beside it."""
    with assemble(experiment) as assembly:
        drives = servos(assembly.drives)
    assert drives is not None and has_monolithic_form(experiment)
    rows = monolithic_rows(experiment, drives)
    finest, _ = sampled_run(FINEST_COUPLING.apply_to(experiment, experiment.cosim.tick / 8))
    errors = largest_errors(finest, signal_samples(rows, rows["theta_m"]))
    return rows, errors


@pytest.mark.parametrize("drive", ["velocity_servo", "ideal_velocity"])
def test_the_finest_run_tends_to_the_monolithic_one(root: Path, drive: str):
    experiment = short(drive=str(root / "fmus" / drive))
    rows, errors = finest_beside_the_monolith(experiment)
    # 5 mN at the shipped tick and coupling; what is left is of the size of the solver's tolerance
    assert errors["F_z"] < 1e-6 and errors["theta_m"] < 1e-8
    assert np.ptp(rows["theta_m"]) > 0.01


def test_a_drive_whose_equations_are_not_known_is_compared_with_its_finest_run(root: Path):
    reference = reference_of(shorten(short(drive=str(root / "fmus" / "pmsm_foc")), 0.2))
    assert reference.meaning.startswith("the finest run: gauss_seidel, linear, 0.03125 ms")
    assert all(floor >= 0.0 for floor in reference.floor.values())


def test_a_servo_at_a_limit_is_not_the_equation_that_is_integrated():
    experiment = short("drive.parameters.alpha_max=0.5")
    with assemble(experiment) as assembly:
        drives = servos(assembly.drives)
    assert drives is not None
    assert not within_limits(monolithic_rows(experiment, drives), drives)
    assert reference_of(shorten(experiment, 0.2)).meaning.endswith("a drive reaches a limit")


@pytest.mark.parametrize(
    "key",
    [
        "controller.delay_ticks", "controller.bus_delay_ticks", "plant.encoder_latency_ms", "plant.joint_friction_Nm",
    ],
)  # fmt: skip
def test_the_monolithic_run_knows_no_delays_and_no_dry_friction(key: str):
    assert has_monolithic_form(short())
    assert not has_monolithic_form(short(f"{key}=1"))


def test_the_monolithic_run_has_belt_base_head_and_eccentric_encoders_of_the_plant():
    told = (
        "plant.belt_compliance_rad_per_Nm=0.05", "plant.mounting_tilt_deg=10", "plant.head_mm=[1,2,-17]",
        "plant.joint_eccentricity_deg=[0.5,0,0]",
    )  # fmt: skip
    experiment = shorten(short(*told), 0.4)
    rows, errors = finest_beside_the_monolith(experiment)
    assert errors["F_z"] < 1e-6 and errors["theta_m"] < 1e-8
    # the head is 1 mm in the scale
    assert -rows["plant.F_ee_B"][0, 2] == pytest.approx(1.25, rel=1e-9)


def test_a_drive_behind_a_gear_is_not_taken_for_ours():
    experiment = short("drive.gear_ratio=2.0")
    with assemble(experiment) as assembly:
        assert servos(assembly.drives) is None


def test_the_force_loop_of_a_comparable_run_starts_when_it_did():
    smooth, changes = comparable_experiment(shorten(shipped(FORCE), 6.0))
    assert changes == ("encoders exact", "force loop on at 5.606 s, not by force")
    assert smooth.controller.force.trigger_time == 5.606


@pytest.mark.parametrize(("name", "says"), [("pressing", "change phase at the measured force"), (FORCE, "has faults")])
def test_what_no_two_runs_do_alike_is_refused(name: str, says: str):
    broken = 'fault=[{kind="drive_runaway", onset_s=6.0, magnitude_rad_per_s=2.0}]'
    with pytest.raises(InputRefused, match=says):
        comparable_experiment(shipped(name, *([broken] if name == FORCE else [])))


@pytest.mark.parametrize("setting", ["plant.spring_hysteresis=0.02", "plant.spring_stop_deg=15"])
def test_springs_whose_energy_is_not_known_are_refused(setting: str):
    with pytest.raises(InputRefused, match=rf"\[plant\] {setting.partition('=')[0][6:]}: the energy that a coupling"):
        comparable_experiment(shipped(FORCE, setting))


TICKS = 1e-3 * np.array([2.0, 1.0, 0.5, 0.25])


@given(st.floats(0.6, 4.0), st.floats(1e-6, 1e3))
def test_a_power_of_the_tick_is_its_own_order(p: float, C: float):
    order = observed_order(TICKS, C * TICKS**p, 0.0)
    # rounding of logarithms
    assert order.slope == pytest.approx(p, abs=1e-9)
    assert order.finding is OrderFinding.SMOOTH


@given(st.permutations(range(4)))
def test_the_sequence_of_the_runs_does_not_matter(sequence: list[int]):
    errors = TICKS**2 * np.array([1.0, 1.1, 0.9, 1.0])
    one, other = observed_order(TICKS, errors, 0.0), observed_order(TICKS[sequence], errors[sequence], 0.0)
    # rounding of sums in another sequence
    assert other.slope == pytest.approx(one.slope, abs=1e-9)
    assert other.finding is one.finding


def test_slopes_that_contradict_each_other_are_said_to():
    errors = [8e-3, 4e-3, 1e-3, 5e-4]
    assert observed_order(TICKS, errors, 0.0).finding is OrderFinding.NOT_SMOOTH


def test_an_error_that_does_not_fall_has_no_order():
    order = observed_order(TICKS, [1e-3, 1.1e-3, 0.9e-3, 1e-3], 0.0)
    assert order.slope is None and order.finding is OrderFinding.NOT_FALLING


def test_errors_near_the_floor_are_left_out_and_too_few_others_make_no_order():
    errors = np.array([1.6e-3, 4e-4, 1e-4, 7e-5])
    # the last one is not an eighth of a square of anything: it has met the floor
    order = observed_order(TICKS, errors, 8e-6)
    assert order.slope == pytest.approx(2.0, abs=1e-9) and order.finding is OrderFinding.SMOOTH
    order = observed_order(TICKS, errors, 2e-5)
    assert order.slope is None and order.finding is OrderFinding.AT_FLOOR


def test_a_run_that_failed_leaves_no_order():
    order = observed_order(TICKS, [np.inf, 1e-3, 5e-4, 2.5e-4], 0.0)
    assert order.slope is None and order.finding is OrderFinding.UNSTABLE
