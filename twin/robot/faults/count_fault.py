"""Faults of encoders and of messages, at random some of them.

A random generator small enough to live in a component's memory: the same seed gives the same bytes.

SplitMix64: Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014, with the constants of
Vigna's public-domain splitmix64.c.

An encoder that miscounts: one element of a port of counts, replaced on its way to every reader.

Messages that come late, at random times or never; the reader keeps the last one that came.

A message is whatever its sender puts out in one period. One that is overtaken by a later one is dropped, so what a
reader gets never goes back in time.
"""

from dataclasses import replace
from enum import IntEnum

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.cosim.component import doubles_at, step_function
from twin.kernel.cosim.port import Port, memory_of, record, state, states, width
from twin.robot.faults.drive_fault import ACTIVE, WINDOW, FaultComponent, Span, tick_now, window, within

_GAMMA, _MIX_1, _MIX_2 = (np.uint64(n) for n in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))
_27, _30, _31, _11 = (np.uint64(n) for n in (27, 30, 31, 11))
_UNIT = 2.0**-53


@njit(cache=True)
def mixed(z):
    """SplitMix64's scrambling of a uint64."""
    z = (z ^ (z >> _30)) * _MIX_1
    z = (z ^ (z >> _27)) * _MIX_2
    return z ^ (z >> _31)


@njit(cache=True)
def drawn(memory):
    """The next number of the generator in `memory.random` (uint64): uniform in [0, 1)."""
    memory.random += _GAMMA
    return (mixed(memory.random) >> _11) * _UNIT


def first_state(seed: int, number: int) -> int:
    """State of the generator of the fault with this number: the same `seed` serves them all, and each draws its own."""
    # modulo 2**64, which is what is meant
    with np.errstate(over="ignore"):
        return int(mixed(np.uint64((seed + number * int(_GAMMA)) % 2**64)))


class CountLaw(IntEnum):
    """What becomes of a count; by the names in an experiment's file, in capitals."""

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


NUMBERS: dict[CountLaw, dict[str, str]] = {
    CountLaw.BIAS: {"magnitude": "counts"},
    CountLaw.GLITCH: {"magnitude": "counts", "share": "share"},
    CountLaw.DROPOUT_HOLD: {"magnitude": "share"},
    CountLaw.DROPOUT_ZERO: {"magnitude": "share"},
    CountLaw.DROPOUT_NAN: {"magnitude": "share"},
}
"""Numbers of a [[fault]] that a law takes as they are, and the field of its memory."""

# plain integers: what compiled code compares with
_BIAS, _DRIFT, _QUANTISATION, _HOLD, _ZERO, _NAN, _STUCK, _GLITCH, _FLIP, _SWAP = (int(law) for law in CountLaw)

ENCODER_CHANNELS = 3
COUNT = Port("count", ENCODER_CHANNELS, "1", "counts of the motor or of the joint encoders")

MEMORY = record(
    window=WINDOW, law="i8", element="i8", partner="i8", counts="f8", share="f8",
    **states(held="f8", spiked="i8", random="u8"),
)  # fmt: skip
"""`counts`: the magnitude in counts, of a drift in counts per tick. `held`: the last count that went through."""


@njit(cache=True)
def whole(count):
    """The nearest whole count, half up, as the encoder itself rounds."""
    return np.floor(count + 0.5)


@njit(cache=True)
def lost_count(m, count):
    """What a reader gets while a random share of samples is lost."""
    if drawn(m) >= m.share:
        m.held = count
        return count
    if m.law == _HOLD:
        return m.held
    return 0.0 if m.law == _ZERO else np.nan


@njit(cache=True)
def spiked_count(m, count):
    """`count` with spikes of one sample: never two in a row, and in the long run the stated share of all samples.

    A spike follows a good sample with probability q, a spike never: of all samples the share p = q (1 - p) are spikes,
    so q = p / (1 - p).
    """
    spike = drawn(m) < m.share / (1.0 - m.share) and m.spiked == 0
    m.spiked = 1 if spike else 0
    return count + whole(m.counts) if spike else count


@njit(cache=True)
def faulty_count(m, counts, k):
    """What the encoder `m.element` delivers at tick `k` instead of its own of the clean `counts`."""
    count = counts[m.element]
    if m.law == _BIAS:
        return count + whole(m.counts)
    if m.law == _DRIFT:
        return count + whole(m.counts * (k - m.window.onset))
    if m.law == _QUANTISATION:
        return m.counts * whole(count / m.counts)
    if m.law == _STUCK:
        return m.held
    if m.law == _GLITCH:
        return spiked_count(m, count)
    if m.law == _FLIP:
        return -count
    if m.law == _SWAP:
        return counts[m.partner]
    return lost_count(m, count)


@step_function(MEMORY, (COUNT,), (COUNT, ACTIVE))
def step(m, t, h, u, y):
    counts, delivered = u.count, y.count
    # not delivered[:] = counts, for which memory is allocated
    for i in range(ENCODER_CHANNELS):
        delivered[i] = counts[i]
    k = tick_now(m.window)
    active = within(m.window, k)
    if k == 0 or not active:
        m.held = counts[m.element]
    if active:
        delivered[m.element] = faulty_count(m, counts, k)
        if m.law == _SWAP:
            delivered[m.partner] = counts[m.element]
    y.active = active
    return 0


