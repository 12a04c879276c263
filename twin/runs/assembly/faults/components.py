"""Each fault as the component that does it; what of a fault would do nothing, or cannot be done, is refused."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from twin.cosim.component import Component
from twin.cosim.place import Place
from twin.cosim.port import Port
from twin.errors import InputRefused
from twin.experiment.fault import Fault
from twin.faults.command_fault import CommandFault
from twin.faults.count_fault import CountFault
from twin.faults.count_fault import Law as CountLaw
from twin.faults.drive_fault import DriveFault
from twin.faults.drive_fault import Law as DriveLaw
from twin.faults.message_fault import MessageFault
from twin.faults.parameter_fault import ParameterFault
from twin.faults.randomness import first_state
from twin.faults.window import Span

COUNT_LAWS = {
    "encoder_bias": CountLaw.BIAS,
    "encoder_drift": CountLaw.DRIFT,
    "encoder_quantisation": CountLaw.QUANTISATION,
    "encoder_dropout_hold": CountLaw.HOLD,
    "encoder_dropout_zero": CountLaw.ZERO,
    "encoder_dropout_nan": CountLaw.NAN,
    "encoder_stuck": CountLaw.STUCK,
    "encoder_glitch": CountLaw.GLITCH,
    "encoder_flip": CountLaw.FLIP,
    "encoder_swap": CountLaw.SWAP,
}
LEAST_COUNTS = {CountLaw.BIAS: 0.5, CountLaw.GLITCH: 0.5, CountLaw.QUANTISATION: 2.0}
"""Below which a law changes no count."""
DRIVE_LAWS = {
    "drive_runaway": DriveLaw.RUNAWAY,
    "drive_freewheel": DriveLaw.FREEWHEEL,
    "drive_dead": DriveLaw.DEAD,
    "joint_jam": DriveLaw.JAM,
    "drive_failure": DriveLaw.FAILURE,
}


@dataclass(frozen=True)
class Parameter(Place):
    """Where a kind's parameter lies, and how the magnitude acts on it."""

    operation: Literal["factor", "added"]


PARAMETERS = {
    "spring_softened": Parameter("plant", "parameters", "k_s_share", "factor"),
    "spring_broken": Parameter("plant", "parameters", "k_s_share", "factor"),
    "stiffness_change": Parameter("plant", "parameters", "K", "factor"),
    "backlash_growth": Parameter("plant", "parameters", "backlash_added", "added"),
    "joint_friction": Parameter("plant", "parameters", "b_j_added", "added"),
    "belt_slip": Parameter("plant", "parameters", "slip", "added"),
    "belief_k_s": Parameter("estimator", "belief", "k_s", "factor"),
    "belief_eta": Parameter("estimator", "belief", "eta", "factor"),
}


def count_fault(
    number: int, fault: Fault, port: Port, element: int, counts_per_rad: float, tick: float, period: int
) -> CountFault:
    """The encoder that miscounts.

    Args:
        number: of the fault in its file, from 1; so below.
        fault: its magnitude is an angle of the encoder's own shaft (rad), of a drift a speed (rad/s), of a dropout a
            share of samples.
        port: the encoder's port of counts (3). element: which of the three.
        counts_per_rad: of this encoder. tick: (s). period: of the encoder, in ticks.

    Raises:
        InputRefused: the magnitude is too small to change a count.
    """
    law = COUNT_LAWS[fault.kind]
    counts = fault.magnitude * counts_per_rad
    if law == CountLaw.DRIFT:
        counts *= tick
    if law == CountLaw.QUANTISATION:
        counts = np.floor(counts + 0.5)
    least = LEAST_COUNTS.get(law, 0.0)
    if abs(counts) < least:
        enough = np.degrees(least / counts_per_rad)
        raise InputRefused(
            f"[[fault]] {number}: {fault.kind} of {np.degrees(fault.magnitude):g} deg changes no count of "
            f"{fault.target}; expected at least {least:g} counts, which are {enough:.3g} deg"
        )
    share = fault.share if law == CountLaw.GLITCH else fault.magnitude
    random = first_state(fault.seed, number)
    return CountFault(_name(number), _span(fault), law, port, element, counts, share, random, period)


