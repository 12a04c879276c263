"""Injection of faults into the wires of a healthy system.

Each fault is a component in the wires. Faults without effect and impossible faults are refused.
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
"""Name of a drive for all joints; single drives are drive_1 .. drive_3."""
COUNT_LAWS = {f"encoder_{law.name.lower()}": law for law in CountLaw}
LEAST_COUNTS = {CountLaw.BIAS: 0.5, CountLaw.GLITCH: 0.5, CountLaw.QUANTISATION: 2.0}
"""Minimum magnitude (counts) with an effect, by law."""
DRIVE_LAWS = {law.name.lower(): law for law in DriveLaw}
CONTROLLER, REMOTE = "controller", "remote"
"""Names of the controllers: the experiment's, and one behind a wire."""
BUS_TARGET = "bus"
"""Target of faults on the commands between the computer and the drives."""


class Circuit:
    """An editable copy of a system's wiring, into which faults are inserted.

    Components are shared with the system, in the order of evaluation within a tick.
    """

    def __init__(self, components: Iterable[Component], feeds: Mapping[End, End]):
        self.components = list(components)
        self.feeds = dict(feeds)
        self._stand_ins: dict[End, End] = {}

    def component(self, name: str, number: int, target: str) -> Component:
        """Return the component `name`; refuse fault `number` on `target` if it does not exist."""
        for component in self.components:
            if component.name == name:
                return component
        names = ", ".join(c.name for c in self.components) or "none"
        raise InputRefused(
            f"[[fault]] {number} target = \"{target}\": expected a system with a component '{name}'; "
            f"there are {names}. Change the target or add what it names"
        )

    def has(self, name: str) -> bool:
        return any(component.name == name for component in self.components)

    def faulty_output(self, output: End) -> End:
        """Return the output that readers of a signal now get: of its last inserted fault, else the signal itself."""
        return self._stand_ins.get(output, output)

    def insert_after(self, fault: Component, outputs: Sequence[End], inputs: Sequence[End]) -> None:
        """Insert a fault component between output signals and all of their readers, behind earlier faults.

        The fault has outputs with the same names as its inputs.
        """
        sources = [self.faulty_output(output) for output in outputs]
        instead = dict(zip(sources, inputs, strict=True))
        self.feeds = {target: instead.get(source, source) for target, source in self.feeds.items()}
        self.feeds.update(zip(inputs, sources, strict=True))
        self._stand_ins.update(zip(outputs, inputs, strict=True))
        self.insert(fault, sources)

    def insert_before(self, fault: Component, targets: Sequence[End], inputs: Sequence[End]) -> None:
        """Insert a fault component in front of some inputs: it reads their sources and feeds them."""
        sources = [self.feeds[target] for target in targets]
        self.feeds.update(zip(targets, inputs, strict=True))
        self.feeds.update(zip(inputs, sources, strict=True))
        self.insert(fault, sources)

    def insert(self, fault: Component, sources: Iterable[End]) -> None:
        """Insert a fault component into the evaluation order, right after the last component that feeds it.

        Its outputs may be NaN if those of a source may.
        """
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
    """Insert faults into a system and return its new components and wiring; the arguments stay unchanged.

    Fault n of the list is the component "fault_n"; each member of a group counts. Faults on one signal act in the order
    of the list. Faults with the mechanism "body" belong to the surface and are skipped.

    Args:
        components, feeds: healthy system with the components encoder, estimator, controller, monitor (optional),
            drive or drive_1 .. drive_3, and plant.
        tick: duration of a tick (s).
        counts_per_turn: counts per turn of motor and joint encoders.
        speed_limit: speed limit of a drive (rad/s).

    Raises:
        InputRefused: an unknown kind or target, or a magnitude without effect.
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
    """Return the index, from 0, of the axis in a fault's target such as "drive_2"; 0 without a number."""
    last = target.rpartition("_")[2]
    return int(last) - 1 if last.isdigit() else 0


def _name_and_span(number: int, fault: Fault) -> tuple[str, Span]:
    return f"fault_{number}", Span(fault.onset, fault.end)


