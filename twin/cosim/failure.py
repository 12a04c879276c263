"""Failures of components as sentences."""

import numpy as np

from twin.cosim.component import NOT_FINITE
from twin.cosim.port import by_port, named_values, width
from twin.cosim.system import System


def failed_phrase(system: System, u: np.ndarray, y: np.ndarray, culprit: int, status: int, tick: int) -> str:
    """What went wrong: component, function, simulated time and last inputs, without a full stop.

    Args:
        u, y: memory of all inputs, and of all outputs, as the master left them.
        culprit, status: as the master returned them.
        tick: the one at which it happened.
    """
    component = system.components[culprit]
    what = _not_finite(system, y, culprit) if status == NOT_FINITE else component.explain(status)
    label = f"{component.label} ({component.name})" if component.label else component.name
    inputs = named_values(component.inputs, u[system.u_start[culprit] : system.u_start[culprit + 1]]) or "none"
    when = f"t = {tick * system.tick:.6g} s, tick {tick}"
    where = f"at {when}" if component.sampled else f"in the step from {when}"
    return f"{label} {what} {where}. Last inputs: {inputs}"


def _not_finite(system: System, y: np.ndarray, culprit: int) -> str:
    component = system.components[culprit]
    start = int(system.y_start[culprit])
    if system.apart and not component.sampled:
        start += system.outputs_width
    outputs = y[start : start + width(component.outputs)]
    for name, values in by_port(component.outputs, outputs).items():
        if not np.all(np.isfinite(values)):
            bad = values[~np.isfinite(values)][0]
            return f"returned {'NaN' if np.isnan(bad) else 'infinity'} for {name}"
    raise AssertionError("the master reported a value that is not finite, and all are")
