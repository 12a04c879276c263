"""Shared memory that survives a crash: which call was in progress, when, with which inputs.

A file without a name, open in two processes. The writer maps it and pays a store per value (see
`twin.kernel.process.reporter.PipeReporter`), so the reader is not woken by what it need not know unless the
writer dies; it asks the operating system for the bytes when it wants to know.

Layout, native byte order: tick int64, component int64; from byte `_COMPILED_AT` on how long the writer has compiled and
since when it does so (ns, int64, of the system's clock; 0: it does not); from byte `_CALL_AT` on a call outside the
steps, its number and length int64 and its text; from byte `INPUTS_AT` on the inputs of all components, float64.

What a supervisor knows of a job: what the job has said, and what the black box shows.

The sentence about a job whose process ended without a result.
"""

import mmap
import os
import signal
import struct
import tempfile
import time
from dataclasses import dataclass, field
from typing import Any, NamedTuple

INPUTS_AT = 1024
_COMPILED_AT = 32
_CALL_AT = 64
"""A cache line of its own for the mark."""
_MARK_STRUCT = _COMPILED_STRUCT = _CALL_STRUCT = struct.Struct("=qq")
_TEXT_AT = _CALL_AT + _CALL_STRUCT.size
_MAX_PART_BYTES = 255
"""Bytes of each of the three parts of a call's text that are kept; as long as the name of a file may be."""
MAX_QUOTE_LENGTH = 200
_FMU_REMEDY = (
    "{file} is not fit to be used: tell its maker, with these facts; `--isolate none` runs it under a debugger."
)


class Call(NamedTuple):
    """A call into a component that has been announced and has not returned; `number` counts those of its process."""

    number: int
    file: str
    instance: str
    function: str


class BlackBox:
    """The reader's end; a context manager that gives the memory back.

    Attributes:
        fd: of the nameless file, to be inherited by the writer.
    """

    def __init__(self) -> None:
        # Windows has no fcntl, and no guarded processes either
        import fcntl

        if hasattr(os, "memfd_create"):
            fd = os.memfd_create("twin black box")
        else:
            with tempfile.TemporaryFile() as file:
                fd = os.dup(file.fileno())
        # where a standard stream is closed it would get its number, which is another file in the child
        self.fd = fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, 3)
        os.close(fd)
        os.ftruncate(self.fd, INPUTS_AT)

    def mark(self) -> tuple[int, int]:
        """(tick, component) of the step that is running or was the last to begin; see `SimulationMemory.mark`."""
        tick, component = _MARK_STRUCT.unpack(os.pread(self.fd, _MARK_STRUCT.size, 0))
        return tick, component

    def compile_time(self) -> float:
        """How long the writer has compiled until now (s)."""
        done, since = _COMPILED_STRUCT.unpack(os.pread(self.fd, _COMPILED_STRUCT.size, _COMPILED_AT))
        return 1e-9 * (done + (max(time.monotonic_ns() - since, 0) if since else 0))

    def call(self) -> Call | None:
        """The call that has been announced last, if it has not returned."""
        content = os.pread(self.fd, INPUTS_AT - _CALL_AT, _CALL_AT)
        number, length = _CALL_STRUCT.unpack_from(content)
        if not length:
            return None
        text = content[_CALL_STRUCT.size : _CALL_STRUCT.size + length].decode(errors="replace")
        # a living writer may be half-way through the next one
        file, instance, function, *_ = [*text.split("\0"), "", ""]
        return Call(number, file, instance, function)

    def inputs(self, start: int, count: int) -> tuple[float, ...]:
        """`count` of the inputs of all components from number `start` on, as the last steps saw them."""
        return struct.unpack(f"={count}d", os.pread(self.fd, 8 * count, INPUTS_AT + 8 * start))

    def close(self) -> None:
        os.close(self.fd)


class Announcer:
    """The writer's end for calls, and for the time in which there are none because something is compiled.

    Args:
        fd: of the nameless file.
    """

    def __init__(self, fd: int):
        self._memory = mmap.mmap(fd, INPUTS_AT)
        self._number = 0
        self._compiled, self._since = 0, 0

    def compiling(self, begins: bool) -> None:
        """Something is being compiled from now on, or no more. Fits `Hooks.compiling`."""
        now = time.monotonic_ns()
        if not begins:
            self._compiled += now - self._since
        self._since = now if begins else 0
        _COMPILED_STRUCT.pack_into(self._memory, _COMPILED_AT, self._compiled, self._since)

    def announce_call(self, file: str, instance: str, function: str) -> None:
        """A call begins; with function "" it has returned. Fits `Hooks.fmi_call`."""
        _CALL_STRUCT.pack_into(self._memory, _CALL_AT, self._number, 0)
        if function:
            text = b"\0".join(part.encode()[:_MAX_PART_BYTES] for part in (file, instance, function))
            self._memory[_TEXT_AT : _TEXT_AT + len(text)] = text
            self._number += 1
            # the length comes last: a process that is ended while it writes has not called yet
            _CALL_STRUCT.pack_into(self._memory, _CALL_AT, self._number, len(text))