class CountFault(FaultComponent):
    """Sampled component: three counts in, three counts out, one of them (two if swapped) wrong while active.

    Counts stay whole numbers, as an encoder's are, but the port is of kind "double": a lost one may be NaN.

    Args:
        name: of the component.
        span: when it is active.
        law: what becomes of a count.
        port: the encoder's port of counts (3).
        element: which of the three.
        counts: by which a count is off, or of one step; of a drift per tick.
        share: of the samples that are lost, or hit by a glitch.
        random: state in which its generator begins, see `first_state`.
        period: of the encoder, in ticks.
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
        memory = memory_of(MEMORY, window=window(span, period), counts=counts, share=share, random=random)
        memory["law"], memory["element"], memory["partner"] = law, element, (element + 1) % ENCODER_CHANNELS
        out = Port(port.name, port.size, port.unit, f"{port.meaning}, faulty")
        super().__init__(name, (port,), (out, ACTIVE), True, step, memory, period=period)
        self.finite = law != CountLaw.DROPOUT_NAN

    def passed_on(self, given: np.ndarray) -> np.ndarray:
        self.memory["held"] = given[int(self.memory["element"][0])]
        return super().passed_on(given)


NEVER = 1 << 62
"""The tick at which a lost message arrives."""

MESSAGE_MEMORY = record(
    window=WINDOW,
    size="i8",
    sender_period="i8",
    least="i8",
    most="i8",
    share="f8",
    sent=state("i8"),
    capacity="i8",
    messages=state("i8"),
    arrivals=state("i8"),
    present=state("i8"),
    random=state("u8"),
)
"""A message is `least` to `most` ticks under way, a `share` of them for ever. `sent`: messages since the onset; the
n-th of them lies at n modulo `capacity` in the rings `messages` and `arrivals` (ticks), which are long enough for all
that are under way. `present`: what the reader has."""
_ticks_at = pointer_to(np.int64)


@njit(cache=True)
def copy(target, values):
    """Write `values` into `target`; an assignment of a whole array allocates memory."""
    for j in range(len(values)):
        target[j] = values[j]


@njit(cache=True)
def arrival(m, k):
    """The tick at which a message sent at tick `k` arrives."""
    if m.share > 0.0 and drawn(m) < m.share:
        return NEVER
    under_way = m.least
    if m.most > m.least:
        under_way += int(drawn(m) * (m.most - m.least + 1))
    return k + under_way


@njit(cache=True)
def post(m, message, messages, arrivals, k):
    """Put `message` of tick `k` under way."""
    m.sent += 1
    slot = m.sent % m.capacity
    copy(messages[slot], message)
    arrivals[slot] = arrival(m, k)


@njit(cache=True)
def receive(m, present, messages, arrivals, k):
    """Make the newest message that has arrived the `present` one, in place."""
    for n in range(m.sent, max(0, m.sent - m.capacity), -1):
        if arrivals[n % m.capacity] <= k:
            copy(present, messages[n % m.capacity])
            return


@step_function(MESSAGE_MEMORY)
def message_step(m, t, h, u, y):
    message, read, present = carray(u, m.size), carray(y, m.size + 1), carray(doubles_at(m.present), m.size)
    messages = carray(doubles_at(m.messages), (m.capacity, m.size))
    arrivals = carray(_ticks_at(m.arrivals), m.capacity)
    k = tick_now(m.window)
    active = within(m.window, k)
    if k == 0 or not active:
        copy(present, message)
        m.sent = 0
    if active:
        if k % m.sender_period == 0:
            post(m, message, messages, arrivals, k)
        receive(m, present, messages, arrivals, k)
    for j in range(m.size):
        read[j] = present[j]
    read[m.size] = active
    return 0


class MessageFault(FaultComponent):
    """Sampled component, every tick: the ports of a sender in, the same ports out, late or held while active.

    Once the fault is over the reader has the sender's own message again at once; what is still under way is dropped.

    Args:
        name: of the component.
        span: when it is active.
        ports: the sender's ports that make one message.
        sender_period: in ticks.
        least, most: how long a message is under way, in ticks.
        share: of the messages that are lost.
        random: state in which its generator begins, see `first_state`.
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
    ):
        size, capacity = width(ports), most // sender_period + 2
        messages, arrivals, present = np.zeros((capacity, size)), np.zeros(capacity, dtype=np.int64), np.zeros(size)
        pointers = {"messages": messages, "arrivals": arrivals, "present": present}
        memory = memory_of(
            MESSAGE_MEMORY, window=window(span, 1), size=size, sender_period=sender_period, capacity=capacity
        )
        memory["least"], memory["most"], memory["share"], memory["random"] = least, most, share, random
        # a count that came through a fault before may be NaN
        read = (replace(port, kind="double") for port in ports)
        super().__init__(name, ports, (*read, ACTIVE), True, message_step, memory, pointers=pointers)

    def passed_on(self, given: np.ndarray) -> np.ndarray:
        self.pointers["present"][:] = given
        return super().passed_on(given)
