"""The runs behind each line: all causes on all bodies, the worst one searched for a worse, with and without monitor."""

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.stats import binomtest, qmc

from twin.kernel.errors import TwinError
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import CATALOGUE
from twin.robot.experiment.together import table
from twin.robot.run.trace import fields_of, run_in_memory
from twin.studies.faults.matrix import healthy_trial, onsets_of, touching
from twin.studies.faults.together import Felt, directions, faults_of, felt, with_share
from twin.studies.metrics.requirement import checked_requirement, distance
from twin.studies.safety.hazards import Cause, Hazard, SafetyTable, magnitudes_of

CONFIDENCE = 0.95
"""Of intervals of a detected share, by Clopper and Pearson (1934)."""


class HazardRobot(NamedTuple):
    """An experiment on one body at one point, healthy.

    Attributes:
        body: its name.
        settings: that make it of the experiment's file.
        experiment: loaded.
        onsets: (s) in free motion and in contact.
        touches: at each tick.
    """

    body: str
    settings: tuple[str, ...]
    experiment: Experiment
    onsets: tuple[float, ...]
    touches: np.ndarray


@dataclass(frozen=True)
class EvidenceRun:
    """One run of a line.

    Attributes:
        cause: what breaks.
        body, settings: where.
        tables: of its [[fault]]s.
        seed: of the experiment.
        watched: with the monitor; None: it failed.
        unwatched: without; None: not made.
        searched: whether the search found it.
        failure: why it failed.
    """

    cause: str
    body: str
    settings: tuple[str, ...]
    tables: tuple[dict[str, Any], ...]
    seed: int
    watched: Felt | None
    unwatched: Felt | None = None
    searched: bool = False
    failure: str = ""

    @property
    def id(self) -> str:
        """First digits of the SHA-256 of all that the run is made of besides the experiment's own file."""
        made_of = [self.body, self.settings, self.tables, self.seed]
        return hashlib.sha256(json.dumps(made_of, sort_keys=True).encode()).hexdigest()[:12]

    def command(self, experiment: str) -> str:
        """What makes it again."""
        tables = ", ".join("{" + ", ".join(f"{k}={_toml(v)}" for k, v in one.items()) + "}" for one in self.tables)
        words = [f"twin run {experiment}", f"--body {self.body}", *(f"--set '{text}'" for text in self.settings)]
        return " ".join([*words, f"--set 'fault=[{tables}]'"])

    def facts(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "id": self.id,
            "cause": self.cause,
            "body": self.body,
            "settings": list(self.settings),
            "fault": list(self.tables),
            "seed": self.seed,
            "searched": self.searched,
            "failure": self.failure,
            "with_monitor": self.watched and self.watched.facts(),
            "without_monitor": self.unwatched and self.unwatched.facts(),
        }


def _toml(value: Any) -> str:
    return json.dumps(value)


Status = Literal["kept", "exceeded", "exceeded as stated", "failed"]


