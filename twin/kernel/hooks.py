"""Hooks of this process: functions of higher modules that the kernel calls at certain moments."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Hooks:
    """The hooks that are set in this process; a guarded one sets them before its first job.

    Attributes:
        before_compiling: called once each, before this process compiles for the first time.
        compiling: called with True when this process begins to compile, and with False when it has done so, for
            timers: no component is to be charged with that.
        fmi_call: called with (file, instance, function) before each FMI call, and with function "" after it. A call may
            crash or hang; then only another process can name it. Steps are not announced: that would cost more than
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
