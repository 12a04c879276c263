"""The black box of a job: shared memory that survives a crash, and the error message about the crashed process.

It shows the call in progress, its time and its inputs. It is a nameless file that two processes open. The writer maps
it and pays one store per value (see `twin.kernel.process.reporter.PipeReporter`); the reader is not woken, but reads
the bytes through the operating system when it needs them.

Layout, native byte order:
- tick int64, component int64
- from byte `_COMPILED_AT`: compile time so far and start of the running compilation (ns, int64, of the system's clock;
  0 if not compiling)
- from byte `_CALL_AT`: a call outside the steps: number and length int64, then its text
- from byte `INPUTS_AT`: the inputs of all components, float64
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
"""Offset of the announced call; its own cache line."""
_MARK_STRUCT = _COMPILED_STRUCT = _CALL_STRUCT = struct.Struct("=qq")
_TEXT_AT = _CALL_AT + _CALL_STRUCT.size
_MAX_PART_BYTES = 255
"""Maximum length of each of the three parts of a call's text (bytes): the maximum length of a file name."""
MAX_QUOTE_LENGTH = 200
_FMU_REMEDY = "{file} is unusable: report this message to its vendor; `--isolate none` runs it under a debugger."


class Call(NamedTuple):
    """A call into a component that was announced and may not have returned; `number` counts its process's calls."""

    number: int
    file: str
    instance: str
    function: str


class BlackBox:
    """The supervisor's end of a black box: memory shared with a process, which notes its present activity there.

    The writer inherits `fd`, the descriptor of the nameless file.
    """

    def __init__(self) -> None:
        # Windows has neither fcntl nor guarded processes
        import fcntl

        if hasattr(os, "memfd_create"):
            fd = os.memfd_create("twin black box")
        else:
            with tempfile.TemporaryFile() as file:
                fd = os.dup(file.fileno())
        # a descriptor below 3, possible if a standard stream is closed, would be another file in the child
        self.fd = fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, 3)
        os.close(fd)
        os.ftruncate(self.fd, INPUTS_AT)

    def mark(self) -> tuple[int, int]:
        """Return (tick, component) of the process's running or last step; see `SimulationMemory.mark`."""
        tick, component = _MARK_STRUCT.unpack(os.pread(self.fd, _MARK_STRUCT.size, 0))
        return tick, component

    def compile_time(self) -> float:
        """Return the time that the process has spent compiling until now (s)."""
        done, since = _COMPILED_STRUCT.unpack(os.pread(self.fd, _COMPILED_STRUCT.size, _COMPILED_AT))
        return 1e-9 * (done + (max(time.monotonic_ns() - since, 0) if since else 0))

    def call(self) -> Call | None:
        """Return the last FMI call that the process announced; None if it has returned."""
        content = os.pread(self.fd, INPUTS_AT - _CALL_AT, _CALL_AT)
        number, length = _CALL_STRUCT.unpack_from(content)
        if not length:
            return None
        text = content[_CALL_STRUCT.size : _CALL_STRUCT.size + length].decode(errors="replace")
        # the writer may be in the middle of writing the next call
        file, instance, function, *_ = [*text.split("\0"), "", ""]
        return Call(number, file, instance, function)

    def inputs(self, start: int, count: int) -> tuple[float, ...]:
        """Return inputs number `start` to `start` + `count` of all components, at their last steps."""
        return struct.unpack(f"={count}d", os.pread(self.fd, 8 * count, INPUTS_AT + 8 * start))

    def close(self) -> None:
        os.close(self.fd)