@dataclass(frozen=True)
class HazardLine:
    """A hazard with its runs.

    Attributes:
        hazard: the line of the table.
        runs: all, those of the search last.
        searched: how many runs the search made.
        distances: of requirements, by body and formula, how far the healthy robot is from violating them.
        variants: what the worst run gives with other hardware, (peak, left) in N by name; None: it fails.
        head_area: of the head (m2).
    """

    hazard: Hazard
    runs: tuple[EvidenceRun, ...]
    searched: int
    distances: dict[str, float]
    head_area: float
    variants: dict[str, tuple[float, float] | None] = field(default_factory=dict)

    def measured(self, run: Felt) -> float:
        """What the limit limits, in its unit."""
        match self.hazard.limit_key:
            case "limit_kPa":
                return 1e-3 * run.peak / self.head_area
            case "limit_s":
                return math.inf if run.below is None else run.below
        return run.peak

    @property
    def failed(self) -> list[EvidenceRun]:
        return [run for run in self.runs if run.watched is None]

    @property
    def worst(self) -> EvidenceRun | None:
        """The run that is worst by the limit, of those that did not fail."""
        made = [run for run in self.runs if run.watched is not None]
        return max(
            made,
            key=lambda run: (self.measured(run.watched), run.watched.peak) if run.watched else (0.0, 0.0),
            default=None,
        )

    @property
    def value(self) -> float:
        """The worst of what the limit limits; 0 if nothing breaks."""
        worst = self.worst
        return self.measured(worst.watched) if worst and worst.watched else 0.0

    @property
    def status(self) -> Status:
        """A run that failed makes the line fail, whatever the others did."""
        if self.failed or not (self.runs or self.distances):
            return "failed"
        violated = any(left < 0.0 for left in self.distances.values())
        if not violated and (self.worst is None or self.value <= self.hazard.limit):
            return "kept"
        return "exceeded as stated" if self.hazard.table.beyond else "exceeded"

    @property
    def detected(self) -> tuple[int, int]:
        """(runs that the monitor saw, runs) without those of the search, which are not drawn independently of them."""
        made = [run for run in self.runs if run.watched is not None and not run.searched]
        return sum(bool(run.watched and run.watched.reason) for run in made), len(made)

    @property
    def coverage(self) -> tuple[float, float] | None:
        """Interval of the share that is seen, if the runs were drawn at random; None: there are no runs."""
        seen, made = self.detected
        if not made:
            return None
        interval = binomtest(seen, made).proportion_ci(CONFIDENCE, method="exact")
        return float(interval.low), float(interval.high)

    def facts(self) -> dict[str, Any]:
        """For JSON; what `--against` compares."""
        worst, coverage = self.worst, self.coverage
        seen, made = self.detected
        return {
            "id": self.hazard.table.id,
            **self.hazard.table.model_dump(),
            "causes": [str(cause) for cause in self.hazard.causes],
            "limit_key": self.hazard.limit_key,
            "limit": self.hazard.limit,
            "status": self.status,
            "value": None if math.isinf(self.value) else self.value,
            "worst": worst and worst.id,
            "peak_N": worst.watched.peak if worst and worst.watched else None,
            "detected": seen,
            "runs": made,
            "searched": self.searched,
            "coverage": list(coverage) if coverage else None,
            "distances": self.distances,
            "variants": self.variants,
            "evidence": [run.facts() for run in self.runs],
        }


def robot_of(path: Path, settings: Sequence[str], body: str, point: tuple[float, float]) -> HazardRobot:
    """The experiment on `body`, its first task at `point` (m).

    Raises:
        InputRefused: it cannot be made so. SafetyTrip, ComponentFailed: it trips or fails without any fault.
    """
    moved = (f"task.1.point_mm=[{1e3 * point[0]:g},{1e3 * point[1]:g}]",) if point != (0.0, 0.0) else ()
    experiment = load_experiment(path, (*settings, *moved), None, body)
    healthy = healthy_trial(experiment)
    return HazardRobot(body, (*settings, *moved), experiment, onsets_of(experiment, healthy, ()), touching(healthy))


def run_of(
    robot: HazardRobot, cause: Cause, sizes: Sequence[float | None], onset: float, searched: bool = False
) -> EvidenceRun:
    """One run with the monitor; one that is refused or fails is a failed run, never none."""
    parts = zip(cause.faults, sizes, strict=True)
    tables = tuple(with_share(table(kind, target, size, onset)) for (kind, target), size in parts)
    one = EvidenceRun(str(cause), robot.body, robot.settings, tables, robot.experiment.seed, None, searched=searched)
    try:
        watched = felt(robot.experiment, faults_of(robot.experiment, tables))
    except TwinError as problem:
        return replace(one, failure=str(problem))
    meant = any(kind == "drive_failure" for kind, _ in cause.faults)
    if watched.failure and not meant:
        return replace(one, failure=watched.failure)
    return replace(one, watched=watched)


def without_monitor(robot: HazardRobot, run: EvidenceRun) -> EvidenceRun:
    """`run` with that of the same robot without its monitor."""
    faults = faults_of(robot.experiment, run.tables)
    return replace(run, unwatched=felt(robot.experiment, faults, watched=False))


