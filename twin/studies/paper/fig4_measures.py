"""Measures of Fig. 4: functions of its runs that return a number in SI, nan (which fails) if the event never happened.

Measures "while sweeping" are nan without a sweep.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import Recording
from twin.robot.run.view import RunView
from twin.studies.metrics import response as tracking
from twin.studies.metrics.required_series import FIG4_SERIES, missing_series
from twin.studies.metrics.response import Curve, first_time, level_changes, mean_error, rms, window_mask

SWEEP_WINDOW = (10.7, 18.7)
"""Judged part of the sweep (s), from 2 s after its start, when the position loop's lag (1/kp) has decayed."""
BEFORE_SWEEP = (8.0, 8.6)
"""Rest before the sweep (s)."""
FINAL_WINDOW = (19.0, 19.9)
"""Rest after the sweep (s)."""
MIN_DURATION = 19.9
"""Minimum duration of a recording (s)."""
CURVE_PARTS = ((0.72, 5.82), (5.82, 8.7), (8.7, 18.7), (18.7, MIN_DURATION))
"""Parts of a whole curve: descent, arrival, sweep, end (s)."""
MIN_SWEEP = 0.020
"""Minimum path along -y (m) that counts as a sweep: half of the paper's 40 mm."""
MAX_SYMMETRIC_FORCE = 1e-3
"""Maximum force in x (N) of a symmetrical run."""

SWEEP_START, SWEEP_END, SWEEP_HEIGHT = 0.020, -0.020, -0.105
"""Sweep of Sec. III.A.1: from p_y to p_y at p_z (m)."""
JUMP_WINDOW = 0.2
"""Time window for detecting a sudden change (s)."""
JUMP_TIME = 0.1
"""Time after the trigger within which the reference jumps (s)."""
FLUCTUATION_WINDOW = (13.2, 14.7)
"""Time window (s) for maintaining the force in spite of the fluctuation."""
MIN_FORCE_CHANGE = 0.02
"""Minimum detectable change of the force (N): half the effect of one count of a motor encoder (0.04 N)."""
FLUCTUATION_RATIO = 10.0
"""Minimum ratio of a fluctuation to the median change of the force; noise reaches less than six."""
MAX_HEIGHT_RANGE = 0.2e-3
"""Maximum range (m) of a constant height: a twentieth of the 4 mm that the head presses in."""
FORCE_THRESHOLD = 0.6
"""Trigger threshold of the force control (N), as printed."""
MAX_LAG = 2.0
"""Maximum lag tried (s)."""
TIME_ROUNDING = 1e-6
"""Rounding tolerance of times, in blocks: a sample on the edge belongs to the block that it begins."""


def _cached_series(of: Callable[[RunView], Curve]) -> "cached_property[Curve]":
    return cached_property(lambda run: of(run.recording))