@dataclass(frozen=True)
class Participant:
    """A component as the job described it.

    Attributes:
        name, label: see `twin.kernel.cosim.component.Component`.
        function: the FMI function its step calls, or empty.
        sampled: whether it is evaluated at a time rather than stepped over one.
        first_input: where its inputs start in the black box.
        inputs: (name, size, unit) of each input port.
    """

    name: str
    label: str
    function: str
    sampled: bool
    first_input: int
    inputs: tuple[tuple[str, int, str], ...]


@dataclass(frozen=True)
class SteppedSystem:
    """The system being stepped: tick (s), number of the last tick, components in the order of the mark."""

    tick: float
    last_tick: int
    components: tuple[Participant, ...]


@dataclass
class JobAccount:
    """Attributes:
    stepped: None while components are being made.
    unstepped: what to say of the time while `stepped` is None.
    helpers: component -> the process it lives in.
    """

    stepped: SteppedSystem | None = None
    unstepped: str = "before the first step"
    helpers: dict[str, int] = field(default_factory=dict)

    def update(self, report: dict[str, Any]) -> None:
        """Learn from a report of the kinds "loading", "stepping" and "helper"; others tell nothing."""
        if "loading" in report:
            self.stepped = None
            self.helpers.clear()
        elif "helper" in report:
            name, pid = report["helper"]
            self.helpers[name] = pid
        elif "stepping" in report:
            facts = report["stepping"]
            components = tuple(
                Participant(**{**c, "inputs": tuple((name, size, unit) for name, size, unit in c["inputs"])})
                for c in facts["components"]
            )
            self.stepped = SteppedSystem(facts["tick"], facts["last_tick"], components)

    def stepping(self, box: BlackBox) -> Participant | None:
        """The component whose step is running, or was when the process ended."""
        component = box.mark()[1]
        return self.stepped.components[component] if self.stepped and component >= 0 else None

    def is_busy(self, box: BlackBox) -> bool:
        """Whether a call into a component is running."""
        return box.call() is not None or self.stepping(box) is not None


def exit_phrase(status: int) -> str:
    """How a process ended by itself, as the verb phrase of a sentence.

    Args:
        status: exit status, negative for a signal.
    """
    if status >= 0:
        return f"ended the process with exit({status})"
    name = signal.Signals(-status).name
    if -status == signal.SIGKILL:
        return f"was killed from outside ({name}; the machine may have run out of memory)"
    if -status == signal.SIGABRT:
        return f"aborted the process ({name})"
    return f"crashed ({name}, {(signal.strsignal(-status) or 'unknown').lower()})"


def failure_message(
    account: JobAccount, box: BlackBox, manner: str, remedy: str | None, printed: str, culprit: str | None = None
) -> str:
    """Who ended the job: file, instance, function, simulated time, last inputs, remedy.

    Args:
        account, box: what is known.
        manner: verb phrase, see `manner`.
        remedy: a sentence; None: the one for an FMU that is broken.
        printed: what the job wrote at last.
        culprit: the component to blame; None: the one at work.
    """
    participant = _find_participant(account.stepped, culprit) if culprit else account.stepping(box)
    if (call := box.call()) and not culprit:
        _, file, instance, function = call
        who, where = f"{file} ({instance})", f"in {function}, {_time_phrase(account, box)}"
        participant = _find_participant(account.stepped, instance)
    elif account.stepped and participant:
        file = participant.label
        who = f"{file} ({participant.name})" if file else participant.name
        where = ("at " if participant.sampled else "in the step from ") + _time_text(account.stepped, box)
        where += f", in {participant.function} or the set and get calls around it" if participant.function else ""
    else:
        file, who = "", "the process of this job"
        where = f"between two steps, {_time_phrase(account, box)}"
    parts = [f"{who} {manner} {where}."]
    if participant:
        parts.append(f"Last inputs: {_last_inputs(participant, box)}.")
    if remedy or file:
        parts.append(remedy or _FMU_REMEDY.format(file=file))
    lines = printed.strip().splitlines()
    if lines:
        parts.append(f"It printed last: '{lines[-1][-MAX_QUOTE_LENGTH:]}'.")
    return " ".join(parts)


def _find_participant(stepped: SteppedSystem | None, name: str) -> Participant | None:
    return next((c for c in stepped.components if c.name == name), None) if stepped else None


def _time_phrase(account: JobAccount, box: BlackBox) -> str:
    return f"at {_time_text(account.stepped, box)}" if account.stepped else account.unstepped


def _time_text(stepped: SteppedSystem, box: BlackBox) -> str:
    tick = box.mark()[0]
    return f"t = {tick * stepped.tick:.6g} s, tick {tick}"


def _last_inputs(participant: Participant, box: BlackBox) -> str:
    """As `twin.kernel.cosim.component.named_values`, without numpy, which a supervisor does not load."""
    values = list(box.inputs(participant.first_input, sum(size for _, size, _ in participant.inputs)))
    texts = []
    for name, size, unit in participant.inputs:
        part, values = values[:size], values[size:]
        shown = f"{part[0]:.6g}" if size == 1 else "(" + ", ".join(f"{v:.6g}" for v in part) + ")"
        texts.append(f"{name} = {shown}" + ("" if unit == "1" else f" {unit}"))
    return ", ".join(texts) or "none"
