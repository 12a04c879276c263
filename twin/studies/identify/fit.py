"""Nonlinear least squares that detects undetermined directions of the parameters.

The unknowns, in units of their sizes, are found by a Gauss-Newton search. At each step the singular values of the
whitened Jacobian give the sensitivity of each direction in parameter space. A direction that rounding leaves uncertain
by more than `BLIND_SIZE` sizes is not changed: undetermined parameters keep their believed values and are reported.
Intervals are computed for clustered errors (`clustered.sandwich`), without assumptions on errors within a cluster, but
at least as for independent errors of one size, since few clusters can agree by chance.
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
"""Maximum uncertainty of a determined direction (sizes)."""
MAX_INTERVAL_SIZE = 0.1
"""Maximum half width of a reported parameter, including undetermined directions (sizes)."""
JOINT_ZEROS = slice(JOINT_ZERO, JOINT_ZERO + 3)
DIFFERENCE_STEP = 1e-5
"""Step of numerical derivatives (sizes)."""
MAX_STEPS = 12
RETURNING_STEPS = 6
"""Number of steps after which excluded windows stay so, as one at a dead zone's edge would alternate forever."""
CONVERGED_STEP = 1e-4
"""Step length that ends the search (sizes); the remaining error is its square."""
MIN_POSITIVE_SHARE = 0.05
"""Lower bound of positive parameters (k_s eta, a rate) by their start."""


@dataclass(frozen=True)
class Fit:
    """Fitted parameters of an identification, with their covariance.

    Attributes:
        x: values (17,); undetermined ones at their start.
        covariance: covariance (17, 17) of the determined directions, by the scatter between clusters.
        independent: covariance for independent errors.
        unseen: orthonormal undetermined directions in units of sizes (17, k).
        singular: singular values of the whitened Jacobian in units of sizes, descending (k,).
        seen: used windows.
        rows: equations of these at x.
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
        """Compute the half width of the 95 % interval of `direction` (17,) . x, undetermined parts at full size."""
        if self.clusters < 2:
            return np.inf
        scatter = self.t_factor * np.sqrt(direction @ self.covariance @ direction)
        independent = self.t_factor * np.sqrt(direction @ self.independent @ direction)
        hidden = np.linalg.norm((direction * sizes(self.unknowns)) @ self.unseen)
        return float(max(scatter, independent) + hidden)

    def is_determined(self, direction: NDArray[np.float64], size: float) -> bool:
        """Check whether the log determines the combination direction . x to within `MAX_INTERVAL_SIZE` of `size`."""
        return self.half_width(direction) < MAX_INTERVAL_SIZE * size

    @property
    def force_residual(self) -> NDArray[np.float64]:
        """Force by the springs less the force of the scale, in the windows in contact (n,), N."""
        at = self.rows.kind == 1
        return self.rows.residual[at] / self.rows.per_newton

    def misfit(self, *kinds: int) -> float:
        """Compute the rms residual of the equations of `kinds` by one sample's rounding; 0 without residuals."""
        at = np.isin(self.rows.kind, kinds)
        return float(np.sqrt(np.mean((self.rows.residual[at] / self.rows.sigma[at]) ** 2))) if np.any(at) else 0.0

    def half_width_through(self, quantity: Callable[[NDArray[np.float64]], float]) -> float:
        """Compute the half width of the 95 % interval of a function of the parameters x (17,), by its gradient at x."""
        steps = np.diag(1e-4 * sizes(self.unknowns))
        slope = [(quantity(self.x + e) - quantity(self.x - e)) / (2.0 * e.sum()) for e in steps]
        return self.half_width(np.array(slope))

    def direction(self, index: int) -> NDArray[np.float64]:
        """Return the unit vector of parameter `index`."""
        return np.eye(PARAMETER_COUNT)[index]


def fit(
    seen: Windows,
    belief: Belief,
    unknowns: tuple[Parameter, ...],
    resolution: float,
    fixed: tuple[int, ...] = (),
    surface: bool = True,
) -> Fit:
    """Fit the parameters of springs and scale to the equations of statics in `balance.rows`.

    Args:
        seen: windows of a log; those at the edge of a dead zone, and those neither in air nor in contact, are excluded.
        resolution: step of the force (N).
        fixed: indices of known parameters, which keep their start.

    Raises:
        Unreachable: joint angles that do not close.
    """
    x, scale = starts(unknowns), sizes(unknowns)
    scale = np.where(np.isin(np.arange(PARAMETER_COUNT), fixed), 0.0, scale)
    settled = seen.select(in_air(seen) | on_scale(seen))
    used = settled.select(clear_of_edges(x, settled, belief.N))
    change = np.inf
    for number in range(MAX_STEPS):
        if len(used.t) == 0 or change < CONVERGED_STEP:
            break
        at, A = _linearise(x, scale, used, belief, resolution, surface)
        step = _visible_directions(A, fixed)[0] @ (-at.residual / at.sigma)
        there = x + scale * np.clip(step, -0.5, 0.5)
        for index in (KAPPA, RATE):
            there[index] = max(there[index], MIN_POSITIVE_SHARE * unknowns[index].start)
        # a parameter at its bound has converged
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
    """Compute the equations of statics at x, and their Jacobian d residual / d (x / scale) by their sigma (m, 17), by
    central differences.

    The equations are smooth away from dead zones. Kinematics are recomputed only for zeros of the joints.
    """
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
    """Split parameter space by the singular values of A: return the pseudo-inverse over determined directions (17, m),
    the undetermined directions (17, k) without `fixed` parameters, and the singular values."""
    free = np.setdiff1d(np.arange(PARAMETER_COUNT), fixed)
    n = len(free)
    U, s, Vt = np.linalg.svd(A[:, free], full_matrices=len(A) < n)
    s = np.pad(s, (0, n - len(s)))
    good = s > 1.0 / BLIND_SIZE
    inverse, unseen = np.zeros((PARAMETER_COUNT, len(A))), np.zeros((PARAMETER_COUNT, int(np.sum(~good))))
    inverse[free] = (Vt[good].T / s[good]) @ U[:, : np.sum(good)].T
    unseen[free] = Vt[~good].T
    return inverse, unseen, s
