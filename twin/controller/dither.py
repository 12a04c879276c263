"""A swing of the reference while the tissue is not known well enough: a quiet press teaches `tissue` nothing.

It costs force, so it asks what there is to be gained (dual control; Åström and Wittenmark 1995, Adaptive Control, Ch.
7). While the reference rises it has its full force; while it stands still it hides beneath the force error that there
is, and rests where there is none, for gains would not improve it; while the reference falls it rests, for the press
is over before anything is learnt.
"""

import math

from twin.compiled.function import njit
from twin.controller.filter import state_variable
from twin.controller.tissue import HIGHEST, unlearn

LARGEST = 5e-4
"""Largest amplitude of the dither (m)."""
HIDDEN = 0.3
"""Amplitude of its force over the rms of the force error without it, at most, while the reference stands still."""
NOTCH = 2.0
"""1/Q of the notch at the dither's frequency: it is over in 1/(2 pi f), as fast as the force error of a quick loop."""
RESTING = 0.05
"""Share of its full force below which it rests."""


@njit(cache=True, error_model="numpy")
def dither(m, h, F, F_ref):
    """(shift of the reference (m), its rate (m/s)) of this call; 0 where the tissue is known well enough.

    Args:
        F, F_ref: pressing force and its reference (N).
    """
    change = F_ref - m.F_ref
    m.F_ref, m.leading = F_ref, change != 0.0
    if m.since == 0.0 or m.dither == 0.0:
        m.off, m.off_squared, m.notch.fast, m.notch.slow = F_ref - F, 0.0, 0.0, F_ref - F
        return 0.0, 0.0
    m.off += m.smoothing * (F_ref - F - m.off)
    _, band, _, m.notch.fast, m.notch.slow = state_variable(NOTCH, m.g, m.notch.fast, m.notch.slow, m.off)
    besides = m.off - NOTCH * band
    m.off_squared += m.averaging * (besides * besides - m.off_squared)
    force = m.dither
    if change < 0.0:
        force = 0.0
    elif change == 0.0:
        force = min(force, HIDDEN * math.sqrt(m.off_squared))
    doubt = m.std / m.k if m.known else HIGHEST
    if not m.dithering and doubt > m.doubtful and force > 2.0 * RESTING * m.dither:
        m.dithering, m.phase, m.sine, m.cosine, m.amplitude = 1, 0.0, 0.0, 1.0, 0.0
        unlearn(m)
    if not m.dithering:
        return 0.0, 0.0
    m.phase += m.omega * h
    # turned on from call to call: sine and cosine themselves would cost a sixth of all that happens here
    m.sine, m.cosine = (
        m.sine * m.turn_cosine + m.cosine * m.turn_sine,
        m.cosine * m.turn_cosine - m.sine * m.turn_sine,
    )
    # it ends with a whole swing
    if m.phase >= 2.0 * math.pi:
        m.phase -= 2.0 * math.pi
        if doubt < m.enough or force < RESTING * m.dither:
            m.dithering, m.phase = 0, 0.0
            return 0.0, 0.0
    # what is not known may be hard
    k = min(m.k + 2.0 * m.std, HIGHEST) if m.known else HIGHEST
    asked = min(force * (1.0 / k + 1.0 / m.spring), LARGEST)
    least = force * (1.0 / HIGHEST + 1.0 / m.spring)
    m.amplitude = min(max(m.growth * m.amplitude, least), asked)
    return m.amplitude * m.sine, m.amplitude * m.omega * m.cosine
