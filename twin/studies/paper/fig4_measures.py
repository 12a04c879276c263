"""Measures of Fig. 4: its runs in, a number in SI out; nan where what is measured never happened, which fails.

Everything "while sweeping" is nan without a sweep.
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
"""From 2 s after the sweep along y has begun, when the lag of the position loop (1/kp) has died out, to its end (s)."""
BEFORE_SWEEP = (8.0, 8.6)
"""Before the sweep, at rest (s)."""
FINAL_WINDOW = (19.0, 19.9)
"""After the sweep, at rest (s)."""
MIN_DURATION = 19.9
"""What a recording has to cover (s)."""
CURVE_PARTS = ((0.72, 5.82), (5.82, 8.7), (8.7, 18.7), (18.7, MIN_DURATION))
"""Of a whole curve: descent, arrival, sweep, end (s)."""
MIN_SWEEP = 0.020
"""Least way along -y (m) that counts as a sweep: half of the paper's 40 mm."""
MAX_SYMMETRIC_FORCE = 1e-3
"""Force in x (N) below which a run is symmetrical."""

SWEEP_START, SWEEP_END, SWEEP_HEIGHT = 0.020, -0.020, -0.105
"""The sweep of Sec. III.A.1: from p_y to p_y at p_z (m)."""
JUMP_WINDOW = 0.2
"""Time over which a sudden change is looked for (s)."""
JUMP_TIME = 0.1
"""Time after the trigger within which the reference has jumped (s)."""
FLUCTUATION_WINDOW = (13.2, 14.7)
"""When the force has to be held although it fluctuates (s)."""
MIN_FORCE_CHANGE = 0.02
"""Change of the force (N) that is seen at all: half of what one count of a motor encoder is worth (0.04 N)."""
FLUCTUATION_RATIO = 10.0
"""A fluctuation changes the force by so many times the median change: the largest of noise has less than six."""
MAX_HEIGHT_RANGE = 0.2e-3
"""Range (m) within which a height is a constant: a twentieth of the 4 mm that the head presses in."""
FORCE_THRESHOLD = 0.6
"""Of the force control (N), as printed."""
MAX_LAG = 2.0
"""Of those that are tried (s)."""
TIME_ROUNDING = 1e-6
"""Of a time, in blocks of it: a sample on the edge belongs to the block that it begins."""


def _cached_series(of: Callable[[RunView], Curve]) -> "cached_property[Curve]":
    return cached_property(lambda run: of(run.recording))


@dataclass(frozen=True)
class Fig4Run:
    """One run. Curves at the controller's rate on `t`, those of the plant (the truth) at the tick on `t_plant`.

    Attributes:
        t, t_plant, t_scale: times (n,), s, of controller, plant and electronic scale.
        F_z, F_ee_B: pressing force as the controller estimates it, low-passed (N); force on the environment as
            estimated, unfiltered (n, 3), N.
        F_z_ref: what the former should be (N).
        true_F_z, true_F_ee_B: the same in truth, on `t_plant`.
        scale_F_z: the scale's reading (N), on `t_scale`.
        p_B, z: position as the controller estimates it (n, 3), m: what the paper's encoders give; its height.
        z_ref, z_cmd: height asked for, pre-defined and after the force loop (m).
        true_z: in truth, on `t_plant`.
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
        """Whether estimator and controller tell of the same instants, as they do where nothing was lost."""
        return np.array_equal(self.recording.time("estimator"), self.t)

    @cached_property
    def true_z_error(self) -> Curve:
        """True z minus the pre-defined reference (m), at the controller's rate."""
        return np.interp(self.t, self.t_plant, self.true_z) - self.z_ref

    @cached_property
    def F_z_ref(self) -> float:
        return float(self.recording["controller.F_z_ref"][0])

    @cached_property
    def trigger_time(self) -> float:
        """When the force loop was triggered (s); infinity: never."""
        return first_time(self.t, self.recording["controller.triggered"])

    @cached_property
    def sweeps(self) -> bool:
        """Whether the platform moves along -y while it should."""
        y = self.p_B[self.controller_window(*SWEEP_WINDOW), 1]
        return bool(y[0] - y[-1] >= MIN_SWEEP)

    def controller_window(self, start: float, end: float) -> np.ndarray:
        """Mask of the controller's samples in a window."""
        return window_mask(self.t, start, end)

    def plant_window(self, start: float, end: float) -> np.ndarray:
        """Mask of the plant's samples in a window."""
        return window_mask(self.t_plant, start, end)


