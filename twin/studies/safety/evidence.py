"""Runs behind a line of a hazard table, with the monitor and without, and what they come to."""

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from scipy.stats import binomtest

from twin.kernel.errors import TwinError
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.together import table
from twin.studies.faults.cases import faults_of, with_share
from twin.studies.faults.reaction import Reaction
from twin.studies.faults.stage import Stage
from twin.studies.safety.hazards import Cause, Hazard, SafetyTable

CONFIDENCE = 0.95
"""Of intervals of a detected share, by Clopper and Pearson (1934)."""


Stages = Callable[[str, tuple[float, float]], Stage]
"""Stage of a body and an offset, made once."""
Origin = Literal["grid", "search", "draw"]
"""Of a run: one of the grid of all causes, one that was searched for a worse case, or one that was drawn at random."""


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
        ideal: with a monitor that cuts all power when this one trips; None: it does not, or not made.
        found: how it came to be made.
        failure: why it failed.
    """

    cause: str
    body: str
    settings: tuple[str, ...]
    tables: tuple[dict[str, Any], ...]
    seed: int
    watched: Reaction | None
    unwatched: Reaction | None = None
    ideal: Reaction | None = None
    found: Origin = "grid"
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
            "found": self.found,
            "failure": self.failure,
            "with_monitor": self.watched and self.watched.facts(),
            "without_monitor": self.unwatched and self.unwatched.facts(),
            "with_ideal_monitor": self.ideal and self.ideal.facts(),
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
        distances: of requirements, by body and formula, how far the healthy robot is from violating them.
        variants: what the worst run gives with other hardware, (peak, left) in N by name; None: it fails.
        head_area: of the head (m2).
    """

    hazard: Hazard
    runs: tuple[EvidenceRun, ...]
    distances: dict[str, float]
    head_area: float
    variants: dict[str, tuple[float, float] | None] = field(default_factory=dict)

    def measured(self, run: Reaction) -> float:
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
    def searched(self) -> int:
        """How many runs the search made."""
        return len(self._found("search"))

    def _found(self, origin: Origin) -> list[EvidenceRun]:
        return [run for run in self.runs if run.watched is not None and run.found == origin]

    @property
    def detected(self) -> tuple[int, int]:
        """(runs that the monitor saw, runs) of the grid."""
        return _seen(self._found("grid"))

    @property
    def drawn(self) -> tuple[int, int]:
        """(runs that the monitor saw, runs) of those that were drawn at random, independently of each other."""
        return _seen(self._found("draw"))

    @property
    def dangerous(self) -> tuple[int, int]:
        """Of the drawn runs those that exceed the limit, or fail, without the monitor: (kept below it by the monitor,
        runs)."""
        bad = [
            run
            for run in self._found("draw")
            if run.unwatched and (run.unwatched.failure or self.measured(run.unwatched) > self.hazard.limit)
        ]
        return sum(bool(run.watched and self.measured(run.watched) <= self.hazard.limit) for run in bad), len(bad)

    def facts(self) -> dict[str, Any]:
        """For JSON; what `--against` compares."""
        worst = self.worst
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
            "drawn": _share_facts(self.drawn),
            "dangerous": _share_facts(self.dangerous),
            "distances": self.distances,
            "variants": self.variants,
            "evidence": [run.facts() for run in self.runs],
        }


def interval(share: tuple[int, int]) -> tuple[float, float]:
    """That of a share, (so many, of how many at least one), by Clopper and Pearson (1934)."""
    found = binomtest(*share).proportion_ci(CONFIDENCE, method="exact")
    return float(found.low), float(found.high)


def _seen(runs: Sequence[EvidenceRun]) -> tuple[int, int]:
    return sum(bool(run.watched and run.watched.reason) for run in runs), len(runs)


def _share_facts(share: tuple[int, int]) -> dict[str, Any] | None:
    return {"count": share[0], "of": share[1], "interval": list(interval(share))} if share[1] else None


def run_of(
    robot: Stage, cause: Cause, tables: Sequence[dict[str, Any]], found: Origin = "grid", delay: float = 0.0
) -> EvidenceRun:
    """One run with the monitor, a drawn one also without; one that is refused or fails is a failed run, never none.

    Args:
        tables: of its [[fault]]s.
        delay: of the second fault of an ordered cause after the trip that the first one causes (s).
    """
    one = EvidenceRun(str(cause), robot.body, robot.settings, tuple(tables), robot.experiment.seed, None, found=found)
    try:
        if cause.ordered:
            one = replace(one, tables=robot.delayed(tables, delay))
        faults = faults_of(robot.experiment, one.tables)
        watched, unwatched = robot.reactions(faults) if found == "draw" else (robot.reaction(faults), None)
    except TwinError as problem:
        return replace(one, failure=str(problem))
    meant = any(kind == "drive_failure" for kind, _ in cause.faults)
    if watched.failure and not meant:
        return replace(one, failure=watched.failure)
    return replace(one, watched=watched, unwatched=unwatched)


def tables_of(cause: Cause, sizes: Sequence[float | None], onset: float, seed: int = 0) -> list[dict[str, Any]]:
    """The [[fault]]s of `cause`, all at `onset` (s); see `run_of` for the delay of an ordered one."""
    parts = zip(cause.faults, sizes, strict=True)
    made = [with_share(table(kind, target, size, onset)) for (kind, target), size in parts]
    return [one | ({"seed": seed} if seed else {}) for one in made]


def beside(robot: Stage, run: EvidenceRun) -> EvidenceRun:
    """`run` with that of the same robot without its monitor, and with an ideal one."""
    faults = faults_of(robot.experiment, run.tables)
    seen = None if run.watched is None else run.watched.seen
    ideal = None if seen is None else robot.ideal(faults, seen)
    return replace(run, unwatched=run.unwatched or robot.reaction(faults, watched=False), ideal=ideal)


def hardware(
    line: HazardLine, table_: SafetyTable, path: Path, robot: Stage | None
) -> dict[str, tuple[float, float] | None]:
    """(peak, left) in N of the worst run of `line` with each variant of the hardware."""
    worst = line.worst
    if worst is None or robot is None:
        return {}
    found: dict[str, tuple[float, float] | None] = {}
    for variant in table_.variants:
        try:
            experiment = load_experiment(path, (*robot.settings, *variant.set), None, robot.body)
            run = Stage(experiment, share=False).reaction(faults_of(experiment, worst.tables))
            found[variant.name] = None if run.failure else (run.peak, run.left)
        except TwinError:
            found[variant.name] = None
    return found
