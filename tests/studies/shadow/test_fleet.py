"""Healthy robots raise no alarm, broken ones do: what the alarm promises, counted."""

from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import poisson

from tests.studies.replay.logs import drifting, softened
from tests.studies.shadow.false_alarms import Count, FalseAlarmRate, counts, rates
from tests.studies.shadow.robots import EXPERIMENTS, FIG4, FLEET, identified_fleet, shipped_fleet
from twin.kernel.errors import InputRefused, TwinError
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import FAULT_KINDS
from twin.robot.run.trace import run_in_memory
from twin.studies.replay.drift import drift
from twin.studies.replay.model import model_of
from twin.studies.replay.parts import PlantModel
from twin.studies.replay.replay import estimates
from twin.studies.replay.residual import angle_rounding
from twin.studies.replay.sample_columns import INPUTS
from twin.studies.replay.samples import RobotSamples, samples_of
from twin.studies.shadow.alarm import CHANNELS, FIRST_BLOCKS, ShadowWatch, Tolerances, tolerances_at
from twin.studies.shadow.fleet import (
    MAX_LOST_SHARE,
    MAX_STAMP_ERROR,
    SCALE_SETTINGS,
    TOLERANCE_MARGIN,
    block_means,
    fleet_limits,
    limits_of,
    own_commands,
    read_fleet,
    transmit_samples,
    watch_blocks,
)
from twin.studies.shadow.tolerances import PERIOD_FACTORS, tolerances_of

EVERY = 2
"""Ticks: samples at 500 Hz, the controller's."""
FRESH = 1000
"""Seed of robots that no tolerance was taken from."""
Means = tuple[list[float], np.ndarray]


@cache
def fig4_limits() -> Tolerances:
    """Of identified robots, in the motion of Fig. 4."""
    return fleet_limits(read_fleet(identified_fleet(), FIG4))[0]


@cache
def fig4_twin() -> Experiment:
    return read_fleet(identified_fleet(), FIG4).twin()


def robot(*settings: str) -> RobotSamples:
    """A robot of Fig. 4 with a scale, by `settings` not what its twin believes."""
    return samples_of(run_in_memory(load_experiment(FIG4, [*SCALE_SETTINGS, *settings]), EVERY))


def alarms_of(
    samples: RobotSamples, twin: Experiment | None = None, per_hour: float = 1.0, limits: Tolerances | None = None
):
    ends, means = block_means(twin or fig4_twin(), samples)
    return watch_blocks(ends, means, ShadowWatch(limits or fig4_limits(), per_hour))


def test_robots_are_the_same_each_time_and_different_from_each_other():
    fleet = read_fleet(FLEET, FIG4, runs=3)
    first, again, other = fleet.samples(0, 50), fleet.samples(0, 50), fleet.samples(1, 50)
    assert np.array_equal(first.u, again.u, equal_nan=True) and np.array_equal(first.t, again.t)
    assert not np.array_equal(first.u[:100, :6], other.u[:100, :6])
    assert read_fleet(FLEET, FIG4, runs=3, seed=5).robots != fleet.robots


def test_a_fleet_has_a_robot_at_each_corner_of_what_varies_where_it_varies_between_ends(tmp_path: Path):
    fleet = read_fleet(FLEET, FIG4, runs=3)
    assert len(set(fleet.corners)) == 64
    ends: dict[str, set[float]] = {key: set() for key in (setting.partition("=")[0] for setting in fleet.corners[0])}
    for setting in (one for corner in fleet.corners for one in corner):
        ends[setting.partition("=")[0]].add(float(setting.partition("=")[2]))
    assert ends["contact.height_mm"] == {-101.5, -100.5} and ends["plant.joint_friction_Nm"] == {0.0, 0.02}
    assert {len(found) for found in ends.values()} == {2}
    # one that nothing bounds has no corner
    file = tmp_path / "fleet.toml"
    text = FLEET.read_text().replace("../massage.toml", str(EXPERIMENTS / "massage.toml"))
    file.write_text(text.replace("from = 1000\nto   = 1500", 'distribution = "normal"\nmean = 1250\nstd = 100'))
    assert len(read_fleet(file, FIG4, runs=3).corners) == 64
    assert not any(setting.startswith("contact.stiffness") for setting in read_fleet(file, FIG4, runs=3).corners[0])


