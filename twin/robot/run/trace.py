"""A run in memory: its topics, all or every n-th of its rows, all or selected signals."""

import math
import re
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.observers import Observer, TickEvent, simulate
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.errors import UnknownSeries, nearest
from twin.kernel.recording.messages import VALUE_TYPES, Field, Topic
from twin.kernel.recording.recorder import RowStream, port_fields
from twin.kernel.recording.scan import NS_PER_S
from twin.robot.assembly.assemble import assemble
from twin.robot.experiment.experiment import Experiment


def streams_of(system: System, shortest: int = 1) -> list[RowStream]:
    """Return one recorded stream of signals per component of a system, in component order.

    `drive_1` becomes the topic drive/1, `fault_1` fault/1; other components keep their names. Messages are `shortest`
    ticks apart, or more.
    """
    streams = []
    for c, component in enumerate(system.components):
        name = re.sub(r"^(drive|fault)_", r"\1/", component.name)
        columns = slice(int(system.y_start[c]), int(system.y_start[c + 1]))
        streams.append(RowStream(Topic(name, port_fields(component.outputs), max(shortest, component.period)), columns))
    return streams


def fields_of(system: System) -> dict[str, Field]:
    """Return all signals that a recording of the system has, by `topic.field`."""
    return {f"{s.topic.name}.{field.name}": field for s in streams_of(system) for field in s.topic.fields}


class _StoredSignal(NamedTuple):
    """A signal kept in memory: its field, the ticks between its values, its columns."""

    field: Field
    period: int
    columns: slice


class Trace(Observer):
    """Observer that keeps a run's signals in memory, read like a recording: `trace["plant.F_ee_B"]`; `tick` in s.

    Args:
        every: row interval: every `every`-th tick is kept, from tick 0.
        only: signals to keep, each `topic.field`; empty for all.
        past: trace of the same signals before the first tick of the simulation; None if it begins at tick 0.
    """

    def __init__(self, every: int = 1, only: Collection[str] = (), past: "Trace | None" = None):
        self.metadata: dict[str, dict[str, str]] = {}
        self._every, self._only, self._past = every, only, past
        self._signals: dict[str, _StoredSignal] = {}

    def begin(self, simulation: Simulation) -> None:
        self.tick = simulation.system.tick
        taken: list[int] = []
        for stream in streams_of(simulation.system):
            column = stream.columns.start
            for field in stream.topic.fields:
                name = f"{stream.topic.name}.{field.name}"
                if not self._only or name in self._only:
                    columns = slice(len(taken), len(taken) + field.size)
                    self._signals[name] = _StoredSignal(field, stream.topic.period, columns)
                    taken += range(column, column + field.size)
                column += field.size
        self._taken = np.array(taken, dtype=np.intp) if self._only else slice(None)
        self._memory = np.empty((simulation.last_tick // self._every + 1, len(taken)))
        self._count = 0
        if self._past is not None and simulation.next_tick > 0:
            self._count = -(-simulation.next_tick // self._every)
            for name, chosen in self._signals.items():
                before = self._past.values[: self._count, self._past._signal(name).columns]
                self._memory[: self._count, chosen.columns] = before

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        chosen = rows[-first % self._every :: self._every, self._taken]
        self._memory[self._count : self._count + len(chosen)] = chosen
        self._count += len(chosen)

    def __getitem__(self, key: str) -> NDArray:
        """Return the values of the signal `topic.field` at its own samples among the kept rows.

        The shape is (n,), or (n, size) for a field of several values; float64, int64 or bool.

        Raises:
            UnknownSeries: the signal was not kept; the message suggests the nearest names.
        """
        return self.held(key)[:: self._stride(self._signal(key).period)]

    def held(self, key: str) -> NDArray:
        """Return the values of the signal `topic.field` at every kept row, held from sample to sample.

        Raises:
            UnknownSeries: the signal was not kept.
        """
        field, _, columns = self._signal(key)
        values = self.values[:, columns] if field.size > 1 else self.values[:, columns.start]
        return values != 0.0 if field.kind == "bool" else values.astype(VALUE_TYPES[field.kind], copy=False)

    def of_drives(self, name: str) -> NDArray[np.float64]:
        """Return a signal of all three drives at every kept row, (n, 3); (n, 0) if they do not have it."""
        keys = [key for key in self._signals if key.startswith("drive") and key.endswith(f".{name}")]
        return np.column_stack([self.held(key) for key in keys]) if keys else np.zeros((self._count, 0))

    @property
    def t(self) -> NDArray[np.float64]:
        """Times of the kept rows of the run (s), (n,)."""
        return np.arange(self._count, dtype=float) * (self._every * self.tick)

    @property
    def values(self) -> NDArray[np.float64]:
        """Values of all kept signals in the kept rows, (n, width)."""
        return self._memory[: self._count]

    def time(self, topic: str) -> NDArray[np.float64]:
        """Return the sample times of a topic (s), (n,); rounded to nanoseconds as in a recording.

        Raises:
            UnknownSeries: no signal of the topic was kept; the message suggests the nearest names.
        """
        periods = {key.rpartition(".")[0]: chosen.period for key, chosen in self._signals.items()}
        if topic not in periods:
            raise UnknownSeries(
                f"run in memory: no topic {topic!r}; {nearest(topic, periods, 'it holds {}', 3)}", topic
            )
        ticks = np.arange(0, self._count, self._stride(periods[topic])) * self._every
        return np.rint(ticks * (self.tick * NS_PER_S)) / NS_PER_S

    def fields(self) -> dict[str, Field]:
        """Return all kept signals with unit and meaning by `topic.field`, in component order."""
        return {key: chosen.field for key, chosen in self._signals.items()}

    def _signal(self, key: str) -> _StoredSignal:
        if key not in self._signals:
            raise UnknownSeries(
                f"run in memory: no series {key!r}; {nearest(key, self._signals, 'it holds {}', 3)}", key
            )
        return self._signals[key]

    def _stride(self, period: int) -> int:
        """Return the number of kept rows between two samples of a signal with the given period in ticks."""
        return math.lcm(period, self._every) // self._every


def run_in_memory(experiment: Experiment, every: int = 1, only: Collection[str] = ()) -> Trace:
    """Run an experiment in this process and return its signals.

    Raises:
        InputRefused: a drive FMU does not fit.
        ComponentFailed: a component failed.
    """
    trace = Trace(every, only)
    with assemble(experiment) as assembly:
        simulate(assembly, experiment.duration_ticks, [trace]).require_success()
    return trace
