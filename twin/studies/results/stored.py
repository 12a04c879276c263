"""The runs in a folder of results: their properties, differences from the current experiment files, and removal."""

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Any

from twin.kernel.errors import InputRefused, TwinError, nearest, translate_disk_errors
from twin.kernel.files import read_json
from twin.kernel.recording.folder import FOLDER_STAMP, LATEST_LINK, NAMED_NOTE_FILE, PARTIAL_SUFFIX, RECORDING_FILE
from twin.kernel.recording.reader import last_time, read_metadata
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.assembly.drives import fmus
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.command_words import options, repeating_words, run_command
from twin.robot.experiment.differences import comparable_values, differing_values, recorded_comparable_values
from twin.robot.experiment.experiment_files import experiment_file
from twin.robot.experiment.recorded import recorded_name, recorded_values
from twin.robot.run.measures import LARGE_OVERSHOOT, ROWS_BY_KEY
from twin.robot.run.run import SUMMARY_FILE, without_folders
from twin.studies.command import Answer, Say, Steps
from twin.studies.result import count_text, shorten, wrap_text

WRITTEN_NAMES = re.compile(
    r"run\.(mcap|mcap\.partial|csv|parquet|mat)|summary\.json|report\.html"
    r"|run_ros2/(run_ros2_0\.mcap|metadata\.yaml|map\.toml)"
    # Unfinished temporary files of `twin.kernel.atomic_write.own_files`.
    r"|\.(run|summary|report)\.\w{8}\.\w+"
)
"""Pattern of the files that twin writes into a run's folder: recording, summary, page and exports."""
MAX_DIFFERENCES = 4
"""Maximum number of differences shown in the text of a run; `--json` has all of them."""
MAX_VALUE_LENGTH = 40
"""Maximum length of a value in the text (characters); a list of waypoints does not fit in a line."""
DETAIL_INDENT = " " * 6
MAX_LISTED_FILES = 10
Differences = Mapping[str, tuple[str, str]]
"""Values of a stored run that differ now: key -> (then, now)."""


@dataclass(frozen=True)
class StoredRun:
    """A stored run: its folder in results/, named by experiment and time, or by the user.

    Attributes:
        latest: whether the link results/EXPERIMENT/latest points to this run.
        is_top_level: whether the folder is directly in results/, where only users create runs.
    """

    folder: Path
    recording: Path
    latest: bool
    is_top_level: bool = False

    @cached_property
    def has_user_name(self) -> bool:
        """Whether the user chose the name of the run's folder, even if it looks like a time."""
        if self.is_top_level or not FOLDER_STAMP.fullmatch(self.folder.name):
            return True
        return (self.folder / NAMED_NOTE_FILE).exists() or self._recorded_name not in ("", self.folder.parent.name)

    @property
    def experiment(self) -> str:
        """Name of the run's experiment: the parent folder's name, or the recorded name if the user chose the folder."""
        if not self.has_user_name:
            return self.folder.parent.name
        return self._recorded_name or self.folder.name

    @property
    def _recorded_name(self) -> str:
        return self.metadata.get("experiment", {}).get("name", "")

    @property
    def is_finished(self) -> bool:
        return self.recording.suffix != PARTIAL_SUFFIX

    @cached_property
    def size(self) -> int:
        """Size of all files in the run's folder (bytes)."""
        return size_of(self.folder)

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata of the run's recording; empty if it cannot be read."""
        try:
            return read_metadata(self.recording)
        except InputRefused:
            return {}

    @cached_property
    def start_options(self) -> list[str]:
        """Command-line options of the run, as recorded: `--drive`, `pmsm_foc.fmu`."""
        try:
            # twin records file names without folders; any recorded path is reduced to its name, so that no other file
            # is opened.
            values = without_folders(recorded_values(DECLARED_TABLES, self.metadata, self.recording))
            return options(values, self.metadata.get("origins", {}))
        except InputRefused:
            return []

    @property
    def words(self) -> list[str]:
        return repeating_words(self.summary, self.experiment, self.start_options)

    @cached_property
    def summary(self) -> dict[str, Any]:
        try:
            found = read_json(self.folder / SUMMARY_FILE)
        except InputRefused:
            return {}
        return found if isinstance(found, dict) else {}

    @cached_property
    def own_files(self) -> list[Path]:
        """Files in the run's folder that match the names twin writes."""
        return [path for path in self._files if WRITTEN_NAMES.fullmatch(path.relative_to(self.folder).as_posix())]

    @property
    def other_files(self) -> list[Path]:
        return sorted(set(self._files).difference(self.own_files))

    @cached_property
    def _files(self) -> list[Path]:
        """Files, links and empty folders in the run's folder, recursively; links are not followed."""
        found = []
        for place, folders, names in os.walk(self.folder):
            links = [name for name in folders if os.path.islink(os.path.join(place, name))]
            found += [Path(place, name) for name in (*names, *links)]
            if not folders and not names and Path(place) != self.folder:
                found.append(Path(place))
        return found

    def remove(self) -> int:
        """Remove the run's files and its folder if it is then empty; return the removed size (bytes)."""
        size = 0
        for path in self.own_files:
            size += path.lstat().st_size
            path.unlink()
        for folder in (*{path.parent for path in self.own_files if path.parent != self.folder}, self.folder):
            if not any(folder.iterdir()):
                folder.rmdir()
        return size


