"""What a step of an FMU says when it is bad, and the sentences for it."""

SET, DO_STEP, GET, TERMINATE, SAVE, RESTORE = 16, 32, 48, 64, 80, 96
EVENT_MODE, UPDATE, STEP_MODE, SET_CLOCK, GET_CLOCK, INTERVAL, DERIVATIVES = 256, 272, 288, 304, 320, 336, 352
"""What a bad status starts with: the function that returned the rest of it."""

EARLY, OUTSIDE, STALLED, TOO_MANY, ENDLESS, PAST, PERIOD, STUCK = 512, 513, 514, 515, 516, 517, 518, 519
"""What an FMU did that no function of it calls bad."""

DISCARD = 2
STATUSES = {2: "Discard", 3: "Error", 4: "Fatal", 5: "Pending"}

SHORTENED = 10
"""How often a step is halved without any progress before the FMU is believed to be stuck."""

MOST_STEPS = 10_000
"""Parts of one step."""

MOST_STALLS = 100
"""Events and early returns at one and the same time."""

MOST_UPDATES = 1000
"""Updates of discrete states in one event."""

FUNCTIONS = {
    SET: "Set", DO_STEP: "DoStep", GET: "Get", EVENT_MODE: "EnterEventMode", UPDATE: "UpdateDiscreteStates",
    STEP_MODE: "EnterStepMode", SET_CLOCK: "SetClock", GET_CLOCK: "GetClock", INTERVAL: "GetIntervalDecimal",
    DERIVATIVES: "SetRealInputDerivatives",
}  # fmt: skip


def told(status: int, prefix: str, functions: dict[int, str], value: float, clock: str, said: str) -> str:
    """What a bad `status` means, as the verb phrase of a sentence.

    Args:
        status: of a step.
        prefix: of the standard's names.
        functions: more of them, by what a status starts with.
        value: what the FMU told when it went wrong, a time or an interval (s).
        clock: name of the clock it was about.
        said: what it logged last.
    """
    step, update = f"{prefix}DoStep", f"{prefix}UpdateDiscreteStates"
    sentences = {
        TERMINATE: f"{step} asked to terminate the simulation{said}",
        EARLY: f"{step} returned early although its description does not say that it might{said}; export it again",
        OUTSIDE: f"{step} says that it went on until t = {value:.9g} s, which lies outside of this step{said}",
        STALLED: f"{step} stays at t = {value:.9g} s{said}: more than {MOST_STALLS} events or early returns there",
        STUCK: f"{step} returned {prefix}Discard{said} and stays at t = {value:.9g} s, however short its steps",
        TOO_MANY: f"{step} takes more than {MOST_STEPS} parts for this step, and is at t = {value:.9g} s{said}",
        ENDLESS: f"{update} wants to be called for ever: more than {MOST_UPDATES} times in one event{said}",
        PAST: f"{update} plans its next event for t = {value:.9g} s, which has passed or is no time{said}",
        PERIOD: f"{prefix}GetIntervalDecimal says that clock '{clock}' ticks after {value:.9g} s{said}; "
        "expected a whole number of steps: choose a tick or substeps that fit",
    }
    if status in sentences:
        return sentences[status]
    called = (FUNCTIONS | functions)[status // 16 * 16]
    code = STATUSES.get(status % 16, f" status {status % 16}")
    return f"{prefix}{called} returned {prefix}{code}{said}"
