"""A little off, in control theory or statistics, is out of bounds."""

import numpy as np
import pytest

from twin.studies.analyse.linear import margins as disk
from twin.studies.metrics import requirement as distance
from twin.studies.metrics import response as step
from twin.studies.sweep.statistics import ranking as claims
from twin.studies.sweep.statistics import sensitivity
from validation.yardstick import Yardstick
from validation.yardsticks import python_control, scipy_stats, temporal_logic


def worst(yardstick: Yardstick) -> float:
    return max(yardstick.differences().values())


def test_what_is_printed_of_disk_margins_holds_and_what_is_off_by_a_fiftieth_does_not(monkeypatch: pytest.MonkeyPatch):
    lag, satellite = python_control.YARDSTICKS[:2]
    for one in (lag, satellite):
        assert worst(one) <= one.bound
    right = disk.smallest_disk
    monkeypatch.setattr(disk, "smallest_disk", lambda S, skew=0.0: (0, 1.02 * right(S, skew)[1]))
    for one in (lag, satellite):
        assert worst(one) > one.bound


def test_a_loop_of_which_python_control_has_the_same_sensitivity_is_given_to_it():
    control = pytest.importorskip("control")
    from twin.studies.analyse.linear.loops import SPEED_COMMANDS
    from twin.studies.analyse.linear.margins import sensitivity

    at = python_control.pressing()
    breaks = (*at.gains, *SPEED_COMMANDS)
    omega = np.geomspace(1.0, 1000.0, 20)
    ours = sensitivity(at.loops, at.gains, breaks, omega)
    theirs = control.ss([], [], [], np.eye(len(breaks))).feedback(python_control.opened(breaks))
    found = np.moveaxis(theirs(np.exp(1j * omega * at.loops.dt)), -1, 0)
    # the same system by another way, rounded
    np.testing.assert_allclose(found, ours, atol=1e-8 * np.abs(ours).max())


@pytest.mark.slow
def test_times_and_sizes_of_steps_hold_and_other_definitions_do_not(monkeypatch: pytest.MonkeyPatch):
    times, sizes = python_control.YARDSTICKS[3:]
    assert worst(times) <= times.bound and worst(sizes) <= sizes.bound
    right = step.settling_time
    monkeypatch.setattr(step, "settling_time", lambda t, y, target, band: right(t, y, target, 1.05 * band))
    assert worst(times) > times.bound
    monkeypatch.setattr(step, "overshoot", lambda y, target: float(np.max(y)) - 0.9999 * target)
    assert worst(sizes) > sizes.bound


def test_indices_and_intervals_hold_and_others_do_not(monkeypatch: pytest.MonkeyPatch):
    published, scipys, newcombe = scipy_stats.YARDSTICKS
    for one in (published, scipys, newcombe):
        assert worst(one) <= one.bound
    right, interval = sensitivity.estimates, claims.wilson_interval
    monkeypatch.setattr(sensitivity, "estimates", lambda *f: tuple(1.05 * index for index in right(*f)))
    assert worst(published) > published.bound and worst(scipys) > scipys.bound
    monkeypatch.setattr(claims, "wilson_interval", lambda k, n: interval(k, n + 1))
    assert worst(newcombe) > newcombe.bound


def test_distances_of_temporal_logic_are_rtamts_and_others_are_not(monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("rtamt")
    (one,) = temporal_logic.YARDSTICKS
    assert worst(one) <= one.bound
    right = distance._largest
    monkeypatch.setattr(distance, "_largest", lambda x, first, last: right(x, first, last and last + 1))
    assert worst(one) > one.bound
