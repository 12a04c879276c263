"""Faults inserted into the wires of a healthy system.

A fault is a component in the wires. What of it would do nothing, or cannot be done, is refused.
"""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.system import End, Feeds, ends
from twin.kernel.errors import InputRefused
from twin.robot.assembly.build import JOINTS
from twin.robot.assembly.declared import FAULT_PLACES
from twin.robot.experiment.fault import Fault, find_kind, member_faults, refuse_target
from twin.robot.experiment.schema import whole_ticks
from twin.robot.faults import (
    LAW_FIELDS,
    CommandFault,
    CountFault,
    CountLaw,
    MessageFault,
    ParameterFault,
    PowerFault,
    PowerGate,
    Span,
    first_state,
)
from twin.robot.shaft import DriveFault, DriveLaw

THREE_AXES = "drive"
"""Name of a drive that turns all joints; others are drive_1 .. drive_3."""
COUNT_LAWS = {f"encoder_{law.name.lower()}": law for law in CountLaw}
LEAST_COUNTS = {CountLaw.BIAS: 0.5, CountLaw.GLITCH: 0.5, CountLaw.QUANTISATION: 2.0}
"""Below which a law changes no count."""
DRIVE_LAWS = {law.name.lower(): law for law in DriveLaw}
BUS_TARGET = "bus"
"""Target of what happens to commands on their last way, into the drives."""


class Circuit:
    """A copy of a system's components and feeds; the components themselves are shared.

    Attributes:
        components: in the order in which a tick evaluates them.
        feeds: see `twin.kernel.cosim.system`.
    """

    def __init__(self, components: Iterable[Component], feeds: Mapping[End, End]):
        self.components = list(components)
        self.feeds = dict(feeds)
        self._stand_ins: dict[End, End] = {}

    def component(self, name: str, number: int, target: str) -> Component:
        """The component `name`, which fault `number` on `target` needs.

        Raises:
            InputRefused: there is none.
        """
        for component in self.components:
            if component.name == name:
                return component
        names = ", ".join(c.name for c in self.components) or "none"
        raise InputRefused(
            f"[[fault]] {number} target = \"{target}\": expected a system with a component '{name}'; "
            f"there are {names}. Change the target or add what it names"
        )

    def has(self, name: str) -> bool:
        """Whether there is a component `name`."""
        return any(component.name == name for component in self.components)

    def faulty_output(self, output: End) -> End:
        """The last of the faults behind `output`, or itself."""
        return self._stand_ins.get(output, output)

    def insert_after(self, fault: Component, outputs: Sequence[End], inputs: Sequence[End]) -> None:
        """Feed `inputs` of `fault` from `outputs` (or the faults behind them); who read these reads it instead.

        Args:
            inputs: of the fault, which has outputs of the same names.
        """
        sources = [self.faulty_output(output) for output in outputs]
        instead = dict(zip(sources, inputs, strict=True))
        self.feeds = {target: instead.get(source, source) for target, source in self.feeds.items()}
        self.feeds.update(zip(inputs, sources, strict=True))
        self._stand_ins.update(zip(outputs, inputs, strict=True))
        self.insert(fault, sources)

    def insert_before(self, fault: Component, targets: Sequence[End], inputs: Sequence[End]) -> None:
        """Let `fault` feed `targets` from what has fed them; `inputs`: its own, and its outputs of the same names."""
        sources = [self.feeds[target] for target in targets]
        self.feeds.update(zip(targets, inputs, strict=True))
        self.feeds.update(zip(inputs, sources, strict=True))
        self.insert(fault, sources)

    def insert(self, fault: Component, sources: Iterable[End]) -> None:
        """Right behind the last component that feeds it; behind one that may return NaN, it may too."""
        feeding = {source.component for source in sources}
        fault.finite = fault.finite and all(c.finite for c in self.components if c.name in feeding)
        self.components.insert(1 + max(i for i, c in enumerate(self.components) if c.name in feeding), fault)


