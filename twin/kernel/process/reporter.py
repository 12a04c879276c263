"""What a job reports to its parent, from a process of its own or from the same one.

What a job in a guarded process says to its supervisor.
"""

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
    """A component that stands for one in another process.

    Attributes:
        function: what `called_function` says of that one.
        code: names of twin's own compiled functions in it.
    """

    function: str
    code: tuple[str, ...] = ()


def called_function(component: Component) -> str:
    """The FMI function that a step of `component` calls, empty if it calls none."""
    if isinstance(component, FmuComponent):
        return component.step_call
    if isinstance(component, Subsystem):
        return ", ".join(dict.fromkeys(filter(None, map(called_function, component.system.components))))
    return component.function if isinstance(component, ProcessProxy) else ""


class Reporter(Protocol):
    """How a job speaks.

    A job is a function `job(reporter, **arguments)`; its notes and its result are what JSON can hold.
    """

    def note(self, **facts: Any) -> None:
        """Tell the one who listens to this job whatever the two have agreed on."""

    def loading(self) -> None:
        """From now on components are made; a failure is one of the input."""

    def progress(self, done: int, total: int) -> None:
        """`done` of `total` ticks are over. Fits `twin.robot.run.execute(progress=...)`."""

    def helper(self, name: str, pid: int) -> None:
        """The component `name` lives in the process `pid`."""


class DirectReporter:
    """For a job in the same process: without a supervisor, so only notes and progress are passed on."""

    def __init__(self, listen: Listen, show: Show = lambda done, total: None):
        self._listen, self.progress = listen, show

    def note(self, **facts: Any) -> None:
        self._listen(facts)

    def loading(self) -> None:
        """Nothing to say: errors are raised."""

    def helper(self, name: str, pid: int) -> None:
        """Nothing to say: its memory is not limited."""


def own_reporter() -> Reporter:
    """That of this process, for what no job hands on; without a listener, one that drops everything."""
    return HOOKS.reporter or DirectReporter(lambda note: None)


class PipeReporter:
    """For a job in a guarded process: a JSON object per line, and the black box.

    Args:
        pipe: where the supervisor reads.
        box: file descriptor of its `BlackBox`.

    Attributes:
        announcer: says which call is about to be made; there are dozens in a run, too many to wake the supervisor for.
    """

    def __init__(self, pipe: TextIO, box: int):
        self._pipe, self.box = pipe, box
        self.announcer = Announcer(box)

    def report(self, kind: str, content: Any) -> None:
        """Send one line."""
        self._pipe.write(json.dumps({kind: content}) + "\n")
        self._pipe.flush()

    def note(self, **facts: Any) -> None:
        self.report("note", facts)

    def loading(self) -> None:
        self.report("loading", None)

    def stepping(self, system: System, last_tick: int) -> SimulationMemory:
        """From now on `system` is stepped, in the memory returned. Fits `Hooks.memory`."""
        # never shorter: simulations before this one, which somebody may go back to, still look into it
        size = max(os.fstat(self.box).st_size, INPUTS_AT + 8 * max(1, system.inputs_width))
        os.ftruncate(self.box, size)
        # numpy keeps the mapping alive as long as an array looks into it
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
        """Nothing to say: the black box shows the tick."""

    def helper(self, name: str, pid: int) -> None:
        self.report("helper", [name, pid])
