"""The plan of a sweep: the points of its design, and every run with its key, checked without running it."""

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused
from twin.robot.experiment.source import NAMING
from twin.studies.sweep.definition import SweepFile, Value, Vary, read_definition
from twin.studies.sweep.measures import checked_metric, metric_names

if TYPE_CHECKING:
    from twin.robot.experiment.experiment import Experiment


MOST = 10_000_000
"""Points that are planned in memory at most."""
_TINY = 2.0**-53
"""Half a unit in the last place of 1: keeps a draw off the ends, where distributions reach to infinity."""


@dataclass(frozen=True)
class DesignPoint:
    """One run: the drive (None: the experiment's own) and the values decided, by the label of their [[vary]]."""

    drive: str | None
    parameters: dict[str, Value]


def largest_count(definition: SweepFile) -> int:
    """How many runs it makes if every condition holds; no point is made for that."""
    if definition.design == "grid":
        points = math.prod(len(vary.values) if vary.values else vary.count or 1 for vary in definition.vary)
    else:
        points = definition.runs or 0
    if definition.design == "saltelli":
        points *= block_width(len(definition.vary))
    return points * max(1, len(definition.drives))


def points(definition: SweepFile) -> list[DesignPoint]:
    """Every run, no two alike. Each drive runs the same points, so that drives can be compared.

    Raises:
        InputRefused: more than fit in memory.
    """
    if (count := largest_count(definition)) > MOST:
        raise InputRefused(f"{count:,} runs: more than {MOST:,} cannot be planned; take fewer levels, or draw")
    cube = None if definition.design == "grid" else unit_cube(definition)
    found: dict[tuple[object, ...], DesignPoint] = {}
    drives: list[str | None] = [*definition.drives] or [None]
    for drive in drives:
        start: dict[str, Value] = {} if drive is None else {"drive": drive}
        rows = grid(definition.vary, start) if cube is None else (_drawn(definition.vary, start, u) for u in cube)
        for chosen in rows:
            chosen.pop("drive", None)
            # without the keys that a condition left out, two draws can be the same run
            found.setdefault((drive, *((type(v), k, v) for k, v in chosen.items())), DesignPoint(drive, chosen))
    return list(found.values())


def grid(tables: list[Vary], chosen: dict[str, Value]) -> Iterator[dict[str, Value]]:
    """Every combination of levels, the last table varying fastest; one whose condition fails adds none."""
    if not tables:
        yield dict(chosen)
        return
    first, *rest = tables
    if not first.applies(chosen):
        yield from grid(rest, chosen)
        return
    for level in first.levels():
        yield from grid(rest, {**chosen, first.label: level})


def unit_cube(definition: SweepFile) -> NDArray[np.float64]:
    """Draws of the design, (runs, tables), inside 0 .. 1. Same seed, same draws. Of "saltelli" see `saltelli_cube`.

    Source: scipy.stats.qmc; Latin hypercube after McKay, Beckman and Conover (1979), Sobol' scrambled after Owen.
    """
    rng = np.random.default_rng(definition.seed)
    runs, dimensions = definition.runs or 0, len(definition.vary)
    if definition.design == "random":
        draws = rng.random((runs, dimensions))
    elif definition.design == "saltelli":
        draws = saltelli_cube(runs, dimensions, rng)
    else:
        from scipy.stats import qmc

        engine = (qmc.Sobol if definition.design == "sobol" else qmc.LatinHypercube)(dimensions, seed=rng)
        draws = engine.random(runs)
    return np.clip(draws, _TINY, 1.0 - _TINY)


def _drawn(tables: list[Vary], chosen: dict[str, Value], u: NDArray[np.float64]) -> dict[str, Value]:
    chosen = dict(chosen)
    for vary, share in zip(tables, u, strict=True):
        if vary.applies(chosen):
            chosen[vary.label] = vary.drawn(float(share))
    return chosen


def block_width(dimensions: int) -> int:
    """Runs in a block."""
    return dimensions + 2


def saltelli_cube(blocks: int, dimensions: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draws, (blocks * (d + 2), d), from which Sobol' indices are estimated: two points and those in between.

    A block of d + 2 runs is a row of the matrices A, B, A_B^1 .. A_B^d of Saltelli et al. (2010), "Variance based
    sensitivity analysis of model output", Computer Physics Communications 181: A_B^i is A with parameter i of B. Block
    comes after block, so that a sweep that was interrupted has whole blocks. A and B are the two halves of a scrambled
    Sobol' sequence in 2 d dimensions, as Saltelli et al. advise (Sec. 3).

    Args:
        blocks: a power of 2.
    """
    from scipy.stats import qmc

    A, B = np.split(qmc.Sobol(2 * dimensions, seed=rng).random(blocks), 2, axis=1)
    cube = np.repeat(A[:, None, :], block_width(dimensions), axis=1)
    cube[:, 1] = B
    for i in range(dimensions):
        cube[:, 2 + i, i] = B[:, i]
    return cube.reshape(-1, dimensions)


@dataclass(frozen=True)
class Task:
    """One run.

    Attributes:
        run: its number, from 1.
        key: says what it computes, see `SweepPlan`.
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
class SweepPlan:
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
    definition: SweepFile
    experiment: Path
    tasks: tuple[Task, ...]
    metrics: tuple[str, ...]
    configuration: dict[str, str]


def planned(path: Path) -> SweepPlan:
    """The sweep file at `path` as a plan.

    Raises:
        InputRefused: as `read_definition` and `plan_of`.
    """
    definition, experiment = read_definition(path)
    return plan_of(definition, experiment, path.stem, str(path))


def plan_of(definition: SweepFile, experiment: Path, name: str, source: str, settings: Sequence[str] = ()) -> SweepPlan:
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
    return SweepPlan(name, definition, experiment, tasks, metrics, configuration)


def _settings(definition: SweepFile, point: DesignPoint) -> tuple[str, ...]:
    """What `load_experiment` takes; JSON writes numbers, texts and truth values as TOML does."""
    return tuple(
        f"{name}={json.dumps(point.parameters[vary.label])}"
        for vary in definition.vary
        if vary.label in point.parameters
        for name in vary.names
    )


Draft = tuple[DesignPoint, tuple[str, ...]]


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

    def key(self, point: DesignPoint, settings: tuple[str, ...]) -> str:
        return _hash([self._version, self._known(point, settings)[0], point.drive, settings])[:16]

    def pins(self, point: DesignPoint, settings: tuple[str, ...]) -> tuple[str, ...]:
        """Settings by which a run takes no other file for a third-party part than the one that was planned with."""
        return self._known(point, settings)[1]

    def _known(self, point: DesignPoint, settings: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
        """Digest and pins of the files of a run, found out once."""
        files = point.drive, texts(settings)
        if files not in self._found:
            _, digest, parts = self.load(*files)
            self.digests[files] = digest
            pins = tuple(f'{role}.sha256="{of}"' for role, of in parts.items())
            self._found[files] = digest, pins
        return self._found[files]

    def load(self, drive: str | None, settings: tuple[str, ...]) -> "tuple[Experiment, str, dict[str, str]]":
        """A run, the digest of its files, and the hashes of its third-party parts by their names.

        Raises:
            InputRefused: it is none.
        """
        # the FMU tool chain takes a while to import
        from twin.robot.assembly.drives import planned as planned_drive
        from twin.robot.assembly.load import load_experiment
        from twin.robot.assembly.roles import digest
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
