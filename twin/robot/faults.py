"""Fault components, inserted into wires or before parameters; they know no other part and no experiment.

Each counts its own ticks. A command fault limits the command right before the drive; a parameter fault writes a
constant in the memory of another component; shafts that a drive does not turn are in `twin.robot.shaft`.

A count fault replaces one element of an encoder's counts for every reader. A message fault delays or drops the outputs
of a sender's period; a message that is overtaken by a later one is dropped, so readers never go back in time. Random
numbers come from SplitMix64, whose state fits into a component's memory: the same seed gives the same bytes. Steele,
Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014, with the constants of Vigna's public-domain
splitmix64.c.
"""

from collections.abc import Mapping
from dataclasses import replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.cosim.component import Component, NativeComponent, doubles_at, step_function
from twin.kernel.cosim.port import Port, memory_of, record, state, states, width
from twin.kernel.settings import fields_of_form

WINDOW_RECORD = record(next=state("i8"), period="i8", onset="i8", end="i8")
"""Tick of the next step, ticks between steps, first active tick, first healthy tick after it."""

ACTIVE_PORT = Port("active", 1, "1", "whether the fault is active", "bool")
COMMAND_MEMORY = record(window=WINDOW_RECORD, size="i8", limit="f8")
POWER_PORT = Port("power", 1, "1", "whether the drives may have power", "bool")
POWER_MEMORY = record(window=WINDOW_RECORD, lines="i8")
GATE_MEMORY = record(size="i8")
VALUE_PORT = Port("value", 1, "SI", "the parameter as it holds now")
PARAMETER_MEMORY = record(
    window=WINDOW_RECORD, address="i8", nominal="f8", chained="i8", factor="f8", added="f8", ramp="i8"
)
"""`chained`: another fault writes to the same address before; its result is the nominal value of this one."""
_GAMMA, _MIX_1, _MIX_2 = (np.uint64(n) for n in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))
_UNIT_STEP = 2.0**-53
ENCODER_CHANNELS = 3
COUNT_PORT = Port("count", ENCODER_CHANNELS, "1", "counts of the motor or of the joint encoders")
COUNT_MEMORY = record(
    window=WINDOW_RECORD,
    **fields_of_form("i8", "law element partner"),
    **fields_of_form("f8", "counts share"),
    **states(held="f8", spiked="i8", random="u8"),
)
"""`counts`: magnitude in counts, per tick for a drift. `held`: last count that passed."""
NEVER_TICK = 1 << 62
"""Arrival tick of a lost message."""
MESSAGE_MEMORY = record(
    window=WINDOW_RECORD,
    **fields_of_form("i8", "size sender_period least most blank"),
    share="f8",
    sent=state("i8"),
    capacity="i8",
    **states(**fields_of_form("i8", "messages arrivals present lost"), random="u8"),
)
"""A message takes `least` to `most` ticks; a `share` of them is lost. `blank`: readers get zeros after a lost message
until the next one, while `lost` is set. `sent`: number of messages since the onset; message n is stored at n modulo
`capacity` in the rings `messages` and `arrivals` (ticks), which hold all messages under way. `present`: message that
readers get."""


class Span(NamedTuple):
    """Time span of a fault: active in ticks, or in steps that begin at ticks, onset <= k < end."""

    onset: int
    end: int


def window(span: Span, period: int) -> tuple[int, int, int, int]:
    """Return the initial record of a fault's time window, for a component called every `period` ticks."""
    return 0, period, span.onset, span.end


@njit(cache=True)
def tick_now(window):
    """Return the tick of the present step and advance a fault's tick counter; call once per step."""
    k = window.next
    window.next = k + window.period
    return k


@njit(cache=True)
def is_active(window, k):
    """Whether a fault is active at tick `k`, by its time window."""
    return window.onset <= k and k < window.end


@step_function(COMMAND_MEMORY)
def command_step(m, t, h, u, y):
    asked, given = carray(u, m.size), carray(y, m.size + 1)
    active = is_active(m.window, tick_now(m.window))
    for j in range(m.size):
        given[j] = min(max(asked[j], -m.limit), m.limit) if active else asked[j]
    given[m.size] = active
    return 0


