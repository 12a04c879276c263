"""Margins, sensitivity and bandwidth of a loop, from its frequency response and cross-checked by eigenvalues.

The frequency response is evaluated point by point and passed to python-control as data. Its margins of a state-space
loop use a transfer function's coefficients, which rounding ruins with a dozen states near z = 1: for a stable loop of
this robot the resulting gain margin was 0.9 instead of 90.

Disk margins: permitted error of gain and phase of several loops, all at once and independently. Each loop is multiplied
by a complex number f of its own, from a disk (Seiler, Packard and Gahinet 2020, An Introduction to Disk Margins, IEEE
Control Systems 40(5):78):

    f = (1 + (1 - sigma)/2 delta) / (1 - (1 + sigma)/2 delta),  |delta| < alpha.

The loops stay stable for all of them up to alpha = 1 / max mu(S + (sigma - 1)/2 1), the largest over all frequencies, S
being their sensitivity. Balanced, sigma = 0, the disk extends from (1 - alpha/2)/(1 + alpha/2) to its inverse on the
real axis, and contains all rotations of up to 2 arctan(alpha/2).

All margins are those for the linear model on a frequency grid: resonances narrower than the grid are missed.

The structured singular value mu(M) is one over the largest singular value of the smallest complex diagonal Delta with
det(1 - Delta M) = 0. A positive diagonal D leaves it unchanged, so it is at most the largest singular value of D M D^-1
for any D, and the minimum over D is used as mu. For up to three rows the minimum equals mu; for more it is an upper
bound, which errs on the safe side (Doyle 1982, IEE Proc D 129:242; Packard and Doyle 1993, Automatica 29:71).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray

from twin.studies.analyse.linear.loops import LOOPS, Loops, Matrix, closed_loops, spectral_radius

Complex = NDArray[np.complex128]

MIN_FREQUENCY = 0.02
"""Minimum frequency (rad/s), two decades below the slowest loop."""
GRID_POINTS = 1500
MARGIN_TOLERANCE = 0.01
"""Maximum relative difference of a gain margin between eigenvalues and frequency response."""
LARGEST_GAIN = 1000.0
"""Largest gain factor examined; a larger gain margin counts as unlimited."""
HALF_POWER = 1.0 / np.sqrt(2.0)
NORM_EXPONENTS = (4.0, 32.0, 256.0, 2048.0)
"""Exponents of the norms up to about the largest singular value: seven equal ones make the last 0.1 % too large."""
MAX_STEPS, MAX_STEP_LENGTH, MIN_STEP_SHARE = 60, 3.0, 1e-9
"""Maximum number of steps of log D, maximum step, and minimum share of a step in the line search."""
MAX_SPREAD = 60.0
"""Maximum spread of log D, which is unbounded for a loop without feedback."""
MIN_FALL, MIN_NORM = 1e-13, 1e-300
"""Thresholds below which a decrease of the norm, and a matrix, count as zero."""
BOUND_TOLERANCE = 1e-5
REFINED_POINTS = 25
"""Number of frequencies examined on either side of the smallest margin, in each of two refinements."""


class Margins(NamedTuple):
    """Margins of a closed loop; None if undefined.

    Attributes:
        gain: largest permitted factor on the loop's gain.
        gain_frequency: frequency of the swing at that gain (rad/s).
        reduction: smallest permitted factor on the gain, < 1.
        phase: rad.
        crossover: frequency of unit loop gain and of the phase margin (rad/s).
        sensitivity: M_s, largest |1/(1+L)|.
        complementary: M_t, largest |L/(1+L)|.
        bandwidth: lowest frequency with |L/(1+L)| below 1/sqrt(2) (rad/s).
        remark: reason for a missing number.
    """

    gain: float | None
    gain_frequency: float | None
    reduction: float | None
    phase: float | None
    crossover: float | None
    sensitivity: float
    complementary: float
    bandwidth: float | None
    remark: str = ""


def frequencies(period: float) -> Matrix:
    """Return the frequencies (rad/s) of the margins, up to nearly half the sampling rate, logarithmically spaced."""
    return np.geomspace(MIN_FREQUENCY, 0.999 * np.pi / period, GRID_POINTS)


def response(system: control.StateSpace, omega: Matrix) -> Complex:
    """Return the frequency response (n, outputs, inputs) of a sampled system at `omega` (rad/s)."""
    z = np.exp(1j * omega * system.dt)
    inner = np.linalg.solve(z[:, None, None] * np.eye(system.nstates) - system.A, system.B[None].astype(complex))
    return system.C @ inner + system.D


def loop_response(loops: Loops, gains: dict[str, float], name: str, omega: Matrix) -> Complex:
    """Return the loop gain L (n,) of one loop, opened at its law's output, others closed; 1 + L = 0 is critical."""
    others = closed_loops(loops, {loop: gain for loop, gain in gains.items() if loop != name})
    i = LOOPS.index(name)
    return -gains[name] * response(others[i, i], omega)[:, 0, 0]


