"""An encoder that miscounts: one element of a port of counts, replaced on its way to every reader."""

from enum import IntEnum

import numpy as np

from twin.compiled.function import njit
from twin.cosim.native import step_function
from twin.cosim.port import Port, memory_of, record
from twin.faults.command_fault import ACTIVE, WINDOW, FaultComponent, Span, tick_now, window, within
from twin.faults.randomness import drawn


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
    window=WINDOW, law="i8", element="i8", partner="i8", counts="f8", share="f8", held="f8", spiked="i8", random="u8"
)
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