def inject(
    components: Sequence[Component],
    feeds: Mapping[End, End],
    faults: Sequence[Fault],
    tick: float,
    counts_per_turn: tuple[float, float],
    speed_limit: float,
) -> tuple[list[Component], Feeds]:
    """Components and feeds of the same system with `faults` in it; what was given stays as it is.

    Fault n of the list is the component "fault_n"; of a group each member counts. Faults on one signal act in the order
    of the list. A fault of the mechanism "body" belongs to what the robot presses on, and is passed over.

    Args:
        components, feeds: of the healthy system, by the names encoder, estimator, controller, monitor (if there is
            one), drive or drive_1 .. drive_3, plant.
        faults: what breaks.
        tick: (s).
        counts_per_turn: of the motor and of the joint encoders.
        speed_limit: of a drive (rad/s).

    Raises:
        InputRefused: a kind or target that does not exist, or a magnitude that does nothing.
    """
    circuit = Circuit(components, feeds)
    written: list[str] = []
    for number, fault in enumerate(faults, start=1):
        find_kind(number, fault.kind)
        refuse_target(number, fault.kind, fault.target)
    members = [member for fault in faults for member in member_faults(fault)]
    for number, fault in enumerate(members, start=1):
        mechanism = find_kind(number, fault.kind).mechanism
        if mechanism == "counts":
            _break_encoder(circuit, number, fault, tick, counts_per_turn)
        elif mechanism == "message":
            _delay_messages(circuit, number, fault, tick)
        elif fault.kind == "power_off":
            _cut_power(circuit, number, fault)
        elif mechanism == "command":
            _limit_command(circuit, number, fault, speed_limit)
        elif mechanism == "drive":
            _break_drive(circuit, number, fault)
        elif mechanism == "parameter":
            _change_parameter(circuit, number, fault, written)
    return circuit.components, circuit.feeds


def _element_index(target: str) -> int:
    """Which of three "drive_2", "joint_encoder_2" or "joint_2" means, from 0; without a number the only one."""
    last = target.rpartition("_")[2]
    return int(last) - 1 if last.isdigit() else 0


def _name_and_span(number: int, fault: Fault) -> tuple[str, Span]:
    """Name and span of the component of fault `number`."""
    return f"fault_{number}", Span(fault.onset, fault.end)


def _break_encoder(
    circuit: Circuit, number: int, fault: Fault, tick: float, counts_per_turn: tuple[float, float]
) -> None:
    """The magnitude is an angle of the encoder's own shaft, of a drift a speed, of a dropout a share of samples."""
    encoder = circuit.component("encoder", number, fault.target)
    of_motor = fault.target.startswith("motor")
    name = "count_m" if of_motor else "count_l"
    port = next(port for port in encoder.outputs if port.name == name)
    counts_per_rad = counts_per_turn[0 if of_motor else 1] / (2.0 * math.pi)
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
    random, element = first_state(fault.seed, fault.table or number), _element_index(fault.target)
    broken = CountFault(*_name_and_span(number, fault), law, port, element, counts, share, random, encoder.period)
    broken.numbers = {
        key: (field, counts_per_rad if field == "counts" else 1.0) for key, field in LAW_FIELDS.get(law, {}).items()
    }
    circuit.insert_after(broken, ends([encoder], "output", name), ends([broken], "input", name))


def _delay_messages(circuit: Circuit, number: int, fault: Fault, tick: float) -> None:
    """The magnitude is a delay, the longest of random delays, or the share of messages that are lost."""
    targets: list[End] = []
    if fault.target == BUS_TARGET:
        targets = [_drive_end(circuit, number, fault.target, joint, "omega_ref") for joint in range(JOINTS)]
        sender = circuit.component(circuit.feeds[targets[0]].component, number, fault.target)
        ports: tuple[Port, ...] = (Port("omega_ref", JOINTS, "rad/s", "commanded motor speed, as it arrives"),)
    else:
        sender = circuit.component(fault.target, number, fault.target)
        # of a controller only the command leaves the computer
        ports = tuple(port for port in sender.outputs if sender.name == "encoder" or port.name == "omega_ref")
    share, least, most = 0.0, 0, whole_ticks(fault.magnitude, tick)
    if find_kind(number, fault.kind).unit == "share":
        share, most = fault.magnitude, 0
    elif not most:
        raise InputRefused(
            f"[[fault]] {number}: {fault.kind} of {1e3 * fault.magnitude:g} ms; "
            f"expected a whole number of ticks of {1e3 * tick:g} ms, at least one; change magnitude_ms"
        )
    elif fault.kind != "sample_jitter":
        least = most
    random, blank = first_state(fault.seed, fault.table or number), fault.kind == "command_lost"
    late = MessageFault(*_name_and_span(number, fault), ports, sender.period, least, most, share, random, blank)
    if share:
        late.numbers = {"magnitude": ("share", 1.0)}
    if targets:
        circuit.insert_before(late, targets, ends([late], "input", "omega_ref"))
        _insert_power_gate(circuit, f"{late.name}_power", targets)
        return
    sent = [end for port in ports for end in ends([sender], "output", port.name)]
    circuit.insert_after(late, sent, [end for port in ports for end in ends([late], "input", port.name)])


def _insert_power_gate(circuit: Circuit, name: str, targets: Sequence[End]) -> None:
    """Drives whose power is cut stand still, although the bus does not tell them to.

    A monitor without a drive to obey it stops them by its command otherwise, see docs/safety.md.
    """
    lines = power_lines(circuit)
    if lines:
        gate = PowerGate(name, len(targets))
        circuit.insert_before(gate, targets, ends([gate], "input", "omega_ref"))
        circuit.feeds[End(name, "power")] = circuit.faulty_output(End(lines[-1][0], "power"))


