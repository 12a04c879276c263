"""Faults into a system: which component each kind becomes, and between which wires it goes."""

import math
from collections.abc import Mapping, Sequence

from twin.cosim.component import Component
from twin.cosim.wiring import End, Feeds, ends
from twin.experiment.fault import Fault
from twin.experiment.fault_catalogue import kind_named, refuse_target
from twin.runs.assembly.faults.circuit import Circuit
from twin.runs.assembly.faults.components import (
    PARAMETERS,
    command_fault,
    count_fault,
    drive_fault,
    message_fault,
    parameter_fault,
)
from twin.runs.assembly.joints import JOINTS

THREE_AXES = "drive"
"""Name of a drive that turns all joints; others are drive_1 .. drive_3."""


def inject(
    components: Sequence[Component],
    feeds: Mapping[End, End],
    faults: Sequence[Fault],
    tick: float,
    counts_per_turn: tuple[float, float],
    speed_limit: float,
) -> tuple[list[Component], Feeds]:
    """Components and feeds of the same system with `faults` in it; what was given stays as it is.

    Fault n of the list is the component "fault_n". Faults on one signal act in the order of the list. A fault of the
    mechanism "body" belongs to what the robot presses on, and is passed over.

    Args:
        components, feeds: of the healthy system, by the names encoder, estimator, controller, monitor (if there is
            one), drive or drive_1 .. drive_3, plant.
        faults: what breaks.
        tick: (s). counts_per_turn: of the motor and of the joint encoders. speed_limit: of a drive (rad/s).

    Raises:
        InputRefused: a kind or target that does not exist, or a magnitude that does nothing.
    """
    circuit = Circuit(components, feeds)
    written: list[str] = []
    for number, fault in enumerate(faults, start=1):
        mechanism = kind_named(number, fault.kind).mechanism
        refuse_target(number, fault.kind, fault.target)
        if mechanism == "counts":
            _break_encoder(circuit, number, fault, tick, counts_per_turn)
        elif mechanism == "message":
            _delay_messages(circuit, number, fault, tick)
        elif mechanism == "command":
            _limit_command(circuit, number, fault, speed_limit)
        elif mechanism == "drive":
            _break_drive(circuit, number, fault)
        elif mechanism == "parameter":
            _change_parameter(circuit, number, fault, written)
    return circuit.components, circuit.feeds


def _element(target: str) -> int:
    """Which of three "drive_2", "joint_encoder_2" or "joint_2" means, from 0; without a number the only one."""
    last = target.rpartition("_")[2]
    return int(last) - 1 if last.isdigit() else 0


def _break_encoder(
    circuit: Circuit, number: int, fault: Fault, tick: float, counts_per_turn: tuple[float, float]
) -> None:
    encoder = circuit.component("encoder", number, fault.target)
    of_motor = fault.target.startswith("motor")
    name = "count_m" if of_motor else "count_l"
    port = next(port for port in encoder.outputs if port.name == name)
    counts_per_rad = counts_per_turn[0 if of_motor else 1] / (2.0 * math.pi)
    broken = count_fault(number, fault, port, _element(fault.target), counts_per_rad, tick, encoder.period)
    circuit.put_behind(broken, ends([encoder], "output", name), ends([broken], "input", name))


def _delay_messages(circuit: Circuit, number: int, fault: Fault, tick: float) -> None:
    sender = circuit.component(fault.target, number, fault.target)
    # of a controller only the command leaves the computer
    ports = tuple(port for port in sender.outputs if sender.name == "encoder" or port.name == "omega_ref")
    late = message_fault(number, fault, ports, sender.period, tick)
    told = [end for port in ports for end in ends([sender], "output", port.name)]
    circuit.put_behind(late, told, [end for port in ports for end in ends([late], "input", port.name)])


def _limit_command(circuit: Circuit, number: int, fault: Fault, speed_limit: float) -> None:
    joints = [_element(fault.target)] if fault.target != "drives" else list(range(JOINTS))
    targets = [_axis(circuit, number, fault.target, joint, "omega_ref") for joint in joints]
    limited = command_fault(number, fault, len(joints), speed_limit)
    circuit.put_before(limited, targets, ends([limited], "input", "omega_ref"))


def _break_drive(circuit: Circuit, number: int, fault: Fault) -> None:
    joint = _element(fault.target)
    theta_m = _axis(circuit, number, fault.target, joint, "theta_m")
    tau_load = circuit.feeds[_axis(circuit, number, fault.target, joint, "tau_load")]
    drive = circuit.component(theta_m.component, number, fault.target)
    start = float(drive.initial("theta_m")[theta_m.element])
    monitored = circuit.has("monitor")
    broken = drive_fault(number, fault, start, monitored, drive.period)
    circuit.put_behind(broken, [theta_m], [End(broken.name, "theta_m")])
    circuit.feeds[End(broken.name, "tau_load")] = tau_load
    if monitored:
        circuit.feeds[End(broken.name, "power")] = End("monitor", "power")


def _axis(circuit: Circuit, number: int, target: str, joint: int, port: str) -> End:
    """The end of one joint's drive."""
    if circuit.has(THREE_AXES):
        return End(THREE_AXES, port, joint)
    return End(circuit.component(f"drive_{joint + 1}", number, target).name, port)


def _change_parameter(circuit: Circuit, number: int, fault: Fault, written: list[str]) -> None:
    place = PARAMETERS[fault.kind]
    element = _element(fault.target)
    cell = f"{place.component}.{place.field}[{element}]"
    owner = circuit.component(place.component, number, fault.target)
    changed = parameter_fault(number, fault, owner, element, chained=cell in written)
    circuit.components.insert(len(written), changed)
    written.append(cell)
