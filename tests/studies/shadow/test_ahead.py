"""What the robot will do next: branches from states and from estimates, and how good they are."""

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.studies.shadow.robots import EXPERIMENTS, FIG4, identified_fleet, with_inputs
from twin.kernel.cosim.component import Pieces
from twin.kernel.cosim.delay import values_by_port
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.build import plant_parameters
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.trace import Trace, run_in_memory
from twin.studies.replay.model import model_of
from twin.studies.replay.parts import Happening, Rows
from twin.studies.replay.samples import RobotSamples, samples_of
from twin.studies.shadow.ahead import (
    AHEAD_PORTS,
    MODEL_ERROR,
    PRESSING_STATES,
    SessionBranches,
    band,
    changed_experiments,
    cholesky_first,
    session_branches,
)
from twin.studies.shadow.branching import LEAD_TIMES, Branching, RobotSnapshot
from twin.studies.shadow.fleet import SCALE_SETTINGS, read_fleet, transmit_samples
from twin.studies.shadow.following import Twin, twin_of
from twin.studies.shadow.layout import VELOCITY


@pytest.mark.parametrize(
    ("name", "tick", "drive", "settings"),
    [
        ("fig4_force_position", 5400, None, ("plant.motor_noise_deg=0.05", "plant.joint_noise_deg=0.02")),
        ("tapping", 9001, None, ("controller.delay_ticks=4", "plant.encoder_latency_ms=3")),
        pytest.param("pressing", 2503, "pmsm_foc", ("plant.joint_friction_Nm=0.02",), marks=pytest.mark.slow),
    ],
)
def test_from_the_robots_own_state_a_branch_is_its_future_bit_for_bit(
    name: str, tick: int, drive: str | None, settings: tuple[str, ...]
):
    robot = load_experiment(EXPERIMENTS / f"{name}.toml", settings, drive)
    with assemble(robot) as assembly:
        simulation = Simulation(assembly.system, robot.duration_ticks, 1001)
        while simulation.next_tick < tick:
            simulation.advance(min(1001, tick - simulation.next_tick))
        saved = simulation.state().saved()
        rows = simulation.advance(1001)[50::50]
        columns = [assembly.system.columns(f"plant.{key}").start + 2 for key in ("F_ee_B", "p_B")]
        came = rows[:, columns] * (-1.0, 1.0)
    branching = Branching(robot)
    predicted = branching.run_from(saved)
    branching.close()
    assert predicted.tobytes() == came.tobytes()


def test_predictions_go_on_with_the_plant_that_was_accepted():
    experiment = load_experiment(FIG4)
    plant = plant_parameters(experiment.plant, experiment.contact)._replace(k_s_share=(1.0, 0.7, 1.0))
    with SessionBranches(experiment) as ahead:
        for part in twin_of(experiment, model_of(experiment), "robot", ahead=ahead.predicting_part).plant_parts:
            part.accept(plant)
        assert ahead.branchings[0].parameters["k_s_share"].tolist() == [1.0, 0.7, 1.0]


LENGTH = 20.0
"""s of a robot, at most."""


class Foretold(NamedTuple):
    """Of robots: predictions (n, leads, 2) of force and height, their bounds, and what came; what was at their time."""

    first: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    came: NDArray[np.float64]
    held: NDArray[np.float64]


def of_a_fleet(
    name: str, seed: int, number: int, file: Path | None = None, settings: tuple[str, ...] = ()
) -> tuple[Experiment, RobotSamples, Trace]:
    """The twin of a healthy robot that does `name`, samples as they arrive, and the run: zeros, skin, height, friction
    and noise as the fleet has them, samples lost and late."""
    fleet = read_fleet(file or identified_fleet(), EXPERIMENTS / f"{name}.toml", seed=seed, settings=settings)
    random = np.random.default_rng([seed, number])
    zeros = [f"plant.{side}_zero_deg={random.uniform(-0.05, 0.05, 3).tolist()}" for side in ("motor", "joint")]
    own = [*fleet.settings, *fleet.robots[number], *zeros, f"seed={int(random.integers(1 << 31))}"]
    robot = load_experiment(fleet.experiment, own)
    run = run_in_memory(robot, robot.controller_ticks)
    samples = transmit_samples(samples_of(run), random, 0.01, 0.2e-3)
    early = samples.t < LENGTH
    return fleet.twin(), RobotSamples(samples.t[early], samples.u[early]), run


