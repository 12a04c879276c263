"""A running system: slices of compiled ticks, and failures turned into sentences.

Failures of components as sentences.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.kernel.cosim.component import NOT_FINITE, Component
from twin.kernel.cosim.deadlines import Deadlines
from twin.kernel.cosim.master import NO_COMPONENT, advance
from twin.kernel.cosim.port import by_port, format_values, width
from twin.kernel.cosim.state import SavedState, StatePlaces, SystemState
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, EndRequest, InputRefused
from twin.kernel.hooks import HOOKS


def failure_phrase(system: System, u: np.ndarray, y: np.ndarray, culprit: int, status: int, tick: int) -> str:
    """What went wrong: component, function, simulated time and last inputs, without a full stop.

    Args:
        u, y: memory of all inputs, and of all outputs, as the master left them.
        culprit, status: as the master returned them.
        tick: the one at which it happened.
    """
    component = system.components[culprit]
    what = _not_finite(system, y, culprit) if status == NOT_FINITE else component.explain(status)
    label = f"{component.label} ({component.name})" if component.label else component.name
    inputs = format_values(component.inputs, u[system.u_start[culprit] : system.u_start[culprit + 1]]) or "none"
    when = f"t = {tick * system.tick:.6g} s, tick {tick}"
    where = f"at {when}" if component.sampled else f"in the step from {when}"
    return f"{label} {what} {where}. Last inputs: {inputs}"


def _not_finite(system: System, y: np.ndarray, culprit: int) -> str:
    component = system.components[culprit]
    start = int(system.y_start[culprit])
    if system.has_separate_newest and not component.sampled:
        start += system.outputs_width
    outputs = y[start : start + width(component.outputs)]
    if component.unread is not None:
        outputs = np.where(component.unread > 0, 0.0, outputs)
    for name, values in by_port(component.outputs, outputs).items():
        if not np.all(np.isfinite(values)):
            bad = values[~np.isfinite(values)][0]
            return f"returned {'NaN' if np.isnan(bad) else 'infinity'} for {name}"
    raise AssertionError("the master reported a value that is not finite, and all are")


@dataclass(frozen=True)
class SimulationMemory:
    """What can be seen from outside while a step runs.

    Attributes:
        mark: (2,) int64: tick and component being stepped, NO_COMPONENT between slices.
        u: (inputs_width,) float64: the inputs that each component was last stepped with.
    """

    mark: np.ndarray
    u: np.ndarray


class Simulation:
    """Runs a `System` from its first tick to `last_tick`; `failure` and `culprit` say what ended it too early, if so.

    Args:
        system: what to run.
        last_tick: the tick that gets the last row and no step.
        slice_ticks: most ticks one call of `advance` runs.
        timed: count the processor cycles of each component.
        memory: memory of the mark and the inputs; None to use `HOOKS.memory`.
    """

    def __init__(
        self,
        system: System,
        last_tick: int,
        slice_ticks: int = 100,
        timed: bool = False,
        memory: SimulationMemory | None = None,
    ):
        self.system = system
        self.last_tick = last_tick
        self.next_tick = system.first_tick
        if memory is None and HOOKS.memory is not None:
            memory = HOOKS.memory(system, last_tick)
        memory = memory or SimulationMemory(np.array([0, NO_COMPONENT]), np.zeros(system.inputs_width))
        self._mark, self._u = memory.mark, memory.u
        for component in system.components:
            component.keep_time(self._mark)
        self._y = system.outputs()
        self._rows = np.empty((slice_ticks, system.outputs_width))
        self._table = system.table(self._u, self._y)
        self._timed = timed
        self._loop = system.loop(self._table, self._y, self._mark, last_tick)
        self._loop["timed"], self._loop["rows"] = timed, self._rows.ctypes.data
        self._loop["row_width"] = system.outputs_width
        self.failure: ComponentFailed | None = None
        self.culprit = ""
        self._unchanged = [change.memory.copy() for change in system.changes]
        # no ticks: compiles, or loads from the cache, before anyone's clock runs
        self._address = self._loop.ctypes.data
        self._advance = advance.native.c_function
        self._advance(self._address, 0, 0, 0)
        self._deadlines: Deadlines | None = None

    def pace(self, waits: Deadlines) -> None:
        """From now on no tick begins before it is due."""
        self._advance = waits.paced_advance(self._advance, self._address)
        self._deadlines, self._address = waits, waits.address
        self._advance(self._address, 0, 0, 0)

    @property
    def wait_time(self) -> float:
        """Wall time (s) that was waited for ticks to be due."""
        return float(self._deadlines.memory["waited"][0]) if self._deadlines else 0.0

    @property
    def is_over(self) -> bool:
        return self.next_tick > self.last_tick or self.failure is not None

    @property
    def cycles(self) -> np.ndarray:
        """Processor cycles spent in each component, (number of components,); empty if not timed."""
        return self._table["cycles"] if self._timed else np.zeros(0, dtype=np.int64)

    def advance(self, most: int | None = None) -> np.ndarray:
        """Run one slice, of at most so many ticks.

        Returns:
            (ticks, outputs): one row per tick from the old `next_tick` on, a view that the next call overwrites. If a
            component failed, the rows before it, and `failure` says what happened.
        """
        done, most = 0, min(len(self._rows), most or len(self._rows))
        # what `is_over` says, which would cost a tenth of a slice of small drives to ask
        while done < most and self.next_tick <= self.last_tick and self.failure is None:
            count = min(most - done, self._change_memory()) if self.system.changes else most - done
            made = self._advance(self._address, self.next_tick, count, done)
            failed = made < 0
            if failed:
                made = -1 - made
            done += made
            self.next_tick += made
            if failed:
                self.failure = self._make_failure()
        return self._rows if done == len(self._rows) else self._rows[:done]

    def state(self) -> SystemState:
        """The state at the beginning of `next_tick`, to be restored here, or saved for another process.

        Raises:
            InputRefused: a component has no state, see `stateless`.
            ComponentFailed: an FMU refuses.
        """
        return self._places.save_state(self.next_tick)

    def restore(self, state: SystemState | SavedState) -> None:
        """Go to where `state` was taken, here or of the same system elsewhere; `last_tick` stays.

        Raises:
            InputRefused: it is of another system, or a component has no state.
            ComponentFailed: an FMU refuses.
        """
        if isinstance(state, SavedState):
            self._refuse_other_time(state)
        taken = self._places.import_state(state) if isinstance(state, SavedState) else state
        if taken is not state:
            self._refuse_not_finite(taken)
        if taken.places is not self._places:
            raise InputRefused("the state was taken in another simulation; restore what its `saved` returns")
        self._places.restore_state(taken)
        for component in self.system.components if taken is not state else ():
            component.refuse_index()
        for change, value in zip(self.system.changes, self._unchanged, strict=True):
            change.memory[...] = value
        self._set_tick(taken.tick)
        self.failure, self.culprit = None, ""
        if taken is not state:
            taken.close()

    def adopt(self, saved: SavedState) -> list[str]:
        """Go to where `saved` was taken, of a system with perhaps more, fewer or changed components.

        Each component goes on from the state of that with its name; what an experiment says of it is this system's.

        Returns:
            Names of the components that the state has nothing of: they stand as they were made.

        Raises:
            InputRefused: a component cannot go on from the state of the one with its name.
            ComponentFailed: an FMU refuses.
        """
        self._refuse_other_time(saved)
        new = self._places.adopt(saved)
        for component in self.system.components:
            component.refuse_index()
        self._set_tick(saved.tick)
        return new

    def copy_from(self, other: "Simulation") -> list[str]:
        """Go to where `other` stands: of a system of the same components, but for some that only one of both has.

        What components hold is theirs, so it is not copied; only from one that has another of its name in the other
        system, of which the memory is all that holds something.

        Returns:
            Names of the components that only this system has: they stand as they were made.
        """
        there = {component.name: (component, start) for component, start in other._starts}
        mine, theirs = self._copies(), other._copies()
        new = []
        for component, start in self._starts:
            if component.name not in there:
                new.append(component.name)
                continue
            found, place = there[component.name]
            if found is not component:
                for array, value in zip(component.pieces().values(), found.pieces().values(), strict=True):
                    array[...] = value
            size = width(component.outputs)
            mine[:, start : start + size] = theirs[:, place : place + size]
        self._set_tick(other.next_tick)
        return new

    def jump_to(self, tick: int, outputs: Mapping[str, np.ndarray]) -> None:
        """Be at the beginning of `tick`; what components hold is put there by others.

        Args:
            tick: any.
            outputs: by the name of a component what is valid of its outputs, and was at all instants of which the
                system keeps any; of the others they stay.
        """
        copies = self._copies()
        for component, start in self._starts:
            if component.name in outputs:
                copies[:, start : start + width(component.outputs)] = outputs[component.name]
        for change, value in zip(self.system.changes, self._unchanged, strict=True):
            change.memory[...] = value
        self._set_tick(tick)
        self.failure, self.culprit = None, ""

    def derive_outputs(self, component: Component, passed_on: Callable[[np.ndarray], np.ndarray]) -> None:
        """Let the outputs of `component` be what `passed_on` makes of the outputs that feed it; and so at all instants
        of which the system keeps outputs, the newest last."""
        c = self.system.components.index(component)
        sources = self.system.sources[self.system.u_start[c] : self.system.u_start[c + 1]] % self.system.outputs_width
        copies = self._copies()
        # before, valid, newest; of a sampled component there is what is valid
        for one in (2, 0, 1) if c >= self.system.sampled else (0,):
            if one < len(copies):
                copies[one, self.system.y_start[c] : self.system.y_start[c + 1]] = passed_on(copies[one, sources])

    @cached_property
    def _starts(self) -> list[tuple[Component, int]]:
        """Each component, and where its outputs begin."""
        return list(zip(self.system.components, self.system.y_start.tolist(), strict=False))

    def _copies(self) -> np.ndarray:
        """All outputs, (instants of which they are kept, outputs_width), a view."""
        return self._y.reshape(-1, self.system.outputs_width)

    def _set_tick(self, tick: int) -> None:
        """Be at the beginning of `tick`, with the changes until then made."""
        for change in self.system.changes:
            if change.tick < tick:
                change.memory[...] = change.value
        self.next_tick = tick

    def _refuse_other_time(self, saved: SavedState) -> None:
        """Raise InputRefused if the tick of a state is outside this simulation or contradicts the state's time."""
        time = saved.about.get("time", saved.tick * self.system.tick)
        if not self.system.first_tick <= saved.tick <= self.last_tick + 1:
            raise InputRefused(
                f"the state is of tick {saved.tick}; expected {self.system.first_tick} .. {self.last_tick}"
            )
        if (
            not isinstance(time, float | int)
            or not abs(time - saved.tick * self.system.tick) <= 1e-6 * self.system.tick
        ):
            raise InputRefused(
                f"the state says {time!r} s at tick {saved.tick}, which is at another time; it is damaged"
            )

    def _refuse_not_finite(self, state: SystemState) -> None:
        """Raise InputRefused if an output that a component reads is not finite."""
        place = 0
        copies = len(self._y) // max(1, self.system.outputs_width)
        for component in self.system.components:
            size = 8 * copies * width(component.outputs)
            outputs = state.memory[place : place + size].view(float).reshape(copies, -1)
            unread = np.zeros(1) if component.unread is None else component.unread
            if component.finite and not np.all(np.isfinite(outputs) | (unread > 0)):
                raise InputRefused(f"the state has NaN or infinity in the outputs of {component.name}")
            place += size

    @cached_property
    def _places(self) -> StatePlaces:
        return StatePlaces(self.system.components, self._y, self._u)

    def run(self) -> np.ndarray:
        """Run to the end and return every row: (last_tick + 1, outputs).

        Raises:
            ComponentFailed: with the sentence that names component, function, simulated time and last inputs.
        """
        slices = []
        while not self.is_over:
            slices.append(self.advance().copy())
        if self.failure:
            raise self.failure
        return np.concatenate(slices)

    def inputs(self, component: Component) -> np.ndarray:
        """The inputs that `component` was last stepped with."""
        c = self.system.components.index(component)
        return self._u[self.system.u_start[c] : self.system.u_start[c + 1]]

    def outputs(self, component: Component) -> np.ndarray:
        """What is valid of the outputs of `component`."""
        c = self.system.components.index(component)
        return self._y[self.system.y_start[c] : self.system.y_start[c + 1]]

    def _change_memory(self) -> int:
        """Make the changes of the next tick; how many ticks may follow before there are others to make."""
        for change in self.system.changes:
            if change.tick == self.next_tick:
                change.memory[...] = change.value
        return min(
            (change.tick - self.next_tick for change in self.system.changes if change.tick > self.next_tick),
            default=len(self._rows),
        )

    def _make_failure(self) -> ComponentFailed:
        culprit, status = self._loop[["culprit", "status"]][0].tolist()
        # a continuous component fails in a tick whose row is already written
        tick = self.next_tick - (culprit >= self.system.sampled)
        component = self.system.components[culprit]
        self.culprit = component.name
        kind = EndRequest if component.requests_end(status) else ComponentFailed
        return kind(failure_phrase(self.system, self._u, self._y, culprit, status, tick) + ".")
