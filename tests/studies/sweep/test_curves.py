"""Curves kept in a row."""

import json

import numpy as np
import pytest

from twin.studies.sweep.curves import PERIOD, packed, unpacked


def test_a_curve_comes_back_as_it_was_at_every_40_ms():
    t = np.linspace(0.0, 2.0, 2001)
    wave, step = np.sin(5.0 * t), np.where(t < 1.0, -0.105, 5.0)
    kept = json.loads(json.dumps(packed({"wave": (t, wave), "step": (t, step)}, 1.9)))
    times, values = unpacked(kept)
    assert times == pytest.approx(np.arange(48) * PERIOD)
    for name, curve in (("wave", wave), ("step", step)):
        # 32 bit floats have 24 bits: half of 2^-23 of a number up to 5
        assert values[name] == pytest.approx(np.interp(times, t, curve), abs=3e-7)


def test_curves_say_which_they_are_whatever_their_order():
    t = np.array([0.0, 1.0])
    one, other = (packed({name: (t, t * scale) for name, scale in pairs}, 1.0) for pairs in
                  ([("a", 1.0), ("b", 2.0)], [("b", 2.0), ("a", 1.0)]))  # fmt: skip
    assert unpacked(one)[1]["b"][-1] == unpacked(other)[1]["b"][-1] == 2.0


def test_the_same_curve_is_kept_in_the_same_bytes():
    t = np.linspace(0.0, 1.0, 11)
    assert packed({"a": (t, t**2)}, 1.0) == packed({"a": (t, t**2)}, 1.0)
