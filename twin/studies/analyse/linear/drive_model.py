"""A drive as a linear model per tick, fitted to its frequency response.

What is fitted is the shaft's advance per tick, w(k) = theta_m(k+1) - theta_m(k), over the command omega_ref(k) and the
load tau_load(k), both held over the tick. The angle itself has a pole at z = 1 that every drive has and no fit shall
have to find.

The fit is rational, both transfer functions over one denominator, by the iteration of Sanathanan and Koerner (1963,
IEEE Trans Autom Control 8:56). Its variable is not z but

    lambda = (z - p) / (1 - p z),  p = exp(-2 pi f_p tick):

an all-pass map that keeps the unit circle and spreads the frequencies around f_p over it (Wahlberg 1991, IEEE Trans
Autom Control 36:551), because in z a slow drive's poles crowd at 1 and the equations become ill-conditioned.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused

Matrix = NDArray[np.float64]

CENTRE = 20.0
"""f_p (Hz): near the bandwidth of drives and loops."""

MOST_STATES = 8
GOOD = 0.003
"""Residual with which no more states are tried, if the measurement is certain."""
NOTHING = 1e-9
"""Speed per commanded speed of a shaft that stands still but for rounding."""
WORST = 0.3
"""Residual beyond which there is no linear model to speak of."""
ITERATIONS = 12
VANISHED = 1e-9
"""Of the largest: rounding is all that is left of a denominator there."""


@dataclass(frozen=True)
class DriveModel:
    """x(k+1) = A x + B u, theta_m(k+1) - theta_m(k) = C x + D u with u = (omega_ref, tau_load) of the tick, SI.

    Attributes:
        A, B, C, D: (n, n), (n, 2), (1, n), (1, 2); n may be 0.
        residual: rms distance of the model from the measured response, the command's or the load's, whichever is worse.
            It is relative to the response at each frequency, to a tenth of the largest, or to ten times the
            measurement's uncertainty, whichever is largest.
        turning: it was measured while the shaft turned, because at rest it does not answer in proportion.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    residual: float = 0.0
    turning: bool = False

    @property
    def steady_gain(self) -> Matrix:
        """Advance per tick (2,) for a constant command and a constant load, rad per rad/s and rad per N m."""
        return (self.D + self.C @ np.linalg.solve(np.eye(len(self.A)) - self.A, self.B))[0]

    def response(self, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Transfer functions (n, 2) at the points `z` (n,)."""
        states = np.eye(len(self.A))
        return np.array([(self.D + self.C @ np.linalg.solve(point * states - self.A, self.B))[0] for point in z])


def fitted_drive(
    frequencies: Matrix, response: NDArray[np.complex128], uncertainty: Matrix, tick: float, label: str
) -> DriveModel:
    """The smallest stable model that is close to a measured response.

    Args:
        frequencies: Hz (n,), below half the rate of ticks; 0 for the steady gain.
        response: (n, 2), advance per tick over omega_ref (rad per rad/s) and tau_load (rad per N m).
        uncertainty: standard deviation of `response` (n, 2).
        tick: s.
        label: what an error calls the drive.

    Raises:
        InputRefused: no stable model comes close: the drive does not answer in proportion.
    """
    z = np.exp(2j * np.pi * tick * frequencies)
    p = np.exp(-2.0 * np.pi * CENTRE * tick)
    size = np.abs(response)
    if not size[:, 0].max() > NOTHING * tick:
        raise InputRefused(
            f"{label}: no linear model describes it: its shaft does not respond to small commands; "
            "see `twin drive check`"
        )
    # a drive that no load can move has nothing to be relative to
    largest = np.maximum(size.max(axis=0), 1e-9 * size.max())
    weight = 1.0 / np.maximum(np.maximum(size, 0.1 * largest), 10.0 * uncertainty)
    # a model that is as close as the measurement is certain needs no more states
    enough = GOOD + np.sqrt(np.mean((uncertainty * weight) ** 2, axis=0)).max()
    best: DriveModel | None = None
    for states in range(MOST_STATES + 1):
        model = _realised(*_rational_fit((z - p) / (1.0 - p * z), response, weight, states), p)
        if states and np.abs(np.linalg.eigvals(model.A)).max() >= 1.0:
            continue
        distance = np.abs(model.response(z) - response) * weight
        residual = float(np.sqrt(np.mean(distance**2, axis=0)).max())
        if best is None or residual < 0.7 * best.residual:
            best = DriveModel(model.A, model.B, model.C, model.D, residual)
        if best.residual < enough:
            break
    if best is None or best.residual > WORST:
        worst = best.residual if best else 1.0
        raise InputRefused(
            f"{label}: no linear model describes it: the best misses its measured frequency response by {worst:.0%}, "
            f"expected at most {WORST:.0%}. Its response to small signals is not linear; simulate instead (twin run)"
        )
    return best


def _rational_fit(
    variable: NDArray[np.complex128], response: NDArray[np.complex128], weight: Matrix, states: int
) -> tuple[Matrix, Matrix]:
    """(denominator (states + 1,) with 1 first, numerators (states + 1, 2)): polynomials in 1 / `variable`."""
    powers = (1.0 / variable)[:, None] ** np.arange(states + 1)
    denominator = np.ones(len(variable), dtype=complex)
    for _ in range(ITERATIONS if states else 1):
        # a denominator may vanish at a line: where only the steady gain is answered, a pole lies on it
        scale = weight / np.maximum(np.abs(denominator), VANISHED * np.abs(denominator).max())[:, None]
        blocks, right = [], []
        for channel in range(2):
            numerator = np.zeros((len(variable), 2 * (states + 1)), dtype=complex)
            numerator[:, channel * (states + 1) : (channel + 1) * (states + 1)] = powers
            rows = np.hstack([numerator, -response[:, [channel]] * powers[:, 1:]]) * scale[:, [channel]]
            blocks += [rows.real, rows.imag]
            target = response[:, channel] * scale[:, channel]
            right += [target.real, target.imag]
        found = np.linalg.lstsq(np.vstack(blocks), np.concatenate(right), rcond=None)[0]
        coefficients = np.concatenate([[1.0], found[2 * (states + 1) :]])
        denominator = powers @ coefficients
    return coefficients, found[: 2 * (states + 1)].reshape(2, states + 1).T


def _realised(denominator: Matrix, numerators: Matrix, p: float) -> DriveModel:
    """The polynomials in 1/lambda as a state-space model in z.

    In lambda it is the observer form; with A, B, C, D there, (lambda 1 - A)^-1 = (1 - p z)(z 1 - A_z)^-1 (1 + p A)^-1
    for A_z = (1 + p A)^-1 (A + p 1), and (1 - p z)(z 1 - A_z)^-1 = -p 1 + (1 - p A_z)(z 1 - A_z)^-1.
    """
    n = len(denominator) - 1
    A = np.eye(n, k=1)
    A[:, :1] = -denominator[1:, None]
    D = numerators[:1]
    B = numerators[1:] - denominator[1:, None] * D
    C = np.eye(1, n)
    turned = np.linalg.inv(np.eye(n) + p * A)
    A_z = turned @ (A + p * np.eye(n))
    return DriveModel(A_z, turned @ B, C @ (np.eye(n) - p * A_z), D - p * C @ turned @ B)
