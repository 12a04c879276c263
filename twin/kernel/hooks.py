"""Hooks of this process: callbacks that the kernel invokes and higher modules register."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Hooks:
    """The callbacks of this process for compilations, FMI calls and simulations; a guarded process registers its own.

    Attributes:
        before_compiling: called once each, before this process compiles for the first time.
        compiling: called with True when a compilation begins, with False when it ends, so that timers can exclude it.
        fmi_call: called with (file, instance, function) before each FMI call, and with function "" after it. A call may
            crash or hang, and only another process can then name it. Steps are not announced: that would cost more than
            they take (see `SimulationMemory.mark`).
        memory: called with (system, last tick), returns the `SimulationMemory` of a simulation, which another process
            can read after a crash; None for private memory.
        reporter: the `Reporter` of this process; None without a supervisor.
    """

    before_compiling: list[Callable[[], None]] = field(default_factory=list)
    compiling: list[Callable[[bool], None]] = field(default_factory=list)
    fmi_call: list[Callable[[str, str, str], None]] = field(default_factory=list)
    memory: Callable[..., Any] | None = None
    reporter: Any = None


HOOKS = Hooks()