def test_samples_are_lost_and_stamps_are_off_on_the_way():
    # a robot at a corner loses the most
    fleet = read_fleet(FLEET, FIG4, runs=1)
    whole, samples = fleet.run(1), fleet.samples(1)
    lost = 1.0 - len(samples.t) / len(whole.t)
    assert 0.5 * MAX_LOST_SHARE < lost < 1.5 * MAX_LOST_SHARE
    nearest = whole.t[np.rint(samples.t / 2e-3).astype(int)]
    assert 0.9 * MAX_STAMP_ERROR < np.abs(samples.t - nearest).max() <= MAX_STAMP_ERROR


def test_limits_are_the_largest_shift_and_the_spread_from_block_to_block():
    random = np.random.default_rng(2)
    shapes = [np.tile(random.standard_normal(len(CHANNELS)), (2000, 1)) for _ in range(3)]
    means = [shape + 0.1 * random.standard_normal(shape.shape) for shape in shapes]
    means[1][1500, 0] = means[1][:FIRST_BLOCKS, 0].mean() + 7.0
    limits = limits_of(means)
    assert limits.tolerance["motor 1"] == pytest.approx(TOLERANCE_MARGIN * 7.0)
    assert limits.sigma["motor 2"] == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize("blocks", range(FIRST_BLOCKS + 2))
def test_runs_too_short_for_a_shift_are_refused(blocks: int):
    with pytest.raises(InputRefused, match=r"too short; expected at least 4\.5 s"):
        limits_of([np.zeros((blocks, len(CHANNELS)))] * 2)


def test_a_rate_is_bounded_exactly():
    # no event in T hours: the rate is below 3/T with 95 %
    assert FalseAlarmRate(0, 300.0).upper == pytest.approx(-np.log(0.05) / 300.0)
    assert FalseAlarmRate(2, 10.0).upper > FalseAlarmRate(1, 10.0).upper > FalseAlarmRate(0, 10.0).upper


UNKNOWN = {
    "skin": "contact.stiffness_N_per_m=1500",
    "height": "contact.height_mm=-100.5",
    "friction": "plant.joint_friction_Nm=0.02",
}
NOISY = ("plant.motor_noise_deg=0.02", "plant.joint_noise_deg=0.02")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.endurance) for seed in range(2, 8))])
@pytest.mark.parametrize("unknown", UNKNOWN)
def test_joint_residuals_of_a_replay_alarm_on_every_healthy_robot_and_these_on_none(unknown: str, seed: int):
    model = model_of(load_experiment(FIG4, SCALE_SETTINGS))
    rounding = angle_rounding(model.belief_with_dead_zone)
    settings = (UNKNOWN[unknown], *NOISY, f"seed={seed}")
    run = run_in_memory(load_experiment(FIG4, [*SCALE_SETTINGS, *settings]), EVERY)
    samples = samples_of(run)
    off = PlantModel(model).feed(samples, estimates(samples, model))["residual/joints"]
    found = [drift(samples.t, off[:, i], 1.0, *rounding) for i in range(3)]
    assert any(one is not None and not one.matches for one in found)
    assert not alarms_of(samples, per_hour=100.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("faults", "today"), [(softened((1, 2, 3), 10.0), 12.0), (drifting(6.0), 8.0)], ids=["springs", "encoder"]
)
def test_what_a_replay_finds_is_found_at_most_two_seconds_later(faults, today):
    for per_hour in (1.0, 0.01):
        assert alarms_of(robot(faults), per_hour=per_hour)[0].t <= today + 2.0


