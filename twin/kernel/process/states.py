"""States of a run in its recording, and runs that go on from one.

A state is an attachment of the recording, written while the run goes on; a run that was interrupted, or whose machine
lost its power, goes on from the last one. It holds what steps have changed, what observers have found out, and of whom
it is: experiment, FMUs, code, processor. What differs in one of these would go on to other bits, and is refused.
"""

import hashlib
import json
import math
import signal
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from twin.kernel.compiled.machine import chosen_form
from twin.kernel.cosim import master
from twin.kernel.cosim.component import Component, NativeComponent
from twin.kernel.cosim.observers import Observer, SimulationResult, SystemOwner, TickEvent, simulate
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import MEDIA_TYPE, SavedState, stateless_reasons
from twin.kernel.cosim.subsystem import Subsystem
from twin.kernel.cosim.system import System
from twin.kernel.errors import InputRefused
from twin.kernel.fmi import cosim_step
from twin.kernel.process.reporter import ProcessProxy
from twin.kernel.recording.folder import FOLDER_STAMP
from twin.kernel.recording.reader import CONTINUES_KEY, attachments
from twin.kernel.recording.recorder import Recorder

RUN_FUNCTIONS = (master.advance.native, cosim_step.step, cosim_step.plain_step, cosim_step.event_step)
"""What steps a system, and FMUs in it."""
MISMATCH_REASONS = {
    "experiment": "of another experiment",
    "files": "of another FMU",
    "code": "of another version of twin's code",
    "versions": "of other versions of packages",
    "processor": "of another kind of processor",
}
"""What a state is, where the part of its identity is not that of the run."""


def identity(system: System, packages: Mapping[str, str], files: Mapping[str, str], made_of: Any) -> dict[str, Any]:
    """Of whom a state is: what the bits of a run depend on.

    Args:
        system: that is run.
        packages: and their versions.
        files: SHA-256 of FMUs and others by name.
        made_of: what the system was made of; what JSON can say.
    """
    digest = hashlib.sha256(json.dumps(made_of, sort_keys=True).encode()).hexdigest()
    # the name of a compiled function has a digest of all the source that it reaches
    names = sorted({*compiled_names(system.components), *(native.name for native in RUN_FUNCTIONS)})
    code = hashlib.sha256(" ".join(names).encode()).hexdigest()
    return {"experiment": digest, "files": dict(files), "code": code} | machine_identity(packages)


def compiled_names(components: Iterable[Component]) -> Iterator[str]:
    """Names of compiled functions that step `components`, wherever these live."""
    for component in components:
        if isinstance(component, Subsystem):
            yield from compiled_names(component.system.components)
        elif isinstance(component, ProcessProxy):
            yield from component.code
        elif isinstance(component, NativeComponent):
            yield component.step.name


def machine_identity(packages: Mapping[str, str]) -> dict[str, Any]:
    """The part of an identity that no experiment decides: versions of `packages`, and the processor."""
    return {
        "versions": {name: number for name, number in packages.items() if name != "twin"},
        "processor": chosen_form().name,
    }


def refuse_other_run(saved: SavedState, own: Mapping[str, Any], where: str) -> None:
    """Refuse a state that is not of the run that `own`, its `identity` or a part of it, says.

    Raises:
        InputRefused: it says what differs, and that the run can be made again.
    """
    its = saved.about.get("of")
    if not isinstance(its, dict):
        raise InputRefused(f"{where}: the state does not say of whom it is")
    for part, reason in MISMATCH_REASONS.items():
        if part in own and its.get(part) != own[part]:
            both = isinstance(its.get(part), dict) and isinstance(own[part], dict)
            detail = f": {_difference_text(its[part], own[part])}" if both else ""
            raise InputRefused(
                f"{where}: the state at {_time_text(saved)} is {reason}{detail}; it cannot be gone on from here, run "
                "the experiment again"
            )


