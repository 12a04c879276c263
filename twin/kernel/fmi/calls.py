"""FMI functions: called by address from compiled code, announced where Python calls them, and what they return."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from twin.kernel.compiled.function import c, intrinsic, ir, types

Listener = Callable[[str, str, str], None]
_listeners: list[Listener] = []


def listen(listener: Listener) -> None:
    """From now on tell `listener` (file, instance, function) before each call; function "" when it has returned.

    A call may crash or never return; then only somebody outside this process can say which one it was, if told before.
    Steps are not announced: they would cost more than they take (see `SimulationMemory.mark`).
    """
    _listeners.append(listener)


@contextmanager
def announced(file: str, instance: str, function: str) -> Iterator[None]:
    """Around a call of `function`."""
    for listener in _listeners:
        listener(file, instance, function)
    try:
        yield
    finally:
        for listener in _listeners:
            listener(file, instance, "")


_KINDS = {
    "pointer": ("int64", "pointer"),
    "double": ("float64", "f64"),
    "size": ("int64", "i64"),
    "int": ("int64", "i32"),
    "byte": ("int64", "i8"),
}
"""What numba and LLVM call it."""


def foreign(*kinds: str, returns: str = "int") -> Any:
    """A compiled function (address, (arguments)) that calls the C function at that address.

    Args:
        kinds: of its arguments: "pointer", "double", "size" (64 bit), "int" (32 bit), "byte".
        returns: "int" or "pointer".
    """

    @intrinsic
    def call(typingctx, function, arguments):
        result = types.int32 if returns == "int" else types.int64
        native = [getattr(c, _KINDS[kind][1]) for kind in kinds]

        def codegen(context, builder, _, given):
            target = ir.FunctionType(getattr(c, _KINDS[returns][1]), native).as_pointer()
            passed = []
            for i, kind in enumerate(kinds):
                value = builder.extract_value(given[1], i)
                if kind == "pointer":
                    value = builder.inttoptr(value, c.pointer)
                elif kind in ("int", "byte"):
                    value = builder.trunc(value, native[i])
                passed.append(value)
            returned = builder.call(builder.inttoptr(given[0], target), passed)
            return builder.ptrtoint(returned, c.i64) if returns == "pointer" else returned

        return result(types.int64, types.Tuple([getattr(types, _KINDS[kind][0]) for kind in kinds])), codegen

    return call


access_2 = foreign("pointer", "pointer", "size", "pointer")
"""`fmi2SetX|fmi2GetX(c, vr, nvr, values)`, those of FMI 1.0, `fmi3SetClock|fmi3GetClock`."""
access_3 = foreign("pointer", "pointer", "size", "pointer", "size")
"""`fmi3SetX|fmi3GetX(instance, vr, nvr, values, nValues)`."""
access_pairs = foreign("pointer", "pointer", "size", "pointer", "pointer")
"""`fmi2SetRealInputDerivatives(c, vr, nvr, orders, values)`, `fmi3GetIntervalDecimal(.., intervals, qualifiers)`."""
do_step_2 = foreign("pointer", "double", "double", "int")
"""`fmi2DoStep(c, t, h, final)`; `final`: no state will ever be restored to a time before `t`.

In FMI 1.0 the last argument is a char that says that the step is a new one; it is passed in the same way.
"""
do_step_3 = foreign("pointer", "double", "double", "byte", "pointer", "pointer", "pointer", "pointer")
"""`fmi3DoStep(instance, t, h, final, &event, &terminate, &early, &lastTime)`."""
ask_status = foreign("pointer", "int", "pointer")
"""`fmi2GetRealStatus|fmi2GetBooleanStatus(c, kind, value)`."""
plain = foreign("pointer")
"""`fmiNEnterEventMode(c)`, `fmi3EnterStepMode(c)`, `fmiNEnterContinuousTimeMode(c)`."""
update_3 = foreign("pointer", "pointer", "pointer", "pointer", "pointer", "pointer", "pointer")
"""`fmi3UpdateDiscreteStates(c, five flags, next time)`."""
on_pointer = foreign("pointer", "pointer")
"""`fmiNGetFMUState(c, state)`, `fmi2NewDiscreteStates(c, info)`, `fmi3GetNumberOfContinuousStates(c, n)`."""
at_time = foreign("pointer", "double")
"""`fmiNSetTime(c, t)`, `CVodeSetStopTime(memory, t)`."""
on_doubles = foreign("pointer", "pointer", "size")
"""`fmiNSetContinuousStates(c, x, n)` and all other functions of states, derivatives and event indicators."""
completed_2 = foreign("pointer", "int", "pointer", "pointer")
completed_3 = foreign("pointer", "byte", "pointer", "pointer")
"""`fmiNCompletedIntegratorStep(c, noSetFMUStatePriorToCurrentPoint, enterEventMode, terminateSimulation)`."""
start_at = foreign("pointer", "double", "pointer")
"""`CVodeReInit(memory, t, x)`, `CVodeSVtolerances(memory, relative, absolute)`."""
one_step = foreign("pointer", "double", "pointer", "pointer", "int")
"""`CVode(memory, t_out, x, t_reached, task)`."""
values_of = foreign("pointer", returns="pointer")
"""`N_VGetArrayPointer(vector)`."""

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


def explain_status(status: int, prefix: str, functions: dict[int, str], value: float, clock: str, said: str) -> str:
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