@pytest.mark.slow
def test_in_contact_softer_springs_are_found_by_the_motors_torques_and_not_without_them():
    samples = robot(softened((1, 2, 3), 10.0))
    samples.only("tau_motor")[:] = np.nan
    assert not alarms_of(samples)
    samples.only("F_z")[:] = np.nan
    assert not alarms_of(samples, per_hour=100.0)


@pytest.mark.slow
def test_a_robot_that_takes_its_springs_for_others_is_found_by_its_commands():
    belief = "fault=[{kind='belief_k_s', target='estimator', onset_s=10.0, magnitude_factor=1.2}]"
    (alarm, *_) = alarms_of(robot(belief))
    assert alarm.channel == "command" and alarm.t <= ONSET + 10.0
    # its twin's tasks go by single samples
    assert own_commands(load_experiment(EXPERIMENTS / "rolling.toml"), robot()) == {}


ONSET = 10.0


def catalogue() -> list[str]:
    """Every fault of the catalogue that leaves a robot to listen to, at each magnitude."""
    faults = []
    for name, kind in FAULT_KINDS.items():
        for magnitude in kind.magnitudes or (None,):
            own = "" if magnitude is None else f", {kind.magnitude_key} = {magnitude}"
            share = ", share = 0.02" if kind.has_share else ""
            faults.append(f"{{kind = '{name}', target = '{kind.targets[0]}', onset_s = {ONSET}{own}{share}}}")
    return faults


@pytest.mark.slow
@pytest.mark.parametrize(("every", "least"), [(3, 8), pytest.param(1, 25, marks=pytest.mark.endurance)])
def test_nine_of_ten_faults_that_move_a_residual_by_twice_its_tolerance_are_found_within_ten_seconds(
    every: int, least: int
):
    fleet, limits = read_fleet(identified_fleet(), FIG4), fig4_limits()
    tolerance = np.array([limits.tolerance[name] for name in CHANNELS])
    ends, healthy = block_means(fig4_twin(), fleet.samples(0))
    found, moved = [], 0
    for fault in catalogue()[::every]:
        try:
            samples = fleet.samples(0, 1, [f"fault=[{fault}]"])
        except TwinError:
            # the run ended: there is no robot any more
            continue
        ends, means = block_means(fig4_twin(), samples)
        shift = np.abs(means - healthy[: len(means)])[np.array(ends) > ONSET] / tolerance
        if np.nanmax(shift) < 2.0:
            continue
        moved += 1
        later = [a for a in watch_blocks(ends, means, ShadowWatch(limits, 1.0)) if a.t > ONSET]
        found.append(bool(later) and later[0].t <= ONSET + 10.0)
    assert moved >= least
    assert np.mean(found) >= 0.9


WITHOUT = {"all": (), "no torques, no force": ("tau_motor", "F_z"), "angles": ("tau_motor", "F_z", "omega_ref")}
"""Inputs that a robot does not send."""


@pytest.mark.slow
def test_the_fewer_signals_a_robot_sends_the_fewer_faults_of_the_catalogue_are_found():
    fleet = shipped_fleet(FIG4)
    limits = tolerances_at(tolerances_of(fleet)[0], 500.0)
    assert isinstance(limits, Tolerances)
    found, runs = dict.fromkeys(WITHOUT, 0), 0
    for fault in catalogue():
        try:
            whole = fleet.samples(0, 1, [f"fault=[{fault}]"])
        except TwinError:
            continue
        runs += 1
        for name, missing in WITHOUT.items():
            samples = RobotSamples(whole.t, whole.u.copy())
            for port in missing:
                samples.only(port)[:] = np.nan
            found[name] += any(one.t > ONSET for one in alarms_of(samples, per_hour=0.01, limits=limits))
    # docs/shadow_reference.md has this table
    assert (runs, *found.values()) == (80, 38, 33, 16)


