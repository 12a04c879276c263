"""Messages that come late, at random times or never; the reader keeps the last one that came.

A message is whatever its sender puts out in one period. One that is overtaken by a later one is dropped, so what a
reader gets never goes back in time.
"""

from dataclasses import replace

import numpy as np

from twin.compiled.function import carray, njit, pointer_to
from twin.cosim.native import doubles_at, step_function
from twin.cosim.port import Port, memory_of, record, width
from twin.faults.command_fault import ACTIVE, WINDOW, FaultComponent, Span, tick_now, window, within
from twin.faults.randomness import drawn

NEVER = 1 << 62
"""The tick at which a lost message arrives."""

MEMORY = record(
    window=WINDOW,
    size="i8",
    sender_period="i8",
    least="i8",
    most="i8",
    share="f8",
    sent="i8",
    capacity="i8",
    messages="i8",
    arrivals="i8",
    present="i8",
    random="u8",
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


@step_function(MEMORY)
def step(m, t, h, u, y):
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
        memory = memory_of(MEMORY, window=window(span, 1), size=size, sender_period=sender_period, capacity=capacity)
        memory["least"], memory["most"], memory["share"], memory["random"] = least, most, share, random
        # a count that came through a fault before may be NaN
        read = (replace(port, kind="double") for port in ports)
        super().__init__(name, ports, (*read, ACTIVE), True, step, memory, pointers=pointers)
