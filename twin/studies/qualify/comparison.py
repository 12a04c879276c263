"""`twin drive compare`: one drive after the other in the same experiment, judged by the true signals of paired runs.

Each drive runs the experiment once unchanged, for the picture and the table, and eight times with random encoder zeros
and noise, the same for every drive, for the verdict. The zeros cause most of the spread and are common to all drives,
so paired differences reveal effects hidden in unpaired runs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from twin.kernel.serialise import to_dict
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment, with_plant
from twin.robot.run.hold import SETTLING_BAND, UNDER_FORCE
from twin.robot.run.measures import Values, with_units
from twin.robot.run.runs import Outcome, RunRequest, Runs
from twin.robot.run.trace import Trace
from twin.studies.command import Say, Steps, ignore_progress
from twin.studies.figure import BLUE, GREEN, GREY, INK, ORANGE, PINK, SKY, VERMILION, picture
from twin.studies.metrics.response import Curve, first_time, overshoot, rms, settling_time
from twin.studies.metrics.standing import Difference, Ranks, overall_ranks, paired_differences, standing_sentence
from twin.studies.qualify.definitions import Definition, Measure

PAIRED_SEEDS = range(1, 9)
MOTOR_ZERO, JOINT_ZERO = np.radians([0.088, 0.022])
"""Maximum error (rad) of an encoder zero calibrated to one count: 360/4096 and 360/16384 deg."""
MOTOR_NOISE, JOINT_NOISE = np.radians([0.05, 0.02])
"""Standard deviation (rad) of the encoders' noise in paired runs, if the experiment has no noise."""
MIN_REFERENCE_STEP = 1e-9
"""Minimum change of a moving reference (m per tick): rounding is far below, real motion far above."""
COMPARED_MEASURES = {
    "settling_time": Definition(
        "settles", "s",
        "from the trigger of the force loop, or from the first touch if that is later, until the true pressing force "
        "stays within 5 % of its reference; where "
        "nothing triggers, from the end of the z reference's last change until the true z stays within 5 % of it; "
        "not for tasks, which lead the force along a ramp",
    ),
    "overshoot": Definition(
        "beyond", "%",
        "largest share of the same quantity beyond its reference, after the same moment, by force or by change; in "
        "tasks of the force beyond its largest reference, while the force loop is on",
    ),
    "rms_force_error": Definition(
        "rms F", "N",
        "root mean square of the true pressing force minus its reference, second half of the run, from the first touch "
        "on; in tasks while they hold, circle or push",
    ),
    "rms_z_error": Definition(
        "rms z", "m",
        "root mean square of the true z minus its pre-defined reference, in tasks minus the reference shifted by the "
        "force loop, second half of the run",
    ),
    "peak_current": Definition("peak I", "A", "largest current of any of the three drives, if they have that output"),
    "shaft_work": Definition(
        "work", "J", "work the three shafts do on the springs, without the work they get back: tau_load omega_m > 0",
    ),
    "energy": Definition("energy", "J", "electrical energy the three drives draw, if they have an output for power"),
    "cost": Definition("cost", "s", "wall time in the step functions of the three drives, per tick"),
}  # fmt: skip
"""Measures under `measures` in JSON as in 1.0; they need no held force, and continue after a trip of the monitor."""
FREE_RUN_MEASURES = ("settling_time", "overshoot", "rms_force_error", "rms_z_error")
"""Measures shown in the text if no drive holds a force."""
DRIVE_COLORS = (BLUE, ORANGE, GREEN, PINK, SKY, VERMILION, "#6a3d9a", INK)
CLOSE_UP = 2.5
"""Time span of the approach shown in the second panel (s)."""


