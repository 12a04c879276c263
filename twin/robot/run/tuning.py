"""Parameters that can be changed during a run."""

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.kernel.cosim.observers import Observer, TickEvent
from twin.kernel.errors import InputRefused
from twin.robot.assembly.assemble import Assembly, tunable_parameters
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.mistakes import unknown_key
from twin.robot.experiment.schema import changed_value
from twin.robot.run.fault_starts import FaultStarts


class Tuning(Observer):
    """Observer of the parameters of one run that can be changed by hand while it is stepped.

    `values`, `request` and `close` may be called from any thread. `starts` are the faults that can be started by hand.

    Attributes:
        first: event text of the first change by hand; "" without one.
    """

    lasting = ("first", "_values")

    def __init__(self, experiment: Experiment, assembly: Assembly, starts: FaultStarts | None = None):
        self.first = ""
        self._starts, self._started = starts, dict.fromkeys(starts.keys if starts else (), False)
        self._to_start: list[str] = []
        self._experiment = experiment
        self._tunables = tunable_parameters(experiment, assembly.system)
        self._values = {key: float(tunable.number) for key, tunable in self._tunables.items()}
        self._asked: dict[str, tuple[float, float]] = {}
        self._changes: list[TickEvent] = []
        self._open = True
        self._lock = threading.Lock()

    def values(self) -> Mapping[str, bool | float]:
        """Return every tunable parameter by experiment key, in the key's unit, including pending requests."""
        with self._lock:
            return self._started | self._values | {key: number for key, (number, _) in self._asked.items()}

    def request(self, key: str, number: object) -> None:
        """Request a new value of a parameter, in the unit of its key, from the next slice on.

        Raises:
            InputRefused: the parameter is unknown, its value is invalid, or the run is over.
        """
        if self._starts and key in self._starts.keys:
            self._starts.require_button(key, number)
            with self._lock:
                self._to_start.append(key)
                self._started[key] = True
            return
        if key not in self._tunables:
            raise InputRefused(f"{unknown_key(key, list(self._tunables))}; only these can be changed while it runs")
        value = changed_value(DECLARED_TABLES, key, number, self._experiment.values)
        with self._lock:
            if not self._open:
                raise InputRefused(f"{key} = {number}: the run is over, nothing can be changed any more")
            self._asked[key] = (float(number), value)  # type: ignore[arg-type]

    def restore(self, state: Any) -> None:
        """Restore the parameter values that had been changed by hand when a state was saved."""
        before = dict(self._values)
        super().restore(state)
        for key, number in self._values.items():
            if key not in before:
                raise InputRefused(f"the state has {key} = {number}, which cannot be changed in this run")
            if number != before[key]:
                self._tunables[key].memory[...] = changed_value(DECLARED_TABLES, key, number, self._experiment.values)

    def ready(self, tick: int) -> None:
        """Apply the requested parameter changes, so that they act from `tick` on."""
        with self._lock:
            to_start, self._to_start = self._to_start, []
            for key in to_start if self._starts else ():
                assert self._starts
                self._starts.start(key, tick)
                self.first = self.first or f"{key} (live)"
            asked, self._asked = self._asked, {}
            for key, (number, value) in asked.items():
                if number != self._values[key]:
                    self._tunables[key].memory[...] = value
                    self._log_change(tick, key, number, " (live)")
                    self.first = self.first or self._changes[0].text

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        """Report parameter changes as events: those made by hand before this slice, and scheduled ones within it."""
        with self._lock:
            for change in self._experiment.changes:
                if first <= change.tick < first + len(rows) and change.key in self._values:
                    self._log_change(change.tick, change.key, change.number)
        events += self._changes
        self._changes = []

    def _log_change(self, tick: int, key: str, number: float, how: str = "") -> None:
        before, self._values[key] = self._values[key], number
        change = f"{key}: {_number_text(before)} -> {_number_text(number)}{how}"
        self._changes.append(TickEvent(tick, "INFO", change, "tuning"))

    def close(self) -> None:
        """Refuse all later requests."""
        with self._lock:
            self._open = False


def _number_text(number: float) -> str:
    """Format a number with as many digits as are needed to read the same number back."""
    return repr(number).removesuffix(".0")
