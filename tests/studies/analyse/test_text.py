"""Margins in the Bode plots, beside a loop whose margins are known in closed form."""

import math

import numpy as np
import pytest
from matplotlib.figure import Figure

from twin.studies.analyse.linear.margins import Margins
from twin.studies.analyse.pictures import _mark_margins
from twin.studies.analyse.text import decibels, margins_text

OMEGA = np.geomspace(0.01, 100.0, 2000)
L = 1.0 / (1j * OMEGA * (1.0 + 1j * OMEGA) ** 2)
"""1 / (s (1 + s)^2): the phase is -180 degrees at 1 rad/s, where |L| is 1/2."""
CROSSOVER = float(np.interp(0.0, -np.log(np.abs(L)), OMEGA))
MARGINS = Margins(2.0, 1.0, None, math.pi / 2.0 - 2.0 * math.atan(CROSSOVER), CROSSOVER, 1.0, 1.0, None)


@pytest.mark.parametrize("turns", [0.0, 360.0, -720.0])
def test_bars_reach_from_the_curves_to_1_and_to_minus_180_degrees_but_for_whole_turns(turns: float):
    magnitude, phase = Figure().subplots(2)
    degrees = np.unwrap(np.angle(L, deg=True), period=360.0) + turns
    _mark_margins(magnitude, phase, MARGINS, (OMEGA / (2.0 * np.pi), degrees), "k")
    (bar,) = magnitude.lines
    assert bar.get_xdata() == pytest.approx([0.5 / np.pi] * 2) and bar.get_ydata() == pytest.approx([0.5, 1.0])
    (bar,) = phase.lines
    assert bar.get_xdata() == pytest.approx([CROSSOVER / (2.0 * np.pi)] * 2)
    # what is interpolated between 2,000 frequencies
    assert bar.get_ydata()[0] == pytest.approx(-180.0 + turns, abs=0.01)


def test_margins_are_named_in_dB_and_degrees():
    assert margins_text(MARGINS) == ": 6 dB, 21 deg"
    assert margins_text(MARGINS._replace(gain=None)) == ": 21 deg"
    assert margins_text(MARGINS._replace(gain=None, phase=None)) == ""
    assert decibels([1.0, 10.0, 0.1]) == pytest.approx([0.0, 20.0, -20.0])