def _cut_power(circuit: Circuit, number: int, fault: Fault) -> None:
    """No drive has power, nor is it commanded to move."""
    name, span = _name_and_span(number, fault)
    stopped = CommandFault(name, span, 0.0, JOINTS)
    targets = [_drive_end(circuit, number, fault.target, joint, "omega_ref") for joint in range(JOINTS)]
    circuit.insert_before(stopped, targets, ends([stopped], "input", "omega_ref"))
    # without a monitor nothing says whether the drives have power
    for line in power_lines(circuit):
        source = circuit.component(line[0], number, fault.target)
        port = next(port for port in source.outputs if port.name == line[1])
        off = PowerFault(f"{name}_{port.name}", span, port)
        circuit.insert_after(off, ends([source], "output", port.name), ends([off], "input", port.name))


def power_lines(circuit: Circuit) -> list[tuple[str, str]]:
    """(component, port) of what says whether the drives have power."""
    last = next((c for name in ("bus", "monitor") for c in circuit.components if c.name == name), None)
    lines = [port.name for port in last.outputs] if last else []
    return [(last.name, port) for port in ("drive_power", "power") if last and port in lines]


def _limit_command(circuit: Circuit, number: int, fault: Fault, speed_limit: float) -> None:
    """The magnitude is the limit, of a brown-out the share of `speed_limit` that the sagging supply leaves.

    Without load a motor's highest speed is proportional to its voltage.
    """
    joints = [_element_index(fault.target)] if fault.target.startswith("drive_") else list(range(JOINTS))
    targets = [_drive_end(circuit, number, fault.target, joint, "omega_ref") for joint in joints]
    times = speed_limit if fault.kind == "brown_out" else 1.0
    limited = CommandFault(*_name_and_span(number, fault), fault.magnitude * times, len(joints))
    limited.numbers = {"magnitude": ("limit", times)}
    circuit.insert_before(limited, targets, ends([limited], "input", "omega_ref"))


def _break_drive(circuit: Circuit, number: int, fault: Fault) -> None:
    """The magnitude is the speed of a runaway."""
    joint = _element_index(fault.target)
    theta_m = _drive_end(circuit, number, fault.target, joint, "theta_m")
    tau_load = circuit.feeds[_drive_end(circuit, number, fault.target, joint, "tau_load")]
    drive = circuit.component(theta_m.component, number, fault.target)
    start = float(drive.initial("theta_m")[theta_m.element])
    monitored = circuit.has("monitor")
    law, label = DRIVE_LAWS[fault.kind], f"[[fault]] {number}"
    broken = DriveFault(
        *_name_and_span(number, fault), law, fault.magnitude, start, monitored, drive.period, label, fault.target
    )
    if law == DriveLaw.DRIVE_RUNAWAY:
        broken.numbers = {"magnitude": ("omega", 1.0)}
    circuit.insert_after(broken, [theta_m], [End(broken.name, "theta_m")])
    circuit.feeds[End(broken.name, "tau_load")] = tau_load
    if monitored:
        component, port = power_lines(circuit)[0]
        axis = joint if port == "drive_power" else 0
        circuit.feeds[End(broken.name, "power")] = circuit.faulty_output(End(component, port, axis))


def _drive_end(circuit: Circuit, number: int, target: str, joint: int, port: str) -> End:
    """The end of one joint's drive."""
    if circuit.has(THREE_AXES):
        return End(THREE_AXES, port, joint)
    return End(circuit.component(f"drive_{joint + 1}", number, target).name, port)


def _change_parameter(circuit: Circuit, number: int, fault: Fault, written: list[str]) -> None:
    """The magnitude is a factor on the parameter, an addition where it has a unit; without one nothing is left."""
    place = FAULT_PLACES[fault.kind]
    element = _element_index(fault.target)
    owner = circuit.component(place.component, number, fault.target)
    field = place.memory_of(owner)
    if field is None:
        raise InputRefused(
            f"[[fault]] {number}: {fault.kind} writes {place.record}.{place.field} in the memory of component "
            f"'{owner.name}', which has none; remove the fault or use the native {owner.name}"
        )
    cell = field[0, element : element + 1] if field.ndim == 2 else field[0:1]
    factor, added = (
        (fault.magnitude, 0.0) if find_kind(number, fault.kind).unit in ("factor", None) else (1.0, fault.magnitude)
    )
    path = f"{place.component}.{place.field}[{element}]"
    chained = path in written
    name, span = _name_and_span(number, fault)
    changed = ParameterFault(name, span, owner, place.field, cell, factor, added, fault.ramp, chained)
    circuit.components.insert(len(written), changed)
    written.append(path)
