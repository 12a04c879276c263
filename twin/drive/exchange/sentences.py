"""What went wrong in a step of a model-exchange FMU, for people."""

from typing import Any

from twin.drive.exchange.memory import (
    CALLS,
    CALLS_3,
    ENDLESS_UPDATE,
    FAILED,
    INDICATOR_NOT_FINITE,
    MANY_EVENTS,
    MANY_STEPS,
    MOST_EVENTS,
    MOST_STEPS,
    NOT_FINITE,
    OTHER_SIZE,
    OVERFLOW,
    PAST_EVENT,
)
from twin.drive.status import MOST_UPDATES, STATUSES, TERMINATE

_FLAGS = {
    -3: "its error test fails again and again, however short the step",
    -4: "its iterations do not converge, however short the step",
    -22: "its input is not legal",
}


def sentence(m: Any, status: int) -> str:
    """The verb phrase for `status` of a step with the memory `m`; "" if it is not of model exchange alone."""
    prefix = f"fmi{m['version']}"
    if status // 16 * 16 in CALLS:
        start = status // 16 * 16
        name = CALLS_3.get(start, CALLS[start]) if m["version"] == 3 else CALLS[start]
        return f"{prefix}{name} returned {prefix}{STATUSES.get(status % 16, f' status {status % 16}')}"
    update = "fmi2NewDiscreteStates" if m["version"] == 2 else "fmi3UpdateDiscreteStates"
    now, asked, element = float(m["now"]), float(m["asked"]), int(m["element"])
    own = {
        NOT_FINITE: f"said NaN or infinity for derivative {element + 1} of {m['states']} at {asked:.9g} s",
        INDICATOR_NOT_FINITE: f"said NaN or infinity for event indicator {element + 1} of {m['indicators']}",
        ENDLESS_UPDATE: f"came to no end in an event at {now:.9g} s: {update} asked for more {MOST_UPDATES} times",
        MANY_EVENTS: f"made more than {MOST_EVENTS} events in one step, the last at {now:.9g} s; it may be flickering",
        TERMINATE: "asked to terminate the simulation",
        PAST_EVENT: f"asked at {now:.9g} s for a time event at {asked:.9g} s, which is past",
        OTHER_SIZE: f"has {element} continuous states after an event at {now:.9g} s, and had {m['states']}",
        OVERFLOW: "wrote more states, derivatives or event indicators than it says it has",
        MANY_STEPS: f"let the solver make {MOST_STEPS} steps within one, up to {now:.9g} s only",
        FAILED: f"let CVODE fail at {now:.9g} s: {_FLAGS.get(int(m['flag']), 'its code is ' + str(m['flag']))}",
    }
    return own.get(status, "")