class TrueRun:
    """True signals of a robot's run at every tick, (ticks,), for the comparison of drives.

    Attributes:
        F_z, F_z_ref: true pressing force, and its reference while the force loop is on (N).
        z, z_ref: true height of the platform, and its reference (m): pre-defined, i.e. before the force loop shifts it;
            in tasks after the shift.
    """

    def __init__(self, run: Trace):
        # The robot is led by tasks instead of way points.
        self.run, self._tasks = run, "controller.task" in run.fields()
        self.t: Curve = run.t
        self.F_z: Curve = -run["plant.F_ee_B"][:, 2]
        self.F_z_ref: Curve = run.held("controller.F_z_ref")
        self.z: Curve = run["plant.p_B"][:, 2]
        self.z_ref: Curve = run.held("controller.p_cmd_B" if self._tasks else "controller.p_ref_B")[:, 2]

    def measures(self, cost: float) -> tuple[Measure, ...]:
        """Compute all measures for the comparison of drives; `cost`: wall time in the drives per tick (s)."""
        late = np.arange(len(self.t)) >= len(self.t) // 2
        pressing = np.isin(self.run.held("controller.phase"), UNDER_FORCE) if self._tasks else late
        touching = bool(np.any(self.F_z[pressing] > 0.0))
        if not self._tasks:
            pressing = late & (self.t >= first_time(self.t, self.F_z > 0.0))
        # Tapping does not hold a force, however hard.
        unscored = "no contact" if np.any(pressing) else "no task holds a force"
        shaft_power = self.run["plant.tau_load"] * self.run.of_drives("omega_m")
        current, power = self.run.of_drives("current"), self.run.of_drives("power")
        return (
            *self._approach(),
            Measure(
                "rms_force_error",
                rms(self.F_z[pressing] - self.F_z_ref[pressing]) if touching else None,
                "" if touching else unscored,
            ),
            Measure("rms_z_error", rms(self.z[late] - self.z_ref[late])),
            _output_measure("peak_current", float(np.max(np.abs(current))) if current.size else None),
            Measure("shaft_work", self._energy(np.maximum(0.0, shaft_power))),
            _output_measure("energy", self._energy(power) if power.size else None),
            Measure("cost", cost),
        )

    def _energy(self, power: Curve) -> float:
        """Integrate a power (ticks, n), W, held from tick to tick; return the energy (J)."""
        return float(np.sum(power[:-1]) * self.run.tick)

    def _approach(self) -> tuple[Measure, Measure]:
        """Compute settling time and overshoot of the controlled force, else of the height."""
        on = self.run.held("controller.triggered")
        if self._tasks:
            beyond = 100.0 * overshoot(self.F_z[on], float(self.F_z_ref[on].max())) if np.any(on) else None
            ramp = Measure("settling_time", None, "not defined for tasks")
            return ramp, Measure("overshoot", beyond, "" if np.any(on) else "the force loop is never on")
        triggered = first_time(self.t, on)
        if np.isfinite(triggered):
            # A loop that is on in the air has nothing to settle yet.
            touched = first_time(self.t, self.F_z > 0.0)
            start = max(triggered, touched) if np.isfinite(touched) else triggered
            return self._approach_measures(start, self.F_z, float(self.F_z_ref[-1]))
        moving = np.flatnonzero(np.abs(np.diff(self.z_ref)) > MIN_REFERENCE_STEP)
        if len(moving) == 0:
            still = "z is to stay where it is"
            return Measure("settling_time", None, still), Measure("overshoot", None, still)
        # The last change of the reference begins after its last pause.
        pauses = np.flatnonzero(np.diff(moving) > 1)
        before = float(self.z_ref[moving[pauses[-1] + 1] if len(pauses) else moving[0]])
        change = float(self.z_ref[-1]) - before
        return self._approach_measures(float(self.t[moving[-1] + 1]), (self.z - before) * np.sign(change), abs(change))

    def _approach_measures(self, start: float, y: Curve, target: float) -> tuple[Measure, Measure]:
        after = self.t >= start
        settled = settling_time(self.t[after], y[after], target, SETTLING_BAND * target) - start
        found = (settled,) if np.isfinite(settled) else (None, "not in this run")
        return Measure("settling_time", *found), Measure("overshoot", 100.0 * overshoot(y[after], target))


def _output_measure(name: str, value: float | None) -> Measure:
    return Measure(name, value, "" if value is not None else "not an output of this drive")