def margins(loops: Loops, gains: dict[str, float], name: str) -> Margins:
    """Compute gain margin, phase margin, sensitivity and bandwidth of one loop of a stable system."""
    omega = frequencies(loops.dt)
    L = loop_response(loops, gains, name, omega)
    gain, phase, _, at_gain, at_phase, _ = control.stability_margins(control.frd(L, omega, smooth=True), returnall=True)
    more, less = np.flatnonzero((gain > 1.0) & (gain < LARGEST_GAIN)), np.flatnonzero(gain < 1.0)
    first = more[np.argmin(gain[more])] if len(more) else None
    last = less[np.argmax(gain[less])] if len(less) else None
    near = int(np.argmin(np.abs(phase))) if len(phase) else None
    T = np.abs(L / (1.0 + L))
    below = np.flatnonzero(T < HALF_POWER)
    found = Margins(
        gain=None if first is None else float(gain[first]),
        gain_frequency=None if first is None else float(at_gain[first]),
        reduction=None if last is None else float(gain[last]),
        phase=None if near is None else float(np.deg2rad(np.abs(phase[near]))),
        crossover=None if near is None else float(at_phase[near]),
        sensitivity=float(np.max(np.abs(1.0 / (1.0 + L)))),
        complementary=float(np.max(T)),
        bandwidth=float(omega[below[0]]) if len(below) and below[0] else None,
    )
    return _cross_check(loops, gains, name, found)


def _cross_check(loops: Loops, gains: dict[str, float], name: str, found: Margins) -> Margins:
    """Return the margins without their gain margin if the eigenvalues contradict it."""

    def stable(factor: float) -> bool:
        return spectral_radius(loops, {**gains, name: factor * gains[name]}) < 1.0

    if found.gain is None:
        agree = stable(LARGEST_GAIN)
    else:
        agree = stable(found.gain * (1.0 - MARGIN_TOLERANCE)) and not stable(found.gain * (1.0 + MARGIN_TOLERANCE))
    if agree:
        return found
    remark = "eigenvalues and frequency response disagree about the gain margin"
    return found._replace(gain=None, gain_frequency=None, reduction=None, remark=remark)


def worst_sensitivity(loops: Loops, gains: dict[str, float]) -> float:
    """Return the largest singular value, over all frequencies, of the sensitivity (1 + L)^-1 of all closed loops."""
    whole = sensitivity(loops, gains, [name for name in LOOPS if gains.get(name)], frequencies(loops.dt))
    return float(np.linalg.svd(whole, compute_uv=False).max())


def sensitivity(loops: Loops, gains: dict[str, float], breaks: Sequence[str], omega: Matrix) -> Complex:
    """Return the sensitivity (1 + L)^-1 (n, k, k) of loops opened at several points at once, input included."""
    closed = closed_loops(loops, gains)
    labels = closed.input_labels, closed.output_labels
    inputs, outputs = ([there.index(name) for name in breaks] for there in labels)
    back = np.array([gains.get(name, 1.0) for name in breaks])
    only = control.ss(closed.A, closed.B[:, inputs], closed.C[outputs], closed.D[np.ix_(outputs, inputs)], closed.dt)
    return np.eye(len(breaks)) + back[:, None] * response(only, omega)


def gain_limit(loops: Loops, gains: dict[str, float], names: tuple[str, ...]) -> float | None:
    """Return the largest common factor on some loops' gains that keeps the system stable, by eigenvalues.

    The factor is above 1 for a stable system and below 1 for a system that smaller gains stabilise; 0 if unstable down
    to 1 / `LARGEST_GAIN`; None if stable up to `LARGEST_GAIN`.
    """

    def stable(factor: float) -> bool:
        return spectral_radius(loops, gains | {name: factor * gains[name] for name in names}) < 1.0

    as_it_is = stable(1.0)
    last = LARGEST_GAIN if as_it_is else 1.0 / LARGEST_GAIN
    factors = np.geomspace(1.0, last, 100)
    turned = next((i for i, factor in enumerate(factors) if stable(factor) != as_it_is), None)
    if turned is None:
        return None if as_it_is else 0.0
    low, high = sorted(factors[turned - 1 : turned + 1])
    while high > low * 1.0001:
        middle = np.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(low)


class Pole(NamedTuple):
    """A pole of the closed loops: frequency omega (rad/s) and damping ratio zeta; zeta < 0 if it grows."""

    omega: float
    zeta: float


def poles(z: Complex, period: float) -> list[Pole]:
    """Convert poles in z (n,) except pure delays to `Pole`, slowest decay first, one per conjugate pair."""
    lasting = z[(np.abs(z) > 1e-6) & (z.imag >= 0.0)]
    s = np.log(lasting) / period
    # a pole at z = 1 neither grows nor decays; avoid a division by zero
    magnitude = np.maximum(np.abs(s), 1e-9)
    return [Pole(float(magnitude[i]), float(-s.real[i] / magnitude[i])) for i in np.argsort(-s.real)]