ROBOTS = 6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("encoder", "found", "earliest", "latest"),
    [
        ("motor_encoder_1", 2, 7.5, 9.5),
        ("motor_encoder_2", ROBOTS, 1.5, 2.5),
        ("motor_encoder_3", ROBOTS, 1.5, 1.5),
        ("joint_encoder_1", ROBOTS, 1.5, 1.5),
        *((f"joint_encoder_{k}", ROBOTS, 0.5, 0.5) for k in (2, 3)),
    ],
)
def test_a_bias_of_a_tenth_of_a_degree_is_found_as_the_page_states(
    encoder: str, found: int, earliest: float, latest: float
):
    fleet = read_fleet(identified_fleet(), FIG4)
    bias = f"fault=[{{kind = 'encoder_bias', target = '{encoder}', onset_s = {ONSET}, magnitude_deg = 0.1}}]"
    alarms = [[one.t for one in alarms_of(fleet.samples(k, 1, [bias])) if one.t > ONSET] for k in range(ROBOTS)]
    after = sorted(times[0] - ONSET for times in alarms if times)
    # docs/shadow_reference.md has these numbers
    assert len(after) == found
    assert after[0] == pytest.approx(earliest, abs=0.1) and after[-1] == pytest.approx(latest, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "factor", "after"),
    [(1, 0.95, None), (2, 0.95, 1.5), (3, 0.95, 0.5), (1, 0.9, 9.5), (2, 0.9, 0.5), (3, 0.9, 0.5)],
)
def test_a_softer_spring_of_an_identified_robot_is_found_as_the_page_states(
    joint: int, factor: float, after: float | None
):
    samples = robot(softened((joint,), ONSET, factor))
    alarms = alarms_of(transmit_samples(samples, np.random.default_rng(4), 0.01, 0.2e-3))
    # docs/shadow_reference.md has these numbers
    assert (alarms[0].t - ONSET if alarms else None) == (after and pytest.approx(after, abs=0.1))


def spread(twin: Experiment, samples: RobotSamples) -> np.ndarray:
    """How far each channel goes from what it was, by its tolerance."""
    _, means = block_means(twin, samples)
    tolerance = np.array([fig4_limits().tolerance[name] for name in CHANNELS])
    shift: np.ndarray = np.nanmax(np.abs(means - means[:FIRST_BLOCKS].mean(axis=0)), axis=0) / tolerance
    return shift


@pytest.mark.slow
def test_a_dead_twin_is_noticed():
    healthy = robot(*NOISY)
    assert spread(fig4_twin(), healthy).max() < 1.0
    # its motors stand still
    frozen = RobotSamples(healthy.t, healthy.u.copy())
    frozen.only("omega_ref")[:] = 0.0
    assert spread(fig4_twin(), frozen)[:3].max() > 2.0
    assert alarms_of(frozen)
    # it believes in softer springs
    softer = load_experiment(FIG4, [*SCALE_SETTINGS, "plant.k_s_Nm_per_rad=0.8"])
    assert spread(softer, healthy)[6:10].max() > 2.0
    assert alarms_of(healthy, softer)
    # it takes one joint for another
    swapped = RobotSamples(healthy.t, healthy.u.copy())
    for name in ("count_m", "count_l"):
        swapped.only(name)[:] = healthy.only(name)[:, [1, 0, 2]]
    assert alarms_of(swapped)


@cache
def massage_limits() -> Tolerances:
    """Those that are shipped, at the controller's rate."""
    limits = tolerances_at(tolerances_of(shipped_fleet(EXPERIMENTS / "massage.toml"))[0], 500.0)
    assert limits is not None
    return limits


def counted(all_means: list[Means], per_hour: float, limits: Tolerances, share: float = 1.0) -> FalseAlarmRate:
    """Alarms of many robots."""
    alarms = sum(
        len(watch_blocks(ends, means, ShadowWatch(limits, per_hour, share=share))) for ends, means in all_means
    )
    return FalseAlarmRate(alarms, sum(len(ends) - FIRST_BLOCKS for ends, _ in all_means) / 3600.0)