def as_said(samples: RobotSamples) -> RobotSamples:
    return RobotSamples(samples.t - samples.t[0], samples.u)


def fed(twin: Twin, samples: RobotSamples, length: int) -> tuple[Rows, list[Happening]]:
    """Rows of all samples, handed over in slices of so many."""
    pieces = [twin.feed(samples.rows(slice(a, a + length))) for a in range(0, len(samples.t), length)]
    return {topic: np.concatenate([piece[topic] for piece in pieces]) for topic in pieces[0]}, twin.happenings()


def predicted(rows: Rows) -> dict[str, NDArray[np.float64]]:
    given = rows["ahead"]
    return values_by_port(AHEAD_PORTS, given[np.isfinite(given[:, 0])])


@cache
def foretold(seed: int, *names: str, file: Path | None = None, settings: tuple[str, ...] = ()) -> Foretold:
    """Predictions that have a band, of one robot for each of `names`."""
    found = []
    for number, name in enumerate(names):
        believed, samples, run = of_a_fleet(name, seed, number, file, settings)
        start = float(np.random.default_rng([seed, number]).uniform(1.0, 1.5))
        with SessionBranches(believed, start=start) as ahead:
            rows, _ = fed(
                twin_of(believed, model_of(believed), name, ahead=ahead.predicting_part), as_said(samples), 5000
            )
        y = predicted(rows)
        t = run.time("plant")
        truth = np.column_stack([-run["plant.F_ee_B"][:, 2], run["plant.p_B"][:, 2]])
        made = y["made"] + samples.t[0]
        inside = (made + LEAD_TIMES[-1] < min(t[-1], LENGTH)) & np.isfinite(y["F_z_lower"][:, 0])
        at = np.searchsorted(t, made[inside, None] + LEAD_TIMES - 1e-3)
        came, held = truth[at], truth[np.searchsorted(t, made[inside] - 1e-3)]
        first, lower, upper = (
            np.stack([y[f"F_z{end}"], y[f"p_z{end}"]], axis=2)[inside] for end in ("", "_lower", "_upper")
        )
        found.append(Foretold(first, lower, upper, came, np.broadcast_to(held[:, None], came.shape)))
    return Foretold(*(np.concatenate(column) for column in zip(*found, strict=True)))


def picked(one: Foretold, count: int, seed: int) -> Foretold:
    """So many of the instants, at random."""
    chosen = np.random.default_rng(seed).choice(len(one.first), count, replace=False)
    return Foretold(*(column[chosen] for column in one))


def covered(one: Foretold, width: float = 1.0) -> tuple[float, float]:
    """Share of what came in the band: of the force of robots that press or are predicted to, of the height of all;
    `width`: of the band."""
    away, rounding = one.came - one.first, 1e-9
    low, high = width * (one.lower - one.first) - rounding, width * (one.upper - one.first) + rounding
    within = (low <= away) & (away <= high)
    return float(np.mean(within[pressing(one), 0])), float(np.mean(within[..., 1]))


def pressing(one: Foretold) -> NDArray[np.bool_]:
    """Where a robot does, or is predicted to (n, leads)."""
    return (one.first[..., 0] > 0.0) | (one.came[..., 0] > 0.0)


ROBOTS = (
    "fig4_force_position",
    "massage",
    "pressing",
    "rolling",
    "pushing",
    *("pushing", "pressing", "rolling"),
)
FRESH = 77
"""Seed of robots that nothing was calibrated on."""


@pytest.mark.slow
def test_the_band_holds_95_percent_and_is_narrower_than_holding_the_last_value_is_wrong():
    one = picked(foretold(FRESH, *ROBOTS), 200, 1)
    touching = pressing(one)
    # taps, half of which are in air, have no band
    assert 0.3 < np.mean(touching) < 0.9
    assert min(covered(one)) >= 0.95
    # a band of half the width is none
    assert max(covered(one, 0.5)) < 0.95
    width, holding = one.upper - one.lower, one.came - one.held
    assert np.median(width[..., 1]) < np.sqrt(np.mean(holding[..., 1] ** 2))
    # of all there is more air, where the band has no width
    for where in (touching, np.ones_like(touching)):
        assert np.median(width[where, 0]) < 0.5 * np.sqrt(np.mean(holding[where, 0] ** 2))