def line_of(
    hazard: Hazard,
    robots: Callable[[str, tuple[float, float]], HazardRobot],
    head_area: float,
    say: Callable[[str], None],
) -> tuple[HazardLine, HazardRobot | None]:
    """The line of a hazard, and the robot of its worst run.

    Args:
        robots: by body and point.
        head_area: (m2).
        say: called before each robot, with what is done.
    """
    runs: list[EvidenceRun] = []
    distances: dict[str, float] = {}
    of_run: dict[int, tuple[HazardRobot, Cause, tuple[float | None, ...]]] = {}
    for body in hazard.evidence.bodies:
        for point in hazard.evidence.points:
            say(f"{hazard.table.id}: {hazard.table.hazard}")
            try:
                robot = robots(body, point)
            except TwinError as problem:
                runs.append(EvidenceRun("healthy", body, (), (), 0, None, failure=str(problem)))
                continue
            for cause, sizes, onset in _cases(hazard, robot):
                of_run[len(runs)] = robot, cause, sizes
                runs.append(run_of(robot, cause, sizes, onset))
            for cause in hazard.causes:
                if cause.requirement:
                    distances |= _distance(robot, cause.requirement, runs)
    line = HazardLine(hazard, tuple(runs), 0, distances, head_area)
    worst = line.worst
    if worst is None:
        return line, None
    robot, cause, sizes = of_run[runs.index(worst)]
    found = list(_searched(hazard, robot, cause, sizes))
    line = HazardLine(hazard, (*runs, *found), len(found), distances, head_area)
    last = line.worst
    assert last is not None
    every = tuple(without_monitor(robot, run) if run is last else run for run in line.runs)
    return HazardLine(hazard, every, len(found), distances, head_area), robot


def _cases(hazard: Hazard, robot: HazardRobot) -> Iterator[tuple[Cause, tuple[float | None, ...], float]]:
    for cause in hazard.causes:
        if cause.faults:
            signs = {kind: directions(kind) for kind, _ in cause.faults}
            for sizes in magnitudes_of(cause, signs):
                for onset in robot.onsets:
                    yield cause, sizes, onset


def _distance(robot: HazardRobot, formula: str, runs: list[EvidenceRun]) -> dict[str, float]:
    try:
        with assemble(robot.experiment) as assembly:
            fields = fields_of(assembly.system)
        checked, _ = checked_requirement(formula, fields)
        return {f"{formula} on {robot.body}": distance(checked, run_in_memory(robot.experiment))}
    except TwinError as problem:
        failed = EvidenceRun(formula, robot.body, robot.settings, (), robot.experiment.seed, None, failure=str(problem))
        runs.append(failed)
        return {}


def _searched(hazard: Hazard, robot: HazardRobot, cause: Cause, sizes: Sequence[float | None]) -> Iterator[EvidenceRun]:
    """Runs about the worst: other times over the whole run, magnitudes down to the catalogue's smallest.

    Points of a Halton sequence, scrambled by the seed of the evidence: the same seed gives the same runs.
    """
    experiment = robot.experiment
    points = qmc.Halton(2, seed=hazard.evidence.seed).random(hazard.evidence.search)
    for time, less in points:
        onset = round(float(time) * (experiment.duration_ticks - 1)) * experiment.cosim.tick
        scaled = tuple(_scaled(kind, size, float(less)) for (kind, _), size in zip(cause.faults, sizes, strict=True))
        yield run_of(robot, cause, scaled, float(f"{onset:.12g}"), searched=True)


def _scaled(kind: str, size: float | None, less: float) -> float | None:
    """A magnitude between the largest (0) and the smallest (1) of the catalogue, with the sign of `size`."""
    known = CATALOGUE[kind].magnitudes
    if size is None or known is None or CATALOGUE[kind].unit == "ms":
        return size
    ratio = known[0] / known[-1]
    largest = math.copysign(abs(known[-1]), size)
    return float(f"{largest * ratio**less:.4g}")


def hardware(
    line: HazardLine, table_: SafetyTable, path: Path, robot: HazardRobot | None
) -> dict[str, tuple[float, float] | None]:
    """(peak, left) in N of the worst run of `line` with each variant of the hardware."""
    worst = line.worst
    if worst is None or robot is None:
        return {}
    found: dict[str, tuple[float, float] | None] = {}
    for variant in table_.variants:
        try:
            experiment = load_experiment(path, (*robot.settings, *variant.set), None, robot.body)
            run = felt(experiment, faults_of(experiment, worst.tables))
            found[variant.name] = None if run.failure else (run.peak, run.left)
        except TwinError:
            found[variant.name] = None
    return found
