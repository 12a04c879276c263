"""Estimation of breathing under the head: an oscillator locks to it, and its velocity is fed forward.

While pressing, the surface moves at v_0 = dz/dt + (dF/dt)/k. The oscillator follows it as a second-order generalised
integrator with a frequency-locked loop (Rodriguez et al. 2011, IEEE Trans. Ind. Electron. 58:127),

    e = v_0 - x,   dx/dt = w (g e - q),   dq/dt = w x,   dw/dt = -f w e q w/(x^2 + q^2),

with the velocity x, its value q a quarter of a breath before, and the rate w. It models one sine, without a shape:
motion at the rate of the breath passes unchanged, all other motion of the surface is attenuated and phase-shifted.
"""

import math

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.port import record_of, states
from twin.kernel.settings import Settings, fields_of_form, setting
from twin.robot.controller.pid import low_pass_share

OSCILLATOR_GAIN, RATE_GAIN = 2.5, 0.3
"""Gains g and f of the equations above: settling within a quarter of a breath; rate within some percent after two."""
VELOCITY_CORNER = 3.0
"""Low-pass corner (Hz) of the velocity, which is a difference of two rounded values; its lag is compensated."""
MIN_RATE_RATIO, MAX_RATE_RATIO = 0.5, 2.0
"""Bounds of the rate relative to its initial value."""
MIN_BREATH_VELOCITY = 1e-4
"""Minimum speed (m/s) of the surface for tracking the rate; slower than any breathing."""
MAX_STIFFNESS_ERROR = 0.4
"""Maximum standard error, relative to k_hat, for feeding the breath forward."""


class Breath(Settings):
    """[controller.breath]: follow a surface that breathes, with the tissue known by [controller.tissue]."""

    rate: float = setting(
        "1/min", default=15.0, gt=0, le=120, help="believed initial rate; rates from half to twice of it are followed"
    )
    lag: float = setting("ms", default=20.0, ge=0, le=1000, help="believed lag of the robot behind its reference")


BREATH_RECORD = record_of(
    Breath,
    **states(**fields_of_form("f8", "omega x q v share z F"), running="i8", **fields_of_form("f8", "low ahead")),
)
"""Settings and state. omega .. q: the oscillator. v: low-passed velocity of the surface. share: share that is fed
forward. z, F, running: height and force of the previous call, and whether it exists. low: share of the low-pass. ahead:
prediction time (s)."""


@njit(cache=True)
def _advance_oscillator(m, v, h):
    """Advance the breathing oscillator by one call with the measured surface velocity `v` (m/s)."""
    e, squared, before = v - m.x, m.x * m.x + m.q * m.q, m.q
    step = m.omega * h
    m.q += step * m.x
    m.x += step * (OSCILLATOR_GAIN * e - m.q)
    if squared > MIN_BREATH_VELOCITY * MIN_BREATH_VELOCITY:
        first = 2.0 * math.pi * m.rate
        # the previous state: the new one contains the noise of e itself
        turned = m.omega * (1.0 - RATE_GAIN * step * e * before / squared)
        m.omega = min(max(turned, MIN_RATE_RATIO * first), MAX_RATE_RATIO * first)


@njit(cache=True, error_model="numpy")
def breath_velocity(m, tissue, h, z, F):
    """Estimate the velocity (m/s) of the breathing surface that the controller feeds forward.

    It is predicted by the robot's lag and weighted by the confidence in the breath. `z` and `F` are the estimated
    height (m) and pressing force (N), unfiltered.
    """
    if m.omega == 0.0:
        m.omega, m.low = 2.0 * math.pi * m.rate, low_pass_share(VELOCITY_CORNER, h)
        m.ahead = m.lag + h * (1.0 - m.low) / m.low
    if not tissue.known or tissue.since == 0.0 or not tissue.pressing:
        m.running, m.share = 0, 0.0
        return 0.0
    if not m.running:
        m.running, m.z, m.F, m.x, m.q, m.v = 1, z, F, 0.0, 0.0, 0.0
    m.v += m.low * ((z - m.z + (F - m.F) / tissue.k) / h - m.v)
    m.z, m.F = z, F
    _advance_oscillator(m, m.v, h)
    trusted = tissue.std < MAX_STIFFNESS_ERROR * tissue.k
    m.share = min(m.share + m.omega * h, 1.0) if trusted else max(m.share - m.omega * h, 0.0)
    # the prediction is a fraction of a rad, so a Taylor series is enough
    ahead = m.omega * m.ahead
    return m.share * (m.x * (1.0 - 0.5 * ahead * ahead) - m.q * ahead)
