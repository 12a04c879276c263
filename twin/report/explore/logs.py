"""Logs of robots below the current folder, for comparison with a run: their signals and the estimator's results.

They are read like in `twin replay`, with the column map that `twin log new` writes next to them.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twin.kernel.cosim.delay import values_by_port
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.recording.folder import RECORDING_FILE
from twin.kernel.recording.logs.bag import is_bag
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import Log, LogSeries
from twin.kernel.recording.logs.reader import read_log
from twin.report.page.panels import PanelRun
from twin.robot.controller.controller import ESTIMATOR_OUTPUTS
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.view import LogView
from twin.studies.metrics.response import Curve
from twin.studies.replay.model import model_of
from twin.studies.replay.parts import pressing
from twin.studies.replay.replay import estimates
from twin.studies.replay.samples import robot_samples

LOG_SUFFIXES = (".csv", ".mcap", ".db3", ".db3.zstd", ".mcap.zstd")
MAX_DEPTH = 4
MAX_LOGS = 100
MAX_ENTRIES = 20_000
ENCODER_SERIES = {"encoder": ("count_m", "count_l"), "estimator": ("theta_m", "theta_l")}
"""Series of encoders; position and force are computed from them."""
MAX_SHIFT = 1e6
"""Maximum time shift of a log (s)."""
MISSING_PERIODS = 0.75
"""Time without a sample, in sample periods, after which a sample counts as missing."""
MAX_SAMPLES = 4_000_000
"""Maximum number of samples of one series, gaps included."""


def known_logs() -> list[str]:
    """List the paths of robot logs below the current folder: tables, ROS 2 bags, MCAP files other than run.mcap."""
    found: list[str] = []
    for number, entry in enumerate(_entries(Path(), MAX_DEPTH)):
        if number >= MAX_ENTRIES or len(found) >= MAX_LOGS:
            break
        if is_bag(entry) if entry.is_dir() else entry.name.endswith(LOG_SUFFIXES) and entry.name != RECORDING_FILE:
            found.append(str(entry))
    return sorted(found)


def _entries(folder: Path, depth: int) -> Iterator[Path]:
    """Yield files and folders below `folder`, without hidden ones, links and the contents of bags."""
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


def _view_of(log: Log, experiment: Experiment, shift: float) -> LogView:
    """Convert a log, its times moved by `shift` (s), to a view, with all topics on one clock and NaN in gaps.

    The estimator of the `experiment` computes position and force from the encoders' counts.
    """
    vectors = {name.partition("[")[0] for name in log.series if name.endswith("[0]")}
    series = {name: log[name] for name in log.series if not name.endswith("]")}
    series |= {name: log.vector(name) for name in vectors}
    if any(f"{topic}.{name}[0]" in log.series for topic, names in ENCODER_SERIES.items() for name in names):
        series |= {key: one for key, one in _estimates(log, experiment).items() if key not in series}
    times: dict[str, Curve] = {}
    columns: dict[str, Curve] = {}
    for key, one in series.items():
        topic, period = key.rpartition(".")[0], one.sampling.period
        if topic not in times:
            count = int((one.t[-1] - one.t[0]) / period + 1e-6) + 1
            if count > MAX_SAMPLES:
                raise InputRefused(f"{key}: {count:.3g} samples with its gaps; expected at most {MAX_SAMPLES:,}")
            times[topic] = shift + one.t[0] + period * np.arange(count)
        grid = times[topic] - shift
        place = np.maximum(np.searchsorted(one.t, grid + 0.5 * period, side="right") - 1, 0)
        columns[key] = one.values[place].astype(float)
        if one.sampling.regular:
            columns[key][grid - one.t[place] > MISSING_PERIODS * period] = np.nan
    return LogView(columns, times)


def _estimates(log: Log, experiment: Experiment) -> dict[str, LogSeries]:
    """Return the outputs of the estimator for a log, and the pressing force as the controller computes it."""
    model = model_of(experiment)
    robot = robot_samples(log, model.belief)
    found = values_by_port(ESTIMATOR_OUTPUTS, estimates(robot, model)["estimator"])
    series = {f"estimator.{name}": values for name, values in found.items() if name != "valid"}
    series["controller.F_z"] = pressing(found)
    return {key: LogSeries(robot.t, values, "") for key, values in series.items()}


def log_run(ask: Mapping[str, Any], experiment: Experiment) -> tuple[PanelRun, str]:
    """Read the log that `ask` names ("log", "shift_s"; untrusted) and a column map next to it; return it and notes."""
    name, known, shift = str(ask.get("log")), known_logs(), ask.get("shift_s") or 0.0
    if name not in known:
        raise InputRefused(f"log {name[:80]!r}: no such log below the current folder; {nearest(name[:80], known)}")
    if not isinstance(shift, int | float) or isinstance(shift, bool) or not abs(shift) < MAX_SHIFT:
        raise InputRefused("shift_s: expected a time in s")
    path = Path(name)
    beside = path.with_suffix(".map.toml")
    mapped = beside.is_file()
    try:
        log = read_log(path, column_map([beside] if mapped else []))
    except InputRefused as refusal:
        hint = "" if mapped else f"; a map of its columns is expected in {beside.name} next to it: twin log new {path}"
        raise InputRefused(f"{refusal}{hint}") from None
    return PanelRun(_view_of(log, experiment, float(shift)), experiment.values), "; ".join(log.notes)
