"""Judge of a search for faults: distances of runs from violating the requirements."""

import functools
import math
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from twin.kernel.atomic_write import write_text
from twin.kernel.errors import ComponentFailed, InputRefused, SafetyTrip
from twin.kernel.process.warm import Pool
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.build import need_processes, planned_drives
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.measure import RequirementMeasure, parse_requirement, signals_of
from twin.robot.experiment.together import SEQUENCE_SEPARATOR
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.run.runs import RunRequest, Runs
from twin.robot.run.trace import fields_of
from twin.studies.check.measurement import Signals, metrics_of_measure, refuse_unknown
from twin.studies.command import Say
from twin.studies.falsify.space import EarlyEnd, Requirement, Space, TriedFault, offset_text
from twin.studies.faults.offsets import NO_OFFSET
from twin.studies.faults.onsets import FORCE_SIGNAL, PLACE_SIGNAL, default_onsets
from twin.studies.metrics.requirement import checked_requirement
from twin.studies.sweep.measures import run_fields
from twin.studies.sweep.plan import Task

MAX_PASTS = 8
"""Maximum number of pasts in one process: a body each, at rest and moved."""
TRIAL_JOB = "twin.studies.falsify.judge:judge_run"


@functools.cache
def _runs(signals: frozenset[str], most: int) -> Runs:
    """Return this process's runner that keeps `signals`; a past shared by runs is simulated on its second request."""
    return Runs(RunRequest(signals, check=refuse_unknown), after=1, most=most)


def judge_run(path: Path, drive: str | None, settings: Sequence[str], claims: str = "") -> dict[str, Any]:
    """Run the experiment file `settings[0]`; return the distance from violating each requirement as "NAME.distance".

    A failed component ends the run; requirements are judged until then. The fields have more: "trip", the tick of the
    trip or None; without faults also "onsets": ticks in contact and in free motion for the beginning of a fault.

    Args:
        path, drive, claims: unused; the experiment file states path and drive.
    """
    began = time.perf_counter()
    try:
        experiment = load_experiment(settings[0], (), drive)
        required = [measure for measure in experiment.measures if isinstance(measure, RequirementMeasure)]
        names = {name for measure in required for name, _ in signals_of(parse_requirement(measure.formula))}
        # drives that need processes would need some for each past
        most = 0 if need_processes(planned_drives(experiment)) else MAX_PASTS
        ended = _runs(frozenset(names | {FORCE_SIGNAL, PLACE_SIGNAL}), most).run(experiment)
        assert ended.trace is not None
        signals = Signals(ended.trace, geometry_of(experiment.controller.model))
        found: dict[str, float | None] = {
            name: m.value for measure in required for name, m in metrics_of_measure(measure, signals).items()
        }
        onsets: list[int] = []
        if not experiment.faults:
            try:
                # in contact first: only there can a fault press
                onsets = list(reversed(default_onsets(ended)))
            except InputRefused:
                onsets = [round(0.5 * experiment.duration_ticks)]
    # an internal error costs this run only, as in a sweep
    except Exception as problem:
        status = "refused" if isinstance(problem, InputRefused) else "failed"
        return run_fields(status, str(problem), {}, time.perf_counter() - began, 0.0)
    more = {"onsets": onsets, "trip": ended.trip.tick if ended.trip else None}
    return run_fields(ended.status, ended.reason, found, time.perf_counter() - began, ended.stepping, **more)