@dataclass(frozen=True)
class Fig4Run:
    """A run of Fig. 4: estimates at the controller's rate on `t`, truth at the plant's tick on `t_plant`.

    Attributes:
        t, t_plant, t_scale: times (n,), s, of controller, plant and electronic scale.
        F_z, F_ee_B: pressing force as the controller estimates it, low-passed (N); force on the environment as
            estimated, unfiltered (n, 3), N.
        F_z_ref: reference of F_z (N).
        true_F_z, true_F_ee_B: true pressing force and force on the environment, on `t_plant`.
        scale_F_z: the scale's reading (N), on `t_scale`.
        p_B, z: position as the controller estimates it (n, 3), m, as from the paper's encoders; its height.
        z_ref, z_cmd: reference height, pre-defined and after the force loop (m).
        true_z: true height, on `t_plant`.
    """

    recording: RunView

    t = _cached_series(lambda series: series.time("controller"))
    t_plant = _cached_series(lambda series: series.time("plant"))
    t_scale = _cached_series(lambda series: series.time("scale"))
    F_z = _cached_series(lambda series: series["controller.F_z"])
    F_ee_B = _cached_series(lambda series: series["estimator.F_ee_B"])
    true_F_ee_B = _cached_series(lambda series: series["plant.F_ee_B"])
    true_F_z = _cached_series(lambda series: -series["plant.F_ee_B"][:, 2])
    scale_F_z = _cached_series(lambda series: series["scale.F_z"])
    p_B = _cached_series(lambda series: series["estimator.p_B"])
    z = _cached_series(lambda series: series["estimator.p_B"][:, 2])
    z_ref = _cached_series(lambda series: series["controller.p_ref_B"][:, 2])
    z_cmd = _cached_series(lambda series: series["controller.p_cmd_B"][:, 2])
    true_z = _cached_series(lambda series: series["plant.p_B"][:, 2])

    @property
    def is_in_step(self) -> bool:
        """Whether estimator and controller have samples at the same instants, as without lost messages."""
        return np.array_equal(self.recording.time("estimator"), self.t)

    @cached_property
    def true_z_error(self) -> Curve:
        """True height minus the pre-defined reference (m), at the controller's rate."""
        return np.interp(self.t, self.t_plant, self.true_z) - self.z_ref

    @cached_property
    def F_z_ref(self) -> float:
        return float(self.recording["controller.F_z_ref"][0])

    @cached_property
    def trigger_time(self) -> float:
        """Trigger time of the force loop (s); infinity if never triggered."""
        return first_time(self.t, self.recording["controller.triggered"])

    @cached_property
    def sweeps(self) -> bool:
        """Whether the platform moves along -y during the sweep of Fig. 4."""
        y = self.p_B[self.controller_window(*SWEEP_WINDOW), 1]
        return bool(y[0] - y[-1] >= MIN_SWEEP)

    def controller_window(self, start: float, end: float) -> np.ndarray:
        return window_mask(self.t, start, end)

    def plant_window(self, start: float, end: float) -> np.ndarray:
        return window_mask(self.t_plant, start, end)


@dataclass(frozen=True)
class Fig4Runs:
    """Runs of Fig. 4's experiment, with force-position control and with position control alone.

    `imperfect` has both runs of an asymmetrical robot, which the claims about forces in x need; None without them.
    """

    force_position: Fig4Run
    position: Fig4Run
    imperfect: "tuple[Fig4Run, Fig4Run] | None" = None

    @property
    def imperfect_force_position(self) -> Fig4Run | None:
        return self.imperfect[0] if self.imperfect else None

    @property
    def imperfect_position(self) -> Fig4Run | None:
        return self.imperfect[1] if self.imperfect else None

    @property
    def without_x(self) -> str:
        """Reason why the forces in x are not judged on the runs of Fig. 4, or ""."""
        if self.imperfect is None:
            return "needs the runs of fig4_imperfect.toml and fig4_imperfect_position.toml as well"
        if all(np.max(np.abs(run.true_F_ee_B[:, 0])) < MAX_SYMMETRIC_FORCE for run in self.imperfect):
            return "the true F_x is 0 by symmetry"
        return ""

    @property
    def missing(self) -> dict[str, list[str]]:
        """Series that claims of Fig. 4 need and each recorded run lacks, by file."""
        runs = [self.force_position, self.position, *(self.imperfect or ())]
        recorded = [run.recording for run in runs if isinstance(run.recording, Recording)]
        found = {str(one.path): missing_series(FIG4_SERIES, one.fields()) for one in recorded}
        return {path: names for path, names in found.items() if names}

    @property
    def tuned_parameters(self) -> dict[str, str]:
        """Parameters whose source states that they were tuned to meet the paper: key -> source."""
        runs = (self.force_position, *(self.imperfect[:1] if self.imperfect else ()))
        origins = [run.recording.metadata.get("origins", {}) for run in runs]
        return {key: text for one in origins for key, text in one.items() if text.startswith("tuned")}


def fig4_runs(force_position: Recording, position: Recording, *imperfect: Recording) -> Fig4Runs:
    """Check the recordings of Fig. 4 and combine them; `imperfect`: the two runs of an asymmetrical robot, or none."""
    pairs = [(force_position, position), *([(imperfect[0], imperfect[1])] if imperfect else [])]
    ideal, *others = [_checked_pair(*pair) for pair in pairs]
    return Fig4Runs(*ideal, *others)


