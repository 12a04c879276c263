"""Observers of a simulation and the events they report, slice by slice."""

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
"""Ticks. Where no observer waits for a slice it may be long; but its rows are to stay in the processor's cache."""


class TickEvent(NamedTuple):
    """Something that happened at a tick: how much it matters, what, and in which component."""

    tick: int
    level: Level
    text: str
    source: str


class Observer:
    """Sees a simulation slice by slice. By itself it does nothing: a kind of observer overrides what it needs.

    The thread that steps calls all observers of a simulation in their order, between slices: what they take their time
    over delays the run. None may write into rows.

    Attributes:
        enough: asked after every slice: whether the simulation may end before its time.
        halts: ticks at which a slice is to begin.
        lasting: names of the attributes that belong to the state of a run.
    """

    enough = False
    halts: Collection[int] = ()
    lasting: tuple[str, ...] = ()

    def begin(self, simulation: Simulation) -> None:
        """`simulation` runs as soon as all observers have returned from this."""

    def ready(self, tick: int) -> None:
        """The slice from `tick` on is next: what is now written into a component's memory acts from that tick on."""

    def state(self) -> Any:
        """What it has found out so far, as JSON says it."""
        return encode_json({name: getattr(self, name) for name in self.lasting})

    def restore(self, state: Any) -> None:
        """Go on from what `state` returned when as many ticks were over as now.

        Raises:
            InputRefused: it is nothing that `state` returns.
        """
        found = decode_json(state, type(self).__name__)
        if not isinstance(found, dict) or set(found) != set(self.lasting):
            raise InputRefused(f"the state of {type(self).__name__} has other contents than {', '.join(self.lasting)}")
        for name, value in found.items():
            mine = getattr(self, name)
            if not _is_same_kind(value, mine):
                raise InputRefused(f"the state of {type(self).__name__} has no valid {name}")
            setattr(self, name, value)

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        """A slice is over.

        Args:
            first: tick of the first row.
            rows: (n, width of the system's outputs), overwritten by the next slice; fewer than in other slices at the
                end, none if a component failed in its first tick.
            events: what happened in it as far as the observers before this one found out, by ascending ticks; one that
                finds more puts it in.
        """


def _is_same_kind(value: Any, mine: Any) -> bool:
    """Whether `value` may take the place of `mine`."""
    if isinstance(mine, np.ndarray):
        return isinstance(value, np.ndarray) and (value.dtype, value.ndim) == (mine.dtype, mine.ndim)
    if isinstance(mine, (bool, int, float, np.generic)):
        return isinstance(value, (bool, int, float))
    return isinstance(value, type(mine))


class ProgressObserver(Observer):
    """Reports how far a run of `ticks` has come: `report(ticks done, ticks)`."""

    def __init__(self, report: Callable[[int, int], None], ticks: int):
        self._report, self._ticks = report, ticks

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self._report(first + len(rows), self._ticks)


class MessageObserver(Observer):
    """Reports the messages of a system's components as events."""

    def __init__(self, system: System):
        self._system = system

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        if len(rows):
            events += sorted(message_events(self._system), key=lambda event: event.tick)


def message_events(system: System) -> Iterator[TickEvent]:
    """The messages of the components of `system` since they were last asked for."""
    for component in system.components:
        for tick, text in component.take_messages():
            yield TickEvent(tick, "WARNING", text, component.name)


class SystemOwner(Protocol):
    """What has a system."""

    @property
    def system(self) -> System:
        """To be stepped."""


@dataclass(frozen=True)
class SimulationResult:
    """A simulation that is over.

    Attributes:
        simulation: how far it came, and what ended it too early, if anything did.
        stepping: wall time in the master (s).
        first: tick from which on it went.
    """

    simulation: Simulation
    stepping: float
    first: int = 0

    @property
    def failure(self) -> ComponentFailed | None:
        return self.simulation.failure

    def require_success(self) -> Self:
        """The same, of a simulation in which no component failed.

        Raises:
            ComponentFailed: one did.
        """
        if self.failure:
            raise self.failure
        return self

    @property
    def costs(self) -> dict[str, float]:
        """Wall time per tick of each component (s), by its name; {} if they were not timed."""
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
    """Step a system from its first tick to `last_tick`, or until a component fails or an observer has seen enough.

    Args:
        assembly: freshly made.
        last_tick: the tick that gets the last row and no step.
        observers: called in this order.
        slice_ticks: most ticks of a slice.
        timed: measure each component.
        state: to go on from in place of tick 0.
        lasting: those of `observers` that go on from what the state says about "observers", by name.
        adopt: restores the state where it is of a system that is not the same; None: it is the same.
        start: brings the simulation to another tick than 0 where there is no such `state`.

    Raises:
        InputRefused: the state is of another system.
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
        # a state may hold anything, and each observer checks its own part only
        except (TypeError, ValueError, LookupError, AttributeError, OverflowError) as problem:
            raise InputRefused(f"the state of {name} is damaged: {problem}") from None
    return step_until(simulation, observers, last_tick + 1)


def step_until(simulation: Simulation, observers: Sequence[Observer], until: int) -> SimulationResult:
    """Step `simulation`, which the `observers` know, from where it stands to the beginning of tick `until`, a failure,
    or until one of them has seen enough."""
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
