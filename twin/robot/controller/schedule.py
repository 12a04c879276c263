"""Scheduling of the force loop's gains by the estimated stiffness, without bumps.

Between two points of the table 1/gain is linear in the stiffness, because a loop's largest stable gain falls with the
stiffness. If the estimate is poor, the gains return to the experiment's own, the safe set. Both the stiffness
of the lookup and the table's share in the gains are rate-limited; but if the estimate contradicts the force, the safe
set is restored in the same call. A change of kp shifts the integral by its effect on the error, so that the output
stays (Åström and Hägglund 2006, Advanced PID Control, Sec. 9.4).

A change of the reference is fed forward: the tissue yields by dF/k, and the springs deflect by dF/k_spring.
"""

from collections.abc import Sequence

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.cosim.port import record_of, state, states
from twin.kernel.settings import Values, setting_fields
from twin.robot.controller.pid import ForceLoop, ScheduledGains
from twin.robot.controller.tissue import Tissue


class SchedulePoint(Values, parts=(setting_fields(ScheduledGains),)):
    """Force loop gains on one tissue stiffness, SI."""


class Scheduling(
    Values,
    parts=(setting_fields(Tissue, "tolerance"), setting_fields(ForceLoop, "rate", "follow", "kp", "ki")),
    first="tolerance",
):
    """Settings of gain scheduling, SI: tolerated relative error of the stiffness, rates of change, safe gains."""


POINT_RECORD = record_of(SchedulePoint)
SCHEDULE_RECORD = record_of(
    Scheduling, count="i8", segment=state("i8", below="count"), **states(at="f8", share="f8", F_ref="f8")
)
"""Settings and state: number of points, last segment, stiffness of the lookup, share of the table, last reference."""
_points_at = pointer_to(POINT_RECORD)


def schedule_table(points: Sequence[SchedulePoint]) -> np.ndarray:
    """Convert the scheduled gains to an array for the compiled code."""
    return np.array([tuple(point) for point in points], dtype=POINT_RECORD)


@njit(cache=True, error_model="numpy")
def gains_at(points, segment, k):
    """Interpolate the scheduled gains at stiffness `k` (N/m), 1 / gain linearly; return (kp, ki, index of the segment).

    The gains are constant beyond the ends of the table. The search begins at any `segment`,
    such as the last result.
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
    """Set the force loop's gains for the estimated stiffness without a jump; `table`: address of the points."""
    if not tissue.pressing:
        m.share, pid.kp, pid.ki = 0.0, m.kp, m.ki
        return
    trusted = tissue.known and tissue.std <= m.tolerance * tissue.k
    step = m.rate * h
    if trusted:
        # without a share yet, the lookup may start anywhere
        at = m.at if m.share > 0.0 else tissue.k
        m.at = min(max(tissue.k, at * (1.0 - step)), at * (1.0 + step))
    m.share = min(max(1.0 if trusted else 0.0, m.share - step), m.share + step)
    if tissue.std >= tissue.k:
        # not even the error of these gains is known: the safe set at once
        m.share = 0.0
    kp, ki = m.kp, m.ki
    if m.share > 0.0:
        kp, ki, m.segment = gains_at(carray(_points_at(table), m.count), m.segment, m.at)
        kp, ki = m.kp + m.share * (kp - m.kp), m.ki + m.share * (ki - m.ki)
    pid.integral += (pid.kp - kp) * pid.error
    pid.kp, pid.ki = kp, ki


@njit(cache=True, error_model="numpy")
def follow_reference(m, spring, pid, F_ref, pressing, h):
    """Return the motors' feed-forward speed (m/s) for a changing force reference, and shift the loop's integral."""
    change = F_ref - m.F_ref if pressing else 0.0
    m.F_ref = F_ref
    if m.share == 0.0 or change == 0.0:
        return 0.0
    change *= m.follow * m.share
    pid.integral += change / m.at
    return -change * (1.0 / m.at + 1.0 / spring) / h
