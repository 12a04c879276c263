"""How a drive follows a step of its command."""

import numpy as np

from twin.studies.metrics.response import overshoot, rise_time, settling_time
from twin.studies.qualify.bench import Response
from twin.studies.qualify.definitions import Finding, Measure
from twin.studies.qualify.operating_range import SPEED_IN_USE
from twin.studies.qualify.work_cycle import AVERAGE, COMMANDED, LOADED

BAND = 0.05
"""Share of the final speed within which a drive has settled."""


ROUNDING = 1e-9
"""rad/s. Of a mean speed."""


def step_findings(cycle: Response) -> list[Finding]:
    """Measures `ripple`, `rise_time`, `settling_time` and `overshoot`, from the work cycle's first step."""
    final = cycle.mean_speed(LOADED - AVERAGE, LOADED)
    steady = cycle.omega_m[cycle.window(LOADED - AVERAGE, LOADED)]
    ripple = float(np.max(np.abs(steady - np.mean(steady))))
    if final < BAND * SPEED_IN_USE:
        still = "does not turn forward"
        return [Measure(name, None, still) for name in ("ripple", "rise_time", "settling_time", "overshoot")]
    after = cycle.window(COMMANDED, LOADED)
    t, omega_m = cycle.t[after] - COMMANDED, cycle.omega_m[after]
    rise = rise_time(t, omega_m, 0.0, final)
    hidden = f"hidden by a ripple of {ripple / final:.0%}" if ripple > BAND * final else ""
    peak = overshoot(omega_m, final)
    seen = peak if peak * final > 1.05 * ripple + ROUNDING else 0.0
    settled = settling_time(t, omega_m, final, BAND * final)
    return [
        Measure("ripple", ripple),
        _in_time("rise_time", rise, "within one tick" if rise == 0.0 else ""),
        Measure("settling_time", None, hidden) if hidden else _in_time("settling_time", settled),
        Measure("overshoot", None if hidden else 100.0 * seen, hidden),
    ]


def _in_time(name: str, value: float, remark: str = "") -> Measure:
    """A measure of time (s) if the speed ever came so far."""
    return Measure(name, value, remark) if np.isfinite(value) else Measure(name, None, "omega_m does not get there")