@dataclass
class Judge:
    """Judge of faults: runs them, and returns their distances from a violation as shares of the healthy distance."""

    space: Space
    requirements: Sequence[Requirement]
    workers: Pool[Task, dict[str, Any]]
    experiment: Path
    scratch: Path
    runs: int
    say: Say
    distances: dict[TriedFault, dict[str, float]] = field(default_factory=dict)
    first: dict[str, int] = field(default_factory=dict)
    ended: dict[TriedFault, EarlyEnd] = field(default_factory=dict)
    seconds: float = 0.0
    _scales: dict[str, float] = field(default_factory=dict)
    _moved: dict[TriedFault, str] = field(default_factory=dict)
    _trips: dict[TriedFault, int] = field(default_factory=dict)

    def run_healthy(self) -> list[int]:
        """Run the healthy robot on each body, and return the first fault onsets to try (ticks)."""
        unbroken = [TriedFault("", body=body) for body in self.space.bodies]
        onsets: list[int] = []
        for wrong, facts in zip(unbroken, self._run_batch(unbroken), strict=True):
            on = f" on {wrong.body}" if wrong.body else ""
            if facts.get("status") == "refused":
                raise InputRefused(facts["reason"])
            if facts.get("status") != "done":
                kind = SafetyTrip if facts.get("status") == "tripped" else ComponentFailed
                raise kind(f"without any fault{on}: {facts.get('reason')}")
            onsets = onsets or facts["onsets"]
            for wanted in self.requirements:
                left = self._distance(facts, wanted.name)
                if left < 0.0:
                    raise InputRefused(
                        f'"{wanted.formula}": violated without any fault{on}, by {-left:.3g} {wanted.unit}; '
                        "require what holds for the healthy robot"
                    )
                least = min(self._scales.get(wanted.name, math.inf), left)
                self._scales[wanted.name] = least
        # without a healthy distance (flags alone, or a bound that is just kept) distances are in SI units
        self._scales = {name: s if 1e-9 < s < math.inf else 1.0 for name, s in self._scales.items()}
        return onsets

    def shares(self, batch: Sequence[TriedFault]) -> list[float]:
        """Run the faults of `batch`; return distances as shares of the healthy one, infinite for a refused run."""
        shares = []
        for wrong, facts in zip(batch, self._run_batch(batch), strict=True):
            distances = {name: self._distance(facts, name) for name in self._scales}
            share = min((distances[name] / scale for name, scale in self._scales.items()), default=math.inf)
            self.distances[wrong] = distances
            if facts.get("status") not in ("done", "tripped"):
                self.ended[wrong] = EarlyEnd(facts.get("status") == "refused", facts.get("reason") or "")
            if share < 0.0 and wrong.offset != NO_OFFSET and (wanting := self._without_fault(wrong)):
                self.ended[wrong], share = EarlyEnd(True, wanting), math.inf
            if share < 0.0:
                self.first.setdefault(wrong.kind, len(self.distances))
            shares.append(share)
        return shares

    def _without_fault(self, wrong: TriedFault) -> str:
        """Run the healthy robot at the place of a fault; return why the place is unsuitable, "" if suitable."""
        unbroken = TriedFault("", body=wrong.body, offset=wrong.offset)
        if unbroken not in self._moved:
            (facts,) = self._run_batch([unbroken])
            violated = any(self._distance(facts, name) < 0.0 for name in self._scales)
            reason = facts.get("reason") if facts.get("status") != "done" else "violated" if violated else ""
            self._moved[unbroken] = f"{offset_text(wrong.offset)}, without any fault: {reason}" if reason else ""
        return self._moved[unbroken]

    @staticmethod
    def _distance(facts: dict, name: str) -> float:
        value = facts.get("metrics", {}).get(f"{name}.distance")
        return math.inf if value is None else value

    def trip(self, wrong: TriedFault) -> int:
        """Return the tick for delaying an ordered pair's second fault: the first one's trip, else its onset."""
        return self._trips[self.space.first_alone(wrong)] if SEQUENCE_SEPARATOR in wrong.kind else 0

    def _run_batch(self, batch: Sequence[TriedFault]) -> list[dict]:
        first = dict.fromkeys(self.space.first_alone(wrong) for wrong in batch if SEQUENCE_SEPARATOR in wrong.kind)
        new = [one for one in first if one not in self._trips]
        if new:
            # not counted as runs: single faults judge them
            trips = [facts.get("trip") for facts in self._run_batch(new)]
            self._trips |= {one: one.onset if trip is None else trip for one, trip in zip(new, trips, strict=True)}
        files = []
        for number, wrong in enumerate(batch):
            files.append(self.scratch / f"{number}.toml")
            write_text(files[-1], self.space.file(wrong, self.experiment, trip=self.trip(wrong)))
        self.say(f"{len(self.distances)} of {self.runs} runs", len(self.distances) / self.runs)
        tasks = [Task(number, "", None, {}, (str(file),)) for number, file in enumerate(files)]
        answers = {task.run: facts for task, facts in chain.from_iterable(self.workers.answers(tasks))}
        facts = [answers[task.run] for task in tasks]
        self.seconds += sum(one.get("seconds") or 0.0 for one in facts)
        return facts


def requirements_of(experiment: Experiment, texts: Sequence[str], path: Path) -> list[Requirement]:
    """Parse requirement `texts`, or the experiment's own if empty, and check that recordings have their signals."""
    if experiment.faults:
        raise InputRefused(f"{path}: has [[fault]] tables; the search inserts one fault at a time, remove them")
    named = [
        (measure.name, measure.formula) for measure in experiment.measures if isinstance(measure, RequirementMeasure)
    ]
    named = [(f"requirement_{number}", text) for number, text in enumerate(texts, start=1)] or named
    if not named:
        raise InputRefused(
            f"{path}: it has no requirement; give --requirement 'always (|plant.F_ee_B| <= 18 N)', or what else has "
            "to hold"
        )
    with assemble(experiment) as assembly:
        fields = fields_of(assembly.system)
    plain = [(name, re.sub(r"\s+", " ", text).strip()) for name, text in named]
    return [Requirement(name, text, checked_requirement(text, fields)[1]) for name, text in plain]