def _difference_text(there: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    keys = [key for key in {**there, **here} if there.get(key) != here.get(key)]
    return ", ".join(f"{key} {str(there.get(key, '-'))[:12]}, here {str(here.get(key, '-'))[:12]}" for key in keys[:3])


def _time_text(saved: SavedState) -> str:
    time = saved.about.get("time")
    return f"{time:g} s" if isinstance(time, float) else f"tick {saved.tick}"


class RunStates(Observer):
    """Saves states of a run to its recording.

    Args:
        ticks: at which it is asked for.
        last_tick: of the run.
        tick: duration of a tick (s).
        about: `identity` of the run.
        lasting: the observers that go on, by name; the recorder is one of them.

    Attributes:
        lacking: why there are no states, as a sentence; "" if there are.
    """

    def __init__(
        self,
        ticks: Collection[int],
        last_tick: int,
        tick: float,
        about: Mapping[str, Any],
        lasting: Mapping[str, Observer],
    ):
        self._last_tick, self._tick = last_tick, tick
        self._asked = set(ticks)
        self.halts = sorted({*self._asked, last_tick})
        self._about, self._lasting = about, lasting
        self._end: bytes = b""
        self.lacking = ""

    def begin(self, simulation: Simulation) -> None:
        self._simulation, self._first = simulation, simulation.next_tick
        self.lacking = "; ".join(stateless_reasons(simulation.system.components))
        # after a halt at which nothing is written a recorder's block would have no room for the next slice
        self.halts = [self._last_tick] if self.lacking else self.halts

    def ready(self, tick: int) -> None:
        if self.lacking:
            return
        if tick == self._last_tick:
            self._end = self._content()
        elif tick in self._asked and tick > self._first:
            self._write(tick, self._content())

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        begun = first == self._simulation.system.first_tick
        if self.lacking and self._asked and first == self._simulation.next_tick - len(rows) and begun:
            text = f"no state is saved: {self.lacking}; twin run --from runs again from the start"
            events.append(TickEvent(first, "WARNING", text, "states"))
            events.sort(key=lambda event: event.tick)

    def save_on_interrupt(self) -> None:
        """The run ends here, before its time: save the state."""
        if not self.lacking and not self._simulation.failure and 0 < self._simulation.next_tick <= self._last_tick:
            self._write(self._simulation.next_tick, self._content())

    def finish(self) -> None:
        """The run has come to its end: what was saved just before it is recorded."""
        if self._end:
            self._write(self._last_tick, self._end)

    def _content(self) -> bytes:
        state = self._simulation.state()
        try:
            observers = {name: observer.state() for name, observer in self._lasting.items()}
            about = {"of": self._about, "time": state.tick * self._tick, "observers": observers}
            return state.saved(**about).to_bytes()
        finally:
            state.close()

    def _write(self, tick: int, content: bytes) -> None:
        recorder = self._lasting["recorder"]
        assert isinstance(recorder, Recorder)
        recorder.attach(tick, content, MEDIA_TYPE)


def state_ticks(times: Iterable[float], every: float | None, tick: float, last: int) -> set[int]:
    """Ticks within a run at which a state is asked for.

    Args:
        times: (s).
        every: time from one to the next (s); None: none.
        tick: duration of a tick (s).
        last: tick of the run.
    """
    ticks = {round(t / tick) for t in times}
    if every is not None:
        step = max(1, round(every / tick))
        ticks |= set(range(step, last, step))
    return {one for one in ticks if 0 < one < last}


class Interrupts(Observer):
    """Ends a run between two slices when Ctrl-C or SIGTERM asks for it; the second time at once.

    Attributes:
        enough: whether it was asked for.
    """

    enough = False

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Within the block, in the main thread of a process; elsewhere nothing changes."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        found = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        self._before: dict[int, Callable[[int, Any], Any]] = {n: one for n, one in found.items() if callable(one)}
        try:
            for number in self._before:
                signal.signal(number, self._note)
            yield
        finally:
            for number, handler in self._before.items():
                signal.signal(number, handler)

    def _note(self, number: int, frame: Any) -> None:
        self._asked = number
        if self.enough:
            self.end(frame)
        self.enough = True

    def end(self, frame: Any = None) -> None:
        """Raise what the signal would have raised."""
        self._before[self._asked](self._asked, frame)


def simulate_saving(
    assembly: SystemOwner,
    last_tick: int,
    observers: Sequence[Observer],
    slice_ticks: int,
    states: RunStates,
    saved: SavedState | None = None,
    lasting: Mapping[str, Observer] = MappingProxyType({}),
    adopt: Callable[[Simulation, SavedState], None] | None = None,
    timed: bool = True,
) -> SimulationResult:
    """`simulate` a system that is recorded: `states` are saved, the last one also where an interrupt ends it.

    Args:
        assembly, last_tick, observers, slice_ticks, lasting, adopt, timed: see `simulate`.
        states: what saves them; the last of a run is written by this.
        saved: the state to go on from; None: from tick 0.

    Raises:
        InputRefused: the state is of another system.
        KeyboardInterrupt: Ctrl-C or SIGTERM, once the state is saved.
    """
    interrupts = Interrupts()
    with interrupts.listening():
        # states first: what others change at the beginning of a tick is not in its state
        watching = [states, *observers, interrupts]
        done = simulate(assembly, last_tick, watching, slice_ticks, timed, saved, lasting, adopt)
        if interrupts.enough and not done.simulation.is_over:
            states.save_on_interrupt()
            interrupts.end()
        if not done.failure:
            states.finish()
    return done


@dataclass(frozen=True)
class StoredState:
    """A state that was found in a recording.

    Attributes:
        recording: the file.
        time: when it was taken (s).
        content: its bytes.
        branch: whether the experiment that goes on from it may be another one.
        alive: components of that experiment which the state does not hold, by their names; they are at its tick.
    """

    recording: Path
    time: float
    content: bytes
    branch: bool = False
    alive: Mapping[str, Component] = field(default_factory=dict)

    @property
    def saved_state(self) -> SavedState:
        """The state.

        Raises:
            InputRefused: the bytes are none.
        """
        return SavedState.from_bytes(self.content, str(self.recording))


def split_time(text: str) -> tuple[str, float | None]:
    """`results/NAME/latest@31.5` as the path and the time (s), None where none is given.

    Raises:
        InputRefused: what stands behind the @ is no time.
    """
    path, at, time = text.rpartition("@")
    if not at:
        return text, None
    try:
        seconds = float(time)
    except ValueError:
        seconds = math.nan
    if not 0.0 <= seconds < math.inf:
        raise InputRefused(f"--from {text}: {time!r} behind the @ is no time in seconds, 0 or more")
    return path, seconds


def stored_state(recording: Path, until: float | None) -> StoredState | None:
    """The last state in `recording` that was taken no later than `until` (s; None: the last one); None: there is none.

    Raises:
        RecordingRefused: it cannot be read.
    """
    found = None
    for time, content in attachments(recording, MEDIA_TYPE):
        if until is None or time <= until + 1e-9:
            found = StoredState(recording, time, content)
    return found


def continuation_metadata(state: StoredState) -> dict[str, dict[str, str]]:
    """What the recording that goes on from `state` says of it."""
    folder = state.recording.resolve().parent
    # where a folder lies that its user has named is private
    run = f"{folder.parent.name}/{folder.name}" if FOLDER_STAMP.fullmatch(folder.name) else folder.name
    return {CONTINUES_KEY: {"run": run, "time_s": f"{state.time:.9g}"}}
