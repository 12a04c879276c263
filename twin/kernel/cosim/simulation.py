"""A running system: compiled slices of ticks, saved and restored states, failures with error messages."""

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
    """Describe a failure: component `culprit`, function, simulated time and last inputs, without a full stop.

    `u` and `y` are the memory of all inputs and outputs, and `status` is the code, as the master left them.
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
    """Memory of a simulation that a supervising process can read while a step runs.

    `mark` (2,) int64: tick and component being stepped, NO_COMPONENT between slices; `u` (inputs_width,): last inputs.
    """

    mark: np.ndarray
    u: np.ndarray


class Simulation:
    """A run of a `System` to `last_tick`, which gets a row but no step; `failure`, `culprit` describe an early end.

    `advance` makes at most `slice_ticks`, and counts each component's processor cycles if `timed`. `memory` has mark
    and inputs; None to use `HOOKS.memory`.
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
        # a call without ticks compiles the loop, or loads it from the cache, before time is measured
        self._address = self._loop.ctypes.data
        self._advance = advance.native.c_function
        self._advance(self._address, 0, 0, 0)
        self._deadlines: Deadlines | None = None

    def pace(self, waits: Deadlines) -> None:
        """Run the simulation in real time: from now on no tick begins before its deadline."""
        self._advance = waits.paced_advance(self._advance, self._address)
        self._deadlines, self._address = waits, waits.address
        self._advance(self._address, 0, 0, 0)

    @property
    def wait_time(self) -> float:
        """Wall time that the simulation has spent waiting for deadlines (s)."""
        return float(self._deadlines.memory["waited"][0]) if self._deadlines else 0.0

    @property
    def is_over(self) -> bool:
        return self.next_tick > self.last_tick or self.failure is not None

    @property
    def cycles(self) -> np.ndarray:
        """Processor cycles spent in each component, (number of components,); empty if not timed."""
        return self._table["cycles"] if self._timed else np.zeros(0, dtype=np.int64)

    def advance(self, most: int | None = None) -> np.ndarray:
        """Run a slice of at most `most` ticks (None: `slice_ticks`); return its outputs, shape (ticks, outputs).

        There is one row per tick, from the old `next_tick` on. The array is a view that the next call overwrites.
        After a failure, which `failure` describes, it ends before the failed tick.
        """
        done, most = 0, min(len(self._rows), most or len(self._rows))
        # inlined `is_over`, whose call costs a tenth of a slice of small drives
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
        """Save the simulation's state at the beginning of `next_tick`, for use here or in another process.

        InputRefused: a component cannot save it, see `stateless_reasons`; ComponentFailed: an FMU refuses.
        """
        return self._places.save_state(self.next_tick)

    def restore(self, state: SystemState | SavedState) -> None:
        """Restore a saved `state` of this simulation or one of the same system; `last_tick` is unchanged.

        InputRefused: of another system, or a component cannot restore it. ComponentFailed: an FMU refuses.
        """
        if isinstance(state, SavedState):
            self._refuse_other_time(state)
            taken = self._places.import_state(state)
            self._refuse_not_finite(taken)
            self.restore(taken)
            for component in self.system.components:
                component.refuse_index()
            taken.close()
            return
        if state.places is not self._places:
            raise InputRefused("the state was taken in another simulation; restore what its `saved` returns")
        self._places.restore_state(state)
        for change, value in zip(self.system.changes, self._unchanged, strict=True):
            change.memory[...] = value
        self._set_tick(state.tick)
        self.failure, self.culprit = None, ""

    def adopt(self, saved: SavedState) -> list[str]:
        """Restore the state of a system with more, fewer or changed components; return the names of those it lacks.

        Components are matched by name; those it lacks keep their initial state, and constants of the experiment stay.
        """
        self._refuse_other_time(saved)
        new = self._places.adopt(saved)
        for component in self.system.components:
            component.refuse_index()
        self._set_tick(saved.tick)
        return new

    def copy_from(self, other: "Simulation") -> list[str]:
        """Copy tick and outputs from a simulation of a system that may differ; return the components only this has.

        These keep their initial state, and shared components their own. The memory of a different component of the same
        name is copied, which must be its whole state.
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
        """Set the simulation's present tick and outputs; the caller sets the state of the components.

        `outputs` are valid ones by component, also used for all other instants that the system stores; others stay.
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
        """Compute and set the outputs of `component` by a function of its present inputs, at all stored instants."""
        c = self.system.components.index(component)
        sources = self.system.sources[self.system.u_start[c] : self.system.u_start[c + 1]] % self.system.outputs_width
        copies = self._copies()
        # previous, valid, newest; sampled components have only valid outputs
        for one in (2, 0, 1) if c >= self.system.sampled else (0,):
            if one < len(copies):
                copies[one, self.system.y_start[c] : self.system.y_start[c + 1]] = passed_on(copies[one, sources])

    @cached_property
    def _starts(self) -> list[tuple[Component, int]]:
        return list(zip(self.system.components, self.system.y_start.tolist(), strict=False))

    def _copies(self) -> np.ndarray:
        """Return a view of all components' outputs at the stored instants, (number of instants, outputs_width)."""
        return self._y.reshape(-1, self.system.outputs_width)

    def _set_tick(self, tick: int) -> None:
        for change in self.system.changes:
            if change.tick < tick:
                change.memory[...] = change.value
        self.next_tick = tick

    def _refuse_other_time(self, saved: SavedState) -> None:
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
                f"the state says {time!r} s at tick {saved.tick}, which is at a different time; it is damaged"
            )

    def _refuse_not_finite(self, state: SystemState) -> None:
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
        """Run the simulation to the end and return all output rows, (last_tick + 1, outputs).

        ComponentFailed names a failed component, its function, the simulated time and its last inputs.
        """
        slices = []
        while not self.is_over:
            slices.append(self.advance().copy())
        if self.failure:
            raise self.failure
        return np.concatenate(slices)

    def inputs(self, component: Component) -> np.ndarray:
        """Return the inputs of the last step of `component`."""
        c = self.system.components.index(component)
        return self._u[self.system.u_start[c] : self.system.u_start[c + 1]]

    def outputs(self, component: Component) -> np.ndarray:
        """Return the valid outputs of `component`, as a view."""
        c = self.system.components.index(component)
        return self._y[self.system.y_start[c] : self.system.y_start[c + 1]]

    def _change_memory(self) -> int:
        """Apply the next tick's scheduled memory changes; return the number of ticks until the following change."""
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