def checked_run(recording: Recording) -> Fig4Run:
    """Return a recording as a run of Fig. 4; raise `InputRefused` if too short or with lost estimates."""
    run = Fig4Run(recording)
    end = run.t[-1] if len(run.t) else 0.0
    if end < MIN_DURATION:
        note = f" ({recording.note})" if recording.note else ""
        raise InputRefused(f"{recording.path}: ends at {end:.3f} s{note}; Fig. 4 needs {MIN_DURATION} s, run it again")
    if not run.is_in_step:
        raise InputRefused(f"{recording.path}: estimator and controller have different times; run it again")
    return run


def _checked_pair(force_position: Recording, position: Recording) -> tuple[Fig4Run, Fig4Run]:
    pair = checked_run(force_position), checked_run(position)
    if any("controller.triggered" not in one.fields() for one in (force_position, position)):
        return pair
    if np.isinf(pair[0].trigger_time) and np.isfinite(pair[1].trigger_time):
        raise InputRefused(
            f"{force_position.path} has no force control and {position.path} has: give the force-position run first"
        )
    return pair


Measure = Callable[[Fig4Runs], float]


def while_sweeping(measure: Measure) -> Measure:
    """Restrict a measure of Fig. 4 to runs that both sweep; nan otherwise."""

    def measured(runs: Fig4Runs) -> float:
        return measure(runs) if runs.force_position.sweeps and runs.position.sweeps else math.nan

    return measured


def in_x(measure: Measure) -> Measure:
    """Apply a measure of Fig. 4 to the imperfect runs, because the ideal runs have no force in x."""

    def measured(runs: Fig4Runs) -> float:
        return while_sweeping(measure)(Fig4Runs(*runs.imperfect)) if runs.imperfect is not None else math.nan

    return measured


def _ratio(a: float, b: float) -> float:
    """Return the ratio of two sizes; infinity for a zero denominator, nan if both are zero."""
    if b == 0.0:
        return math.inf if a > 0.0 else math.nan
    return a / b


def end_error(runs: Fig4Runs) -> float:
    """Measure the platform's largest distance from the ends of the sweep, before and after it, over both runs (m)."""
    missed = [
        abs(float(np.mean(run.p_B[run.controller_window(*window), 1])) - end)
        for run in (runs.force_position, runs.position)
        for window, end in ((BEFORE_SWEEP, SWEEP_START), (FINAL_WINDOW, SWEEP_END))
    ]
    return max(missed)


def unsteadiness(runs: Fig4Runs) -> float:
    """Largest relative deviation of the speed along y, averaged over 1 s, from its mean, in both runs."""
    worst = 0.0
    for run in (runs.force_position, runs.position):
        on = run.controller_window(*SWEEP_WINDOW)
        t, y = run.t[on], run.p_B[on, 1]
        steps = round(1.0 / (t[1] - t[0]))
        speed = (y[steps:] - y[:-steps]) / (t[steps:] - t[:-steps])
        worst = max(worst, float(np.max(np.abs(speed / np.mean(speed) - 1.0))))
    return worst


def off_line(runs: Fig4Runs) -> float:
    """Largest distance from the line p_x = 0, p_z = -105 mm: of the platform in x, of the pre-defined path in z (m)."""
    return max(
        float(np.max(np.hypot(run.p_B[on, 0], run.z_ref[on] - SWEEP_HEIGHT)))
        for run in (runs.force_position, runs.position)
        for on in (run.controller_window(*SWEEP_WINDOW),)
    )


def force_at_trigger(runs: Fig4Runs) -> float:
    """Estimated force at the sample of the trigger (N)."""
    run = runs.force_position
    return float(run.F_z[np.searchsorted(run.t, run.trigger_time)]) if np.isfinite(run.trigger_time) else math.nan


def reference_distance(runs: Fig4Runs) -> float:
    """Largest distance of the z reference from the pre-defined one before the trigger (m)."""
    run = runs.force_position
    before = run.t < run.trigger_time
    return float(np.max(np.abs(run.z_cmd - run.z_ref)[before])) if np.any(before) else math.nan


def reference_jump(runs: Fig4Runs) -> float:
    """Largest depth of the z reference below the pre-defined one within `JUMP_TIME` after the trigger (m)."""
    run = runs.force_position
    if np.isinf(run.trigger_time):
        return math.nan
    return float(np.max((run.z_ref - run.z_cmd)[run.controller_window(run.trigger_time, run.trigger_time + JUMP_TIME)]))


