"""The search for the worst fault: runs judged by their distance from a violation, then differential evolution."""

import functools
import math
import re
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from twin.kernel.atomic_write import write_text
from twin.kernel.errors import ComponentFailed, InputRefused, SafetyTrip
from twin.kernel.process.warm import Pool
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.build import need_processes, planned_drives
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import FAULT_KINDS
from twin.robot.experiment.measure import RequirementMeasure, parse_requirement, signals_of
from twin.robot.experiment.together import SEQUENCE_SEPARATOR
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.run.runs import RunRequest, Runs
from twin.robot.run.trace import fields_of
from twin.studies.check.measurement import Signals, metrics_of_measure, refuse_unknown
from twin.studies.command import Say
from twin.studies.falsify.space import EarlyEnd, Place, Requirement, Space, TriedFault, may_creep, offset_text, ways_of
from twin.studies.faults.magnitudes import UPPER_SHARE
from twin.studies.faults.offsets import NO_OFFSET
from twin.studies.faults.onsets import FORCE_SIGNAL, PLACE_SIGNAL, default_onsets
from twin.studies.faults.together import SECOND_DELAYS
from twin.studies.metrics.requirement import checked_requirement
from twin.studies.sweep.measures import RunFinding
from twin.studies.sweep.plan import Task

MAX_PASTS = 8
"""Maximum number of pasts in one process: a body each, at rest and moved."""


@functools.cache
def _runs(signals: frozenset[str], most: int) -> Runs:
    """Return the runs of this process that keep `signals`; a past is run when it is asked for a second time."""
    return Runs(RunRequest(signals, check=refuse_unknown), after=1, most=most)