def stored_runs(results: Path, experiments: Sequence[str] = ()) -> list[StoredRun]:
    """Return the stored runs in a folder of results, grouped by experiment: newest first, then user-named ones."""
    runs = [run for home in _folders(results) for run in _runs(home)]
    runs.sort(key=lambda run: (run.experiment, run.has_user_name))
    there = dict.fromkeys(run.experiment for run in runs)
    for name in experiments:
        if name not in there:
            raise InputRefused(f"{results / name}: no run of it; {nearest(name, there, 'there are runs of {}')}")
    return [run for run in runs if not experiments or run.experiment in experiments]


def stored_run(recording: Path) -> StoredRun:
    """Return the stored run that wrote a recording; its folder is resolved from links."""
    return StoredRun(recording.parent.resolve(), recording, False)


def other_folders(results: Path) -> dict[str, int]:
    """Return the sizes (bytes) of the folders of results without runs, such as pictures of other commands."""
    return {home.name: size_of(home) for home in _folders(results) if not any(True for _ in _runs(home))}


def size_of(folder: Path) -> int:
    """Return the size of all files below `folder` (bytes); links are not followed."""
    total = 0
    for place, _, names in os.walk(folder):
        total += sum(os.lstat(os.path.join(place, name)).st_size for name in names)
    return total


def _folders(results: Path) -> list[Path]:
    if not results.is_dir():
        return []
    return sorted(path for path in results.iterdir() if path.is_dir() and not path.is_symlink())


def _runs(home: Path) -> Iterator[StoredRun]:
    latest = os.path.realpath(home / LATEST_LINK)
    stamped = [path for path in home.iterdir() if FOLDER_STAMP.fullmatch(path.name) and not path.is_symlink()]
    # The second of two runs within a second ends in _2, the tenth in _10.
    stamped.sort(key=lambda path: (path.name[:17], len(path.name), path.name), reverse=True)
    for folder in (*stamped, home):
        for name in (RECORDING_FILE, f"{RECORDING_FILE}{PARTIAL_SUFFIX}"):
            if (folder / name).is_file():
                yield StoredRun(folder, folder / name, os.path.realpath(folder) == latest, folder == home)
                break


