"""Logs of robots below the current folder, laid beside a run: what they hold, and what the estimator makes of it.

They are read as `twin replay` reads them, with the map of columns that `twin log new` writes beside them.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.recording.folder import RECORDING
from twin.kernel.recording.logs.bag import is_bag
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import Log, LogSeries
from twin.kernel.recording.logs.reader import read_log
from twin.kernel.recording.messages import Field
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.view import held_samples
from twin.studies.metrics.response import Curve
from twin.studies.replay.model import model_of
from twin.studies.replay.replay import estimates, pressing, robot_log

ENDINGS = (".csv", ".mcap", ".db3", ".db3.zstd", ".mcap.zstd")
DEEPEST = 4
"""Folders below each other in which logs are looked for."""
MOST_LOGS = 100
MOST_ENTRIES = 20_000
"""Files and folders that are looked at."""
COUNTED = {"encoder": ("count_m", "count_l"), "estimator": ("theta_m", "theta_l")}
"""Series of encoders, of which position and force follow."""
MOST_SHIFT = 1e6
"""s"""
MISSING = 0.75
"""Sample periods after a sample in which the next one should have come."""
MOST_SAMPLES = 4_000_000
"""Of one series, gaps included."""


def known_logs() -> list[str]:
    """Logs below the current folder, by their paths: tables, bags of ROS 2, MCAP files but those of runs."""
    found: list[str] = []
    for number, entry in enumerate(_entries(Path(), DEEPEST)):
        if number >= MOST_ENTRIES or len(found) >= MOST_LOGS:
            break
        if is_bag(entry) if entry.is_dir() else entry.name.endswith(ENDINGS) and entry.name != RECORDING:
            found.append(str(entry))
    return sorted(found)


def _entries(folder: Path, depth: int) -> Iterator[Path]:
    """Files and folders below `folder`, those of bags not; hidden ones and links are left out."""
    try:
        entries = sorted(folder.iterdir())
    except OSError:
        return
    for entry in entries:
        if entry.name.startswith(".") or entry.is_symlink():
            continue
        yield entry
        if depth > 1 and entry.is_dir() and not is_bag(entry):
            yield from _entries(entry, depth - 1)


def _chosen(name: Any) -> Path:
    if not isinstance(name, str) or name not in known_logs():
        raise InputRefused(
            f"log {str(name)[:80]!r}: no such log below the current folder; {nearest(str(name)[:80], known_logs())}"
        )
    return Path(name)


class LogRun:
    """A log as the panels read a run, see `PanelRun`: every topic on one clock, gaps are no numbers.

    Args:
        log: as it was read.
        experiment: describes the robot, whose estimator makes position and force of the encoders' counts.
        shift: of its times (s).

    Raises:
        InputRefused: its encoders are not those of the robot, or it has none of the signals that panels show.
    """

    def __init__(self, log: Log, experiment: Experiment, shift: float):
        self.values, self.times, self._shift = experiment.values, dict[str, Curve](), shift
        self._columns: dict[str, Curve] = {}
        vectors = {name.partition("[")[0] for name in log.series if name.endswith("[0]")}
        for key in (*(name for name in log.series if not name.endswith("]")), *vectors):
            self._add(key, log.vector(key) if key in vectors else log[key])
        if any(f"{topic}.{name}[0]" in log.series for topic, names in COUNTED.items() for name in names):
            self._estimate(log, experiment)

    def _estimate(self, log: Log, experiment: Experiment) -> None:
        model = model_of(experiment)
        robot = robot_log(log, model.belief)
        found = estimates(robot, model.belief, model.gravity_compensation)
        series = {f"estimator.{name}": values for name, values in found.items() if name != "valid"}
        series["controller.F_z"] = pressing(found)
        for key, values in series.items():
            if key not in self._columns:
                self._add(key, LogSeries(robot.t, values, ""))

    def _add(self, key: str, one: LogSeries) -> None:
        topic, period = key.rpartition(".")[0], one.sampling.period
        if topic not in self.times:
            count = int((one.t[-1] - one.t[0]) / period + 1e-6) + 1
            if count > MOST_SAMPLES:
                raise InputRefused(f"{key}: {count:.3g} samples with its gaps; expected at most {MOST_SAMPLES:,}")
            self.times[topic] = self._shift + one.t[0] + period * np.arange(count)
        grid = self.times[topic] - self._shift
        place = np.searchsorted(one.t, grid + 0.5 * period, side="right") - 1
        values = one.values[np.maximum(place, 0)].astype(float)
        if one.sampling.regular:
            values[grid - one.t[np.maximum(place, 0)] > MISSING * period] = np.nan
        self._columns[key] = values

    @property
    def recording(self) -> "LogRun":
        """Itself: it knows its series."""
        return self

    @property
    def end(self) -> float:
        """Time of the last sample (s)."""
        return max(float(t[-1]) for t in self.times.values())

    def fields(self) -> Mapping[str, Field]:
        """Of drives nothing is known."""
        return {}

    def has(self, *keys: str) -> bool:
        """Whether the log has all these series, or the estimator makes them of it."""
        return all(key in self._columns for key in keys)

    def column(self, key: str, column: int | None) -> Curve:
        """Samples of a series (n,), or of one column of it."""
        values = self._columns[key]
        return values if column is None else values[:, column]

    def held(self, key: str, t: Curve) -> Curve:
        """Samples of a series as they held at times `t` (n,) in s."""
        grid = self.times[key.rpartition(".")[0]]
        return self._columns[key][held_samples(grid, t)]


def log_run(ask: Mapping[str, Any], experiment: Experiment) -> tuple[LogRun, str]:
    """Return a log for the panels, read with the NAME.map.toml beside it if there is one, and notes on its file.

    Args:
        ask: "log" one of `known_logs`, "shift_s"; values may be anything.
        experiment: describes the robot.

    Raises:
        InputRefused: the log is not listed, or as `read_log` and `LogRun`.
    """
    path, shift = _chosen(ask.get("log")), ask.get("shift_s") or 0.0
    if not isinstance(shift, int | float) or isinstance(shift, bool) or not abs(shift) < MOST_SHIFT:
        raise InputRefused("shift_s: expected a time in s")
    beside = path.with_suffix(".map.toml")
    mapped = beside.is_file()
    try:
        log = read_log(path, column_map([beside] if mapped else []))
    except InputRefused as refusal:
        hint = "" if mapped else f"; a map of its columns belongs beside it as {beside.name}: twin log new {path}"
        raise InputRefused(f"{refusal}{hint}") from None
    return LogRun(log, experiment, float(shift)), "; ".join(log.notes)
