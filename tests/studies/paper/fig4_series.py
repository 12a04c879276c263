"""Runs of Fig. 4 as they are meant to be, written by hand, with a flaw where a test wants one."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.kernel.recording.messages import Field
from twin.studies.metrics.response import Curve
from twin.studies.paper.fig4_measures import BEFORE_SWEEP, CURVE_PARTS, FINAL_WINDOW, SWEEP_WINDOW, Fig4Run, Fig4Runs

T = np.round(0.01 * np.arange(2001), 9)
ON = (T >= SWEEP_WINDOW[0]) & (T <= SWEEP_WINDOW[1])
AFTER = T > SWEEP_WINDOW[1]
HELD = T >= CURVE_PARTS[2][0]
Z_REF = np.interp(T, CURVE_PARTS[0], [-0.085, -0.105])


class WrittenSeries:
    """Series of one run, all at the same times `T` (s)."""

    def __init__(self, **series: NDArray[Any]):
        self.metadata: dict[str, dict[str, str]] = {}
        self._series = series

    def __getitem__(self, key: str) -> NDArray[Any]:
        return self._series[key.replace(".", "_")]

    def time(self, topic: str) -> Curve:
        return T

    def fields(self) -> dict[str, Field]:
        return {}


def written(
    F_z: Curve,
    z: Curve,
    z_cmd: Curve,
    scale: Curve,
    true_F_z: Curve,
    friction: tuple[float, float],
    trigger: float,
    flaws: dict[str, Any],
) -> Fig4Run:
    """One run. `friction`: F_x, F_y while sweeping (N). trigger: when (s)."""
    z_ref, y = Z_REF, np.interp(T, CURVE_PARTS[2], [0.020, -0.020])
    y = (
        y
        + flaws.get("y", 0.0)
        + flaws.get("y_before", 0.0) * (T <= BEFORE_SWEEP[1])
        + flaws.get("y_after", 0.0) * AFTER
    )
    # a wave of 1 s has no mean over 1 s; over 2 s it is fastest where it crosses zero: 1 s there goes 2 amplitudes
    y = y + flaws.get("wave", 0.0) * np.sin(np.pi * (T - SWEEP_WINDOW[0])) * ON
    if not flaws.get("sweeps", True):
        y = np.full_like(T, 0.020)
    x, zero = np.full_like(T, flaws.get("x", 0.0)), np.zeros_like(T)
    F_x, F_y = (force * ON for force in friction)
    return Fig4Run(
        WrittenSeries(
            controller_F_z=F_z,
            controller_F_z_ref=np.full_like(T, flaws.get("F_z_ref", 5.0)),
            controller_p_ref_B=np.column_stack([zero, y, z_ref + flaws.get("z_ref", 0.0) * ON]),
            controller_p_cmd_B=np.column_stack([zero, y, z_cmd + z_ref + flaws.get("z_ref", 0.0) * ON]),
            controller_triggered=T >= trigger,
            estimator_p_B=np.column_stack([x, y, z + flaws.get("z_ref", 0.0) * ON]),
            estimator_F_ee_B=np.column_stack([F_x, F_y, -F_z]),
            scale_F_z=scale,
            plant_p_B=np.column_stack([x, y, z_ref + flaws.get("z_ref", 0.0) * ON + flaws.get("true_z", 0.0) * ON]),
            plant_F_ee_B=np.column_stack([F_x, F_y, -true_F_z]),
        )
    )


def with_force(
    trigger: float = 5.6,
    F_trigger: float = 0.62,
    force: float = 0.0,
    fluctuation: tuple[float, float] = (13.7, 0.05),
    noise: Curve | float = 0.0,
    apart: float = 0.0,
    jump: float = 0.008,
    left: float = 0.0003,
    after: float = 0.0,
    faster: float = 3.0,
    above: float = 0.0003,
    z: float = 0.0001,
    bias: float = 0.1,
    touch: float = 0.0,
    peak: float = 0.0,
    true: float = -0.1,
    final: float = 4.9,
    friction: tuple[float, float] = (0.1, -1.1),
    **flaws: Any,
) -> Fig4Run:
    """With force control; forces in N, lengths in m.

    Args:
        force: mean error while sweeping; three quarters of it at most where the fluctuation is. fluctuation: when it
            is and how much the force goes up in it. noise: added while sweeping.
        apart: of the reference before the trigger. jump, after, left: of the reference at the trigger, how late it
            does (s), and what is left of it at the end. faster: factor of the platform's speed at the trigger.
        above, z: error of the height until the trigger, and from the sweep on. bias: of the estimate.
        touch: no true force before it (s). peak, true, final: true force at one instant, while sweeping less 5 N, and
            at the end.
    """
    held = np.interp(T, [12.0, 13.0, 14.8, 15.8], [1.0, 0.7, 0.7, 1.0])
    when, size = fluctuation
    F_z = np.interp(T, [trigger - 0.1, trigger, trigger + 0.4, trigger + 0.9], [0.0, F_trigger, 4.0, 5.0])
    F_z = F_z + ON * (force * held / np.mean(held[ON]) + size * np.where(when > T, -0.5, 0.5) + noise)
    jumped = np.where(trigger + after > T, 0.0, jump * np.exp(-(T - trigger - after) / 0.3))
    shift = np.where(trigger > T, -apart, jumped + left)
    before = max(trigger - 0.2, 0.0)
    last = float(np.interp(before, T, Z_REF)) + above
    way = [last, last - 0.0004, last - 0.0004 * (1.0 + faster), -0.105]
    height = np.interp(T, [before, before + 0.2, before + 0.4, before + 1.1], way)
    height = np.where(HELD, -0.105 + z, np.where(before > T, Z_REF + above, height))
    true_F_z = np.where(ON, 5.0 + true, np.where(FINAL_WINDOW[0] <= T, final, F_z - 0.1))
    true_F_z[1000] = 5.0 + peak
    true_F_z[touch > T] = 0.0
    return written(F_z, height, -shift, F_z - bias, true_F_z, friction, trigger, flaws)


def without_force(
    late: float = 1.2,
    force: float = 4.2,
    sag: float = 0.0,
    lag: float = 0.1,
    above: float = 0.0,
    swing: float = 0.0,
    z: float = 0.0004,
    bend: float = 0.0,
    wobble: float = 0.0,
    z_wobble: float = 0.0,
    friction: tuple[float, float] = (0.09, -1.0),
    **flaws: Any,
) -> Fig4Run:
    """Under position control alone; forces in N, lengths in m.

    Args:
        late: how much later it reaches 4 N (s). force: while sweeping. sag: how far it falls back before.
        lag, above, swing, z: of the height behind the pre-defined one on the way down (s), how far above it, with which
            amplitude it swings about it in the air, and its error from the arrival on.
        bend: how far the scale is off proportion at half of its way, as a share. wobble, z_wobble: range of the
            scale's reading and of the height while sweeping.
    """
    at_4_N = 6.0 + late
    F_z = np.where(
        ON, force, np.interp(T, [5.5, at_4_N, at_4_N + 0.2], [0.0, 4.0, 4.2]) - np.interp(T, [7.6, 8.6], [0.0, sag])
    )
    wave = 0.5 * np.sin(2.0 * np.pi * T)
    height = np.maximum(np.interp(T - lag, T, Z_REF) + above, -0.105 + z)
    height = height + swing * np.sin(2.0 * np.pi * T) * (T < 3.0)
    share = np.clip((-0.101 - height) / 0.0036, 0.0, 1.0)
    scale = 4.4 * (share + 4.0 * bend * share * (1.0 - share)) + ON * wobble * wave
    height = height + ON * z_wobble * wave
    return written(F_z, height, np.zeros_like(T), scale, F_z, friction, np.inf, flaws)


def runs(
    fp: dict[str, Any] | None = None,
    p: dict[str, Any] | None = None,
    x_fp: dict[str, Any] | None = None,
    x_p: dict[str, Any] | None = None,
    both: dict[str, Any] | None = None,
) -> Fig4Runs:
    """The four runs with flaws: of force-position, position only, the imperfect two, of all."""
    every = both or {}
    ideal = with_force(**(fp or {}), **every), without_force(**(p or {}), **every)
    return Fig4Runs(*ideal, (with_force(**(x_fp or {}), **every), without_force(**(x_p or {}), **every)))