@dataclass(frozen=True)
class Fig4Runs:
    """The force-position run and the position-only run.

    Attributes:
        imperfect: the same two of a robot and a scale that are not symmetrical, for the forces in x; None: there are
            none, and nothing is said of these.
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
        """Why these runs say nothing about forces in x, or ""."""
        if self.imperfect is None:
            return "needs the runs of fig4_imperfect.toml and fig4_imperfect_position.toml as well"
        if all(np.max(np.abs(run.true_F_ee_B[:, 0])) < MAX_SYMMETRIC_FORCE for run in self.imperfect):
            return "the true F_x is 0 by symmetry"
        return ""

    @property
    def missing(self) -> dict[str, list[str]]:
        """Series that claims are judged on and a recorded run lacks, by the run's file."""
        runs = [self.force_position, self.position, *(self.imperfect or ())]
        recorded = [run.recording for run in runs if isinstance(run.recording, Recording)]
        found = {str(one.path): missing_series(FIG4_SERIES, one.fields()) for one in recorded}
        return {path: names for path, names in found.items() if names}

    @property
    def tuned_parameters(self) -> dict[str, str]:
        """Parameters whose source says that they were tuned to meet the text: key -> source."""
        runs = (self.force_position, *(self.imperfect[:1] if self.imperfect else ()))
        origins = [run.recording.metadata.get("origins", {}) for run in runs]
        return {key: text for one in origins for key, text in one.items() if text.startswith("tuned")}


def fig4_runs(force_position: Recording, position: Recording, *imperfect: Recording) -> Fig4Runs:
    """The recordings of Fig. 4.

    Args:
        imperfect: the same two of fig4_imperfect.toml and fig4_imperfect_position.toml, or none.

    Raises:
        InputRefused: as `checked_run`, or they stand in the wrong order.
    """
    pairs = [(force_position, position), *([(imperfect[0], imperfect[1])] if imperfect else [])]
    ideal, *others = [_checked_pair(*pair) for pair in pairs]
    return Fig4Runs(*ideal, *others)


def checked_run(recording: Recording) -> Fig4Run:
    """A recording of Fig. 4 that can be judged.

    Raises:
        InputRefused: it is too short, or has lost estimates.
    """
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
    """`measure`, of runs that both sweep."""

    def measured(runs: Fig4Runs) -> float:
        return measure(runs) if runs.force_position.sweeps and runs.position.sweeps else math.nan

    return measured


def in_x(measure: Measure) -> Measure:
    """`measure`, of the imperfect runs, which alone have a force in x."""

    def measured(runs: Fig4Runs) -> float:
        return while_sweeping(measure)(Fig4Runs(*runs.imperfect)) if runs.imperfect is not None else math.nan

    return measured


def _ratio(a: float, b: float) -> float:
    """The ratio of two sizes; infinity over nothing, nan if there is neither."""
    if b == 0.0:
        return math.inf if a > 0.0 else math.nan
    return a / b


# the way over the scale


def end_error(runs: Fig4Runs) -> float:
    """How far the platform is from the ends of the sweep before and after it, the worst of both runs (m)."""
    missed = [
        abs(float(np.mean(run.p_B[run.controller_window(*window), 1])) - end)
        for run in (runs.force_position, runs.position)
        for window, end in ((BEFORE_SWEEP, SWEEP_START), (FINAL_WINDOW, SWEEP_END))
    ]
    return max(missed)


def unsteadiness(runs: Fig4Runs) -> float:
    """Largest deviation of the speed along y, taken over 1 s, from its mean, as a share of it; of both runs."""
    worst = 0.0
    for run in (runs.force_position, runs.position):
        on = run.controller_window(*SWEEP_WINDOW)
        t, y = run.t[on], run.p_B[on, 1]
        steps = round(1.0 / (t[1] - t[0]))
        speed = (y[steps:] - y[:-steps]) / (t[steps:] - t[:-steps])
        worst = max(worst, float(np.max(np.abs(speed / np.mean(speed) - 1.0))))
    return worst


