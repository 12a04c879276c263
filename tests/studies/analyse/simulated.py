"""What the co-simulation itself says of steps and of limits of stability, to hold the linear analysis against."""

from collections.abc import Sequence

import numpy as np

from tests.laws.runs import EXACT_ENCODERS, EXPERIMENTS, co_simulated
from twin.kernel.errors import ComponentFailed
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.trace import Trace

LINEAR = (
    *EXACT_ENCODERS,
    "plant.backlash_deg=0",
    "controller.speed_limit_rad_per_s=1000",
    "controller.force.limit_mm=1000",
)
"""Overrides without which small signals drown in counts and backlash, or stop at a limit."""
RESTED = 6.0
"""Time (s) after which the platform no longer sags under the drives' droop."""
NUDGE = 1e-4
"""m. A step of the reference that no contact is lost by."""
SHAKING = 0.05
"""m/s. No nudge makes the platform that fast if it decays."""


def held(z: float) -> tuple[str, ...]:
    """Fig. 4's controller, holding the platform at (0, 20 mm, `z`), nudged in all directions when it is at rest."""
    rest, nudged = f"[0,20,{1e3 * z!r}]", f"[{1e3 * NUDGE!r},{20 + 1e3 * NUDGE!r},{1e3 * (z + NUDGE)!r}]"
    return (
        *LINEAR,
        f"reference.t_s=[0,{RESTED},{RESTED + 0.002}]",
        f"reference.p_mm=[{rest},{rest},{nudged}]",
        "controller.mode=position",
    )


AIR, PRESSING = held(-0.1), held(-0.105)
"""1 mm over the scale, and pressing with about 5 N."""


def pressing_with_force_loop(overrides: Sequence[str] = (), drive: str | None = None) -> tuple[str, ...]:
    """As `PRESSING`, but when it is nudged the force loop starts, with the force that is there as its reference."""
    rested = co_simulated(fig4([*PRESSING, *overrides], drive), RESTED - 0.01)
    F_z = float(rested["controller.F_z"][-1])
    return (
        *PRESSING,
        "controller.mode=force_position",
        f"controller.force.trigger_time_s={RESTED}",
        "controller.force.trigger_N=1000",
        f"controller.force.reference_N={F_z!r}",
    )


def fig4(overrides: Sequence[str], drive: str | None = None) -> Experiment:
    return load_experiment(EXPERIMENTS / "fig4_force_position.toml", overrides, drive)


def difference(base: Sequence[str], changed: Sequence[str], duration: float) -> tuple[Trace, Trace]:
    """The same run twice, the second with one more override, so that what both do falls out of the difference."""
    return co_simulated(fig4(base), duration), co_simulated(fig4([*base, *changed]), duration)


def grows(overrides: Sequence[str], drive: str | None, duration: float = 3.0) -> bool:
    """Whether the platform's speed after the nudge is larger late than before, or past `SHAKING`; a failure counts."""
    try:
        speed = co_simulated(fig4(overrides, drive), RESTED + duration)["plant.v_B"]
    except ComponentFailed:
        return True
    after = np.sum(speed**2, axis=1)[round(1e3 * RESTED) :]
    _, _, third, last = np.array_split(after, 4)
    return bool(np.mean(last) > min(np.mean(third), SHAKING**2))


def simulated_limit(
    base: Sequence[str],
    gains: dict[str, float],
    predicted: float,
    drive: str | None = None,
    spread: float = 1.3,
    within: float = 0.01,
) -> float:
    """The factor on `gains` (override key -> value) from which on a run grows, bisected around `predicted`.

    Infinity or 0 if it is not between `predicted` / `spread` and `predicted` * `spread`.
    """

    def unstable(factor: float) -> bool:
        changed = [f"{key}={factor * value!r}" for key, value in gains.items()]
        return grows([*base, *changed], drive)

    low, high = predicted / spread, predicted * spread
    if unstable(low):
        return 0.0
    if not unstable(high):
        return np.inf
    while high > (1.0 + within) * low:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if unstable(middle) else (middle, high)
    return float(np.sqrt(low * high))
