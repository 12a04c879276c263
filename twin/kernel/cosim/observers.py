"""Simulation driver that calls observers after each slice of ticks, and the events that observers report."""

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, Protocol, Self

import numpy as np

from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedState, decode_json, encode_json
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, InputRefused

Level = Literal["DEBUG", "INFO", "WARNING", "ERROR"]
MAX_SLICE = 1000
"""Maximum slice length without halts (ticks), so that its rows stay in the processor's cache."""


class TickEvent(NamedTuple):
    """An event of a simulation at a tick: severity, message, and component."""

    tick: int
    level: Level
    text: str
    source: str


class Observer:
    """An observer of a simulation; subclasses override the methods they need.

    The stepping thread calls all observers in order between slices, so slow observers delay the run. Observers must not
    write to rows. Once `enough` is set, the simulation may end early after a slice; a slice begins at the ticks in
    `halts`. `lasting` names the attributes that belong to the state of a run.
    """

    enough = False
    halts: Collection[int] = ()
    lasting: tuple[str, ...] = ()

    def begin(self, simulation: Simulation) -> None:
        """Prepare the observer for `simulation`, which starts after this method of all observers has returned."""

    def ready(self, tick: int) -> None:
        """Prepare the observer for the slice from `tick` on; component memory written now takes effect at that tick."""

    def state(self) -> Any:
        """Return the observer's saved state: the attributes in `lasting`, JSON-compatible."""
        return encode_json({name: getattr(self, name) for name in self.lasting})

    def restore(self, state: Any) -> None:
        """Restore the observer's state from a result of `state` at the same tick."""
        found = decode_json(state, type(self).__name__)
        if not isinstance(found, dict) or set(found) != set(self.lasting):
            raise InputRefused(f"the state of {type(self).__name__} has other contents than {', '.join(self.lasting)}")
        for name, value in found.items():
            mine = getattr(self, name)
            if not _is_same_kind(value, mine):
                raise InputRefused(f"the state of {type(self).__name__} has no valid {name}")
            setattr(self, name, value)

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        """Process the output rows and events of a completed slice of the simulation.

        Rows are (n, width of the system's outputs), overwritten by the next slice; the last slice may be shorter, and
        empty if a component failed in its first tick. Earlier observers reported the events, by ascending tick; an
        observer may insert its own.
        """


def _is_same_kind(value: Any, mine: Any) -> bool:
    """Whether a restored `value` fits the attribute value `mine`: both numbers, like arrays, or of the same type."""
    if isinstance(mine, np.ndarray):
        return isinstance(value, np.ndarray) and (value.dtype, value.ndim) == (mine.dtype, mine.ndim)
    if isinstance(mine, (bool, int, float, np.generic)):
        return isinstance(value, (bool, int, float))
    return isinstance(value, type(mine))


class ProgressObserver(Observer):
    """An observer of a simulation that reports progress: `report(completed ticks, ticks)`."""

    def __init__(self, report: Callable[[int, int], None], ticks: int):
        self._report, self._ticks = report, ticks

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self._report(first + len(rows), self._ticks)


class MessageObserver(Observer):
    """An observer of a simulation that reports the messages of a system's components as events."""

    def __init__(self, system: System):
        self._system = system

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        if len(rows):
            events += sorted(message_events(self._system), key=lambda event: event.tick)


def message_events(system: System) -> Iterator[TickEvent]:
    """Yield the messages of a system's components since the last call, as events."""
    for component in system.components:
        for tick, text in component.take_messages():
            yield TickEvent(tick, "WARNING", text, component.name)


class SystemOwner(Protocol):
    """An object that owns a co-simulation system."""

    @property
    def system(self) -> System:
        """The co-simulation system to be stepped."""


@dataclass(frozen=True)
class SimulationResult:
    """Final state and failure of a simulation begun at tick `first`, and wall time `stepping` in the master (s)."""

    simulation: Simulation
    stepping: float
    first: int = 0

    @property
    def failure(self) -> ComponentFailed | None:
        return self.simulation.failure

    def require_success(self) -> Self:
        """Return this simulation result if no component failed; otherwise raise the component's failure."""
        if self.failure:
            raise self.failure
        return self

    @property
    def costs(self) -> dict[str, float]:
        """Wall time per tick of each component (s), by name; empty if not timed."""
        cycles, ticks = self.simulation.cycles, max(1, self.simulation.next_tick - self.first)
        share = self.stepping / max(1, cycles.sum()) / ticks
        return {c.name: float(n * share) for c, n in zip(self.simulation.system.components, cycles, strict=False)}


def simulate(
    assembly: SystemOwner,
    last_tick: int,
    observers: Sequence[Observer] = (),
    slice_ticks: int = MAX_SLICE,
    timed: bool = False,
    state: SavedState | None = None,
    lasting: Mapping[str, Observer] = MappingProxyType({}),
    adopt: Callable[[Simulation, SavedState], None] | None = None,
    start: Callable[[Simulation], None] | None = None,
) -> SimulationResult:
    """Step a co-simulation system from its first to its last tick, until a component fails or an observer ends it.

    The last tick gets a row but no step. Observers are called in order, and `timed` measures each component. A `state`
    replaces tick 0: observers in `lasting` are restored from its entry "observers", and `adopt` restores it if of a
    different system. Without one, `start` may move the simulation to another tick.
    """
    simulation = Simulation(assembly.system, last_tick, slice_ticks, timed)
    if state is not None:
        (adopt or Simulation.restore)(simulation, state)
    if start is not None:
        start(simulation)
    for observer in observers:
        observer.begin(simulation)
    found = state.about.get("observers", {}) if state is not None else {}
    if not isinstance(found, dict):
        raise InputRefused("the state has no table of observers; it is damaged")
    for name, observer in lasting.items() if state is not None else ():
        try:
            observer.restore(found.get(name))
        # the file may contain anything, and each observer checks only its own part
        except (TypeError, ValueError, LookupError, AttributeError, OverflowError) as problem:
            raise InputRefused(f"the state of {name} is damaged: {problem}") from None
    return step_until(simulation, observers, last_tick + 1)


def step_until(simulation: Simulation, observers: Sequence[Observer], until: int) -> SimulationResult:
    """Advance `simulation` slice by slice with its observers until tick `until`, a failure, or an observer ends it."""
    halts = sorted({until, *(tick for observer in observers for tick in observer.halts)})
    stepping, began_at = 0.0, simulation.next_tick
    waited = simulation.wait_time
    while simulation.next_tick < until and not simulation.is_over and not any(o.enough for o in observers):
        first = simulation.next_tick
        for observer in observers:
            observer.ready(first)
        while halts and halts[0] <= first:
            halts.pop(0)
        began = time.perf_counter()
        rows = simulation.advance(halts[0] - first)
        stepping += time.perf_counter() - began
        events: list[TickEvent] = []
        for observer in observers:
            observer.on_rows(first, rows, events)
    return SimulationResult(simulation, stepping - (simulation.wait_time - waited), began_at)