def message_fault(number: int, fault: Fault, ports: tuple[Port, ...], sender_period: int, tick: float) -> MessageFault:
    """Messages of `ports` that are late or lost.

    Args:
        fault: its magnitude is a delay (s), the longest of random delays (s), or the share of messages lost.
        sender_period: in ticks. tick: (s).

    Raises:
        InputRefused: a delay that is not at least one whole tick.
    """
    least = most = 0
    if fault.kind != "sample_loss":
        most = _delay(number, fault, tick)
        least = 0 if fault.kind == "sample_jitter" else most
    share = fault.magnitude if fault.kind == "sample_loss" else 0.0
    random = first_state(fault.seed, number)
    return MessageFault(_name(number), _span(fault), ports, sender_period, least, most, share, random)


def command_fault(number: int, fault: Fault, size: int, speed_limit: float) -> CommandFault:
    """The limit of `size` drives.

    Args:
        fault: its magnitude is the limit (rad/s), of a brown-out the share of `speed_limit` that the sagging supply
            leaves: without load a motor's highest speed is proportional to its voltage.
        speed_limit: what a healthy drive can run (rad/s).
    """
    limit = fault.magnitude * speed_limit if fault.kind == "brown_out" else fault.magnitude
    return CommandFault(_name(number), _span(fault), limit, size)


def drive_fault(number: int, fault: Fault, theta_m: float, monitored: bool, period: int) -> DriveFault:
    """The shaft of a drive that does not do what it should.

    Args:
        fault: its magnitude is the speed of a runaway (rad/s).
        theta_m: of the drive before tick 0 (rad). monitored: whether somebody may take its power. period: in ticks.
    """
    law, label = DRIVE_LAWS[fault.kind], f"[[fault]] {number}"
    name, span = _name(number), _span(fault)
    return DriveFault(name, span, law, fault.magnitude, theta_m, monitored, period, label, fault.target)


def parameter_fault(number: int, fault: Fault, owner: Component, element: int, chained: bool) -> ParameterFault:
    """The change of a constant in the memory of `owner`.

    Args:
        fault: its magnitude is a factor on the parameter or an addition to it (SI), as `PARAMETERS` says.
        element: which element of the field; 0 where it is a single number.
        chained: whether a fault before it in the tick writes to the same place.

    Raises:
        InputRefused: `owner` has no such parameter.
    """
    place = PARAMETERS[fault.kind]
    factor, added = (fault.magnitude, 0.0) if place.operation == "factor" else (1.0, fault.magnitude)
    cell = _cell(number, fault, owner, element)
    return ParameterFault(_name(number), _span(fault), owner, place.field, cell, factor, added, fault.ramp, chained)


def _name(number: int) -> str:
    return f"fault_{number}"


def _span(fault: Fault) -> Span:
    return Span(fault.onset, fault.end)


def _delay(number: int, fault: Fault, tick: float) -> int:
    """The magnitude in whole ticks."""
    ticks = round(fault.magnitude / tick)
    # a delay in ms over a tick in ms is whole up to rounding of the two
    if ticks < 1 or abs(ticks * tick - fault.magnitude) > 1e-9 * fault.magnitude:
        raise InputRefused(
            f"[[fault]] {number}: {fault.kind} of {1e3 * fault.magnitude:g} ms; "
            f"expected a whole number of ticks of {1e3 * tick:g} ms, at least one; change magnitude_ms"
        )
    return ticks


def _cell(number: int, fault: Fault, owner: Component, element: int) -> np.ndarray:
    """The parameter itself in the memory of `owner`, (1,) float64, a view."""
    place = PARAMETERS[fault.kind]
    field = place.memory_of(owner)
    if field is None:
        raise InputRefused(
            f"[[fault]] {number}: {fault.kind} writes {place.record}.{place.field} in the memory of component "
            f"'{owner.name}', which has none; remove the fault or use the native {owner.name}"
        )
    return field[0, element : element + 1] if field.ndim == 2 else field[0:1]