class CurrentExperiments:
    """Cache of the current experiment files, for comparison with stored runs."""

    def __init__(self) -> None:
        self._facts: dict[tuple[str, ...], dict[str, str]] = {}

    def differences(self, run: StoredRun) -> dict[str, tuple[str, str]]:
        """Return the values that would differ if a stored run were repeated now: key -> (then, now).

        The gains of a third-party controller are not recorded, so they are not compared.

        Raises:
            TwinError: the run records no experiment, or the experiment is missing or invalid now.
        """
        then = recorded_comparable_values(DECLARED_TABLES, run.metadata, run.recording)
        now = self._experiment_facts(recorded_name(run.metadata, run.recording), run)
        if "controller" in run.metadata.get("substituted", {}):
            now = {key: value for key, value in now.items() if key in then or not key.startswith("controller.")}
        return {key: (values[0], values[1]) for key, values in differing_values([then, now]).items()}

    def _experiment_facts(self, name: str, run: StoredRun) -> dict[str, str]:
        first, *words = run.words
        # a summary that contradicts its recording names no file
        typed = Path(first).name.removesuffix(".toml") == name and bool(words) == bool(run.start_options)
        if not typed:
            first, words = name, run.start_options
        known = (first, *words)
        if known not in self._facts:
            given: dict[str, list[str]] = {}
            for option, value in zip(words[::2], words[1::2], strict=True):
                given.setdefault(option, []).append(value)
            drive, body = (given.get(option, [None])[0] for option in ("--drive", "--body"))
            file = experiment_file(first)
            # A recorded name must not match another file in the current folder.
            if file.name != f"{name}.toml":
                raise InputRefused(f"{name}: not a valid name of an experiment, and the recording has it")
            if body and Path(body).name != body and not typed:
                raise InputRefused(f"its body {body} is named by a path, and only a name is looked up")
            experiment = load_experiment(file, given.get("--set", ()), drive, body)
            hashes = {fmu.path.name: fmu.sha256 for one in experiment.drives for fmu in fmus(one).values()}
            # Convert through JSON, like the recorded values.
            self._facts[known] = comparable_values(json.loads(json.dumps(without_folders(experiment.values))), hashes)
        return self._facts[known]


def describe_differences(run: StoredRun, now: CurrentExperiments) -> tuple[Differences, str]:
    """Return a run's differences from its experiment's current file, or else why they cannot be listed."""
    if "system" in run.metadata:
        return {}, "a system of FMUs, without an experiment"
    if "experiment" not in run.metadata:
        return {}, "the recording does not name its experiment"
    try:
        return now.differences(run), ""
    except TwinError as problem:
        return {}, str(problem).splitlines()[0].removesuffix(":")


def runs_text(
    results: Path, runs: Sequence[StoredRun], differences: Sequence[tuple[Differences, str]], others: Mapping[str, int]
) -> str:
    """Return the list of stored runs as text: totals, then each run, the newest of each experiment first."""
    if not runs:
        return f"{results}: no runs; the first: twin run fig4_force_position"
    experiments = len({run.experiment for run in runs})
    total = size_text(sum(run.size for run in runs))
    lines = [f"{results}: {count_text(len(runs), 'run')} of {count_text(experiments, 'experiment')}, {total}"]
    last = ""
    for run, (found, why) in zip(runs, differences, strict=True):
        if run.experiment != last:
            lines += ["", run.experiment]
            last = run.experiment
        lines += [*run_lines(run), *difference_lines(found, why)]
    if others:
        given = ", ".join(f"{name} {size_text(size)}" for name, size in others.items())
        lines += ["", *wrap_text(f"also there: {given}", later=2)]
    return "\n".join(lines)


def run_lines(run: StoredRun) -> list[str]:
    """Return the lines of a stored run: time, size and verdict, and the command to repeat it if necessary."""
    latest = "  latest" if run.latest else ""
    # A single line of any length: a wrapped command could not be copied.
    made = [f"{DETAIL_INDENT}{run_command(run.words)}"] if run.words != [run.experiment] else []
    return [f"  {run.folder.name:17}  {size_text(run.size):>7}  {verdict(run)}{latest}", *made]


def verdict(run: StoredRun) -> str:
    if not run.is_finished:
        return f"not finished: ends at {last_time(run.recording) or 0.0:.3g} s"
    words = []
    if run.summary.get("trip"):
        words.append("safety trip")
    elif any(level in ("ERROR", "FATAL") for level in _event_levels(run.summary)):
        words.append("failed")
    outcome = run.summary.get("outcome")
    if isinstance(outcome, dict):
        peak, error, hold = outcome.get("peak"), outcome.get("force_error"), _measure_value(outcome, "hold_error")
        words += [f"hold error {ROWS_BY_KEY['hold_error'].format_value(hold)}"] if hold is not None else []
        if (overshoot := _measure_value(outcome, "hold_overshoot") or 0.0) > LARGE_OVERSHOOT:
            words.append(f"overshoot {ROWS_BY_KEY['hold_overshoot'].format_value(overshoot)}")
        words += [f"at most {peak:.2f} N" if peak > 0.0 else "never touched"] if isinstance(peak, float) else []
        if hold is None and isinstance(error, float):
            words.append(f"error since the first touch {error:.2f} N")
    return ", ".join(words) or "finished"