@pytest.mark.slow
def test_a_prediction_from_the_pose_at_rest_is_none(monkeypatch: pytest.MonkeyPatch):
    names = ("fig4_force_position", "pressing")
    assert min(covered(foretold(FRESH, *names))) >= 0.95
    honest = Branching.present

    def at_rest(self: Branching, *arguments: Any) -> RobotSnapshot:
        now = honest(self, *arguments)
        now.x[VELOCITY : VELOCITY + 3] = 0.0
        begun = Pieces(self.law.pieces().values()).save()
        return now._replace(law=begun, omega_ref=np.zeros(3))

    monkeypatch.setattr(Branching, "present", at_rest)
    assert max(covered(foretold.__wrapped__(FRESH, *names))) < 0.9


@pytest.mark.parametrize(("name", "settings", "why"), [
    ("tapping", (), "a tap's time of touch is not estimated"), ("pressing", ("contact.body=back",), "surface moves"),
])  # fmt: skip
def test_where_twins_clock_decides_when_a_surface_is_touched_there_is_no_band(name: str, settings: tuple, why: str):
    robot = load_experiment(EXPERIMENTS / f"{name}.toml", [*SCALE_SETTINGS, *settings])
    samples = as_said(samples_of(run_in_memory(robot, robot.controller_ticks)))
    samples = samples.rows(slice(4000))
    with SessionBranches(robot) as ahead:
        rows, _ = fed(twin_of(robot, model_of(robot), "robot", ahead=ahead.predicting_part), samples, 4000)
    y = predicted(rows)
    there = np.atleast_1d(np.isfinite(y["F_z_lower"]).all(axis=1))
    assert len(there) > 10 and np.all(np.isfinite(y["F_z"])) and not there.any()
    assert why in ahead.score.no_band and not ahead.score.banded


WHAT_IF = "controller.force.kp_mm_per_N=3"


@cache
def of_fig4() -> tuple[Experiment, RobotSamples]:
    """Its first 6.6 s; it presses from 5.6 s on."""
    robot = load_experiment(FIG4, SCALE_SETTINGS)
    samples = as_said(samples_of(run_in_memory(robot, robot.controller_ticks)))
    return robot, samples.rows(slice(3300))


def looked_ahead(length: int, samples: RobotSamples, **more: Any) -> tuple[Rows, list[Happening], SessionBranches]:
    robot, _ = of_fig4()
    with SessionBranches(robot, **more) as ahead:
        rows, happened = fed(twin_of(robot, model_of(robot), "robot", ahead=ahead.predicting_part), samples, length)
    return rows, happened, ahead


def test_a_prediction_is_the_same_however_samples_are_cut_and_so_is_its_warning_which_comes_once():
    _, samples = of_fig4()
    more: dict[str, Any] = {"changed": {WHAT_IF: load_experiment(FIG4, [*SCALE_SETTINGS, WHAT_IF])}, "limit": 4.0}
    whole, happened, ahead = looked_ahead(len(samples.t), samples, **more)
    cut, happened_then, _ = looked_ahead(37, samples, **more)
    assert [one.text for one in happened] == [one.text for one in happened_then] == ["will press beyond 4 N in 0.5 s"]
    # it does so at 6.06 s
    assert happened[0].t == pytest.approx(5.6, abs=0.01)
    for topic in ("ahead", "what_if/1"):
        given = np.isfinite(whole[topic][:, 0])
        # every half second, a tenth of a second after the estimate
        np.testing.assert_allclose(samples.t[given], 0.6 + 0.5 * np.arange(12), atol=2e-3)
        np.testing.assert_allclose(whole[topic][given, 0], samples.t[given] - 0.1, atol=2e-3)
        np.testing.assert_allclose(cut[topic], whole[topic], rtol=0, atol=1e-9, err_msg=topic)
    # the gain acts once the force loop is on
    assert (
        ahead.score.what_if_differences[WHAT_IF].largest > 0.1
        and ahead.score.what_if_differences[WHAT_IF].largest_time > 5.6
    )
    assert ahead.score.predictions == 12 and ahead.score.share > 0.95
    assert ahead.score.error.rms < 0.1 * ahead.score.hold_error.rms


