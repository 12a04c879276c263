"""Saved states of a run in its recording, and runs restored from one.

A state is an attachment of the recording, written during the run; a run that was interrupted, or whose machine lost
power, is restored from the last one. It contains everything that steps have changed, the state of observers, and the
run's identity: experiment, FMUs, code, processor. A state whose identity differs would give other bits and is refused.
"""

import hashlib
import json
import math
import signal
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
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
from twin.kernel.units import parse_float

RUN_FUNCTIONS = (master.advance.native, cosim_step.step, cosim_step.plain_step, cosim_step.event_step)
"""Compiled functions that step a system and the FMUs in it."""
MISMATCH_REASONS = {
    "experiment": "of another experiment",
    "files": "of another FMU",
    "code": "of another version of twin's code",
    "versions": "of other versions of packages",
    "processor": "of another kind of processor",
}
"""Part of the identity -> how a state with another one differs from the run."""


def identity(system: System, packages: Mapping[str, str], files: Mapping[str, str], made_of: Any) -> dict[str, Any]:
    """Return a run's identity, to match saved states: all that its bits depend on.

    Versions of `packages`, SHA-256 of FMUs and other `files`, and the system's JSON-serialisable definition `made_of`.
    """
    digest = hashlib.sha256(json.dumps(made_of, sort_keys=True).encode()).hexdigest()
    # the name of a compiled function contains a digest of all the source that it reaches
    names = sorted({*compiled_names(system.components), *(native.name for native in RUN_FUNCTIONS)})
    code = hashlib.sha256(" ".join(names).encode()).hexdigest()
    return {"experiment": digest, "files": dict(files), "code": code} | machine_identity(packages)


def compiled_names(components: Iterable[Component]) -> Iterator[str]:
    """Yield the names of the compiled functions that step `components`, in any process."""
    for component in components:
        if isinstance(component, Subsystem):
            yield from compiled_names(component.system.components)
        elif isinstance(component, ProcessProxy):
            yield from component.code
        elif isinstance(component, NativeComponent):
            yield component.step.name


def machine_identity(packages: Mapping[str, str]) -> dict[str, Any]:
    """Return the part of a run's identity that is independent of the experiment: package versions and processor."""
    return {
        "versions": {name: number for name, number in packages.items() if name != "twin"},
        "processor": chosen_form().name,
    }


def refuse_other_run(saved: SavedState, own: Mapping[str, Any], where: str) -> None:
    """Refuse a saved state of another run than `own`, an `identity` or a part of it."""
    its = saved.about.get("of")
    if not isinstance(its, dict):
        raise InputRefused(f"{where}: the state does not identify its run")
    for part, reason in MISMATCH_REASONS.items():
        if part in own and its.get(part) != own[part]:
            both = isinstance(its.get(part), dict) and isinstance(own[part], dict)
            detail = f": {_difference_text(its[part], own[part])}" if both else ""
            raise InputRefused(
                f"{where}: the state at {_time_text(saved)} is {reason}{detail}; it cannot be continued here; run "
                "the experiment again"
            )


def _difference_text(there: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    keys = [key for key in {**there, **here} if there.get(key) != here.get(key)]
    return ", ".join(f"{key} {str(there.get(key, '-'))[:12]}, here {str(here.get(key, '-'))[:12]}" for key in keys[:3])


def _time_text(saved: SavedState) -> str:
    time = saved.about.get("time")
    return f"{time:g} s" if isinstance(time, float) else f"tick {saved.tick}"


class RunStates(Observer):
    """Observer that saves states of a run, whose `identity` is `about`, to its recording; a tick lasts `tick` s.

    The state of observers in `lasting`, such as the recorder, is saved too. `lacking` is why no state is saved, or "".
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
        # a halt without a write would leave the recorder's block no room for the next slice
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
        """Save the present state of a run that is interrupted."""
        if not self.lacking and not self._simulation.failure and 0 < self._simulation.next_tick <= self._last_tick:
            self._write(self._simulation.next_tick, self._content())

    def finish(self) -> None:
        """Add the state saved at the end of the run to its recording."""
        if self._end:
            self._write(self._last_tick, self._end)

    def _content(self) -> bytes:
        with closing(self._simulation.state()) as state:
            observers = {name: observer.state() for name, observer in self._lasting.items()}
            about = {"of": self._about, "time": state.tick * self._tick, "observers": observers}
            return state.saved(**about).to_bytes()

    def _write(self, tick: int, content: bytes) -> None:
        recorder = self._lasting["recorder"]
        assert isinstance(recorder, Recorder)
        recorder.attach(tick, content, MEDIA_TYPE)


def state_ticks(times: Iterable[float], every: float | None, tick: float, last: int) -> set[int]:
    """Compute the ticks at which a run's state is saved: at `times` (s), and at the interval `every` (s), if any."""
    ticks = {round(t / tick) for t in times}
    if every is not None:
        step = max(1, round(every / tick))
        ticks |= set(range(step, last, step))
    return {one for one in ticks if 0 < one < last}


class Interrupts(Observer):
    """Observer that ends a run between two slices on Ctrl-C, SIGTERM or a hang-up; the second one ends it immediately.

    Attributes:
        enough: whether a signal has arrived.
    """

    enough = False

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Handle the signals within the block; no effect outside the main thread."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
        found = {number: signal.getsignal(number) for number in numbers}
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
        """Call the handler that the received signal would have called."""
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
    """Simulate a recorded system and save its states on the way, the last one even if the run is interrupted.

    Arguments are as of `simulate`; `states` saves states but the last one, `saved` is the one to restore, None for tick
    0. InputRefused: it is of another system. KeyboardInterrupt: Ctrl-C or SIGTERM, once the state is saved.
    """
    interrupts = Interrupts()
    with interrupts.listening():
        # states first: changes by other observers at the beginning of a tick are not part of its state
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
    """An encoded state of a run at a simulation time (s), found in a recording.

    `branch`: the restored run may have another experiment. `alive` are its components, at that tick, that it lacks.
    """

    recording: Path
    time: float
    content: bytes
    branch: bool = False
    alive: Mapping[str, Component] = field(default_factory=dict)

    @property
    def saved_state(self) -> SavedState:
        return SavedState.from_bytes(self.content, str(self.recording))


def split_time(text: str) -> tuple[str, float | None]:
    """Split a path with a time, `results/NAME/latest@31.5`, into path and time (s); the time is None without an @."""
    path, at, time = text.rpartition("@")
    if not at:
        return text, None
    seconds = parse_float(time)
    if seconds is None or not 0.0 <= seconds < math.inf:
        raise InputRefused(f"--from {text}: {time!r} after the @ is not a time in seconds, 0 or more")
    return path, seconds


def stored_state(recording: Path, until: float | None) -> StoredState | None:
    """Find the last saved state in `recording` no later than `until` (s; None for the end); None if not found."""
    found = None
    for time, content in attachments(recording, MEDIA_TYPE):
        if until is None or time <= until + 1e-9:
            found = StoredState(recording, time, content)
    return found


def continuation_metadata(state: StoredState) -> dict[str, dict[str, str]]:
    """Return the metadata that names the saved `state` as the origin of a continued run."""
    folder = state.recording.resolve().parent
    # the parent folder of a user-named run is private
    run = f"{folder.parent.name}/{folder.name}" if FOLDER_STAMP.fullmatch(folder.name) else folder.name
    return {CONTINUES_KEY: {"run": run, "time_s": f"{state.time:.9g}"}}
