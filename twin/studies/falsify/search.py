"""Search for the worst fault: a race over all kinds, then differential evolution."""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from twin.robot.experiment.fault import FAULT_KINDS
from twin.robot.experiment.together import SEQUENCE_SEPARATOR
from twin.studies.falsify.space import Place, Space, TriedFault, may_creep, ways_of
from twin.studies.faults.magnitudes import UPPER_SHARE
from twin.studies.faults.offsets import NO_OFFSET, on_disc
from twin.studies.faults.together import SECOND_DELAYS

Judgement = Callable[[Sequence[TriedFault]], list[float]]
"""Returns the distance of each run from a violation as a share of the healthy distance; negative if violated."""

POPULATION_SIZE = 6
"""Population of differential evolution: at least 5 for its mutation; small, since dimensions and runs are few."""
RACE_SHARE = 0.7
"""Maximum share of the runs for the race, in addition to the first run of every kind."""
MIN_SPEED_SHARE = 0.01
"""Minimum share of the speed of a drive that creeps after a trip; 0 has no direction."""
SEED_COUNT = 1000


def _number(kind: str) -> int:
    """Return the seed for the order of the places of a fault kind."""
    kinds = list(FAULT_KINDS)
    return kinds.index(kind) if kind in kinds else len(kinds) + zlib.crc32(kind.encode())


@dataclass
class Search:
    """Search over a space of faults, with all runs tried so far.

    Attributes:
        runs: maximum number of runs.
        onsets: ticks to try first.
        tried: share of every run, in the order of the runs.
    """

    space: Space
    judge: Judgement
    runs: int
    onsets: Sequence[int]
    tried: dict[TriedFault, float] = field(default_factory=dict)

    def spend_runs(self) -> None:
        """Run the race over all fault kinds, then evolution of the violating kinds, until the runs are spent."""
        self._race()
        found = sorted((share, kind) for kind, (_, share) in self.worst.items())
        violated = [kind for share, kind in found if share < 0.0] or [kind for _, kind in found[:1]]
        # evolution needs at least two generations
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
        """List the fault kinds without a violation so far, the nearest to a violation first."""
        share = {kind: self.worst[kind][1] if kind in self.worst else 0.0 for kind in self.space.kinds}
        return sorted((kind for kind in share if share[kind] >= 0.0), key=lambda kind: share[kind])

    @property
    def worst(self) -> dict[str, tuple[TriedFault, float]]:
        """Worst run of each fault kind, with the smallest share of the healthy distance; the first of equal runs."""
        best: dict[str, tuple[TriedFault, float]] = {}
        for wrong, share in self.tried.items():
            if wrong.kind not in best or share < best[wrong.kind][1]:
                best[wrong.kind] = wrong, share
        return best

    @property
    def _runs_left(self) -> int:
        return max(0, self.runs - len(self.tried))

    def _try(self, batch: Sequence[TriedFault]) -> list[float]:
        """Run the faults of `batch`; return their shares of the healthy distance, infinite beyond the run limit."""
        fresh = list(dict.fromkeys(wrong for wrong in batch if wrong not in self.tried))[: self._runs_left]
        if fresh:
            self.tried.update(zip(fresh, self.judge(fresh), strict=True))
        return [self.tried.get(wrong, np.inf) for wrong in batch]

    def _rounds(self, kind: str) -> list[tuple[Place, int]]:
        """List the places and onsets of the first rounds of the race for a fault kind.

        The catalogue's place comes first, at each given onset, then the other signs of a set of faults there, then each
        other place in a drawn order, at the onsets in turn until it has been tried at each.
        """
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
        """Choose the fault to run for a kind in a round of the race.

        In `rounds` the magnitude is the catalogue's largest; later rounds fill times, sizes up to the upper end,
        offsets and delays ever more finely.
        """
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
            offset = on_disc(self.space.reach, *rest[-2:]) if self.space.reach else NO_OFFSET
        shares = [way * share for way, share in zip(place.ways, shares, strict=True)]
        seed = lap if self.space.draws(kind) else 0
        return self.space.fault(kind, (place.target, place.body), shares, onset, seed, offset, delay)

    def _evolve(self, kind: str, runs: int) -> None:
        """Spend `runs` on differential evolution of a fault kind, starting from its worst run."""
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

        def tried_fault(x: NDArray[np.float64]) -> TriedFault:
            onset, *rest = (float(each) for each in x)
            shares, (target, body, seed) = rest[: len(sizes)], map(round, rest[len(sizes) : len(sizes) + 3])
            offset = on_disc(space.reach, *rest[-2:]) if space.reach else NO_OFFSET
            delay = rest[len(sizes) + 3] if ordered else 0.0
            return space.fault(kind, (targets[target], bodies[body]), shares, round(onset), seed, offset, delay)

        last = len(self.tried) + min(runs, self._runs_left)

        def shares(x: NDArray[np.float64]) -> NDArray[np.float64]:
            if len(self.tried) >= last:
                return np.full(x.shape[1], np.inf)
            return np.array(self._try([tried_fault(column) for column in x.T]))

        first = qmc.LatinHypercube(len(bounds), seed=0).random(POPULATION_SIZE)
        lower, upper = np.array(bounds, dtype=float).T
        population = lower + first * (upper - lower)
        where = targets.index(best.target), bodies.index(best.body)
        here = space.polar(best.offset) if space.reach else ()
        late = (best.delay * space.tick,) if ordered else ()
        population[0] = best.onset, *space.shares(best), *where, best.seed, *late, *here
        # a generation may need fewer runs than it has members: known runs are not repeated
        differential_evolution(
            shares, bounds, maxiter=max(1, runs), init=population, integrality=np.array(whole), seed=0, polish=False,
            callback=lambda x, convergence: len(self.tried) >= last, vectorized=True, updating="deferred", tol=0.0,
            mutation=(0.5, 1.0), recombination=0.7,
        )  # fmt: skip
