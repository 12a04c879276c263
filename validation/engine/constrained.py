"""Bodies that constraints join, solved exactly: M a + bias = Q + J^T lambda, J a = -drift.

The rows of J are completed to a square matrix A with those of the coordinates that remain free: the columns of its
inverse that belong to these span the null space of J.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Constrained:
    """Bodies in one state, n speeds of which m are bound.

    Attributes:
        M: mass matrix of the unbound bodies (n, n).
        bias: what it takes to go on without acceleration (n,): gravity and gyroscopic forces.
        bound: rows of the constraints (m, n).
        drift: their rate times the speeds (m,): d/dt (bound) qvel.
        inverse: of A, whose first m rows are `bound` (n, n).
    """

    M: Numbers
    bias: Numbers
    bound: Numbers
    drift: Numbers
    inverse: Numbers

    @property
    def directions(self) -> Numbers:
        """How the bodies move with each of the free coordinates (n, n - m)."""
        return self.inverse[:, len(self.bound) :]

    def mass(self, felt: int) -> Numbers:
        """What the first `felt` free coordinates feel while the others follow without a force, (felt, felt)."""
        whole = self.directions.T @ self.M @ self.directions
        kept, rest = slice(None, felt), slice(felt, None)
        return whole[kept, kept] - whole[kept, rest] @ np.linalg.solve(whole[rest, rest], whole[rest, kept])

    def acceleration(self, forces: Numbers) -> Numbers:
        """Of all speeds (n,) under the generalised `forces` (n,)."""
        N = self.directions
        bound = -self.inverse[:, : len(self.bound)] @ self.drift
        return bound + N @ np.linalg.solve(N.T @ self.M @ N, N.T @ (forces - self.bias - self.M @ bound))

    def reactions(self, forces: Numbers, acceleration: Numbers) -> tuple[Numbers, Numbers]:
        """Forces (m,) of the constraints, and (n - m,) those that have to act on the free coordinates besides.

        The latter are zero at the acceleration that `forces` cause.
        """
        found = self.inverse.T @ (self.M @ acceleration + self.bias - forces)
        return found[: len(self.bound)], found[len(self.bound) :]
