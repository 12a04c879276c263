"""The search: every kind once, the promising ones again, then differential evolution where it is worst.

With a hundred runs for thirty kinds a search in one space of all of them would spend most runs on faults that do
nothing. So kinds are candidates of a race, successive halving (Jamieson and Talwalkar 2016): in each round every kind
that is still in it gets one more run, elsewhere in time and magnitude, and the half nearest to violating stays. A kind
that violates is found and leaves the race. What runs are left sharpen the found kinds, the worst first, by differential
evolution (Storn and Price 1997) over onset, magnitude, target, body and seed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from twin.experiment.fault_catalogue import CATALOGUE
from twin.studies.falsify.space import Space, Wrong

Judge = Callable[[Sequence[Wrong]], list[float]]
"""How near each of some runs comes to violating: its distance as a share of the healthy one, negative if it does."""

POPULATION = 6
"""Of differential evolution, at least 5 for its mutation; small, since the space has two to five dimensions and the
runs are few."""
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
    tried: dict[Wrong, float] = field(default_factory=dict)

    def go(self) -> None:
        """Spend the runs."""
        racing = list(self.space.kinds)
        lap = 0
        while racing and self._left:
            self._try([self._probe(kind, lap) for kind in racing])
            open_ = [kind for kind in racing if kind in self.worst and self.worst[kind][1] >= 0.0]
            open_.sort(key=lambda kind: self.worst[kind][1])
            racing, lap = open_[: len(open_) // 2], lap + 1
        found = sorted((share, kind) for kind, (_, share) in self.worst.items())
        violated = [kind for share, kind in found if share < 0.0] or [kind for _, kind in found[:1]]
        # two generations at least, or it is no evolution
        for number, kind in enumerate(violated):
            rest = max(self._left // (len(violated) - number), 2 * POPULATION)
            self._evolve(kind, min(rest, self._left))

    @property
    def worst(self) -> dict[str, tuple[Wrong, float]]:
        """Of each kind the run that came nearest, of equal ones the first."""
        best: dict[str, tuple[Wrong, float]] = {}
        for wrong, share in self.tried.items():
            if wrong.kind not in best or share < best[wrong.kind][1]:
                best[wrong.kind] = wrong, share
        return best

    @property
    def _left(self) -> int:
        return max(0, self.runs - len(self.tried))

    def _try(self, batch: Sequence[Wrong]) -> list[float]:
        """The shares of `batch`; of what has been tried before without a run, infinite where there are none left."""
        fresh = list(dict.fromkeys(wrong for wrong in batch if wrong not in self.tried))[: self._left]
        if fresh:
            self.tried.update(zip(fresh, self.judge(fresh), strict=True))
        return [self.tried.get(wrong, np.inf) for wrong in batch]

    def _probe(self, kind: str, lap: int) -> Wrong:
        """The run of `kind` in a round: the largest magnitude at the onsets given, then ever finer between all."""
        spread = qmc.Halton(2, scramble=False).random(lap + 1)[-1] if lap >= len(self.onsets) else None
        onset = self.onsets[lap] if spread is None else round(float(spread[0]) * (self.space.ticks - 1))
        share = 1.0 if spread is None else 1.0 - 0.5 * float(spread[1])
        body = self.space.bodies[lap % len(self.space.bodies)]
        magnitude, seed = self.space.magnitude(kind, share), lap if self.space.draws(kind) else 0
        return Wrong(kind, CATALOGUE[kind].targets[0], magnitude, onset, body, seed)

    def _evolve(self, kind: str, runs: int) -> None:
        """Spend `runs` around what is known of `kind`."""
        targets, bodies = CATALOGUE[kind].targets, self.space.bodies
        seeds = SEEDS if self.space.draws(kind) else 0
        bounds = [(0, self.space.ticks - 1), (0.0, 1.0), (0, len(targets) - 1), (0, len(bodies) - 1), (0, seeds)]
        whole = np.array([True, False, True, True, True])
        best = self.worst[kind][0]

        def made(x: NDArray[np.float64]) -> Wrong:
            onset, target, body, seed = (round(float(x[i])) for i in (0, 2, 3, 4))
            magnitude = self.space.magnitude(kind, float(x[1]))
            return Wrong(kind, targets[target], magnitude, onset, bodies[body], seed)

        last = len(self.tried) + min(runs, self._left)

        def shares(x: NDArray[np.float64]) -> NDArray[np.float64]:
            if len(self.tried) >= last:
                return np.full(x.shape[1], np.inf)
            return np.array(self._try([made(column) for column in x.T]))

        first = qmc.LatinHypercube(len(bounds), seed=0).random(POPULATION)
        lower, upper = np.array(bounds, dtype=float).T
        population = lower + first * (upper - lower)
        population[0] = best.onset, self._share(best), targets.index(best.target), bodies.index(best.body), best.seed
        differential_evolution(
            shares, bounds, maxiter=max(1, runs // POPULATION), init=population, integrality=whole, seed=0,
            polish=False, vectorized=True, updating="deferred", tol=0.0, mutation=(0.5, 1.0), recombination=0.7,
        )  # fmt: skip

    def _share(self, wrong: Wrong) -> float:
        magnitudes = CATALOGUE[wrong.kind].magnitudes
        if magnitudes is None or wrong.magnitude is None:
            return 0.0
        return float(np.log(wrong.magnitude / magnitudes[0]) / np.log(magnitudes[-1] / magnitudes[0]))