def judge_run(path: Path, drive: str | None, settings: Sequence[str], claims: str = "") -> RunFinding:
    """Run the experiment file `settings[0]`: "NAME.distance" of each of its requirements.

    A component that fails ends the run, and what is required is judged until then.

    Args:
        path, drive: of the experiment that the file extends; it says so itself.
        claims: nothing.

    Returns:
        Besides "trip", the tick of the trip or None; of a run without a fault "onsets", ticks in contact and in free
        motion at which one may begin.
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
                # in contact first: that is where a fault can press
                onsets = list(reversed(default_onsets(ended)))
            except InputRefused:
                onsets = [round(0.5 * experiment.duration_ticks)]
    # a mistake of ours in one run costs that run, as in a sweep
    except Exception as problem:
        status = "refused" if isinstance(problem, InputRefused) else "failed"
        return RunFinding(status, str(problem), {}, time.perf_counter() - began, 0.0)
    more = {"onsets": onsets, "trip": ended.trip.tick if ended.trip else None}
    return RunFinding(ended.status, ended.reason, found, time.perf_counter() - began, ended.stepping, more)


TRIAL_JOB = "twin.studies.falsify.search:judge_run"


class Judge:
    """Runs runs and tells how near they came, in shares of what the healthy run on the same body keeps."""

    def __init__(
        self,
        space: Space,
        requirements: Sequence[Requirement],
        workers: Pool[Task, dict[str, Any]],
        experiment: Path,
        scratch: Path,
        runs: int,
        say: Say,
    ):
        self._space, self._requirements, self._workers = space, requirements, workers
        self._experiment, self._scratch, self._runs, self._say = experiment, scratch, runs, say
        self._scales: dict[str, float] = {}
        self._moved: dict[TriedFault, str] = {}
        self._trips: dict[TriedFault, int] = {}
        self.distances: dict[TriedFault, dict[str, float]] = {}
        self.first: dict[str, int] = {}
        self.ended: dict[TriedFault, EarlyEnd] = {}
        self.seconds = 0.0

    def run_healthy(self) -> list[int]:
        """Make the runs without a fault, on each body, and return where faults begin first (ticks).

        Raises:
            InputRefused: one violates a requirement. ComponentFailed, SafetyTrip: one fails, or trips.
        """
        unbroken = [TriedFault("", body=body) for body in self._space.bodies]
        onsets: list[int] = []
        for wrong, facts in zip(unbroken, self._run_batch(unbroken), strict=True):
            on = f" on {wrong.body}" if wrong.body else ""
            if facts.get("status") == "refused":
                raise InputRefused(facts["reason"])
            if facts.get("status") != "done":
                kind = SafetyTrip if facts.get("status") == "tripped" else ComponentFailed
                raise kind(f"without any fault{on}: {facts.get('reason')}")
            onsets = onsets or facts["onsets"]
            for wanted in self._requirements:
                left = self._distance(facts, wanted.name)
                if left < 0.0:
                    raise InputRefused(
                        f'"{wanted.formula}": violated without any fault{on}, by {-left:.3g} {wanted.unit}; '
                        "require what holds for the healthy robot"
                    )
                least = min(self._scales.get(wanted.name, math.inf), left)
                self._scales[wanted.name] = least
        # nothing but true and false, or a bound that is just kept: then metres and newtons are as good as shares
        self._scales = {name: s if 1e-9 < s < math.inf else 1.0 for name, s in self._scales.items()}
        return onsets

    def shares(self, batch: Sequence[TriedFault]) -> list[float]:
        """Of each run: until then if a failed component ended it, infinite if it is refused."""
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
        """Why the place of `wrong` says nothing of its fault: the healthy robot violates there, trips or fails; ""."""
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
        """Tick from which the second fault of an ordered pair that was run is delayed."""
        return self._trips[self._space.first_alone(wrong)] if SEQUENCE_SEPARATOR in wrong.kind else 0

    def _run_batch(self, batch: Sequence[TriedFault]) -> list[dict]:
        first = dict.fromkeys(self._space.first_alone(wrong) for wrong in batch if SEQUENCE_SEPARATOR in wrong.kind)
        new = [one for one in first if one not in self._trips]
        if new:
            # not counted as runs: they are judged as single faults
            trips = [facts.get("trip") for facts in self._run_batch(new)]
            self._trips |= {one: one.onset if trip is None else trip for one, trip in zip(new, trips, strict=True)}
        files = []
        for number, wrong in enumerate(batch):
            files.append(self._scratch / f"{number}.toml")
            write_text(files[-1], self._space.file(wrong, self._experiment, trip=self.trip(wrong)))
        self._say(f"{len(self.distances)} of {self._runs} runs", len(self.distances) / self._runs)
        tasks = [Task(number, "", None, {}, (str(file),)) for number, file in enumerate(files)]
        answers = {task.run: facts for task, facts in chain.from_iterable(self._workers.answers(tasks))}
        facts = [answers[task.run] for task in tasks]
        self.seconds += sum(one.get("seconds") or 0.0 for one in facts)
        return facts


def requirements_of(experiment: Experiment, texts: Sequence[str], path: Path) -> list[Requirement]:
    """What is required, checked against the signals that a recording of `experiment` has.

    Raises:
        InputRefused: nothing is, or it cannot be judged.
    """
    if experiment.faults:
        raise InputRefused(f"{path}: has [[fault]] tables; the search inserts one fault at a time, remove them")
    named = [
        (measure.name, measure.formula) for measure in experiment.measures if isinstance(measure, RequirementMeasure)
    ]
    named = [(f"requirement_{number}", text) for number, text in enumerate(texts, start=1)] or named
    if not named:
        raise InputRefused(
            f"{path}: nothing is required of it; say --requirement 'always (|plant.F_ee_B| <= 18 N)', or what else has "
            "to hold"
        )
    with assemble(experiment) as assembly:
        fields = fields_of(assembly.system)
    found = []
    for name, text in named:
        plain = re.sub(r"\s+", " ", text).strip()
        _, unit = checked_requirement(plain, fields)
        found.append(Requirement(name, plain, unit))
    return found


def _number(kind: str) -> int:
    """By which the order of the places of `kind` is drawn."""
    kinds = list(FAULT_KINDS)
    return kinds.index(kind) if kind in kinds else len(kinds) + zlib.crc32(kind.encode())


Judgement = Callable[[Sequence[TriedFault]], list[float]]
"""How near each of some runs comes to violating: its distance as a share of the healthy one, negative if it does."""

POPULATION_SIZE = 6
"""Of differential evolution, at least 5 for its mutation; small, since the space has two to five dimensions and the
runs are few."""
RACE_SHARE = 0.7
"""Share of the runs that the race takes at most, but for the first run of every kind."""
MIN_SPEED_SHARE = 0.01
"""Share of the speed of a drive that creeps after a trip; not 0, which has no direction."""
SEED_COUNT = 1000
"""Seeds that the search draws from."""


@dataclass
class Search:
    """What has been tried.

    Attributes:
        space: where it looks.
        judge: runs runs.
        runs: the most that it may make.
        onsets: ticks that are tried first.
        tried: every run with its share, in the order in which they were made.
    """

    space: Space
    judge: Judgement
    runs: int
    onsets: Sequence[int]
    tried: dict[TriedFault, float] = field(default_factory=dict)

    def spend_runs(self) -> None:
        """Spend the runs."""
        self._race()
        found = sorted((share, kind) for kind, (_, share) in self.worst.items())
        violated = [kind for share, kind in found if share < 0.0] or [kind for _, kind in found[:1]]
        # two generations at least, or it is no evolution
        for number, kind in enumerate(violated):
            rest = max(self._runs_left // (len(violated) - number), 2 * POPULATION_SIZE)
            self._evolve(kind, min(rest, self._runs_left))

    def _race(self) -> None:
        rounds = {kind: self._rounds(kind) for kind in self.space.kinds}
        # the first place has all onsets, each other place one
        everywhere = {kind: len(self.space.places(kind)) + len(self.onsets) - 1 for kind in rounds}
        for lap in range(max(everywhere.values())):
            self._run_round([(kind, lap) for kind in self._open_kinds if lap < everywhere[kind]], rounds)
        racing, lap = self._open_kinds, 0
        while self._race_runs_left and (
            racing := [kind for kind in self._open_kinds if kind in racing][: len(racing) // 2]
        ):
            self._run_round([(kind, everywhere[kind] + lap) for kind in racing], rounds)
            lap += 1

    def _run_round(self, batch: Sequence[tuple[str, int]], rounds: dict[str, list[tuple[Place, int]]]) -> None:
        self._try([self._probe(kind, lap, rounds[kind]) for kind, lap in batch[: self._race_runs_left]])

    @property
    def _race_runs_left(self) -> int:
        return max(0, max(len(self.space.kinds), int(RACE_SHARE * self.runs)) - len(self.tried))

    @property
    def _open_kinds(self) -> list[str]:
        """Kinds that are not found to violate, the nearest first."""
        share = {kind: self.worst[kind][1] if kind in self.worst else 0.0 for kind in self.space.kinds}
        return sorted((kind for kind in share if share[kind] >= 0.0), key=lambda kind: share[kind])

    @property
    def worst(self) -> dict[str, tuple[TriedFault, float]]:
        """Of each kind the run that came nearest, of equal ones the first."""
        best: dict[str, tuple[TriedFault, float]] = {}
        for wrong, share in self.tried.items():
            if wrong.kind not in best or share < best[wrong.kind][1]:
                best[wrong.kind] = wrong, share
        return best

    @property
    def _runs_left(self) -> int:
        return max(0, self.runs - len(self.tried))

    def _try(self, batch: Sequence[TriedFault]) -> list[float]:
        """The shares of `batch`; of what has been tried before without a run, infinite where there are none left."""
        fresh = list(dict.fromkeys(wrong for wrong in batch if wrong not in self.tried))[: self._runs_left]
        if fresh:
            self.tried.update(zip(fresh, self.judge(fresh), strict=True))
        return [self.tried.get(wrong, np.inf) for wrong in batch]

    def _rounds(self, kind: str) -> list[tuple[Place, int]]:
        """Where `kind` is in its first rounds, and its onset: the catalogue's place at each of the onsets given, there
        the other signs of a set of faults, then each other place, in an order that is drawn, at the onsets in turn
        until it has been at each."""
        first, *others = self.space.places(kind)
        turned = [place for place in others if len(place.ways) > 1 and place._replace(ways=first.ways) == first]
        others = [place for place in others if place not in turned]
        order = np.random.default_rng(_number(kind)).permutation(len(others))
        others = [*turned, *(others[i] for i in order)]
        rounds = [(first, onset) for onset in self.onsets]
        for past in range(len(self.onsets)):
            rounds += [(one, self.onsets[(n + past) % len(self.onsets)]) for n, one in enumerate(others)]
        return rounds

    def _probe(self, kind: str, lap: int, rounds: Sequence[tuple[Place, int]]) -> TriedFault:
        """The run of `kind` in a round: at the catalogue's largest in `rounds`, later ever finer between all times,
        sizes up to the upper end, offsets and delays."""
        place, onset = rounds[lap % len(rounds)]
        shares, offset, ordered = [1.0] * len(place.ways), NO_OFFSET, SEQUENCE_SEPARATOR in kind
        delay = SECOND_DELAYS[(lap + _number(kind)) % len(SECOND_DELAYS)] if ordered else 0.0
        if may_creep(kind):
            shares[1] = (1.0, MIN_SPEED_SHARE, 0.5)[lap % 3]
        if lap >= len(rounds):
            wide = 1 + len(shares) + ordered + (2 if self.space.reach else 0)
            time, *rest = (float(each) for each in qmc.Halton(wide, scramble=False).random(lap + 1)[-1])
            onset = round(time * (self.space.ticks - 1))
            shares = [0.5 + (UPPER_SHARE - 0.5) * more for more in rest[: len(shares)]]
            if may_creep(kind):
                shares[1] = max(MIN_SPEED_SHARE, UPPER_SHARE * rest[1])
            delay = SECOND_DELAYS[-1] * rest[2] if ordered else 0.0
            offset = self.space.offset(*rest[-2:]) if self.space.reach else NO_OFFSET
        shares = [way * share for way, share in zip(place.ways, shares, strict=True)]
        seed = lap if self.space.draws(kind) else 0
        return self.space.fault(kind, (place.target, place.body), shares, onset, seed, offset, delay)

    def _evolve(self, kind: str, runs: int) -> None:
        """Spend `runs` around what is known of `kind`."""
        space = self.space
        targets, bodies = space.targets(kind), space.bodies
        seeds = SEED_COUNT if space.draws(kind) else 0
        sizes = [(UPPER_SHARE * min(0, *ways), UPPER_SHARE) for ways in ways_of(kind)]
        bounds: list[tuple[float, float]] = [(0, space.ticks - 1), *sizes]
        bounds += [(0, len(targets) - 1), (0, len(bodies) - 1), (0, seeds)]
        whole = [True, *[False] * len(sizes), True, True, True]
        ordered = SEQUENCE_SEPARATOR in kind
        more = [(0.0, SECOND_DELAYS[-1])] * ordered + [(0.0, 1.0)] * (2 if space.reach else 0)
        bounds += more
        whole += [False] * len(more)
        best = self.worst[kind][0]

        def made(x: NDArray[np.float64]) -> TriedFault:
            onset, *rest = (float(each) for each in x)
            shares, (target, body, seed) = rest[: len(sizes)], map(round, rest[len(sizes) : len(sizes) + 3])
            offset = space.offset(*rest[-2:]) if space.reach else NO_OFFSET
            delay = rest[len(sizes) + 3] if ordered else 0.0
            return space.fault(kind, (targets[target], bodies[body]), shares, round(onset), seed, offset, delay)

        last = len(self.tried) + min(runs, self._runs_left)

        def shares(x: NDArray[np.float64]) -> NDArray[np.float64]:
            if len(self.tried) >= last:
                return np.full(x.shape[1], np.inf)
            return np.array(self._try([made(column) for column in x.T]))

        first = qmc.LatinHypercube(len(bounds), seed=0).random(POPULATION_SIZE)
        lower, upper = np.array(bounds, dtype=float).T
        population = lower + first * (upper - lower)
        where = targets.index(best.target), bodies.index(best.body)
        here = space.polar(best.offset) if space.reach else ()
        late = (best.delay * space.tick,) if ordered else ()
        population[0] = best.onset, *space.shares(best), *where, best.seed, *late, *here
        # a generation may bring fewer runs than it has members: some have been made before
        differential_evolution(
            shares, bounds, maxiter=max(1, runs), init=population, integrality=np.array(whole), seed=0, polish=False,
            callback=lambda x, convergence: len(self.tried) >= last, vectorized=True, updating="deferred", tol=0.0,
            mutation=(0.5, 1.0), recombination=0.7,
        )  # fmt: skip
