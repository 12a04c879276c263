"""Gains of the force loop over the stiffness that is estimated, without bumps.

Between two points of the table 1/gain is linear in the stiffness, because the gain that a loop bears falls with the
stiffness it sees. Where the estimate is poor, the gains go back to those of the experiment's file, the safe set. Both
the stiffness they are taken at and the share that the table has in them change no faster than a rate; but where the
estimate does not fit the force any more, the safe set is back in the same call. A change of kp moves the integral by
what the error makes of it, so that the output does not move (Åström and Hägglund 2006, Advanced PID Control, Sec. 9.4).

A change of the reference is fed forward: the tissue gives way by dF/k, and the springs deflect by dF/k_spring.
"""

from collections.abc import Sequence

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.cosim.port import record_of, state, states
from twin.kernel.settings import Values, setting_fields
from twin.robot.controller.pid import ForceLoop, ScheduledGains
from twin.robot.controller.tissue import Tissue


class SchedulePoint(Values, parts=(setting_fields(ScheduledGains),)):
    """Gains at a stiffness, SI."""


class Scheduling(
    Values,
    parts=(setting_fields(Tissue, "tolerance"), setting_fields(ForceLoop, "rate", "follow", "kp", "ki")),
    first="tolerance",
):
    """Settings, SI: up to which standard error over k_hat the estimate is trusted, and how gains follow; kp and ki are
    the safe set."""


POINT_RECORD = record_of(SchedulePoint)
SCHEDULE_RECORD = record_of(
    Scheduling, count="i8", segment=state("i8", below="count"), **states(at="f8", share="f8", F_ref="f8")
)
"""Settings and state: number of points, the segment last used, stiffness that the gains are taken at, share of the
table, last reference."""
_points_at = pointer_to(POINT_RECORD)


def schedule_table(points: Sequence[SchedulePoint]) -> np.ndarray:
    """The points as the compiled code takes them."""
    return np.array([tuple(point) for point in points], dtype=POINT_RECORD)


@njit(cache=True, error_model="numpy")
def gains_at(points, segment, k):
    """(kp, ki, segment) at the stiffness `k` (N/m); beyond the ends those of the end.

    Args:
        segment: any; pass the one returned last.
    """
    last = points.shape[0] - 1
    if k <= points[0].stiffness:
        return points[0].kp, points[0].ki, 0
    if k >= points[last].stiffness:
        return points[last].kp, points[last].ki, last - 1
    while k < points[segment].stiffness:
        segment -= 1
    while k > points[segment + 1].stiffness:
        segment += 1
    a, b = points[segment], points[segment + 1]
    share = (k - a.stiffness) / (b.stiffness - a.stiffness)
    rest = 1.0 - share
    return a.kp * b.kp / (rest * b.kp + share * a.kp), a.ki * b.ki / (rest * b.ki + share * a.ki), segment


@njit(cache=True, error_model="numpy")
def schedule_gains(m, table, tissue, pid, h):
    """Put the gains into the force loop `pid` that the `tissue` asks for.

    Args:
        table: address of the points.
    """
    if not tissue.pressing:
        m.share, pid.kp, pid.ki = 0.0, m.kp, m.ki
        return
    trusted = tissue.known and tissue.std <= m.tolerance * tissue.k
    step = m.rate * h
    if trusted:
        # what has no share yet may begin where it likes
        at = m.at if m.share > 0.0 else tissue.k
        m.at = min(max(tissue.k, at * (1.0 - step)), at * (1.0 + step))
    m.share = min(max(1.0 if trusted else 0.0, m.share - step), m.share + step)
    if tissue.std >= tissue.k:
        # nothing is known: not even of how wrong these gains are
        m.share = 0.0
    kp, ki = m.kp, m.ki
    if m.share > 0.0:
        kp, ki, m.segment = gains_at(carray(_points_at(table), m.count), m.segment, m.at)
        kp, ki = m.kp + m.share * (kp - m.kp), m.ki + m.share * (ki - m.ki)
    pid.integral += (pid.kp - kp) * pid.error
    pid.kp, pid.ki = kp, ki


@njit(cache=True, error_model="numpy")
def follow_reference(m, spring, pid, F_ref, pressing, h):
    """Rate (m/s) at which the motors have to go for the reference `F_ref` (N); the integral follows it."""
    change = F_ref - m.F_ref if pressing else 0.0
    m.F_ref = F_ref
    if m.share == 0.0 or change == 0.0:
        return 0.0
    change *= m.follow * m.share
    pid.integral += change / m.at
    return -change * (1.0 / m.at + 1.0 / spring) / h