def position_jump(runs: Fig4Runs) -> float:
    """Ratio of the platform's downward speed after the trigger to its speed before."""
    run = runs.force_position
    if not JUMP_WINDOW <= run.trigger_time <= run.t[-1] - JUMP_WINDOW:
        return math.nan
    before, at, after = np.interp(run.trigger_time + JUMP_WINDOW * np.array([-1.0, 0.0, 1.0]), run.t, run.z)
    return float((at - after) / (before - at)) if at < before else math.nan


def reference_left(runs: Fig4Runs) -> float:
    """Mean distance of the z reference from the pre-defined one at the end (m)."""
    run = runs.force_position
    return mean_error(run.z_cmd[run.controller_window(*FINAL_WINDOW)], run.z_ref[run.controller_window(*FINAL_WINDOW)])


def early_trigger(runs: Fig4Runs) -> float:
    """Time (s) from the trigger to the first true contact, 0 if the contact is first; nan if either never happened."""
    run = runs.force_position
    lead = first_time(run.t_plant, run.true_F_z > 0.0) - run.trigger_time
    return max(0.0, lead) if math.isfinite(lead) else math.nan


def _worst_part(run: Fig4Run, apart: Curve) -> float:
    """Return the mean absolute value of a curve (m) in the part of the run where that mean is largest."""
    return max(float(np.mean(np.abs(apart[run.controller_window(*part)]))) for part in CURVE_PARTS)


def z_error(run: Fig4Run) -> float:
    """Mean distance of the height from the pre-defined one in its worst part (m)."""
    return _worst_part(run, run.z - run.z_ref)


def z_gap(runs: Fig4Runs) -> float:
    """Mean distance between the heights of both runs in its worst part (m)."""
    fp, p = runs.force_position, runs.position
    return _worst_part(fp, fp.z - np.interp(fp.t, p.t, p.z))


def z_trend(run: Fig4Run) -> float:
    """Measure the correlation of the height with the pre-defined one; nan if either is constant."""
    on = run.controller_window(CURVE_PARTS[0][0], CURVE_PARTS[-1][1])
    if min(np.ptp(run.z[on]), np.ptp(run.z_ref[on])) == 0.0:
        return math.nan
    return float(np.corrcoef(run.z[on], run.z_ref[on])[0, 1])


def lag(run: Fig4Run) -> tuple[float, float]:
    """(delay in s that fits the pre-defined height to the height best, remaining error in the worst part in m)."""
    on = run.controller_window(0.0, CURVE_PARTS[-1][1])
    delay = tracking.lag(run.t[on], run.z[on], run.z_ref[on], MAX_LAG)
    return delay, _worst_part(run, run.z - np.interp(run.t - delay, run.t, run.z_ref))


def rise_share(runs: Fig4Runs) -> float:
    """Upward changes of the force as a share of all its changes, position control, from the threshold to the sweep."""
    run = runs.position
    start = first_time(run.t, run.F_z >= FORCE_THRESHOLD)
    if not start + 2.0 * JUMP_WINDOW <= CURVE_PARTS[1][1]:
        return math.nan
    on = run.controller_window(start, CURVE_PARTS[1][1])
    blocks = np.floor((run.t[on] - start) / JUMP_WINDOW + TIME_ROUNDING).astype(int)
    change = np.diff(np.bincount(blocks, run.F_z[on]) / np.bincount(blocks))
    return _ratio(float(np.sum(change[change > 0.0])), float(np.sum(np.abs(change))))


def force_error(run: Fig4Run) -> float:
    """Mean distance of the force from its reference during the sweep (N)."""
    return mean_error(run.F_z[run.controller_window(*SWEEP_WINDOW)], run.F_z_ref)


def force_error_ratio(runs: Fig4Runs) -> float:
    """Ratio of the force error of position control alone to that with force control."""
    return _ratio(force_error(runs.position), force_error(runs.force_position))


def force_gap(runs: Fig4Runs) -> float:
    """Mean pressing force during the sweep with force control less the force without (N)."""
    fp, p = runs.force_position, runs.position
    return float(
        np.mean(fp.F_z[fp.controller_window(*SWEEP_WINDOW)]) - np.mean(p.F_z[p.controller_window(*SWEEP_WINDOW)])
    )


