"""How large a diagonal perturbation has to be until it makes a matrix singular: the structured singular value, mu.

mu(M) is one over the largest singular value of the smallest complex diagonal Delta with det(1 - Delta M) = 0. No D that
is diagonal and positive moves it, so it is at most the largest singular value of D M D^-1 for any of them, and the
smallest of those is taken for it. For up to three rows that is mu itself; for more it is an upper bound, which errs on
the safe side (Doyle 1982, IEE Proc D 129:242; Packard and Doyle 1993, Automatica 29:71).
"""

import numpy as np
from numpy.typing import NDArray

from twin.studies.analyse.linear.drive_model import Matrix

Complex = NDArray[np.complex128]

EXPONENTS = (4.0, 32.0, 256.0, 2048.0)
"""Of the norms that end up as the largest singular value: seven singular values that are equal count 0.1 % too much."""
STEPS, LONGEST, SHORTEST = 60, 3.0, 1e-9
"""How often log D is moved on, how far at most, and to which share of a step it is tried."""
WIDEST = 60.0
"""Spread of log D: a loop that nothing comes back to wants an infinite one."""
FLAT, TINY = 1e-13, 1e-300
"""A fall of the norm that is none, and a matrix that is none."""
CLOSE = 1e-5
"""Relative. Bounds that are no farther apart are one."""


def scaled(M: Complex, log_D: Matrix) -> Complex:
    """D M D^-1 of matrices (..., k, k), for the logarithms (..., k) of D."""
    return M * np.exp(log_D[..., :, None] - log_D[..., None, :])


def best_scaling(M: Complex, start: Matrix) -> Matrix:
    """log D (k,) with which the largest singular value of D M D^-1 is smallest.

    It is a convex function of log D with edges where singular values are equal; sums of their powers have none, and
    come close with the exponent (Schatten norms).

    Args:
        M: (k, k).
        start: log D to begin with.
    """
    found = start
    for exponent in EXPONENTS:
        found = _lowest(M, found, exponent)
    return found - found.mean()


def _norm(M: Complex, log_D: Matrix, exponent: float) -> tuple[float, Matrix]:
    """Logarithm of the norm of D M D^-1, and its derivatives (k,) by log D."""
    left, sizes, right = np.linalg.svd(scaled(M, log_D))
    share = (sizes / max(sizes[0], TINY)) ** exponent
    total = share.sum()
    # a singular value's logarithm goes with |u_k|^2 - |v_k|^2
    slopes = np.abs(left.T) ** 2 - np.abs(right) ** 2
    return float(np.log(max(sizes[0], TINY)) + np.log(total) / exponent), share @ slopes / total


def _lowest(M: Complex, log_D: Matrix, exponent: float) -> Matrix:
    """log D with the smallest norm, by the method of Broyden, Fletcher, Goldfarb and Shanno."""
    value, slope = _norm(M, log_D, exponent)
    inverse = np.eye(len(log_D))
    for _ in range(STEPS):
        way = -inverse @ slope
        fall = float(way @ slope)
        if fall > -FLAT or np.ptp(log_D) > WIDEST:
            break
        length = min(1.0, LONGEST / np.abs(way).max())
        ahead = _norm(M, log_D + length * way, exponent)
        while ahead[0] > value + 0.1 * length * fall and length > SHORTEST:
            length *= 0.4
            ahead = _norm(M, log_D + length * way, exponent)
        if not ahead[0] < value:
            break
        moved, turned = length * way, ahead[1] - slope
        log_D, (value, slope) = log_D + moved, ahead
        curved = float(moved @ turned)
        if curved > 0.0:
            left = np.eye(len(log_D)) - np.outer(moved, turned) / curved
            inverse = left @ inverse @ left.T + np.outer(moved, moved) / curved
    return log_D


def largest(M: Complex) -> tuple[int, float]:
    """(which, bound) of the matrix (n, k, k) whose upper bound of mu is largest.

    The scaling of the one that seems largest is the best for it and good for its neighbours, so that few have to be
    looked at.
    """
    bounds = np.linalg.svd(M, compute_uv=False)[:, 0]
    log_D, looked_at = np.zeros(M.shape[-1]), 0.0
    for _ in range(len(M)):
        which = int(np.argmax(bounds))
        if bounds[which] <= looked_at * (1.0 + CLOSE):
            break
        log_D = best_scaling(M[which], log_D)
        bounds = np.minimum(bounds, np.linalg.svd(scaled(M, log_D), compute_uv=False)[:, 0])
        looked_at = max(looked_at, float(bounds[which]))
    which = int(np.argmax(bounds))
    return which, float(bounds[which])
