"""Changes of a run's parameters while it goes on: asked for at any time, made between two slices, told as events."""

import threading

from twin.assembly.assemble import Assembly
from twin.assembly.tunable import tunables
from twin.errors import InputRefused
from twin.execution.watch import Event
from twin.experiment.change import changed_value
from twin.experiment.experiment import Experiment
from twin.experiment.mistakes import unknown


class Tuning:
    """The parameters of one run that may be changed while it goes on.

    `values`, `request` and `close` may be called from any thread, `apply` only from the one that steps.

    Attributes:
        changed: whether anything has been.
    """

    def __init__(self, experiment: Experiment, assembly: Assembly):
        self.changed = False
        self._experiment = experiment
        self._tunables = tunables(experiment, assembly.system)
        self._values = {key: float(tunable.number) for key, tunable in self._tunables.items()}
        self._asked: dict[str, tuple[float, float]] = {}
        self._open = True
        self._lock = threading.Lock()

    def values(self) -> dict[str, float]:
        """Every parameter that may be changed, by its key in the experiment's file, in the unit of that key.

        What has been asked for counts already.
        """
        with self._lock:
            return self._values | {key: number for key, (number, _) in self._asked.items()}

    def request(self, key: str, number: object) -> None:
        """Ask for `number` (in the unit of the key) from the next slice on.

        Raises:
            InputRefused: no such parameter, a value that the experiment's schema refuses, or the run is over.
        """
        if key not in self._tunables:
            raise InputRefused(f"{unknown(key, list(self._tunables))}; only these can be changed while it runs")
        value = changed_value(key, number, self._experiment.values)
        with self._lock:
            if not self._open:
                raise InputRefused(f"{key} = {number}: the run is over, nothing can be changed any more")
            self._asked[key] = (float(number), value)  # type: ignore[arg-type]

    def apply(self, tick: int) -> list[Event]:
        """Make the changes asked for, so that they act from `tick` on; what was changed."""
        with self._lock:
            asked, self._asked = self._asked, {}
            events = []
            for key, (number, value) in asked.items():
                before = self._values[key]
                if number == before:
                    continue
                self._tunables[key].memory[...] = value
                self._values[key] = number
                events.append(Event(tick, "INFO", f"{key}: {_written(before)} -> {_written(number)} (live)", "tuning"))
            self.changed = self.changed or bool(events)
            return events

    def scheduled(self, first: int, end: int) -> list[Event]:
        """What the experiment itself has changed in the ticks from `first` to before `end`."""
        events = []
        with self._lock:
            for change in self._experiment.changes:
                if first <= change.tick < end and change.key in self._values:
                    before, self._values[change.key] = self._values[change.key], change.number
                    told = f"{change.key}: {_written(before)} -> {_written(change.number)}"
                    events.append(Event(change.tick, "INFO", told, "tuning"))
        return events

    def close(self) -> None:
        """Refuse from now on."""
        with self._lock:
            self._open = False


def _written(number: float) -> str:
    """With every digit that it takes to get the same number back."""
    return repr(number).removesuffix(".0")
