"""The search: every kind once, then wherever else it can be, then differential evolution where it is worst.

With a few hundred runs for thirty kinds a search in one space of all of them would spend most runs on faults that do
nothing. So kinds are candidates of a race. In each round every kind gets one more run, in a place where it has not been
(`Place`: target, way, body), for a fault that does nothing at one joint may break the robot at another. After that the
half nearest to violating stays in each round (successive halving, Jamieson and Talwalkar 2016) and goes to other times
and magnitudes. A kind that violates is found and leaves the race. The race takes `BREADTH` of the runs at most. What
runs are left sharpen the found kinds, the worst first, by differential evolution (Storn and Price 1997) over onset,
magnitude and way, target, body and seed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from twin.robot.experiment.fault import CATALOGUE
from twin.studies.falsify.space import Place, Space, TriedFault

Judge = Callable[[Sequence[TriedFault]], list[float]]
"""How near each of some runs comes to violating: its distance as a share of the healthy one, negative if it does."""

POPULATION = 6
"""Of differential evolution, at least 5 for its mutation; small, since the space has two to five dimensions and the
runs are few."""
BREADTH = 0.7
"""Share of the runs that the race takes at most, but for the first run of every kind."""
SEEDS = 1000
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
    judge: Judge
    runs: int
    onsets: Sequence[int]
    tried: dict[TriedFault, float] = field(default_factory=dict)

    def go(self) -> None:
        """Spend the runs."""
        self._race()
        found = sorted((share, kind) for kind, (_, share) in self.worst.items())
        violated = [kind for share, kind in found if share < 0.0] or [kind for _, kind in found[:1]]
        # two generations at least, or it is no evolution
        for number, kind in enumerate(violated):
            rest = max(self._left // (len(violated) - number), 2 * POPULATION)
            self._evolve(kind, min(rest, self._left))

    def _race(self) -> None:
        rounds = {kind: self._rounds(kind) for kind in self.space.kinds}
        # the first place has all onsets, each other place one
        everywhere = {kind: len(self.space.places(kind)) + len(self.onsets) - 1 for kind in rounds}
        for lap in range(max(everywhere.values())):
            self._once([(kind, lap) for kind in self._open if lap < everywhere[kind]], rounds)
        racing, lap = self._open, 0
        while self._left_to_race and (racing := [kind for kind in self._open if kind in racing][: len(racing) // 2]):
            self._once([(kind, everywhere[kind] + lap) for kind in racing], rounds)
            lap += 1

    def _once(self, batch: Sequence[tuple[str, int]], rounds: dict[str, list[tuple[Place, int]]]) -> None:
        self._try([self._probe(kind, lap, rounds[kind]) for kind, lap in batch[: self._left_to_race]])

    @property
    def _left_to_race(self) -> int:
        return max(0, max(len(self.space.kinds), int(BREADTH * self.runs)) - len(self.tried))

    @property
    def _open(self) -> list[str]:
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
    def _left(self) -> int:
        return max(0, self.runs - len(self.tried))

    def _try(self, batch: Sequence[TriedFault]) -> list[float]:
        """The shares of `batch`; of what has been tried before without a run, infinite where there are none left."""
        fresh = list(dict.fromkeys(wrong for wrong in batch if wrong not in self.tried))[: self._left]
        if fresh:
            self.tried.update(zip(fresh, self.judge(fresh), strict=True))
        return [self.tried.get(wrong, np.inf) for wrong in batch]

    def _rounds(self, kind: str) -> list[tuple[Place, int]]:
        """Where `kind` is in its first rounds, and its onset: the catalogue's place at each of the onsets given, then
        each other place, in an order that is drawn, at these in turn until it has been at each."""
        first, *others = self.space.places(kind)
        order = np.random.default_rng(list(CATALOGUE).index(kind)).permutation(len(others))
        rounds = [(first, onset) for onset in self.onsets]
        for past in range(len(self.onsets)):
            rounds += [(others[i], self.onsets[(n + past) % len(self.onsets)]) for n, i in enumerate(order)]
        return rounds

    def _probe(self, kind: str, lap: int, rounds: Sequence[tuple[Place, int]]) -> TriedFault:
        """The run of `kind` in a round: at its largest in `rounds`, later ever finer between all times and sizes."""
        place, onset = rounds[lap % len(rounds)]
        share = 1.0
        if lap >= len(rounds):
            time, less = qmc.Halton(2, scramble=False).random(lap + 1)[-1]
            onset, share = round(float(time) * (self.space.ticks - 1)), 1.0 - 0.5 * float(less)
        magnitude, seed = self.space.magnitude(kind, place.way * share), lap if self.space.draws(kind) else 0
        return TriedFault(kind, place.target, magnitude, onset, place.body, seed)

    def _evolve(self, kind: str, runs: int) -> None:
        """Spend `runs` around what is known of `kind`."""
        targets, bodies = CATALOGUE[kind].targets, self.space.bodies
        seeds = SEEDS if self.space.draws(kind) else 0
        ways = {place.way for place in self.space.places(kind)}
        least = -1.0 if -1 in ways else 0.0
        bounds = [(0, self.space.ticks - 1), (least, 1.0), (0, len(targets) - 1), (0, len(bodies) - 1), (0, seeds)]
        whole = np.array([True, False, True, True, True])
        best = self.worst[kind][0]

        def made(x: NDArray[np.float64]) -> TriedFault:
            onset, target, body, seed = (round(float(x[i])) for i in (0, 2, 3, 4))
            magnitude = self.space.magnitude(kind, float(x[1]))
            return TriedFault(kind, targets[target], magnitude, onset, bodies[body], seed)

        last = len(self.tried) + min(runs, self._left)

        def shares(x: NDArray[np.float64]) -> NDArray[np.float64]:
            if len(self.tried) >= last:
                return np.full(x.shape[1], np.inf)
            return np.array(self._try([made(column) for column in x.T]))

        first = qmc.LatinHypercube(len(bounds), seed=0).random(POPULATION)
        lower, upper = np.array(bounds, dtype=float).T
        population = lower + first * (upper - lower)
        where = targets.index(best.target), bodies.index(best.body)
        population[0] = best.onset, self.space.share(best), *where, best.seed
        # a generation may bring fewer runs than it has members: some have been made before
        differential_evolution(
            shares, bounds, maxiter=max(1, runs), init=population, integrality=whole, seed=0, polish=False,
            callback=lambda x, convergence: len(self.tried) >= last, vectorized=True, updating="deferred", tol=0.0,
            mutation=(0.5, 1.0), recombination=0.7,
        )  # fmt: skip
