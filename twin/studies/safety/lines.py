"""Runs of a hazard: a grid of all causes, a search for a worse case, random draws for the detected share."""

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice, product

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from twin.kernel.errors import InputRefused, TwinError
from twin.robot.assembly.assemble import assemble
from twin.robot.experiment.fault import FAULT_KINDS
from twin.robot.run.trace import fields_of, run_in_memory
from twin.studies.faults.magnitudes import directions, has_two_ways, magnitude_between, share_of
from twin.studies.faults.offsets import NO_OFFSET, on_disc
from twin.studies.faults.reaction import Reaction
from twin.studies.faults.stage import Stage
from twin.studies.faults.together import SECOND_DELAYS, slowest
from twin.studies.metrics.requirement import checked_requirement, distance
from twin.studies.safety.evidence import (
    EvidenceRun,
    HazardLine,
    Origin,
    Stages,
    add_reference_runs,
    record_of,
    run_of,
    tables_of,
)
from twin.studies.safety.hazards import Cause, Hazard, magnitudes_of

MadeRun = tuple[EvidenceRun, Stage | None]
NEAR_SHARE = 0.5
"""Share of the search that is spent near the worst run until then."""
NEAR_WIDTH = 0.3
"""Width of that neighbourhood over the range of each number."""
MAX_REDRAWS = 20
"""Maximum number of draws per run; a place that the robot cannot reach is drawn again."""


def line_of(
    hazard: Hazard, stages: Stages, head_area: float, say: Callable[[str], None]
) -> tuple[HazardLine, Stage | None]:
    """Make all runs of a hazard. Return its line, and the stage of its worst run (None without runs)."""
    made: list[MadeRun] = []
    distances: dict[str, float] = {}
    causes: dict[int, Cause] = {}
    for body in hazard.evidence.bodies:
        for point in hazard.evidence.points:
            say(f"{hazard.table.id}: {hazard.table.hazard}")
            try:
                stage = stages(body, point)
            except TwinError as problem:
                made.append((EvidenceRun("healthy", body, (), (), 0, failure=str(problem)), None))
                continue
            for cause, sizes, onset, delay in _cases(hazard, stage):
                causes[len(made)] = cause
                made.append((run_of(stage, cause, tables_of(cause, sizes, onset), delay=delay), stage))
            for cause in hazard.causes:
                if cause.requirement:
                    found, failed = _distance(stage, cause.requirement)
                    distances |= found
                    made += [(one, None) for one in failed]
    line = HazardLine(hazard, tuple(run for run, _ in made), distances, head_area)
    worst = line.worst
    if worst is None:
        return line, None
    first = line.runs.index(worst)
    there = made[first][1]
    assert there is not None
    made += search_runs(hazard, stages, there, causes[first], worst, line.limited_value)
    made += draw_runs(hazard, stages)
    line = replace(line, runs=tuple(run for run, _ in made))
    last = line.worst
    assert last is not None
    there = made[line.runs.index(last)][1]
    assert there is not None
    every = tuple(add_reference_runs(there, run) if run is last else run for run in line.runs)
    return replace(line, runs=every), there


def _cases(hazard: Hazard, stage: Stage) -> Iterator[tuple[Cause, tuple[float | None, ...], float, float]]:
    """Yield cause, magnitudes, onset and delay (s) of each run in the grid; the delay is 0 unless ordered."""
    for cause in hazard.causes:
        if cause.faults:
            signs = {kind: directions(kind) for kind, _ in cause.faults}
            for sizes in magnitudes_of(cause, signs):
                for onset, delay in product(stage.onsets, SECOND_DELAYS if cause.ordered else (0.0,)):
                    yield cause, sizes, onset, delay


def _distance(stage: Stage, formula: str) -> tuple[dict[str, float], list[EvidenceRun]]:
    """Return the healthy robot's distance from a violation by formula, body and offset, or the failed run."""
    where = "" if stage.offset == NO_OFFSET else " at " + ", ".join(f"{1e3 * each:g}" for each in stage.offset) + " mm"
    try:
        with assemble(stage.experiment) as assembly:
            fields = fields_of(assembly.system)
        checked, _ = checked_requirement(formula, fields)
        run = run_in_memory(stage.experiment)
        return {f"{formula} on {stage.body}{where}": distance(checked, run.tick, run.held)}, []
    except TwinError as problem:
        return {}, [record_of(stage, formula, failure=str(problem))]