def scale_matrix(M: Complex, log_D: Matrix) -> Complex:
    """Return D M D^-1 of matrices M (..., k, k), for the logarithms (..., k) of the diagonal D."""
    return M * np.exp(log_D[..., :, None] - log_D[..., None, :])


def best_scaling(M: Complex, start: Matrix) -> Matrix:
    """Find the diagonal scaling log D (k,) that minimises the largest singular value of D M D^-1.

    The largest singular value is a convex function of log D with edges where singular values are equal; sums of their
    powers are smooth and approach it with the exponent (Schatten norms).
    """
    found = start
    for exponent in NORM_EXPONENTS:
        found = _minimise_norm(M, found, exponent)
    return found - found.mean()


def _norm(M: Complex, log_D: Matrix, exponent: float) -> tuple[float, Matrix]:
    """Return the logarithm of a Schatten norm of D M D^-1, and its derivatives (k,) by log D."""
    left, sizes, right = np.linalg.svd(scale_matrix(M, log_D))
    share = (sizes / max(sizes[0], MIN_NORM)) ** exponent
    total = share.sum()
    # d log(sigma_k) / d log D = |u_k|^2 - |v_k|^2
    slopes = np.abs(left.T) ** 2 - np.abs(right) ** 2
    return float(np.log(max(sizes[0], MIN_NORM)) + np.log(total) / exponent), share @ slopes / total


def _minimise_norm(M: Complex, log_D: Matrix, exponent: float) -> Matrix:
    """Find the scaling log D (k,) with the smallest norm of D M D^-1, by the BFGS method."""
    value, slope = _norm(M, log_D, exponent)
    inverse = np.eye(len(log_D))
    for _ in range(MAX_STEPS):
        way = -inverse @ slope
        fall = float(way @ slope)
        if fall > -MIN_FALL or np.ptp(log_D) > MAX_SPREAD:
            break
        length = min(1.0, MAX_STEP_LENGTH / np.abs(way).max())
        ahead = _norm(M, log_D + length * way, exponent)
        while ahead[0] > value + 0.1 * length * fall and length > MIN_STEP_SHARE:
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


def largest_mu(M: Complex) -> tuple[int, float]:
    """Return (index, bound) of the largest structured singular value in `M` (n, k, k); neighbours share a scaling."""
    bounds = np.linalg.svd(M, compute_uv=False)[:, 0]
    log_D, looked_at = np.zeros(M.shape[-1]), 0.0
    for _ in range(len(M)):
        which = int(np.argmax(bounds))
        if bounds[which] <= looked_at * (1.0 + BOUND_TOLERANCE):
            break
        log_D = best_scaling(M[which], log_D)
        bounds = np.minimum(bounds, np.linalg.svd(scale_matrix(M, log_D), compute_uv=False)[:, 0])
        looked_at = max(looked_at, float(bounds[which]))
    which = int(np.argmax(bounds))
    return which, float(bounds[which])


@dataclass(frozen=True)
class DiskMargin:
    """Disk margin: permitted gain and phase error of all loops at once, at the examined frequencies.

    Attributes:
        alpha: size of the disk; a lower bound for more than three loops.
        frequency: frequency of the swing at this error (rad/s).
    """

    alpha: float
    frequency: float

    @property
    def gain(self) -> float | None:
        """Permitted factor on, or divisor of, each loop's gain by the disk margin; None if unlimited."""
        return (2.0 + self.alpha) / (2.0 - self.alpha) if self.alpha < 2.0 else None

    @property
    def phase(self) -> float:
        """Permitted error of each loop's phase (rad) by the disk margin."""
        return float(2.0 * np.arctan(0.5 * self.alpha))

    JSON_KEYS = "alpha frequency gain phase"


def smallest_disk(S: Complex, skew: float = 0.0) -> tuple[int, float]:
    """Return (index, alpha) of the sensitivity matrix in `S` (n, k, k) with the smallest disk margin."""
    which, mu = largest_mu(S + 0.5 * (skew - 1.0) * np.eye(S.shape[-1]))
    return which, 1.0 / mu


def disk_margin(loops: Loops, gains: dict[str, float], breaks: Sequence[str]) -> DiskMargin:
    """Compute the disk margin of a stable system, with its loops opened at several points at once."""
    omega = frequencies(loops.dt)
    for _ in range(3):
        which, alpha = smallest_disk(sensitivity(loops, gains, breaks, omega))
        found = DiskMargin(alpha, float(omega[which]))
        low, high = omega[max(which - 1, 0)], omega[min(which + 1, len(omega) - 1)]
        omega = np.union1d(np.geomspace(low, high, 2 * REFINED_POINTS + 1), omega[which])
    return found