@pytest.mark.parametrize("name", ["fig4_force_position", pytest.param("track_breathing", marks=pytest.mark.slow)])
def test_a_branch_that_is_not_run_would_be_the_first_one_bit_for_bit(name: str, monkeypatch: pytest.MonkeyPatch):
    believed, samples, _ = of_a_fleet(name, FRESH, 0)
    honest, left_out, run = Branching.differing_branches, [0, 0], [0]

    def checked(self: Branching, now: RobotSnapshot, wanted: Any) -> Any:
        kept = honest(self, now, wanted)
        first = self.run(now)
        for _, other in (one for one in wanted if not any(one is of_kept for of_kept in kept)):
            assert self.run(now, other).tobytes() == first.tobytes()
            left_out[int(first[0, 0] > 0.0)] += 1
        run[0] += len(kept)
        return kept

    monkeypatch.setattr(Branching, "differing_branches", checked)
    with SessionBranches(believed) as ahead:
        fed(twin_of(believed, model_of(believed), name, ahead=ahead.predicting_part), as_said(samples), 500)
    # in free air, and in contact
    assert min(left_out) > 3 and run[0] > sum(left_out)


def test_while_another_controller_leads_the_robot_there_is_no_prediction_and_that_is_said_once():
    _, samples = of_fig4()
    other = samples.only("omega_ref").copy()
    other[1000:2000] += 0.3
    rows, happened, _ = looked_ahead(len(samples.t), with_inputs(samples, omega_ref=other))
    assert [one.text for one in happened] == [
        "no prediction while the robot's commands differ from those of the twin's controller"
    ]
    made = predicted(rows)["made"]
    assert not np.any((made > 2.1) & (made < 3.9)) and np.sum(made > 4.0) >= 4


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        ("controller.force.kp=3", "unknown key 'kp'; did you mean 'kp_mm_per_N'?"),
        ("kp", "--what-if kp: expected key=value"),
        ("controller.period_ms=4", "--what-if controller.period_ms=4: controller.period_ms cannot change in mid-run"),
        ("drive.fmu=pmsm_foc", "--what-if drive.fmu=pmsm_foc: drive cannot change in mid-run"),
        ("plant.l_a_mm=70", "lengths of the mechanism cannot change in mid-run"),
        ("contact.height_mm=-99", "where the surface is, and how stiff, comes from the estimate"),
        ("monitor.force_limit_N=9", "branches have no monitor"),
    ],
)
def test_what_cannot_be_otherwise_is_refused_by_name(asked: str, expected: str):
    with pytest.raises(InputRefused) as refused:
        changed_experiments(FIG4, SCALE_SETTINGS, [asked])
    assert expected in str(refused.value)


def test_a_robot_with_a_part_that_cannot_be_put_anywhere_is_not_predicted_and_the_reason_is_said(
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr(FmuComponent, "lacks_state", lambda self, portable=True: "has no FMU state")
    robot, _ = of_fig4()
    notes: list[str] = []
    assert session_branches(robot, {}, None, notes.append) is None
    assert notes[0].startswith("no predictions: velocity_servo.fmu (drive_1) has no FMU state")
    with pytest.raises(InputRefused, match="has no FMU state"):
        session_branches(robot, {WHAT_IF: robot}, None, notes.append)


@given(st.integers(0, 2**32 - 1))
def test_the_directions_of_an_estimate_have_the_variance_of_what_presses(seed: int):
    root = np.random.default_rng(seed).standard_normal((15, 15))
    P = root @ root.T
    columns = cholesky_first(P)
    for k in PRESSING_STATES:
        np.testing.assert_allclose(np.sum(columns[k] ** 2), P[k, k], rtol=1e-9)
    # what is left is a covariance
    assert np.min(np.linalg.eigvalsh(P - columns @ columns.T)) > -1e-9 * np.trace(P)


def test_causes_of_a_band_join_as_independent_ones_do_upwards_and_downwards_each_by_itself():
    first = np.tile([5.0, -0.1], (len(LEAD_TIMES), 1))
    sure = band(first, [], first[0])
    way = np.array([3.0, 0.0])
    lower, upper = band(first, [[first + way], [first + way, first + 4.0 / 3.0 * way]], first[0])
    np.testing.assert_allclose((upper - first)[0, 0], np.sqrt(3.0**2 + 4.0**2 + MODEL_ERROR[0] ** 2))
    # the second cause goes upwards only
    np.testing.assert_allclose((first - lower)[0, 0], np.sqrt(3.0**2 + MODEL_ERROR[0] ** 2))
    np.testing.assert_allclose((upper - lower)[:, 1], (sure[1] - sure[0])[:, 1])
    # nothing pulls
    assert np.min(band(first, [[first - 9.0]], first[0])[0][:, 0]) == 0.0