class Announcer:
    """The writer's end of a black box: a process notes its FMI calls and compile time there for its supervisor."""

    def __init__(self, fd: int):
        self._memory = mmap.mmap(fd, INPUTS_AT)
        self._number = 0
        self._compiled, self._since = 0, 0

    def compiling(self, begins: bool) -> None:
        """Note in the black box that a compilation begins or ends. Fits `Hooks.compiling`."""
        now = time.monotonic_ns()
        if not begins:
            self._compiled += now - self._since
        self._since = now if begins else 0
        _COMPILED_STRUCT.pack_into(self._memory, _COMPILED_AT, self._compiled, self._since)

    def announce_call(self, file: str, instance: str, function: str) -> None:
        """Note in the black box that an FMI call begins, or has returned (empty `function`); for `Hooks.fmi_call`."""
        _CALL_STRUCT.pack_into(self._memory, _CALL_AT, self._number, 0)
        if function:
            text = b"\0".join(part.encode()[:_MAX_PART_BYTES] for part in (file, instance, function))
            self._memory[_TEXT_AT : _TEXT_AT + len(text)] = text
            self._number += 1
            # the length is written last: a process killed before that has not called yet
            _CALL_STRUCT.pack_into(self._memory, _CALL_AT, self._number, len(text))


@dataclass(frozen=True)
class Participant:
    """A component of the running job, for error messages: `function` is the FMI function that its step calls, or "".

    `sampled`: evaluated at a time rather than stepped over an interval. `first_input` is an index in the black box.
    `inputs` are (name, size, unit) of each port.
    """

    name: str
    label: str
    function: str
    sampled: bool
    first_input: int
    inputs: tuple[tuple[str, int, str], ...]


@dataclass(frozen=True)
class SteppedSystem:
    """Description of the system being stepped: tick (s), last tick, components in the order of the mark."""

    tick: float
    last_tick: int
    components: tuple[Participant, ...]


@dataclass
class JobAccount:
    """A supervisor's knowledge of a job from its reports: the system `stepped`, None while components are created.

    `unstepped` is a phrase for that time, `helpers` the pid of the process of each component that has one.
    """

    stepped: SteppedSystem | None = None
    unstepped: str = "before the first step"
    helpers: dict[str, int] = field(default_factory=dict)

    def update(self, report: dict[str, Any]) -> None:
        """Update the supervisor's knowledge from a report of kind "loading", "stepping" or "helper"; ignore others."""
        if "loading" in report:
            self.stepped = None
            self.helpers.clear()
        elif "helper" in report:
            name, pid = report["helper"]
            self.helpers[name] = pid
        elif "stepping" in report:
            facts = report["stepping"]
            listed = [one | {"inputs": tuple(map(tuple, one["inputs"]))} for one in facts["components"]]
            self.stepped = SteppedSystem(facts["tick"], facts["last_tick"], tuple(Participant(**one) for one in listed))

    def stepping(self, box: BlackBox) -> Participant | None:
        """Return the component whose step is running, or was running when the process ended; None between steps."""
        component = box.mark()[1]
        return self.stepped.components[component] if self.stepped and component >= 0 else None

    def is_busy(self, box: BlackBox) -> bool:
        return box.call() is not None or self.stepping(box) is not None


def exit_phrase(status: int) -> str:
    """Describe how a process ended by itself, from its exit `status` (negative for a signal), as a verb phrase."""
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
    """Compose the error message about a failed job: file, instance, function, simulated time, last inputs, remedy.

    `manner` is as from `exit_phrase`, `remedy` a sentence (None: about a broken FMU), `printed` the job's last output,
    `culprit` the component to blame (None: the one at work).
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
    if lines := printed.strip().splitlines():
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
    """Format a component's last inputs with names and units, without NumPy, which a supervisor does not load."""
    values = list(box.inputs(participant.first_input, sum(size for _, size, _ in participant.inputs)))
    texts = []
    for name, size, unit in participant.inputs:
        part, values = values[:size], values[size:]
        shown = f"{part[0]:.6g}" if size == 1 else "(" + ", ".join(f"{v:.6g}" for v in part) + ")"
        texts.append(f"{name} = {shown}" + ("" if unit == "1" else f" {unit}"))
    return ", ".join(texts) or "none"