@dataclass(frozen=True)
class ComparedDrive:
    """The run of an experiment with one of the compared drives, and its paired runs.

    The paired runs are in the order of `PAIRED_SEEDS`, up to the first that failed or tripped.
    """

    name: str
    done: Outcome
    paired: Sequence[Outcome] = ()

    @cached_property
    def run(self) -> TrueRun:
        """True signals of the unchanged experiment, up to the failure if there was one."""
        assert self.done.trace is not None
        return TrueRun(self.done.trace)

    @cached_property
    def measures(self) -> tuple[Measure, ...]:
        if self.done.failure:
            return tuple(Measure(measure, None, "the run failed") for measure in COMPARED_MEASURES)
        return self.run.measures(sum(cost for name, cost in self.done.costs.items() if name.startswith("drive")))

    @property
    def failure(self) -> str:
        """Error that ended one of the runs early; empty if all completed."""
        return next((one.reason for one in (self.done, *self.paired) if one.failure), "")

    @property
    def repeats(self) -> list[Values]:
        """Measures of the paired runs; empty if one of them failed or tripped."""
        return [] if any(one.reason for one in self.paired) else [one.measures for one in self.paired]

    def exclusion_reason(self, experiment: str) -> str:
        """Return what a paired run did that rules out a judgement in the experiment; "" if all completed."""
        for seed, one in zip(PAIRED_SEEDS, self.paired, strict=False):
            did, why = ("fails", "") if one.failure else ("trips the safety monitor", f" ({one.reason})")
            if one.reason:
                return f"{did} in {experiment} with seed {seed}, and is not judged there{why}"
        return ""


@dataclass(frozen=True)
class DriveTrials:
    name: str
    trials: tuple[ComparedDrive, ...]

    def differences(self) -> dict[str, list[Difference]]:
        """Compute the paired differences of each judged drive to the first: drive name -> differences."""
        first, *others = self.trials
        return {
            one.name: paired_differences(one.repeats, first.repeats) for one in others if one.repeats and first.repeats
        }


def trials(
    experiments: Sequence[Path],
    drives: Sequence[str],
    settings: Sequence[str] = (),
    body: str | None = None,
    say: Say = ignore_progress,
) -> tuple[DriveTrials, ...]:
    """Run each experiment with each of the drives in all three joints, for comparison."""
    loaded = [[load_experiment(path, settings, drive, body) for drive in drives] for path in experiments]
    for one in (one for row in loaded for one in row):
        assemble(one).close()
    each = 1 + len(PAIRED_SEEDS) * (len(drives) > 1)
    done, steps = [], Steps(say, len(experiments) * len(drives) * each)
    for path, row in zip(experiments, loaded, strict=True):
        found = []
        for one, drive in zip(row, drives, strict=True):
            label = f"{path.stem} with {drive}"
            steps.next(label)
            run, paired = Runs(RunRequest(None, tally=True, timed=True), most=0).run(one), []
            for seed in PAIRED_SEEDS if each > 1 and not run.failure else ():
                steps.next(f"{label}, seed {seed}")
                paired.append(Runs(RunRequest(tally=True), most=0).run(disturb_encoders(one, seed)))
                if paired[-1].reason:
                    break
            found.append(ComparedDrive(drive, run, paired))
        done.append(DriveTrials(path.stem, tuple(found)))
    return tuple(done)


def verdict(compared: Sequence[DriveTrials]) -> list[str]:
    """Return the verdict of a comparison over all experiments: a sentence per drive except the first, judged or not."""
    first = compared[0].trials[0].name
    by_drive: dict[str, list[Ranks]] = {}
    for one in compared:
        for name, found in one.differences().items():
            by_drive.setdefault(name, []).append({d.measure.text: d.rank for d in found})
    # Over several experiments a measure has several values, which only the tables show.
    values = (
        {name: {d.measure.text: d.text for d in found} for name, found in compared[0].differences().items()}
        if len(compared) == 1
        else {}
    )
    verdicts = [
        standing_sentence(name, first, overall_ranks(ranks), values.get(name)) for name, ranks in by_drive.items()
    ]
    unjudged = {f"{t.name} {why}" for one in compared for t in one.trials if (why := t.exclusion_reason(one.name))}
    failed = {
        f"{t.name} failed in {one.name}, and is not judged there" for one in compared for t in one.trials if t.failure
    }
    return verdicts + sorted(failed | unjudged)


