"""A swing of the reference while the tissue is not known well enough: a quiet press teaches `tissue` nothing."""

import math

from twin.compiled.function import njit
from twin.controller.tissue import HIGHEST, unlearn

LARGEST = 5e-4
"""Largest amplitude of the dither (m)."""


@njit(cache=True, error_model="numpy")
def dither(m, h):
    """(shift of the reference (m), its rate (m/s)) of this call; 0 where the tissue is known well enough."""
    if m.since == 0.0 or m.dither == 0.0:
        return 0.0, 0.0
    doubt = m.std / m.k if m.known else HIGHEST
    if not m.dithering and doubt > m.doubtful:
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
        if doubt < m.enough:
            m.dithering, m.phase = 0, 0.0
            return 0.0, 0.0
    # what is not known may be hard
    k = min(m.k + 2.0 * m.std, HIGHEST) if m.known else HIGHEST
    asked = min(m.dither * (1.0 / k + 1.0 / m.spring), LARGEST)
    least = m.dither * (1.0 / HIGHEST + 1.0 / m.spring)
    m.amplitude = min(max(m.growth * m.amplitude, least), asked)
    return m.amplitude * m.sine, m.amplitude * m.omega * m.cosine