class FaultComponent(NativeComponent):
    """Base of components that break signals of a healthy system."""

    numbers: Mapping[str, tuple[str, float]] = {}
    """Numbers of the [[fault]] table that the memory holds unrounded: attribute -> (field, factor)."""

    def join_run(self, tick: int) -> None:
        """Let the fault join a run at `tick`, as if it had been present but inactive from the start."""
        clock = self.memory["window"]
        clock["next"] = -(-tick // clock["period"]) * clock["period"]

    def begin_at(self, tick: int) -> None:
        """Move the fault's time window to `tick`; a limited fault keeps its duration."""
        clock = self.memory["window"]
        clock["end"] = min(clock["end"] - clock["onset"] + tick, NEVER_TICK)
        clock["onset"] = tick

    def idle_outputs(self, given: np.ndarray) -> np.ndarray:
        """Return the outputs of the inactive fault for given inputs, and store the values its next step needs."""
        return np.append(given, 0.0)


class CommandFault(FaultComponent):
    """Sampled fault component: limits the commanded speeds of `size` drives to +-`limit` (rad/s) while active."""

    def __init__(self, name: str, span: Span, limit: float, size: int):
        port = Port("omega_ref", size, "rad/s", "commanded motor speed, as far as the drive can follow")
        memory = memory_of(COMMAND_MEMORY, window=window(span, 1), size=size, limit=limit)
        super().__init__(name, (port,), (port, ACTIVE_PORT), True, command_step, memory)


@step_function(POWER_MEMORY)
def power_step(m, t, h, u, y):
    given, left = carray(u, m.lines), carray(y, m.lines + 1)
    active = is_active(m.window, tick_now(m.window))
    for j in range(m.lines):
        left[j] = 0.0 if active else given[j]
    left[m.lines] = active
    return 0


class PowerFault(FaultComponent):
    """Sampled fault component: passes the power line or lines of `port` on, and cuts all of them while active."""

    def __init__(self, name: str, span: Span, port: Port):
        memory = memory_of(POWER_MEMORY, window=window(span, 1), lines=port.size)
        super().__init__(name, (port,), (port, ACTIVE_PORT), True, power_step, memory)


@step_function(GATE_MEMORY)
def gate_step(m, t, h, u, y):
    asked, given = carray(u, m.size + 1), carray(y, m.size)
    power = asked[m.size]
    for j in range(m.size):
        given[j] = asked[j] if power != 0.0 else 0.0
    return 0


class PowerGate(NativeComponent):
    """Sampled component behind a failing bus: sets the speed commands of `size` drives to zero without power."""

    def __init__(self, name: str, size: int):
        port = Port("omega_ref", size, "rad/s", "commanded motor speed, of a drive that has power")
        super().__init__(name, (port, POWER_PORT), (port,), True, gate_step, memory_of(GATE_MEMORY, size=size))


@step_function(PARAMETER_MEMORY, outputs=(VALUE_PORT, ACTIVE_PORT))
def parameter_step(m, t, h, u, y):
    parameter = carray(doubles_at(m.address), 1)
    k = tick_now(m.window)
    active = is_active(m.window, k)
    value = parameter[0] if m.chained else m.nominal
    if active:
        grown = min(1.0, (k - m.window.onset) / m.ramp) if m.ramp else 1.0
        value = value * (1.0 + grown * (m.factor - 1.0)) + grown * m.added
    parameter[0] = value
    y.value, y.active = value, active
    return 0


class ParameterFault(FaultComponent):
    """Sampled fault component, first in every tick: writes the present value of a parameter into memory.

    Before the onset and after the end it is the nominal value, to the last bit.

    Args:
        owner: component whose memory holds the parameter.
        parameter: name of the parameter there.
        cell: the parameter itself, a view (1,) of that memory.
        factor, added: factor on the nominal value, and offset (SI).
        ramp: ticks over which both grow linearly; 0 for a step.
        chained: whether an earlier fault of the tick writes to the same address.
    """

    def __init__(
        self,
        name: str,
        span: Span,
        owner: Component,
        parameter: str,
        cell: np.ndarray,
        factor: float,
        added: float,
        ramp: int,
        chained: bool,
    ):
        memory = memory_of(
            PARAMETER_MEMORY, window=window(span, 1), factor=factor, added=added, ramp=ramp, chained=chained
        )
        memory["address"], memory["nominal"] = cell.ctypes.data, cell[0]
        value = replace(VALUE_PORT, meaning=f"{parameter} of {owner.name}, as it holds now")
        super().__init__(name, (), (value, ACTIVE_PORT), True, parameter_step, memory, keep=owner)

    def idle_outputs(self, given: np.ndarray) -> np.ndarray:
        return np.array([self.memory["nominal"][0], 0.0])


_27, _30, _31, _11 = (np.uint64(n) for n in (27, 30, 31, 11))


@njit(cache=True)
def scramble(z):
    """Apply the SplitMix64 output function to a uint64 state."""
    z = (z ^ (z >> _30)) * _MIX_1
    z = (z ^ (z >> _27)) * _MIX_2
    return z ^ (z >> _31)


@njit(cache=True)
def next_uniform(memory):
    """Advance the random generator in `memory.random` (uint64) and return a number uniform in [0, 1)."""
    memory.random += _GAMMA
    return (scramble(memory.random) >> _11) * _UNIT_STEP


def first_state(seed: int, number: int) -> int:
    """Return the initial random state of a fault; faults with one `seed` draw different numbers."""
    # modulo 2**64 is intended
    with np.errstate(over="ignore"):
        return int(scramble(np.uint64((seed + number * int(_GAMMA)) % 2**64)))


class CountLaw(IntEnum):
    """Law of a fault of encoder counts; an experiment file has the names in lower case."""

    BIAS = 0
    DRIFT = 1
    QUANTISATION = 2
    DROPOUT_HOLD = 3
    DROPOUT_ZERO = 4
    DROPOUT_NAN = 5
    STUCK = 6
    GLITCH = 7
    FLIP = 8
    SWAP = 9


LAW_FIELDS: dict[CountLaw, dict[str, str]] = {
    CountLaw.BIAS: {"magnitude": "counts"},
    CountLaw.GLITCH: {"magnitude": "counts", "share": "share"},
    CountLaw.DROPOUT_HOLD: {"magnitude": "share"},
    CountLaw.DROPOUT_ZERO: {"magnitude": "share"},
    CountLaw.DROPOUT_NAN: {"magnitude": "share"},
}
"""Numbers of a [[fault]] table that a law takes unchanged, and their field in its memory."""


@njit(cache=True)
def round_half_up(count):
    """Round to the nearest integer, half up, as the encoder does."""
    return np.floor(count + 0.5)


@njit(cache=True)
def lost_count(m, count):
    """Return the encoder count read while a random share of samples is lost: the held one, zero or NaN."""
    if next_uniform(m) >= m.share:
        m.held = count
        return count
    if m.law == CountLaw.DROPOUT_HOLD:
        return m.held
    return 0.0 if m.law == CountLaw.DROPOUT_ZERO else np.nan


@njit(cache=True)
def spiked_count(m, count):
    """Return an encoder count with random spikes of one sample each.

    Two spikes never follow each other; on average the stated share of samples is hit.

    A spike follows a good sample with probability q, a spike never: the share of spikes is p = q (1 - p), so
    q = p / (1 - p).
    """
    spike = next_uniform(m) < m.share / (1.0 - m.share) and m.spiked == 0
    m.spiked = 1 if spike else 0
    return count + round_half_up(m.counts) if spike else count


@njit(cache=True)
def faulty_count(m, counts, k):
    """Return the faulty count of an encoder at tick `k`, computed from the clean counts."""
    count = counts[m.element]
    if m.law == CountLaw.BIAS:
        return count + round_half_up(m.counts)
    if m.law == CountLaw.DRIFT:
        return count + round_half_up(m.counts * (k - m.window.onset))
    if m.law == CountLaw.QUANTISATION:
        return m.counts * round_half_up(count / m.counts)
    if m.law == CountLaw.STUCK:
        return m.held
    if m.law == CountLaw.GLITCH:
        return spiked_count(m, count)
    if m.law == CountLaw.FLIP:
        return -count
    if m.law == CountLaw.SWAP:
        return counts[m.partner]
    return lost_count(m, count)


@step_function(COUNT_MEMORY, (COUNT_PORT,), (COUNT_PORT, ACTIVE_PORT))
def count_step(m, t, h, u, y):
    counts, delivered = u.count, y.count
    # delivered[:] = counts would allocate memory
    for i in range(ENCODER_CHANNELS):
        delivered[i] = counts[i]
    k = tick_now(m.window)
    active = is_active(m.window, k)
    if k == 0 or not active:
        m.held = counts[m.element]
    if active:
        delivered[m.element] = faulty_count(m, counts, k)
        if m.law == CountLaw.SWAP:
            delivered[m.partner] = counts[m.element]
    y.active = active
    return 0


class CountFault(FaultComponent):
    """Sampled fault component: passes on three encoder counts, one of them (two if swapped) wrong while active.

    Counts stay whole numbers, but the port is of kind "double": a lost count may be NaN.

    Args:
        element: index of the count, 0 to 2.
        counts: offset in counts, size of one step, or drift per tick.
        share: share of samples that are lost, or have a glitch.
        random: initial state of the generator, see `first_state`.
        period: period of the encoder (ticks).
    """

    def __init__(
        self,
        name: str,
        span: Span,
        law: CountLaw,
        port: Port,
        element: int,
        counts: float,
        share: float,
        random: int,
        period: int,
    ):
        memory = memory_of(COUNT_MEMORY, window=window(span, period), counts=counts, share=share, random=random)
        memory["law"], memory["element"], memory["partner"] = law, element, (element + 1) % ENCODER_CHANNELS
        out = Port(port.name, port.size, port.unit, f"{port.meaning}, faulty")
        super().__init__(name, (port,), (out, ACTIVE_PORT), True, count_step, memory, period=period)
        self.finite = law != CountLaw.DROPOUT_NAN

    def idle_outputs(self, given: np.ndarray) -> np.ndarray:
        self.memory["held"] = given[int(self.memory["element"][0])]
        return super().idle_outputs(given)


_ticks_at = pointer_to(np.int64)


@njit(cache=True)
def copy_values(target, values):
    """Copy `values` into `target` element by element; assigning a whole array would allocate memory."""
    for j in range(len(values)):
        target[j] = values[j]


@njit(cache=True)
def arrival_tick(m, k):
    """Return the arrival tick of a message sent at tick `k`, with a random delay; never for a lost message."""
    if m.share > 0.0 and next_uniform(m) < m.share:
        return NEVER_TICK
    under_way = m.least
    if m.most > m.least:
        under_way += int(next_uniform(m) * (m.most - m.least + 1))
    return k + under_way


@njit(cache=True)
def send_message(m, message, messages, arrivals, k):
    """Store the message sent at tick `k` in a ring buffer, with its arrival tick."""
    m.sent += 1
    slot = m.sent % m.capacity
    copy_values(messages[slot], message)
    arrivals[slot] = arrival_tick(m, k)
    m.lost = m.blank and arrivals[slot] == NEVER_TICK


@njit(cache=True)
def receive_message(m, present, messages, arrivals, k):
    """Copy the newest message that has arrived by tick `k` into `present`."""
    for n in range(m.sent, max(0, m.sent - m.capacity), -1):
        if arrivals[n % m.capacity] <= k:
            copy_values(present, messages[n % m.capacity])
            return


@step_function(MESSAGE_MEMORY)
def message_step(m, t, h, u, y):
    message, read, present = carray(u, m.size), carray(y, m.size + 1), carray(doubles_at(m.present), m.size)
    messages = carray(doubles_at(m.messages), (m.capacity, m.size))
    arrivals = carray(_ticks_at(m.arrivals), m.capacity)
    k = tick_now(m.window)
    active = is_active(m.window, k)
    if k == 0 or not active:
        copy_values(present, message)
        m.sent, m.lost = 0, 0
    if active:
        if k % m.sender_period == 0:
            send_message(m, message, messages, arrivals, k)
        receive_message(m, present, messages, arrivals, k)
    for j in range(m.size):
        read[j] = 0.0 if m.lost else present[j]
    read[m.size] = active
    return 0


class MessageFault(FaultComponent):
    """Sampled fault component: passes on a sender's ports, which make one message, late or held while active.

    After the fault readers get the sender's present message at once; messages under way are dropped.

    Args:
        sender_period: period of the sender (ticks).
        least, most: range of the time under way (ticks).
        share: share of messages that are lost.
        random: initial state of the generator, see `first_state`.
        blank: whether readers get zeros in place of a lost message.
    """

    def __init__(
        self,
        name: str,
        span: Span,
        ports: tuple[Port, ...],
        sender_period: int,
        least: int,
        most: int,
        share: float,
        random: int,
        blank: bool = False,
    ):
        size, capacity = width(ports), most // sender_period + 2
        messages, arrivals, present = np.zeros((capacity, size)), np.zeros(capacity, dtype=np.int64), np.zeros(size)
        pointers = {"messages": messages, "arrivals": arrivals, "present": present}
        memory = memory_of(
            MESSAGE_MEMORY,
            window=window(span, 1),
            size=size,
            sender_period=sender_period,
            capacity=capacity,
            blank=blank,
        )
        memory["least"], memory["most"], memory["share"], memory["random"] = least, most, share, random
        # a count that passed an earlier fault may be NaN
        read = (replace(port, kind="double") for port in ports)
        super().__init__(name, ports, (*read, ACTIVE_PORT), True, message_step, memory, pointers=pointers)

    def idle_outputs(self, given: np.ndarray) -> np.ndarray:
        self.pointers["present"][:] = given
        return super().idle_outputs(given)