def _measure_value(outcome: Mapping[str, Any], key: str) -> float | None:
    """Return a measure from a run's summary file, which is untrusted input; None if missing or invalid."""
    measures = outcome.get("measures")
    found = measures.get(key) if isinstance(measures, dict) else None
    value = found.get("value") if isinstance(found, dict) else None
    return value if isinstance(value, float) else None


def difference_lines(differences: Differences, why: str) -> list[str]:
    """Return lines on a stored run's differences from its experiment's current file; empty without any."""
    if why:
        return wrap_text(f"not compared with its file: {why}", DETAIL_INDENT, later=8)
    lines = []
    for key, values in list(differences.items())[:MAX_DIFFERENCES]:
        then, now = (shorten(value, MAX_VALUE_LENGTH) for value in values)
        lines += wrap_text(f"{key} was {then}, is {now} now", DETAIL_INDENT, later=8, whole=True)
    more = len(differences) - MAX_DIFFERENCES
    return [*lines, *([f"{DETAIL_INDENT}and {count_text(more, 'more difference')}"] if more > 0 else [])]


def size_text(size: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000.0 or unit == "GB":
            return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"
        size /= 1000.0
    raise AssertionError


def _event_levels(summary: Mapping[str, Any]) -> list[Any]:
    events = summary.get("events")
    listed = events if isinstance(events, list) else []
    return [one[1] for one in listed if isinstance(one, list) and len(one) == 3]


def list_runs(results: Path, experiments: Sequence[str], say: Say) -> Answer:
    """Return the list of stored runs and their differences; all, with other folders, if `experiments` is empty."""
    runs, now = stored_runs(results, experiments), CurrentExperiments()
    found = []
    steps = Steps(say, len(runs))
    for run in runs:
        steps.next(run.experiment)
        found.append(describe_differences(run, now))
    others = {} if experiments else other_folders(results)
    facts = {
        "results": str(results),
        "runs": [
            {
                "folder": str(run.folder),
                "experiment": run.experiment,
                "latest": run.latest,
                "finished": run.is_finished,
                "bytes": run.size,
                "verdict": verdict(run),
                "outcome": run.summary.get("outcome"),
                "with": run.start_options,
                "command": run_command(run.words),
                "changed_since": {key: {"then": then, "now": now} for key, (then, now) in differences.items()},
                "not_compared": why,
            }
            for run, (differences, why) in zip(runs, found, strict=True)
        ],
        "others": others,
    }
    return Answer(runs_text(results, runs, found, others), facts)


def removable_runs(results: Path, experiments: Sequence[str], keep: int) -> list[StoredRun]:
    """Return the runs that may be removed: all but `latest`, user-named ones and each experiment's newest `keep`."""
    seen: dict[str, int] = {}
    doomed = []
    for run in stored_runs(results, experiments):
        if run.has_user_name:
            continue
        seen[run.experiment] = seen.get(run.experiment, 0) + 1
        if seen[run.experiment] > keep and not (keep and run.latest):
            doomed.append(run)
    return doomed


def removal_text(doomed: Sequence[StoredRun]) -> str:
    lines = [f"{count_text(len(doomed), 'run')}, {size_text(sum(run.size for run in doomed))}, would go:"]
    for experiment, runs in groupby(doomed, lambda run: run.experiment):
        lines += [experiment, *(line for run in runs for line in run_lines(run))]
    if left := [str(path) for run in doomed for path in run.other_files]:
        lines += ["stays, because twin did not write it:", *(f"  {path}" for path in left[:MAX_LISTED_FILES])]
        lines += [f"  and {len(left) - MAX_LISTED_FILES} more"] if len(left) > MAX_LISTED_FILES else []
    return "\n".join(lines)


def remove_runs(doomed: Sequence[StoredRun]) -> str:
    size = 0
    others = sum(len(run.other_files) for run in doomed)
    for run in doomed:
        with translate_disk_errors(run.folder, "cannot be removed"):
            size += run.remove()
            latest = run.folder.parent / LATEST_LINK
            if run.latest and latest.is_symlink():
                latest.unlink()
            if not any(run.folder.parent.iterdir()):
                run.folder.parent.rmdir()
    stays = f"; {count_text(others, 'file')} that twin did not write stayed" if others else ""
    return f"removed {count_text(len(doomed), 'run')}, {size_text(size)}{stays}"
