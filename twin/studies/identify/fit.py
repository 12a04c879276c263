"""Least squares that knows what it cannot know.

The unknowns, in units of their sizes, go through a Gauss-Newton search. At each step the singular values of the
whitened Jacobian say how well each direction of parameter space is seen; a direction that rounding alone leaves
uncertain by more than `BLIND_SIZE` sizes is not moved in at all: what the data cannot see stays as it is believed, and is
named. Intervals are those of clustered errors (`clustered.sandwich`), which asks nothing of the errors within one, but
no narrower than if all errors were independent and of one size: few clusters can agree by chance.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.robot.controller.controller import Belief
from twin.studies.identify.balance import Equations, clear_of_edges, pose, rows
from twin.studies.identify.clustered import sandwich, t_factor
from twin.studies.identify.parameters import JOINT_ZERO, KAPPA, PARAMETER_COUNT, RATE, Parameter, sizes, starts
from twin.studies.identify.windows import Windows, in_air, on_scale

BLIND_SIZE = 0.3
"""Sizes: a direction that is known to no better than this is not seen."""
MAX_INTERVAL_SIZE = 0.1
"""Sizes: a parameter is reported if its interval and what hides in unseen directions stay within this."""
JOINT_ZEROS = slice(JOINT_ZERO, JOINT_ZERO + 3)
DIFFERENCE_STEP = 1e-5
"""Sizes."""
STEPS = 12
RETURNING_STEPS = 6
"""Steps; windows that leave later do not return: one at the edge of a dead zone would come and go for ever."""
CONVERGED_STEP = 1e-4
"""Sizes: the step that ends the search; what is left after it is its square."""
MIN_POSITIVE_SHARE = 0.05
"""Of what is positive by nature (k_s eta, a rate) and of its start: the search goes no lower."""


@dataclass(frozen=True)
class Fit:
    """Parameters, and how sure.

    Attributes:
        unknowns: what was searched for.
        x: values (17,); what is not seen stands at its start.
        covariance: (17, 17), of what is seen, by the scatter between clusters.
        independent: as if there were none.
        unseen: orthonormal directions in units of sizes that the data do not see (17, k).
        singular: singular values of the whitened Jacobian in units of sizes, descending (k,).
        seen: the windows used.
        rows: their equations at x.
        converged: whether the search came to rest.
        clusters: how many groups of windows.
        t_factor: half width of a 95 % interval in standard deviations.
    """

    unknowns: tuple[Parameter, ...]
    x: NDArray[np.float64]
    covariance: NDArray[np.float64]
    independent: NDArray[np.float64]
    unseen: NDArray[np.float64]
    singular: NDArray[np.float64]
    seen: Windows
    rows: Equations
    converged: bool
    clusters: int
    t_factor: float

    def half_width(self, direction: NDArray[np.float64]) -> float:
        """Of the 95 % interval of direction . x, `direction` (17,); what is not seen counts with its whole size."""
        if self.clusters < 2:
            return np.inf
        scatter = self.t_factor * np.sqrt(direction @ self.covariance @ direction)
        independent = self.t_factor * np.sqrt(direction @ self.independent @ direction)
        hidden = np.linalg.norm((direction * sizes(self.unknowns)) @ self.unseen)
        return float(max(scatter, independent) + hidden)

    def is_determined(self, direction: NDArray[np.float64], size: float) -> bool:
        """Whether direction . x is known to `MAX_INTERVAL_SIZE` of `size`."""
        return self.half_width(direction) < MAX_INTERVAL_SIZE * size

    @property
    def force_residual(self) -> NDArray[np.float64]:
        """Force by the springs less that of the scale, of the windows in contact (n,), N."""
        at = self.rows.kind == 1
        return self.rows.residual[at] / self.rows.per_newton

    def misfit(self, *kinds: int) -> float:
        """Root mean square of the residuals of `kinds` over what rounding leaves in one sample; 0: there are none."""
        at = np.isin(self.rows.kind, kinds)
        return float(np.sqrt(np.mean((self.rows.residual[at] / self.rows.sigma[at]) ** 2))) if np.any(at) else 0.0

    def half_width_through(self, quantity: Callable[[NDArray[np.float64]], float]) -> float:
        """Of the 95 % interval of a `quantity` that is computed from x (17,), by its gradient at x."""
        steps = np.diag(1e-4 * sizes(self.unknowns))
        slope = [(quantity(self.x + e) - quantity(self.x - e)) / (2.0 * e.sum()) for e in steps]
        return self.half_width(np.array(slope))

    def direction(self, index: int) -> NDArray[np.float64]:
        """The direction of parameter `index`."""
        return np.eye(PARAMETER_COUNT)[index]


def fit(
    seen: Windows,
    belief: Belief,
    unknowns: tuple[Parameter, ...],
    resolution: float,
    fixed: tuple[int, ...] = (),
    surface: bool = True,
) -> Fit:
    """The parameters that meet `balance.rows` best.

    Args:
        seen: windows of a log; those at the edge of a dead zone, and those neither in air nor in contact, are left out.
        belief: geometry, masses, N, counts.
        unknowns: of `parameters`.
        resolution: step of the force (N).
        fixed: indices of parameters that are known and stay at their start.
        surface: see `rows`.

    Raises:
        Unreachable: joint angles that do not close.
    """
    x, scale = starts(unknowns), sizes(unknowns)
    scale = np.where(np.isin(np.arange(PARAMETER_COUNT), fixed), 0.0, scale)
    settled = seen.select(in_air(seen) | on_scale(seen))
    used = settled.select(clear_of_edges(x, settled, belief.N))
    change = np.inf
    for number in range(STEPS):
        if len(used.t) == 0 or change < CONVERGED_STEP:
            break
        at, A = _linearise(x, scale, used, belief, resolution, surface)
        step = _visible_directions(A, fixed)[0] @ (-at.residual / at.sigma)
        there = x + scale * np.clip(step, -0.5, 0.5)
        for index in (KAPPA, RATE):
            there[index] = max(there[index], MIN_POSITIVE_SHARE * unknowns[index].start)
        # held back at its least, a parameter has come to rest
        change = float(np.max(np.abs(there - x)[scale > 0.0] / scale[scale > 0.0]))
        x = there
        candidates = settled if number < RETURNING_STEPS else used
        used = candidates.select(clear_of_edges(x, candidates, belief.N))
    at, A = _linearise(x, scale, used, belief, resolution, surface)
    inverse, unseen, singular = _visible_directions(A, fixed)
    r = at.residual / at.sigma
    covariance = sandwich(A, inverse, r, used.cluster[at.window]) * np.outer(scale, scale)
    variance = float(r @ r) / max(len(r) - PARAMETER_COUNT, 1)
    independent = variance * inverse @ inverse.T * np.outer(scale, scale)
    clusters = len(np.unique(used.cluster))
    factor = t_factor(clusters)
    return Fit(
        unknowns, x, covariance, independent, unseen, singular, used, at, change < CONVERGED_STEP, clusters, factor
    )


def _linearise(x, scale, used, belief, resolution, surface) -> tuple[Equations, NDArray[np.float64]]:
    """Equations at x, and d residual / d (x / scale) over their sigma (m, 17), by central differences: the equations
    are smooth away from dead zones. Kinematics are solved anew for the zeros of the joints only."""
    here = pose(belief, used.joint - x[JOINT_ZEROS])
    at = rows(x, used, belief, resolution, here, surface)
    A = np.zeros((len(at.residual), PARAMETER_COUNT))
    for index in np.flatnonzero(scale):
        ends = []
        for side in (DIFFERENCE_STEP, -DIFFERENCE_STEP):
            near = x.copy()
            near[index] += side * scale[index]
            turned = JOINT_ZEROS.start <= index < JOINT_ZEROS.stop
            there = pose(belief, used.joint - near[JOINT_ZEROS]) if turned else here
            ends.append(rows(near, used, belief, resolution, there, surface).residual)
        A[:, index] = (ends[0] - ends[1]) / (2.0 * DIFFERENCE_STEP * at.sigma)
    return at, A


def _visible_directions(A, fixed) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Pseudo-inverse of A over the directions that it sees (17, m); those that it does not, (17, k), without the
    `fixed` parameters, which are no secret of the data; the singular values."""
    free = np.setdiff1d(np.arange(PARAMETER_COUNT), fixed)
    n = len(free)
    U, s, Vt = np.linalg.svd(A[:, free], full_matrices=len(A) < n)
    s = np.pad(s, (0, n - len(s)))
    good = s > 1.0 / BLIND_SIZE
    inverse, unseen = np.zeros((PARAMETER_COUNT, len(A))), np.zeros((PARAMETER_COUNT, int(np.sum(~good))))
    inverse[free] = (Vt[good].T / s[good]) @ U[:, : np.sum(good)].T
    unseen[free] = Vt[~good].T
    return inverse, unseen, s
