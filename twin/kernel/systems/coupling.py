"""Coupling of a planned system: FMUs initialised together, algebraic loops solved, components wired in the master."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.delay import play
from twin.kernel.cosim.loop import DIFFERENCE_STEP, MAX_PASSES, MAX_RESIDUAL, MIN_SCALE, LoopComponent
from twin.kernel.cosim.port import Port, by_port, width
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.fmi.component import FmuComponent, instance_class
from twin.kernel.fmi.description import refuse_step
from twin.kernel.fmi.instance import Instance
from twin.kernel.fmi.solvers import Solver
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.fmi.unpacked import unpacked
from twin.kernel.fmi.variable import Setup, stop_time
from twin.kernel.systems.loops import AlgebraicLoop, find_loops
from twin.kernel.systems.plan import SystemPart, SystemPlan


@dataclass(frozen=True)
class PreparedSystem:
    """A co-simulation system with initialised and coupled FMUs, ready to run.

    The plan lacks outputs that an FMU turned out not to return. `system` has components in plan order, parts of a
    solved loop merged into one. `settled`: every input initially equals its source. `columns` is the slice of a row by
    part name. `forgiven` are accepted violations of binaries.
    """

    plan: SystemPlan
    system: System
    settled: bool
    columns: Mapping[str, slice]
    loops: Sequence[AlgebraicLoop] = ()
    solved: bool = False
    forgiven: Sequence[str] = ()


def folders_of(plan: SystemPlan) -> dict[str, Path]:
    """Unpack the FMUs of a planned system; return their folders by SHA-256."""
    files = {part.description.sha256: part.description.path for part in plan.parts}
    return {sha256: unpacked(file, sha256) for sha256, file in files.items()}


@contextmanager
def couple_system(plan: SystemPlan, folders: Mapping[str, Path]) -> Iterator[PreparedSystem]:
    """Initialise and couple the FMUs of a planned system, unpacked in `folders` by SHA-256; free them after the block.

    All FMUs are in initialisation mode together until their inputs have the values of their sources. FMUs of FMI 1.0,
    which has no such mode, keep their start values.
    """
    refuse_steps(plan, "another --tick-ms or --step")
    found = find_loops(plan)
    solved = [_SolvableLoop(plan, loop) for loop in found] if plan.choice.loops == "solve" else []
    with ExitStack() as made:
        plan, components, settled, forgiven = initialise_fmus(
            plan, folders, made, _start_signals(plan), solved, free=True
        )
        wires = [*plan.wires]
        together = {**{one.name: one for one in plan.extras.components}, **components}
        columns: dict[str, tuple[str, int]] = {name: (name, 0) for name in components}
        for one in solved:
            wires = one.merge_parts(together, wires, columns)
        ordered = list(together.values())
        if plan.extras.order:
            ordered.sort(key=lambda component: plan.extras.order.index(component.name.partition("+")[0]))
        system = System(ordered, wires, plan.timing.tick, plan.scheme)
        system.first_tick = plan.timing.first
        yield PreparedSystem(plan, system, settled, _columns(plan, system, columns), found, bool(solved), forgiven)


def initialise_fmus(
    plan: SystemPlan,
    folders: Mapping[str, Path],
    made: ExitStack,
    given: Mapping[str, np.ndarray],
    solved: Sequence["_SolvableLoop"] = (),
    outputs_at_start: Mapping[str, Mapping[str, float | np.ndarray]] = MappingProxyType({}),
    free: bool = False,
) -> tuple[SystemPlan, dict[str, Component], bool, list[str]]:
    """Initialise the FMUs of a system together, and make components of them, which `made` closes.

    Return (plan, components, settled, forgiven) as of `PreparedSystem`. Arguments are as of `couple_system` and, by
    component, `FmuComponent`. `given` are initial outputs of components that are not FMUs, `solved` loops whose initial
    values are solved for. `free`: unread outputs may be non-finite, and unreadable local variables are dropped.
    """
    fed = {source for source, _ in plan.wires}
    parts: list[SystemPart] = []
    instances: dict[str, Instance] = {}
    for part in plan.parts:
        folder, setup = folders[part.description.sha256], _setup(plan, part)
        kind = instance_class(part.description)
        instances[part.name] = kind(part.path, part.description, folder, part.settings, (), setup)
        made.callback(instances[part.name].close)
    settled = _InitialValues(plan, instances, solved, given).settle()
    components: dict[str, Component] = {}
    for part in plan.parts:
        instance = instances[part.name]
        instance.begin()
        if free:
            part = _without_unreadable(part, instance, fed)
        parts.append(part)
        component = FmuComponent(
            part.name,
            part.description,
            instance.folder,
            part.inputs,
            part.outputs,
            outputs_at_start=outputs_at_start.get(part.name),
            instance=instance,
            solver=Solver(plan.choice.method),
            unread=[p.port.name for p in part.outputs if free and f"{part.name}.{p.port.name}" not in fed],
        )
        component.period = plan.timing.periods[part.path]
        made.callback(component.close)
        components[part.name] = component
    lacking = {part.path: instances[part.name].missing for part in plan.parts}
    forgiven = [f"{path} lacks {', '.join(missing)}" for path, missing in lacking.items() if missing]
    lost = [f"{old.path}.{port.variable.name}" for old, part in zip(plan.parts, parts, strict=True)
            for port in old.outputs if port not in part.outputs]  # fmt: skip
    return replace(plan, parts=tuple(parts), unreadable=tuple(lost)), components, settled, forgiven


def _without_unreadable(part: SystemPart, instance: Instance, fed: Collection[str]) -> SystemPart:
    """Drop local variables from a plan that feed nothing and that the FMU does not return."""
    readable = []
    for port in part.outputs:
        try:
            if port.variable.causality != "output" and f"{part.name}.{port.port.name}" not in fed:
                instance.values(port.variable)
        except ComponentFailed:
            continue
        readable.append(port)
    recorded = sum(port in readable for port in part.outputs[: part.recorded])
    return replace(part, outputs=tuple(readable), recorded=recorded)


def _setup(plan: SystemPlan, part: SystemPart) -> Setup:
    timing = plan.timing
    return Setup(
        part.description.tolerance,
        stop_time(timing.ticks or None, timing.tick, 1),
        timing.tick * timing.periods[part.path],
        waiting=True,
        lenient=plan.choice.lenient,
        start=timing.first * timing.tick,
    )


def _columns(plan: SystemPlan, system: System, places: Mapping[str, tuple[str, int]]) -> dict[str, slice]:
    """Return the columns of each part in an output row; `places` are its component and its offset there."""
    starts = {component.name: int(start) for component, start in zip(system.components, system.y_start, strict=False)}
    found = {}
    for component in plan.extras.components:
        found[component.name] = slice(starts[component.name], starts[component.name] + width(component.outputs))
    for part in plan.parts:
        owner, offset = places[part.name]
        first = starts[owner] + offset
        found[part.name] = slice(first, first + sum(port.port.size for port in part.outputs))
    return found


def refuse_steps(plan: SystemPlan, choice: str) -> None:
    """Check that all FMUs accept the step sizes of a plan; suggest the alternative `choice` otherwise."""
    for part in plan.parts:
        try:
            refuse_step(part.description, plan.timing.tick * plan.timing.periods[part.path], 1)
        except InputRefused as refusal:
            what = str(refusal).partition(": choose ")[0]
            raise InputRefused(f"{what}: choose {choice}") from None


class _SolvableLoop:
    """An algebraic loop of a system that can be solved, with the wires `leading_back` against the step order.

    Their values are the unknowns. `cure` has alternatives, for messages.
    """

    def __init__(self, plan: SystemPlan, loop: AlgebraicLoop):
        self._names, self.path = loop.parts, loop.path
        parts = {part.name: part for part in plan.parts if part.name in loop.parts}
        stuck = [part for part in parts.values() if not _can_repeat_step(part)]
        others = [f"--kind {part.path}=model_exchange" for part in stuck if "model_exchange" in part.description.kinds]
        self.cure = " or ".join([*others, "--loops delay"]) + " does without"
        order = {name: number for number, name in enumerate(loop.parts)}
        self.leading_back = [
            (source, target)
            for source, target in plan.wires
            if (first := source.partition(".")[0]) in order
            and (second := target.partition(".")[0]) in order
            and order[first] >= order[second]
        ]
        file = plan.package.file
        for part in parts.values():
            if plan.timing.periods[part.path] > 1:
                raise InputRefused(f"{file}: {part.path} of the loop {loop.path} has longer steps; {self.cure}")
            for port in part.inputs:
                fed = any(target == f"{part.name}.{port.port.name}" for _, target in self.leading_back)
                if fed and (port.port.kind != "double" or port.variable.variability != "continuous"):
                    what = f"{part.path}.{port.variable.name} of the loop {loop.path}"
                    raise InputRefused(f"{file}: {what} is not continuous; {self.cure}")
        if stuck:
            why = "has no FMU state to go back to the start of a step (canGetAndSetFMUstate)"
            raise InputRefused(f"{file}: {stuck[0].path} of the loop {loop.path} {why}; {self.cure}")

    def merge_parts(
        self, components: dict[str, Component], wires: list[tuple[str, str]], columns: dict[str, tuple[str, int]]
    ) -> list[tuple[str, str]]:
        """Merge the loop's components into one that solves it, at the first part's place; return the remaining wires.

        `components` and `columns` are updated in place.
        """
        name = "+".join(self._names)
        members = [components[part] for part in self._names]
        places = {f"{one.name}.{port.name}": port for one in members for port in one.inputs}
        inner, outer, given = [], [], []
        for source, target in wires:
            inside = [end.partition(".")[0] in self._names for end in (source, target)]
            if all(inside):
                inner.append((source, target))
                continue
            if inside[1]:
                port = places[target]
                # a wire end has exactly two names, component and port
                entry = target.replace(".", "__")
                given.append(Port(entry, port.size, port.unit, port.meaning, port.kind))
                inner.append((f"{LoopComponent.INPUT_OWNER}.{entry}", target))
                target = f"{name}.{entry}"
            if inside[0]:
                source = f"{name}.{source.replace('.', '__')}"
            outer.append((source, target))
        loop = LoopComponent(name, tuple(given), members, inner, self.path, self.cure)
        offset = 0
        for member in members:
            columns[member.name] = name, offset
            offset += len(member.initial_outputs)
        remaining = [(name, loop) if one == self._names[0] else (one, c) for one, c in components.items()]
        components.clear()
        components.update((one, c) for one, c in remaining if one not in self._names)
        return outer


def _can_repeat_step(part: SystemPart) -> bool:
    description = part.description
    return description.kind == "model_exchange" or getattr(description.interface, "canGetAndSetFMUstate", False)


class _InitialValues:
    """Propagator of initial values, FMU outputs and `given` ones, to FMU inputs in initialisation mode."""

    def __init__(
        self,
        plan: SystemPlan,
        instances: Mapping[str, Instance],
        solved: Sequence[_SolvableLoop],
        given: Mapping[str, np.ndarray],
    ):
        self._plan, self._solved = plan, solved
        ports, inputs = (
            {
                f"{part.name}.{port.port.name}": (instances[part.name], port)
                for part in plan.parts
                for port in getattr(part, side)
            }
            for side in ("outputs", "inputs")
        )
        led = {
            (source, target): (*ports[source], *inputs[target])
            for source, target in plan.wires
            if source in ports and target in inputs and _is_readable(*ports[source], inputs[target][1])
        }
        self._written = dict.fromkeys(map(id, instances.values()), 0)
        """Number of inputs written per instance; its outputs change only if this number does."""
        for start, end in plan.wires:
            if start in given and end in inputs and np.all(np.isfinite(given[start])):
                self._set_input(*inputs[end], inputs[end][1].to_fmu(given[start]))
        back = {wire for loop in solved for wire in loop.leading_back}
        self._back = [one for wire, one in led.items() if wire in back]
        self._led = [one for wire, one in led.items() if wire not in back]
        self._last: dict[int, bytes] = {}
        self._read: dict[int, int] = {}

    def settle(self) -> bool:
        """Propagate initial values between FMUs until all agree, and solve loops; return False if they do not."""
        if not self._back:
            return self._propagate()
        z = np.concatenate([source.read_floats([output.variable]) for source, output, _, _ in self._back])
        step, f = np.zeros_like(z), self._residual(z)
        scale = np.maximum(np.abs(z), MIN_SCALE)
        for _ in range(MAX_PASSES):
            scale = np.maximum(scale, np.abs(z))
            if np.all(np.abs(f) <= MAX_RESIDUAL * scale):
                return True
            step = self._newton(z, f, scale)
            # backtracking: halve the step until the residual decreases
            for _ in range(10):
                tried = self._residual(z + step)
                if np.all(np.isfinite(tried)) and np.abs(tried).max() <= 2.0 * np.abs(f).max():
                    break
                step = 0.5 * step
            z, f = z + step, self._residual(z + step)
        paths, cure = ", ".join(loop.path for loop in self._solved), self._solved[0].cure
        raise InputRefused(
            f"{self._plan.package.file}: no start values of the loop {paths} are found: the residual is "
            f"{np.max(np.abs(f) / scale):.3g} after {MAX_PASSES} passes, expected at most {MAX_RESIDUAL:g}; give start "
            f"values nearer to them, or {cure}"
        )

    def _newton(self, z: np.ndarray, f: np.ndarray, scale: np.ndarray) -> np.ndarray:
        nudge = DIFFERENCE_STEP * np.maximum(scale, 1e-3)
        moved = [self._residual(z + nudge[i] * np.eye(len(z))[i]) for i in range(len(z))]
        jacobian = np.array([(one - f) / nudge[i] for i, one in enumerate(moved)]).T
        return np.asarray(-np.linalg.lstsq(jacobian, f, rcond=None)[0], dtype=float)

    def _residual(self, z: np.ndarray) -> np.ndarray:
        """Return the loop's residual: fed-back values after one propagation minus `z`."""
        place = 0
        for _, output, target, port in self._back:
            self._set_input(target, port, port.to_fmu(z[place : place + output.port.size]))
            place += output.port.size
        self._propagate()
        return np.concatenate([source.read_floats([output.variable]) for source, output, _, _ in self._back]) - z

    def _propagate(self) -> bool:
        """Propagate values from FMU outputs to inputs until nothing changes; return False if it does not converge."""
        for _ in range(len(self._plan.parts) + 2):
            changed = False
            for n, (source, output, target, port) in enumerate(self._led):
                if self._read.get(n) == self._written[id(source)]:
                    continue
                self._read[n] = self._written[id(source)]
                value = np.asarray(port.to_fmu(source.read_floats([output.variable])), dtype=float)
                if np.all(np.isfinite(value)) and self._last.get(n) != value.tobytes():
                    self._last[n], changed = value.tobytes(), True
                    self._set_input(target, port, value)
            if not changed:
                return True
        return False

    def _set_input(self, target: Instance, port: FmuPort, value: float | np.ndarray) -> None:
        values = np.asarray(value, dtype=float)
        for one in values:
            if port.variable.range_error(one):
                what = f"{port.variable.name}, {port.variable.range_phrase}"
                raise ComponentFailed(f"{target.label} gets {one:.17g} for {what}, at the start")
        try:
            target.write([(port.variable, values if port.variable.size > 1 else float(values[0]))])
        except ComponentFailed as failure:
            text = str(failure).removeprefix(f"{target.label} ")
            raise InputRefused(f"{target.description.path}: cannot be initialised: {text}") from None
        self._written[id(target)] += 1


def _start_signals(plan: SystemPlan) -> dict[str, np.ndarray]:
    start = np.array([plan.timing.first * plan.timing.tick])
    found: dict[str, np.ndarray] = {}
    for component in plan.extras.components:
        if component.name in plan.extras.signals:
            rows, _ = play(component, start, np.array([plan.timing.tick]), np.zeros((1, 0)))
            found |= {f"{component.name}.{name}": v for name, v in by_port(component.outputs, rows[0]).items()}
    return found


def _is_readable(source: Instance, output: FmuPort, port: FmuPort) -> bool:
    """Whether a connection between FMUs can transfer values in initialisation mode; clocked variables cannot."""
    return source.description.version > 1 and not output.variable.clocks and not port.variable.clocks
