"""Reports of a job to its parent, from a guarded process or from the parent's own process."""

import json
import mmap
import os
from collections.abc import Callable
from typing import Any, Protocol, TextIO

import numpy as np

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.simulation import NO_COMPONENT, SimulationMemory
from twin.kernel.cosim.subsystem import Subsystem
from twin.kernel.cosim.system import System
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.hooks import HOOKS
from twin.kernel.process.black_box import INPUTS_AT, Announcer

Listen = Callable[[dict[str, Any]], None]
Show = Callable[[int, int], None]


class ProcessProxy(Component):
    """A component that represents one in another process: its `called_function`, names of its compiled functions."""

    function: str
    code: tuple[str, ...] = ()


def called_function(component: Component) -> str:
    """Return the FMI function that a step of `component` calls; empty if it calls no FMU."""
    if isinstance(component, FmuComponent):
        return component.step_call
    if isinstance(component, Subsystem):
        return ", ".join(dict.fromkeys(filter(None, map(called_function, component.system.components))))
    return component.function if isinstance(component, ProcessProxy) else ""


class Reporter(Protocol):
    """Interface for reports of a job `job(reporter, **arguments)` to its parent; notes and result become JSON."""

    def note(self, **facts: Any) -> None:
        """Send a note, such as `note(line=text)`, as a dictionary to the parent's listener while the job runs."""

    def loading(self) -> None:
        """Report that components are being created from now on; a failure is then an input error."""

    def progress(self, done: int, total: int) -> None:
        """Report that `done` of `total` ticks are complete; fits `twin.robot.run.execute(progress=...)`."""

    def helper(self, name: str, pid: int) -> None:
        """Report that the component `name` runs in a process of its own, `pid`."""


class DirectReporter:
    """Reporter of a job in its parent's process, without a supervisor; passes on notes and progress only."""

    def __init__(self, listen: Listen, show: Show = lambda done, total: None):
        self._listen, self.progress = listen, show

    def note(self, **facts: Any) -> None:
        self._listen(facts)

    def loading(self) -> None:
        """Ignored, because errors of a job without a supervisor are raised directly."""

    def helper(self, name: str, pid: int) -> None:
        """Ignored, because the memory of a job without a supervisor is not limited."""


def own_reporter() -> Reporter:
    """Return the reporter of this process to its supervisor; without a supervisor, one that drops all reports."""
    return HOOKS.reporter or DirectReporter(lambda note: None)


class PipeReporter:
    """Reporter of a job in a guarded process: writes a JSON object per line, and the `BlackBox` of descriptor `box`.

    `announcer` writes calls to the black box; dozens per run are too many to wake the supervisor for.
    """

    def __init__(self, pipe: TextIO, box: int):
        self._pipe, self.box = pipe, box
        self.announcer = Announcer(box)

    def report(self, kind: str, content: Any) -> None:
        self._pipe.write(json.dumps({kind: content}) + "\n")
        self._pipe.flush()

    def note(self, **facts: Any) -> None:
        self.report("note", facts)

    def loading(self) -> None:
        self.report("loading", None)

    def stepping(self, system: System, last_tick: int) -> SimulationMemory:
        """Report that `system` is stepped; return its memory in the black box. Fits `Hooks.memory`."""
        # never shrink: earlier simulations, which may be resumed, still map it
        size = max(os.fstat(self.box).st_size, INPUTS_AT + 8 * max(1, system.inputs_width))
        os.ftruncate(self.box, size)
        # numpy keeps the mapping alive as long as an array refers to it
        mapped = mmap.mmap(self.box, size)
        memory = SimulationMemory(
            np.frombuffer(mapped, dtype=np.int64, count=2),
            np.frombuffer(mapped, dtype=np.float64, count=system.inputs_width, offset=INPUTS_AT),
        )
        memory.mark[:], memory.u[:] = (0, NO_COMPONENT), 0.0
        components = [
            {
                "name": component.name,
                "label": component.label,
                "function": called_function(component),
                "sampled": component.sampled,
                "first_input": int(start),
                "inputs": [[port.name, port.size, port.unit] for port in component.inputs],
            }
            for component, start in zip(system.components, system.u_start, strict=False)
        ]
        self.report("stepping", {"tick": system.tick, "last_tick": last_tick, "components": components})
        return memory

    def progress(self, done: int, total: int) -> None:
        """Ignored, because the supervisor reads the tick from the black box."""

    def helper(self, name: str, pid: int) -> None:
        self.report("helper", [name, pid])