def search_runs(
    hazard: Hazard,
    stages: Stages,
    stage: Stage,
    cause: Cause,
    worst: EvidenceRun,
    measured: Callable[[Reaction], float],
) -> Iterator[MadeRun]:
    """Search for a run worse than `worst`, as `measured`, on its body and of its cause, and yield all runs made.

    Varied are the time over the whole run, the magnitude (between the catalogue's smallest and largest) and direction
    of each fault, the delay after the trip of an ordered cause, and the place within reach: first everywhere, then near
    the worst run until then. The points are a Halton sequence, scrambled by the seed of the evidence.
    """
    budget, reach = hazard.evidence.search, hazard.evidence.reach
    wide = 1 + len(cause.faults) + cause.ordered + (2 if reach else 0)
    points = qmc.Halton(wide, seed=hazard.evidence.seed).random(budget)
    best, most = _numbers(worst, stage, cause, reach), -1.0 if worst.watched is None else measured(worst.watched)
    for number, point in enumerate(points):
        if number >= (1.0 - NEAR_SHARE) * budget:
            point = np.clip(best + NEAR_WIDTH * (point - 0.5), 0.0, 1.0)
        made = _make_run(hazard, stages, stage, cause, point, "search", 0)
        if made is None:
            continue
        run, where = made
        value = -1.0 if run.watched is None else measured(run.watched)
        if value > most:
            best, most = point, value
        yield run, where


def draw_runs(hazard: Hazard, stages: Stages) -> Iterator[MadeRun]:
    """Make random runs of a hazard, drawn independently of each other, and yield them.

    Uniform are: cause, body and point of the table, place over the disc of its reach, time over the run, magnitude by
    ratio between the catalogue's smallest and largest, direction, and delay of an ordered cause from 0 to the longest.
    Places that the healthy robot cannot reach are drawn again.
    """
    evidence = hazard.evidence
    # lines with one seed draw other numbers
    rng = np.random.default_rng([evidence.seed, zlib.crc32(hazard.table.id.encode())])
    broken = [cause for cause in hazard.causes if cause.faults]

    def one() -> MadeRun | None:
        cause = broken[rng.integers(len(broken))]
        body = evidence.bodies[rng.integers(len(evidence.bodies))]
        point = evidence.points[rng.integers(len(evidence.points))]
        numbers = rng.random(3 + len(cause.faults) + cause.ordered)
        seed = int(rng.integers(1, 2**31))
        try:
            stage = stages(body, point)
        except TwinError:
            # the grid has that as a failed run
            return None
        return _make_run(hazard, stages, stage, cause, numbers, "draw", seed)

    possible = (made for _ in range(MAX_REDRAWS * evidence.draws) if broken and (made := one()) is not None)
    yield from islice(possible, evidence.draws)


def _numbers(run: EvidenceRun, stage: Stage, cause: Cause, reach: float) -> NDArray[np.float64]:
    """Convert a run to its coordinates (0 .. 1 each) in the search space, the inverse of `_make_run`."""
    experiment, kinds = stage.experiment, [one["kind"] for one in run.tables]
    time = run.tables[0]["onset_s"] / experiment.cosim.tick / (experiment.duration_ticks - 1)
    shares = [
        share_of(kind, one.get(FAULT_KINDS[kind].magnitude_key or ""), slowest(kind, cause.ordered and number == 1))
        for number, (kind, one) in enumerate(zip(kinds, run.tables, strict=True))
    ]
    each = [0.5 * (1.0 + share) if has_two_ways(kind) else share for kind, share in zip(kinds, shares, strict=True)]
    late: tuple[float, ...] = ()
    if cause.ordered:
        first, second = run.tables
        after = second["onset_s"] - first["onset_s"] - stage.trip_after(first)
        late = (min(1.0, max(0.0, after / SECOND_DELAYS[-1])),)
    return np.array([time, *each, *late, *((0.0, 0.0) if reach else ())])


def _make_run(
    hazard: Hazard,
    stages: Stages,
    stage: Stage,
    cause: Cause,
    numbers: NDArray[np.float64] | Sequence[float],
    found: Origin,
    seed: int,
) -> MadeRun | None:
    """Make the run at `numbers` (0 .. 1: time, faults, delay if ordered, place); None for an unreachable place."""
    time, *rest = (float(number) for number in numbers)
    experiment, reach = stage.experiment, hazard.evidence.reach
    tick = experiment.cosim.tick
    onset = float(f"{round(time * (experiment.duration_ticks - 1)) * tick:.12g}")
    sizes = [
        magnitude_between(
            kind, 2.0 * share - 1.0 if has_two_ways(kind) else share, tick, slowest(kind, cause.ordered and number == 1)
        )
        for number, ((kind, _), share) in enumerate(zip(cause.faults, rest, strict=False))
    ]
    delay = SECOND_DELAYS[-1] * rest[len(sizes)] if cause.ordered else 0.0
    tables = tables_of(cause, sizes, onset, seed)
    offset = on_disc(reach, *rest[-2:]) if reach else NO_OFFSET
    if offset != NO_OFFSET:
        try:
            stage = stages(stage.body, (stage.offset[0] + offset[0], stage.offset[1] + offset[1]))
        except InputRefused:
            return None
        except TwinError as problem:
            # a healthy robot that trips or fails there
            return record_of(stage, cause, tables, found, str(problem)), None
    return run_of(stage, cause, tables, found, delay), stage