def comparison_facts(compared: DriveTrials) -> dict[str, Any]:
    """Convert a comparison of drives to a dictionary for JSON, without the curves; SI units."""
    done = compared.trials
    return {
        "experiment": compared.name,
        "drives": [
            {
                "drive": trial.name,
                "failure": trial.failure,
                "measures": {m.name: {"value": m.value, "remark": m.remark} for m in trial.measures},
                "run_measures": with_units(trial.done.measures),
            }
            for trial in done
        ],
        "paired": {
            "seeds": list(PAIRED_SEEDS),
            "beside": done[0].name,
            "drives": {
                name: {one.measure.key: to_dict(one) for one in found} for name, found in compared.differences().items()
            },
        },
    }


def disturb_encoders(experiment: Experiment, seed: int) -> Experiment:
    """Return the experiment with random encoder zeros and noise; `seed` determines both."""
    rng, plant = np.random.default_rng(seed), experiment.plant
    motor, joint = (rng.uniform(-largest, largest, 3) for largest in (MOTOR_ZERO, JOINT_ZERO))
    noisy = with_plant(
        experiment,
        motor_zero=tuple(np.add(plant.motor_zero, motor).tolist()),
        joint_zero=tuple(np.add(plant.joint_zero, joint).tolist()),
        motor_noise=plant.motor_noise or float(MOTOR_NOISE),
        joint_noise=plant.joint_noise or float(JOINT_NOISE),
    )
    return replace(noisy, seed=seed)


def draw_drive_compare(trials: Sequence[ComparedDrive], title: str, path: Path) -> None:
    """Draw force (height if the robot touches nothing), approach and errors of the compared drives to `path` (PNG)."""
    with picture(path, 11, 7.5, title) as figure:
        (whole, start), (z_error, late) = figure.subplots(2, 2)
        runs = [trial.run for trial in trials]
        touching = any(np.any(run.F_z > 0.0) for run in runs)
        longest = max(runs, key=lambda run: len(run.t))
        # If all drives failed in the first step, the time axis still needs a length.
        end = float(longest.t[-1]) or longest.run.tick
        for axes in (whole, start):
            label = "reference" * (axes is whole)
            axes.plot(longest.t, _reference_curve(longest, touching), color=GREY, lw=1.4, label=label)
        for i, trial in enumerate(trials):
            run, again = trial.run, i // len(DRIVE_COLORS)
            look = {"color": DRIVE_COLORS[i % len(DRIVE_COLORS)], "ls": ("-", "--")[again % 2]}
            name = trial.name + " (failed)" * bool(trial.failure)
            whole.plot(run.t, _true_curve(run, touching), lw=1.1, label=name, **look)
            start.plot(run.t, _true_curve(run, touching), lw=1.3, **look)
            z_error.plot(run.t, 1e3 * (run.z - run.z_ref), lw=1.1, **look)
            half = slice(len(longest.t) // 2, None)
            error = _true_curve(run, touching) - _reference_curve(run, touching)
            late.plot(run.t[half], error[half], lw=1.1, **look)
        # First touch, or first motion of the reference; the end of the run if neither happens.
        first = min(
            min(
                first_time(run.t, run.F_z > 0.0 if touching else np.abs(run.z_ref - run.z_ref[0]) > MIN_REFERENCE_STEP),
                run.t[-1],
            )
            for run in runs
        )
        quantity = "true pressing force F_z (N)" if touching else "true z (mm)"
        for axes, label, limits in (
            (whole, quantity, (0.0, end)),
            (start, f"{quantity}, approach", (max(0.0, first - 0.2), min(end, first + CLOSE_UP))),
            (z_error, "true z minus pre-defined z (mm)", (0.0, end)),
            (late, f"{quantity.split(' (')[0]} minus reference ({'N' if touching else 'mm'})", (0.5 * end, end)),
        ):
            axes.set(xlabel="time (s)", ylabel=label, xlim=limits)
        figure.legend(loc="outside lower center", ncols=min(5, len(trials) + 1))


def _true_curve(run: TrueRun, touching: bool) -> Curve:
    return run.F_z if touching else 1e3 * run.z


def _reference_curve(run: TrueRun, touching: bool) -> Curve:
    return run.F_z_ref if touching else 1e3 * run.z_ref
