"""A sweep made ready: every run with its key, checked as far as that goes without running it."""

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.errors import InputRefused
from twin.experiment.replaced import NAMING
from twin.studies.sweep.definition import Definition, read_definition
from twin.studies.sweep.design import Point, points
from twin.studies.sweep.measures import checked_metric, metric_names
from twin.studies.sweep.vary import Value

if TYPE_CHECKING:
    from twin.experiment.experiment import Experiment


@dataclass(frozen=True)
class Task:
    """One run.

    Attributes:
        run: its number, from 1.
        key: says what it computes, see `Plan`.
        drive: None: the experiment's own.
        parameters: by label.
        settings: for `load_experiment`.
    """

    run: int
    key: str
    drive: str | None
    parameters: dict[str, Value]
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Plan:
    """A sweep that may begin.

    Attributes:
        name: of the file.
        definition: what it says.
        experiment: its file.
        tasks: every run once. A key is the hash of all that decides the result: version of twin, the experiment's
            values, the FMUs' SHA-256, drive and settings.
        metrics: that a run may have.
        configuration: what all runs have in common, by what a user would call it -> hash.
    """

    name: str
    definition: Definition
    experiment: Path
    tasks: tuple[Task, ...]
    metrics: tuple[str, ...]
    configuration: dict[str, str]


def planned(path: Path) -> Plan:
    """The sweep file at `path` as a plan.

    Raises:
        InputRefused: as `read_definition` and `plan_of`.
    """
    definition, experiment = read_definition(path)
    return plan_of(definition, experiment, path.stem, str(path))


def plan_of(definition: Definition, experiment: Path, name: str, source: str, settings: Sequence[str] = ()) -> Plan:
    """What `definition` means for the file `experiment`: first and extreme runs loaded, their FMUs described.

    Args:
        name: of the sweep.
        source: what a mistake is blamed on.
        settings: for `load_experiment`, of every run.

    Raises:
        InputRefused: no run, or values that make no experiment, or a limit of no metric.
    """
    drafts = [(point, (*settings, *_settings(definition, point))) for point in points(definition)]
    if not drafts:
        raise InputRefused(f"{source}: makes no run; no condition holds")
    files = _Files(source, experiment, definition.claims is not None)
    loaded = [files.load(point.drive, draft)[0] for point, draft in _extremes(drafts)]
    metrics = metric_names(loaded[0].measures)
    for metric in definition.limits:
        checked_metric(f"{source}: [limits]", metric, metrics)
    tasks = tuple(
        Task(number, files.key(point, draft), point.drive, point.parameters, (*draft, *files.pins(point, draft)))
        for number, (point, draft) in enumerate(drafts, start=1)
    )
    configuration = {
        "the sweep": _hash([definition.model_dump(mode="json"), settings]),
        "the experiment, a body or an FMU": _hash(sorted(files.digests.values())),
        "the version of twin": version("twin"),
    }
    return Plan(name, definition, experiment, tasks, metrics, configuration)


def _settings(definition: Definition, point: Point) -> tuple[str, ...]:
    """What `load_experiment` takes; JSON writes numbers, texts and truth values as TOML does."""
    return tuple(
        f"{name}={json.dumps(point.parameters[vary.label])}"
        for vary in definition.vary
        if vary.label in point.parameters
        for name in vary.names
    )


Draft = tuple[Point, tuple[str, ...]]


def _extremes(drafts: Sequence[Draft]) -> Iterable[Draft]:
    """Of every drive the first run, those with the least and the most of each number, one with each other value."""
    ends: dict[tuple[str | None, str, object], tuple[float, int]] = {}
    for number, (point, _) in enumerate(drafts):
        ends.setdefault((point.drive, "", None), (0.0, number))
        for label, value in point.parameters.items():
            sides = {value: 0.0} if isinstance(value, bool | str) else {-1.0: -value, 1.0: value}
            for side, size in sides.items():
                key = (point.drive, label, side)
                if key not in ends or size > ends[key][0]:
                    ends[key] = (size, number)
    return [drafts[number] for number in dict.fromkeys(number for _, number in ends.values())]


def texts(settings: Sequence[str]) -> tuple[str, ...]:
    """Those of `settings` that are no numbers.

    A number cannot name a file, a text can: a body, an FMU. So runs that share drive and texts share their files.
    """
    return tuple(text for text in settings if text.endswith('"'))


class _Files:
    """What runs stand on besides their numbers, read once per drive and choice of texts: digests by these."""

    def __init__(self, source: str, experiment: Path, judged: bool):
        self._source, self._experiment, self._judged = source, experiment, judged
        self._version = version("twin")
        self.digests: dict[tuple[str | None, tuple[str, ...]], str] = {}
        self._found: dict[tuple[str | None, tuple[str, ...]], tuple[str, tuple[str, ...]]] = {}

    def key(self, point: Point, settings: tuple[str, ...]) -> str:
        return _hash([self._version, self._known(point, settings)[0], point.drive, settings])[:16]

    def pins(self, point: Point, settings: tuple[str, ...]) -> tuple[str, ...]:
        """Settings by which a run takes no other file for a part of another make than the one that was planned with."""
        return self._known(point, settings)[1]

    def _known(self, point: Point, settings: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
        """Digest and pins of the files of a run, found out once."""
        files = point.drive, texts(settings)
        if files not in self._found:
            _, digest, parts = self.load(*files)
            self.digests[files] = digest
            pins = tuple(f'{role}.sha256="{of}"' for role, of in parts.items())
            self._found[files] = digest, pins
        return self._found[files]

    def load(self, drive: str | None, settings: tuple[str, ...]) -> "tuple[Experiment, str, dict[str, str]]":
        """A run, the digest of its files, and the hashes of its parts of another make by their names.

        Raises:
            InputRefused: it is none.
        """
        # the FMU tool chain takes a while to import
        from twin.runs.assembly.drives import planned as planned_drive
        from twin.runs.assembly.load import load_experiment
        from twin.runs.assembly.roles import digest
        from twin.studies.sweep.fig4 import refuse_unfit

        where = ", ".join(filter(None, [f"drive {drive}" if drive else "", *settings])) or "as it stands"
        try:
            loaded = load_experiment(self._experiment, settings, drive)
            if self._judged:
                refuse_unfit(loaded)
            tables = {table.model_dump_json(): table for table in loaded.drives}
            plans = [planned_drive(table) for table in tables.values()]
            parts = {role: digest(role, table) for role, table in loaded.stand_ins.items()}
        except InputRefused as refusal:
            raise InputRefused(f"{self._source}: the run with {where} cannot be made:\n{refusal}") from None
        fmus = [fmu.sha256 for plan in plans for fmu in plan.parts.values()]
        # nothing more where there is no such part: the keys of sweeps that were begun stay what they are
        return loaded, _hash([_without_paths(loaded.values), [*fmus, *parts.values()]]), parts


def _without_paths(values: Any) -> Any:
    """`values` with FMUs by their file's name: where they lie decides nothing, and their hash says what they are."""
    if isinstance(values, dict):
        return {k: Path(v).name if k in NAMING and isinstance(v, str) else _without_paths(v) for k, v in values.items()}
    return values


def _hash(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
