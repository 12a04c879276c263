"""How an FMU is stepped: what it says of its steps, events and clocks, and which steps it takes."""

import math

from twin.drive.clocks import clocks, rhythm
from twin.drive.description import FmuDescription
from twin.drive.variable import number
from twin.errors import InputRefused

CLOSE = 1e-6
"""Of a step, by which a multiple of another one may miss it."""


def abilities(description: FmuDescription) -> list[tuple[str, str]]:
    """(what, how) of its stepping, for people; nothing of what every FMU does."""
    if description.kind == "model_exchange":
        return []
    said, its = [], description.model.coSimulation
    if not its.canHandleVariableCommunicationStepSize:
        stated = stated_step(description)
        wish = f"; it prefers {1e3 * stated:g} ms" if stated > 0.0 else ""
        said.append(("steps", f"steps of one size only{wish}"))
    if its.hasEventMode or description.returns_early:
        modes = ["event mode"] * its.hasEventMode + ["may return early"] * description.returns_early
        said.append(("events", ", ".join(modes)))
    said += [("clock", f"{clock.name}, {rhythm(clock)}") for clock in clocks(description)]
    within = its.providesIntermediateUpdate and any(v.intermediate for v in description.offered("input"))
    if its.canInterpolateInputs or within:
        said.append(("inputs", 'taken as lines over a step with [cosim] inputs = "linear"'))
    return said


def refuse_step(description: FmuDescription, tick: float, substeps: int) -> None:
    """See whether an FMU takes `substeps` equal steps per `tick` (s).

    FMI 3.0 says that steps should be multiples of fixedInternalStepSize; one that takes no other steps either is not
    asked for any. The step size that FMI 1.0 and 2.0 state is only the one that they would prefer.

    Raises:
        InputRefused: it has a fixed step of its own, takes no varying ones, and these are no multiples of it.
    """
    # the steps of its equations are ours
    if description.kind == "model_exchange":
        return
    abilities, step = description.model.coSimulation, tick / substeps
    fixed = number(abilities.fixedInternalStepSize)
    if description.version < 3 or abilities.canHandleVariableCommunicationStepSize or not 0.0 < fixed < math.inf:
        return
    count = step / fixed
    if round(count) >= 1 and abs(count - round(count)) < CLOSE:
        return
    whole = tick / fixed
    fitting = [n for n in range(1, 1001) if round(whole / n) >= 1 and abs(whole / n - round(whole / n)) < CLOSE]
    cure = f"substeps = {max(fitting)}" if fitting else f"tick_ms = {1e3 * fixed * max(1, math.ceil(whole)):g}"
    raise InputRefused(
        f"{description.path}: has a fixed step of {1e3 * fixed:g} ms inside and takes multiples of it only "
        f"(fixedInternalStepSize, canHandleVariableCommunicationStepSize); its step here is {1e3 * step:g} ms: "
        f"choose {cure}"
    )


def stated_step(description: FmuDescription) -> float:
    """The step that it has inside or prefers (s); NaN: it does not say."""
    fixed = number(description.model.coSimulation.fixedInternalStepSize)
    preferred = number(getattr(description.model.defaultExperiment, "stepSize", None))
    return preferred if math.isnan(fixed) else fixed
