"""Linear least squares with intervals for clustered errors."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

CONFIDENCE_LEVEL = 0.95


class Line(NamedTuple):
    """Fitted coefficients (p,) of a linear model, and half widths of their 95 % intervals (p,)."""

    coefficients: NDArray[np.float64]
    half_widths: NDArray[np.float64]


def t_factor(clusters: int) -> float:
    """Return the half width of a 95 % interval in standard deviations: Student's t, clusters - 1 degrees of freedom."""
    return float(student.ppf(0.5 + 0.5 * CONFIDENCE_LEVEL, clusters - 1)) if clusters > 1 else np.inf


def sandwich(
    A: NDArray[np.floating], inverse: NDArray[np.floating], residual: NDArray[np.floating], cluster: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Compute the covariance (p, p) of least squares, with errors arbitrary within and independent between clusters.

    (G - 1)/G sum_g s_g s_g^T, s_g = (I - A_g^+ A_g)^-1 A_g^+ r_g, the change without cluster g. It is CR3 of Bell and
    McCaffrey (2002), Bias reduction in standard errors, Survey Methodology 28:169, as in Cameron and Miller (2015), J.
    Human Resources 50:317, Sec. VI.B, with (I - A_g A_g^+)^-1 pushed through: plain residuals of a few clusters are too
    small, because the fit follows them. Infinite for a single cluster.

    Args:
        A: design matrix (m, p).
        inverse: its pseudo-inverse A^+ (p, m).
        residual: residuals (m,).
        cluster: cluster of each row (m,).
    """
    numbers = np.unique(cluster)
    G = len(numbers)
    if G < 2:
        return np.full((len(inverse), len(inverse)), np.inf)
    moved = np.zeros((G, len(inverse)))
    for row, g in zip(moved, numbers, strict=True):
        own = cluster == g
        remainder = np.eye(len(inverse)) - inverse[:, own] @ A[own]
        # a direction seen by one cluster only has no scatter
        row[:] = np.linalg.pinv(remainder, rcond=1e-6) @ (inverse[:, own] @ residual[own])
    return (G - 1.0) / G * moved.T @ moved


def line(A: NDArray[np.float64], y: NDArray[np.float64], cluster: NDArray[np.int64]) -> Line | None:
    """Solve A c = y, A (m, p), by least squares with 95 % intervals for clustered errors; None if rank deficient."""
    if len(y) < A.shape[1] or np.linalg.matrix_rank(A) < A.shape[1]:
        return None
    inverse = np.linalg.pinv(A)
    c: NDArray[np.float64] = inverse @ y
    covariance = sandwich(A, inverse, y - A @ c, cluster)
    return Line(c, t_factor(len(np.unique(cluster))) * np.sqrt(np.diag(covariance)))
