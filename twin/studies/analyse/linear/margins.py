"""Margins, sensitivity and bandwidth of a loop, from its frequency response and cross-checked by eigenvalues.

The frequency response is evaluated point by point and handed to python-control as data. Its margins of a state-space
loop go through a transfer function's coefficients, which rounding ruins with a dozen states near z = 1: for a stable
loop of this robot the gain margin came out as 0.9 where it is 90.
"""

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray

from twin.studies.analyse.linear.drive_model import Matrix
from twin.studies.analyse.linear.loops import Loops, closed_loops, spectral_radius
from twin.studies.analyse.linear.sampled_law import LOOPS

Complex = NDArray[np.complex128]

LOWEST = 0.02
"""rad/s. Two decades below the slowest loop."""
POINTS = 1500
TOLERANCE = 0.01
"""Relative. What eigenvalues and frequency response may differ by about a gain margin."""
LARGEST_GAIN = 1000.0
"""A gain that can be raised so far has no margin worth a number."""
HALF_POWER = 1.0 / np.sqrt(2.0)


class Margins(NamedTuple):
    """How far a closed loop is from instability; None where there is no such number.

    Attributes:
        gain: factor by which the loop's gain may grow.
        gain_frequency: of the swing it then has (rad/s).
        reduction: factor to which the gain may fall, < 1.
        phase: rad.
        crossover: frequency at which the loop's gain is 1 and the phase margin counts (rad/s).
        sensitivity: M_s, largest |1/(1+L)|.
        complementary: M_t, largest |L/(1+L)|.
        bandwidth: where |L/(1+L)| first falls below 1/sqrt(2) (rad/s).
        remark: why a number is missing.
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
    """Frequencies (rad/s) up to nearly half the sampling rate, evenly spaced over their logarithm."""
    return np.geomspace(LOWEST, 0.999 * np.pi / period, POINTS)


def response(system: control.StateSpace, omega: Matrix) -> Complex:
    """Frequency response (n, outputs, inputs) of a sampled `system` at `omega` (rad/s)."""
    z = np.exp(1j * omega * system.dt)
    inner = np.linalg.solve(z[:, None, None] * np.eye(system.nstates) - system.A, system.B[None].astype(complex))
    return system.C @ inner + system.D


def loop_response(loops: Loops, gains: dict[str, float], name: str, omega: Matrix) -> Complex:
    """L (n,) of one loop, opened at its law's output, the others closed with `gains`; 1 + L = 0 is critical."""
    others = closed_loops(loops, {loop: gain for loop, gain in gains.items() if loop != name})
    i = LOOPS.index(name)
    return -gains[name] * response(others[i, i], omega)[:, 0, 0]


def margins(loops: Loops, gains: dict[str, float], name: str) -> Margins:
    """Margins of the loop `name` of a system that is stable with all loops closed with `gains`."""
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
    return _confirmed(loops, gains, name, found)


def _confirmed(loops: Loops, gains: dict[str, float], name: str, found: Margins) -> Margins:
    """The margins if the eigenvalues agree with the gain margin, else without it."""

    def stable(factor: float) -> bool:
        return spectral_radius(loops, {**gains, name: factor * gains[name]}) < 1.0

    if found.gain is None:
        agree = stable(LARGEST_GAIN)
    else:
        agree = stable(found.gain * (1.0 - TOLERANCE)) and not stable(found.gain * (1.0 + TOLERANCE))
    if agree:
        return found
    remark = "eigenvalues and frequency response disagree about the gain margin"
    return found._replace(gain=None, gain_frequency=None, reduction=None, remark=remark)


def worst_sensitivity(loops: Loops, gains: dict[str, float]) -> float:
    """Largest singular value, over all frequencies, of the sensitivity (1 + L)^-1 of all closed loops at once."""
    whole = sensitivity(loops, gains, [name for name in LOOPS if gains.get(name)], frequencies(loops.dt))
    return float(np.linalg.svd(whole, compute_uv=False).max())


def sensitivity(loops: Loops, gains: dict[str, float], breaks: Sequence[str], omega: Matrix) -> Complex:
    """(1 + L)^-1 (n, k, k) of the loops opened at all `breaks` at once, some of `LOOPS` and `COMMANDS`.

    It is what becomes of something added there: with it, and with what comes back.
    """
    closed = closed_loops(loops, gains)
    labels = closed.input_labels, closed.output_labels
    inputs, outputs = ([there.index(name) for name in breaks] for there in labels)
    back = np.array([gains.get(name, 1.0) for name in breaks])
    only = control.ss(closed.A, closed.B[:, inputs], closed.C[outputs], closed.D[np.ix_(outputs, inputs)], closed.dt)
    return np.eye(len(breaks)) + back[:, None] * response(only, omega)


def gain_limit(loops: Loops, gains: dict[str, float], names: tuple[str, ...]) -> float | None:
    """Factor up to which the gains of all of `names` together keep the system stable, by eigenvalues.

    It is above 1 for a stable system and below 1 for one that smaller gains make stable; 0 if none do down to
    1 / `LARGEST_GAIN`; None if nothing happens up to `LARGEST_GAIN`.
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
    """A pole: magnitude omega (rad/s) and damping ratio zeta of s = ln(z) / period; zeta < 0: it grows."""

    omega: float
    zeta: float


def poles(z: Complex, period: float) -> list[Pole]:
    """`z` (n,) as poles of swings, slowest decay first; one of each conjugate pair; without those of pure delays."""
    lasting = z[(np.abs(z) > 1e-6) & (z.imag >= 0.0)]
    s = np.log(lasting) / period
    # a pole at z = 1, rounding aside, neither grows nor decays
    magnitude = np.maximum(np.abs(s), 1e-9)
    return [Pole(float(magnitude[i]), float(-s.real[i] / magnitude[i])) for i in np.argsort(-s.real)]