def _break_encoder(
    circuit: Circuit, number: int, fault: Fault, tick: float, counts_per_turn: tuple[float, float]
) -> None:
    """Insert a fault of encoder counts into the wiring.

    The magnitude is an angle of the encoder's shaft, a speed (drift) or a share of samples (dropout).
    """
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
    """Insert a fault that delays or loses messages.

    The magnitude is a delay, the maximum of random delays, or the share of lost messages.
    """
    targets: list[End] = []
    if fault.target == BUS_TARGET:
        targets = [_drive_end(circuit, number, fault.target, joint, "omega_ref") for joint in range(JOINTS)]
        sender = circuit.component(circuit.feeds[targets[0]].component, number, fault.target)
        ports: tuple[Port, ...] = (Port("omega_ref", JOINTS, "rad/s", "commanded motor speed, as it arrives"),)
    else:
        # the commands of a remote controller, if the drives obey one
        name = REMOTE if fault.target == CONTROLLER and circuit.has(REMOTE) else fault.target
        sender = circuit.component(name, number, fault.target)
        # of the controller's outputs only the command leaves the computer
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
        # without a gate, drives that cannot be switched would obey a late command that the bus still delivers; without
        # faults the monitor stops them through its command, see docs/safety.md
        if lines := power_lines(circuit):
            gate = PowerGate(f"{late.name}_power", len(targets))
            circuit.insert_before(gate, targets, ends([gate], "input", "omega_ref"))
            circuit.feeds[End(gate.name, "power")] = circuit.faulty_output(End(lines[-1][0], "power"))
        return
    sent = [end for port in ports for end in ends([sender], "output", port.name)]
    circuit.insert_after(late, sent, [end for port in ports for end in ends([late], "input", port.name)])


def _cut_power(circuit: Circuit, number: int, fault: Fault) -> None:
    """Insert a power failure into the wiring: all drives lose their power and their motion command."""
    name, span = _name_and_span(number, fault)
    stopped = CommandFault(name, span, 0.0, JOINTS)
    targets = [_drive_end(circuit, number, fault.target, joint, "omega_ref") for joint in range(JOINTS)]
    circuit.insert_before(stopped, targets, ends([stopped], "input", "omega_ref"))
    # power signals exist only with a monitor
    for line in power_lines(circuit):
        source = circuit.component(line[0], number, fault.target)
        port = next(port for port in source.outputs if port.name == line[1])
        off = PowerFault(f"{name}_{port.name}", span, port)
        circuit.insert_after(off, ends([source], "output", port.name), ends([off], "input", port.name))


def power_lines(circuit: Circuit) -> list[tuple[str, str]]:
    """Return (component, port) of each signal that powers the drives."""
    last = next((c for name in ("bus", "monitor") for c in circuit.components if c.name == name), None)
    lines = [port.name for port in last.outputs] if last else []
    return [(last.name, port) for port in ("drive_power", "power") if last and port in lines]


def _limit_command(circuit: Circuit, number: int, fault: Fault, speed_limit: float) -> None:
    """Insert a limit of the commanded drive speeds.

    The magnitude is the limit; in a brown-out the remaining share of `speed_limit`, as a motor's no-load speed is
    proportional to its voltage.
    """
    joints = [_element_index(fault.target)] if fault.target.startswith("drive_") else list(range(JOINTS))
    targets = [_drive_end(circuit, number, fault.target, joint, "omega_ref") for joint in joints]
    times = speed_limit if fault.kind == "brown_out" else 1.0
    limited = CommandFault(*_name_and_span(number, fault), fault.magnitude * times, len(joints))
    limited.numbers = {"magnitude": ("limit", times)}
    circuit.insert_before(limited, targets, ends([limited], "input", "omega_ref"))


def _break_drive(circuit: Circuit, number: int, fault: Fault) -> None:
    """Insert a fault of one joint's drive. The magnitude is the speed of a runaway."""
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
    """Return the wire end of a port for one joint's drive, whether drives are separate or one for three axes."""
    if circuit.has(THREE_AXES):
        return End(THREE_AXES, port, joint)
    return End(circuit.component(f"drive_{joint + 1}", number, target).name, port)


def _change_parameter(circuit: Circuit, number: int, fault: Fault, written: list[str]) -> None:
    """Insert a fault that changes a parameter of a component.

    The magnitude is a factor (0 without a magnitude), or a summand if it has a unit.
    """
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