def off_line(runs: Fig4Runs) -> float:
    """Largest distance from the line p_x = 0, p_z = -105 mm: of the platform in x, of the pre-defined way in z (m)."""
    return max(
        float(np.max(np.hypot(run.p_B[on, 0], run.z_ref[on] - SWEEP_HEIGHT)))
        for run in (runs.force_position, runs.position)
        for on in (run.controller_window(*SWEEP_WINDOW),)
    )


# the trigger


def force_at_trigger(runs: Fig4Runs) -> float:
    """Estimated force in the sample of the trigger (N)."""
    run = runs.force_position
    return float(run.F_z[np.searchsorted(run.t, run.trigger_time)]) if np.isfinite(run.trigger_time) else math.nan


def reference_distance(runs: Fig4Runs) -> float:
    """Largest distance of the z reference from the pre-defined one before the trigger (m)."""
    run = runs.force_position
    before = run.t < run.trigger_time
    return float(np.max(np.abs(run.z_cmd - run.z_ref)[before])) if np.any(before) else math.nan


def reference_jump(runs: Fig4Runs) -> float:
    """How far the z reference is below the pre-defined one right after the trigger (m)."""
    run = runs.force_position
    if np.isinf(run.trigger_time):
        return math.nan
    return float(np.max((run.z_ref - run.z_cmd)[run.controller_window(run.trigger_time, run.trigger_time + JUMP_TIME)]))


def position_jump(runs: Fig4Runs) -> float:
    """How many times faster the platform goes down after the trigger than before."""
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
    """How long the force loop was on before the platform truly pressed (s); nan if either never happened."""
    run = runs.force_position
    lead = first_time(run.t_plant, run.true_F_z > 0.0) - run.trigger_time
    return max(0.0, lead) if math.isfinite(lead) else math.nan


# whole curves


def _worst_part(run: Fig4Run, apart: Curve) -> float:
    """Mean size of `apart` (m), at the controller's rate, in that part of the curve in which it is largest."""
    return max(float(np.mean(np.abs(apart[run.controller_window(*part)]))) for part in CURVE_PARTS)


def z_error(run: Fig4Run) -> float:
    """Distance of the height from the pre-defined one (m)."""
    return _worst_part(run, run.z - run.z_ref)


def z_gap(runs: Fig4Runs) -> float:
    """Distance of both runs' heights (m)."""
    fp, p = runs.force_position, runs.position
    return _worst_part(fp, fp.z - np.interp(fp.t, p.t, p.z))


def z_trend(run: Fig4Run) -> float:
    """Correlation of the height with the pre-defined one; nan if one of them never changes."""
    on = run.controller_window(CURVE_PARTS[0][0], CURVE_PARTS[-1][1])
    if min(np.ptp(run.z[on]), np.ptp(run.z_ref[on])) == 0.0:
        return math.nan
    return float(np.corrcoef(run.z[on], run.z_ref[on])[0, 1])


def lag(run: Fig4Run) -> tuple[float, float]:
    """(delay in s at which the pre-defined height fits the height best, what is then left in the worst part in m)."""
    on = run.controller_window(0.0, CURVE_PARTS[-1][1])
    delay = tracking.lag(run.t[on], run.z[on], run.z_ref[on], MAX_LAG)
    return delay, _worst_part(run, run.z - np.interp(run.t - delay, run.t, run.z_ref))


def rise_share(runs: Fig4Runs) -> float:
    """Share of its changes by which position control's force goes up, from the threshold to the sweep."""
    run = runs.position
    start = first_time(run.t, run.F_z >= FORCE_THRESHOLD)
    if not start + 2.0 * JUMP_WINDOW <= CURVE_PARTS[1][1]:
        return math.nan
    on = run.controller_window(start, CURVE_PARTS[1][1])
    blocks = np.floor((run.t[on] - start) / JUMP_WINDOW + TIME_ROUNDING).astype(int)
    change = np.diff(np.bincount(blocks, run.F_z[on]) / np.bincount(blocks))
    return _ratio(float(np.sum(change[change > 0.0])), float(np.sum(np.abs(change))))