def delay(runs: Fig4Runs) -> float:
    """Delay of position control alone in reaching 80 % of the reference force, after force control (s)."""
    fp, p = (first_time(run.t, run.F_z >= 0.8 * run.F_z_ref) for run in (runs.force_position, runs.position))
    return p - fp if np.isfinite(fp) else -math.inf


def bias(runs: Fig4Runs) -> float:
    """Mean of the estimated force less the scale's reading during the sweep (N)."""
    run = runs.force_position
    on = window_mask(run.t_scale, *SWEEP_WINDOW)
    return float(np.mean(np.interp(run.t_scale[on], run.t, run.F_z) - run.scale_F_z[on]))


def friction(run: Fig4Run, axis: int) -> float:
    """Root mean square of the force along x or y during the sweep (N)."""
    return rms(run.F_ee_B[run.controller_window(*SWEEP_WINDOW), axis])


def friction_share(axis: int) -> Measure:
    """Return a measure: friction with position control alone over friction with force control, along an axis."""
    return lambda runs: _ratio(friction(runs.position, axis), friction(runs.force_position, axis))


def x_share(runs: Fig4Runs) -> float:
    """Force along x over force along y (rms), in the run with the larger ratio."""
    return max(_ratio(friction(run, 0), friction(run, 1)) for run in (runs.force_position, runs.position))


def disproportion(runs: Fig4Runs) -> float:
    """Largest distance of the scale's reading from a straight line over the depth, as a share of its final value.

    The line extends from the scale's first reading to the position of position control alone before the sweep.
    """
    run = runs.position
    before = run.t_scale < SWEEP_WINDOW[0]
    reading, z = run.scale_F_z[before], np.interp(run.t_scale[before], run.t, run.z)
    pressing = np.flatnonzero(reading > 0.0)
    if len(pressing) == 0 or pressing[0] == 0:
        return math.nan
    reading, depth = reading[pressing[0] :], z[pressing[0] - 1] - z[pressing[0] :]
    if min(reading[-1], depth[-1]) <= 0.0:
        return math.nan
    return float(np.max(np.abs(reading / reading[-1] - depth / depth[-1])))


def force_range(runs: Fig4Runs) -> float:
    """Range of the scale's reading while position control alone keeps the height constant (N)."""
    run = runs.position
    if np.ptp(run.z[run.controller_window(*SWEEP_WINDOW)]) > MAX_HEIGHT_RANGE:
        return math.nan
    return float(np.ptp(run.scale_F_z[window_mask(run.t_scale, *SWEEP_WINDOW)]))


def fluctuation(run: Fig4Run) -> tuple[float, float]:
    """(time, size) of the single sudden change of the force (s, N); nan if no change exceeds the noise."""
    on = run.controller_window(*SWEEP_WINDOW)
    t, change = level_changes(run.t[on], run.F_z[on], JUMP_WINDOW)
    sizes: Curve = np.abs(change)
    largest = int(np.argmax(sizes))
    if sizes[largest] < max(MIN_FORCE_CHANGE, FLUCTUATION_RATIO * float(np.median(sizes))):
        return math.nan, math.nan
    return float(t[largest]), float(sizes[largest])


def force_after_fluctuation(runs: Fig4Runs) -> float:
    """Largest error of the force around the fluctuation (N)."""
    run = runs.force_position
    return float(np.max(np.abs(run.F_z[run.controller_window(*FLUCTUATION_WINDOW)] - run.F_z_ref)))


def true_force_error(runs: Fig4Runs) -> float:
    """Root mean square of the true force less its reference during the sweep (N)."""
    run = runs.force_position
    return rms(run.true_F_z[run.plant_window(*SWEEP_WINDOW)] - run.F_z_ref)


def true_final_force(runs: Fig4Runs) -> float:
    """Mean true force at the end (N)."""
    run = runs.force_position
    return float(np.mean(run.true_F_z[run.plant_window(*FINAL_WINDOW)]))


def true_z_error(runs: Fig4Runs) -> float:
    """Root mean square of the true height less the pre-defined one during the sweep (m)."""
    run = runs.force_position
    return rms(run.true_z_error[run.controller_window(*SWEEP_WINDOW)])
