"""Linear least squares whose errors come in clusters."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

CONFIDENCE = 0.95


class Line(NamedTuple):
    """Coefficients (p,), and half widths of their 95 % intervals (p,)."""

    coefficients: NDArray[np.float64]
    half_widths: NDArray[np.float64]


def t_factor(clusters: int) -> float:
    """Half width of a 95 % interval in standard deviations: Student's t of clusters - 1 degrees of freedom."""
    return float(student.ppf(0.5 + 0.5 * CONFIDENCE, clusters - 1)) if clusters > 1 else np.inf


def sandwich(
    inverse: NDArray[np.floating], residual: NDArray[np.floating], cluster: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Covariance (p, p) of least squares whose errors are independent between clusters and anything within.

    (A^T A)^-1 sum_g (A_g^T r_g)(A_g^T r_g)^T (A^T A)^-1 G/(G - 1): Cameron and Miller (2015), A practitioner's guide to
    cluster-robust inference, J. Human Resources 50:317, Eq. 11 and 12. Infinite for a single cluster.

    Args:
        inverse: pseudo-inverse of A (p, m). residual: (m,). cluster: number of the group of each row (m,).
    """
    numbers = np.unique(cluster)
    G = len(numbers)
    if G < 2:
        return np.full((len(inverse), len(inverse)), np.inf)
    scores = np.stack([inverse[:, cluster == g] @ residual[cluster == g] for g in numbers])
    return G / (G - 1.0) * scores.T @ scores


def line(A: NDArray[np.float64], y: NDArray[np.float64], cluster: NDArray[np.int64]) -> Line | None:
    """The least squares solution of A c = y, A (m, p); None if A does not say it."""
    if len(y) < A.shape[1] or np.linalg.matrix_rank(A) < A.shape[1]:
        return None
    inverse = np.linalg.pinv(A)
    c: NDArray[np.float64] = inverse @ y
    covariance = sandwich(inverse, y - A @ c, cluster)
    return Line(c, t_factor(len(np.unique(cluster))) * np.sqrt(np.diag(covariance)))
