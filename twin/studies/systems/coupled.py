"""A planned system made: its FMUs loaded, initialised together, and joined."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.system import System
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.description import refuse_step
from twin.kernel.fmi.instance import Instance
from twin.kernel.fmi.lifecycle import CosimInstance
from twin.kernel.fmi.setting import Setup, stop_time
from twin.kernel.fmi.stepping import FmuPort
from twin.studies.systems.plan import Part, Plan

_T = TypeVar("_T")


@dataclass(frozen=True)
class Coupled:
    """A system ready to be run.

    Attributes:
        system: of components in the order of the plan.
        settled: whether initial values agree with each other: an input has what feeds it, and that follows from it.
    """

    system: System
    settled: bool


@contextmanager
def coupled(plan: Plan, folders: Mapping[str, Path]) -> Iterator[Coupled]:
    """The system of a plan, whose FMUs are freed at the end.

    All FMUs are in initialisation mode together, until their inputs have what feeds them; those of FMI 1.0, which has
    no such mode, have their start values then.

    Args:
        plan: of the system.
        folders: where FMUs are unpacked, by their SHA-256.

    Raises:
        InputRefused: an FMU cannot be loaded or initialised, or takes no such steps.
    """
    tick, ticks = plan.timing.tick, plan.timing.ticks
    for part in plan.parts:
        _refuse_step(part, tick)
    with ExitStack() as made:
        instances: dict[str, Instance] = {}
        for part in plan.parts:
            description = part.description
            setup = Setup(description.tolerance, stop_time(ticks, tick, 1), tick, waiting=True)
            folder = folders[description.sha256]
            instances[part.name] = CosimInstance(part.path, description, folder, part.settings, (), setup)
            made.callback(instances[part.name].close)
        settled = _settle(plan, instances)
        components: list[Component] = []
        for part in plan.parts:
            instance = instances[part.name]
            instance.begin()
            components.append(
                FmuComponent(
                    part.name,
                    part.description,
                    instance.folder,
                    part.inputs,
                    part.outputs,
                    part.settings,
                    setup=instance.setup,
                    instance=instance,
                )
            )
            made.callback(components[-1].close)
        yield Coupled(System(components, plan.wires, tick, plan.scheme), settled)


def _refuse_step(part: Part, tick: float) -> None:
    try:
        refuse_step(part.description, tick, 1)
    except InputRefused as refusal:
        raise InputRefused(f"{str(refusal).partition(': choose ')[0]}: choose another --tick-ms") from None


def _settle(plan: Plan, instances: dict[str, Instance]) -> bool:
    """Give every input what feeds it, again and again until nothing changes; False: it never ends."""
    ports = {
        f"{part.name}.{port.port.name}": (instances[part.name], port) for part in plan.parts for port in part.outputs
    }
    inputs = {
        f"{part.name}.{port.port.name}": (instances[part.name], port) for part in plan.parts for port in part.inputs
    }
    led = [
        (*ports[source], *inputs[target])
        for source, target in plan.wires
        if _readable(*ports[source], inputs[target][1])
    ]
    last: dict[int, bytes] = {}
    for _ in range(len(plan.parts) + 2):
        changed = False
        for number, (source, output, target, port) in enumerate(led):
            value = np.asarray(port.in_fmu(_read(source, output)), dtype=float)
            if np.all(np.isfinite(value)) and last.get(number) != value.tobytes():
                last[number], changed = value.tobytes(), True
                _write(target, port, value)
        if not changed:
            return True
    return False


def _readable(source: Instance, output: FmuPort, port: FmuPort) -> bool:
    """Whether there is something to be read, and to be set, in initialisation mode; a clock has not ticked there."""
    return source.description.version > 1 and not output.variable.clocks and not port.variable.clocks


def _read(instance: Instance, port: FmuPort) -> np.ndarray:
    return _tried(instance, lambda: instance.read([port.variable]))


def _write(instance: Instance, port: FmuPort, value: np.ndarray) -> None:
    _tried(instance, lambda: instance.write([(port.variable, value if port.variable.size > 1 else float(value[0]))]))


def _tried(instance: Instance, call: Callable[[], _T]) -> _T:
    try:
        return call()
    # FMPy's FMICallException and whatever is below it
    except Exception as problem:
        said = f" (it said: {'; '.join(instance.messages)})" if instance.messages else ""
        raise InputRefused(f"{instance.description.path}: cannot be initialised: {problem}{said}") from None