THREE_HOURS, HALF_AN_HOUR = 184, 31
"""Robots of 59 blocks each."""
HOURS = pytest.mark.parametrize("robots", [HALF_AN_HOUR, pytest.param(THREE_HOURS, marks=pytest.mark.endurance)])


@cache
def healthy_robots(robots: int) -> list[Means]:
    fleet = read_fleet(FLEET, runs=robots, seed=FRESH)
    twin = fleet.twin()
    return [block_means(twin, fleet.samples(k)) for k in range(robots)]


def promised(rate: FalseAlarmRate) -> bool:
    """Whether there are no more alarms than one an hour gives with 95 %."""
    return rate.alarms <= poisson.ppf(0.95, rate.hours)


@pytest.mark.slow
@HOURS
def test_healthy_robots_keep_the_promise_of_one_alarm_an_hour(robots: int):
    rate = counted(healthy_robots(robots), 1.0, massage_limits())
    assert rate.hours >= 0.5 and promised(rate)
    if robots == THREE_HOURS:
        assert rate.hours >= 3.0 and rate.upper <= 1.0


@pytest.mark.slow
@HOURS
def test_half_of_threshold_and_tolerance_or_a_fleet_without_tolerance_break_it(robots: int):
    limits = massage_limits()
    assert not promised(counted(healthy_robots(robots), 1.0, limits, share=0.5))
    none = Tolerances(dict.fromkeys(CHANNELS, 0.0), limits.sigma)
    assert not promised(counted(healthy_robots(robots), 1.0, none))


def _counts(one: tuple[str, int, tuple[int, ...], tuple[str, ...]]) -> list[Count]:
    """Of one robot, in a process of its own."""
    return list(counts(*one))


def counted_anew(
    experiment: str, robots: int, thinned: tuple[int, ...], *settings: str
) -> list[tuple[FalseAlarmRate, FalseAlarmRate]]:
    """False alarms at each sampling rate."""
    asked = [(experiment, k, thinned, settings) for k in range(robots)]
    with get_context("spawn").Pool(2) as pool:
        rows = [row for found in pool.imap_unordered(_counts, asked, chunksize=20) for row in found]
    return [both for key, both in rates(rows).items() if key[0] == experiment]


@pytest.mark.endurance
@pytest.mark.parametrize(
    ("experiment", "robots", "settings"),
    [
        ("fig4_force_position", 640, ()), ("fig4_position", 640, ()), ("pressing", 1090, ()), ("tapping", 835, ()),
        ("rolling", 295, ()), ("pushing", 330, ()), ("massage", 184, ()),
        ("fig4_force_position", 640, ("controller.period_ms=1",)),
        ("fig4_force_position", 640, ("controller.period_ms=5",)),
    ],
)  # fmt: skip
def test_at_each_rate_of_each_task_three_hours_keep_the_promise_of_one_alarm_an_hour(
    experiment: str, robots: int, settings: tuple[str, ...]
):
    found = counted_anew(experiment, robots, PERIOD_FACTORS if not settings else (1,), *settings)
    assert found and all(often.hours >= 3.0 and often.upper <= 1.0 for often, _ in found)


THREE_HUNDRED_HOURS = 18_306


@pytest.mark.endurance
def test_three_hundred_hours_keep_the_promise_of_one_alarm_in_a_hundred():
    ((_, rare),) = counted_anew("massage", THREE_HUNDRED_HOURS, (1,))
    assert rare.hours >= 300.0 and rare.upper <= 0.01


def test_a_fleet_is_of_robots_that_can_send_all_that_a_filter_takes():
    samples = read_fleet(FLEET, EXPERIMENTS / "massage.toml", runs=2).samples(1, 100)
    for port in INPUTS:
        assert np.isfinite(samples.only(port.name)).any(), port.name