# position and force while sweeping


def force_error(run: Fig4Run) -> float:
    """Mean distance of the force from its reference (N)."""
    return mean_error(run.F_z[run.controller_window(*SWEEP_WINDOW)], run.F_z_ref)


def force_error_ratio(runs: Fig4Runs) -> float:
    """How many times farther from its reference the force is under position control alone."""
    return _ratio(force_error(runs.position), force_error(runs.force_position))


def force_gap(runs: Fig4Runs) -> float:
    """By how much position control presses less (N)."""
    fp, p = runs.force_position, runs.position
    return float(
        np.mean(fp.F_z[fp.controller_window(*SWEEP_WINDOW)]) - np.mean(p.F_z[p.controller_window(*SWEEP_WINDOW)])
    )


def delay(runs: Fig4Runs) -> float:
    """How much later position control alone reaches 80 % of the reference force (s)."""
    fp, p = (first_time(run.t, run.F_z >= 0.8 * run.F_z_ref) for run in (runs.force_position, runs.position))
    return p - fp if np.isfinite(fp) else -math.inf


def bias(runs: Fig4Runs) -> float:
    """Mean of the estimated force less the scale's reading (N)."""
    run = runs.force_position
    on = window_mask(run.t_scale, *SWEEP_WINDOW)
    return float(np.mean(np.interp(run.t_scale[on], run.t, run.F_z) - run.scale_F_z[on]))


def friction(run: Fig4Run, axis: int) -> float:
    """Root mean square of the force along x or y (N)."""
    return rms(run.F_ee_B[run.controller_window(*SWEEP_WINDOW), axis])


def friction_share(axis: int) -> Measure:
    """Friction of position control alone over that with force control."""
    return lambda runs: _ratio(friction(runs.position, axis), friction(runs.force_position, axis))


def x_share(runs: Fig4Runs) -> float:
    """Force along x over that along y, in the run where that is more."""
    return max(_ratio(friction(run, 0), friction(run, 1)) for run in (runs.force_position, runs.position))


# the scale


def disproportion(runs: Fig4Runs) -> float:
    """Largest distance of the scale's reading from a straight line over the way pressed in, as a share of its end.

    The line goes from where the scale begins to read to where position control alone has come before it sweeps.
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


# the fluctuation


def fluctuation(run: Fig4Run) -> tuple[float, float]:
    """(time, size) of the one sudden change of the force (s, N); nan if none stands out from the noise."""
    on = run.controller_window(*SWEEP_WINDOW)
    t, change = level_changes(run.t[on], run.F_z[on], JUMP_WINDOW)
    sizes: Curve = np.abs(change)
    largest = int(np.argmax(sizes))
    if sizes[largest] < max(MIN_FORCE_CHANGE, FLUCTUATION_RATIO * float(np.median(sizes))):
        return math.nan, math.nan
    return float(t[largest]), float(sizes[largest])


def force_after_fluctuation(runs: Fig4Runs) -> float:
    """Worst error of the force around the fluctuation (N)."""
    run = runs.force_position
    return float(np.max(np.abs(run.F_z[run.controller_window(*FLUCTUATION_WINDOW)] - run.F_z_ref)))


# the truth


def true_force_error(runs: Fig4Runs) -> float:
    """Root mean square of the true force less its reference (N)."""
    run = runs.force_position
    return rms(run.true_F_z[run.plant_window(*SWEEP_WINDOW)] - run.F_z_ref)


def true_final_force(runs: Fig4Runs) -> float:
    """Mean true force at the end (N)."""
    run = runs.force_position
    return float(np.mean(run.true_F_z[run.plant_window(*FINAL_WINDOW)]))


def true_z_error(runs: Fig4Runs) -> float:
    """Root mean square of the true height less the pre-defined one (m)."""
    run = runs.force_position
    return rms(run.true_z_error[run.controller_window(*SWEEP_WINDOW)])
