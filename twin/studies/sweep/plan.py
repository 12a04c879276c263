"""The plan of a sweep, from its file SWEEP.toml: the points of the design, and every run with its key.

The file names the experiment, the keys that vary and the drives. It is validated without running anything.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from twin.kernel.errors import InputRefused
from twin.kernel.files import read_toml
from twin.kernel.units import has_plain_digits
from twin.robot.experiment.experiment_files import no_sweep_message
from twin.robot.experiment.mistakes import error_messages
from twin.robot.experiment.source import FILE_KEYS
from twin.robot.paths import locate_file
from twin.studies.sweep.measures import metric_names, require_metric

if TYPE_CHECKING:
    from twin.robot.experiment.experiment import Experiment

Value = bool | int | float | str
_DISTRIBUTION_KEYS = {"normal": ("mean", "std"), "lognormal": ("median", "sigma")}
_TOML_KEYS = {"low": "from", "high": "to"}
MAX_PLANNED_RUNS = 10_000_000
_END_MARGIN = 2.0**-53
"""Half a unit in the last place of 1; keeps draws away from 0 and 1, where quantiles are infinite."""


class _SweepTable(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Condition(_SweepTable):
    """Condition `when = { key, value }` of a [[vary]] table: its keys vary only if another key has that value."""

    key: str
    value: Value


class Vary(_SweepTable):
    """One [[vary]] table of a sweep file: keys that vary together, and their levels or distribution.

    Attributes:
        key, keys: keys of the experiment, with their units; several keys get the same value.
        values: levels of a grid, or values drawn with equal probability.
        low, high: ends of an interval, `from` and `to` in TOML.
        count: number of levels in a grid.
        scale: whether levels and probability are uniform in the value or in its logarithm.
        distribution: distribution of an uncertain value; uniform has `from` and `to`, normal `mean` and `std`,
            lognormal `median` and `sigma`, the standard deviation of the natural logarithm.
    """

    key: str | None = None
    keys: list[str] | None = Field(None, min_length=1)
    values: list[Value] | None = Field(None, min_length=1)
    low: float | None = Field(None, alias="from")
    high: float | None = Field(None, alias="to")
    count: int | None = Field(None, ge=1)
    scale: Literal["linear", "log"] = "linear"
    distribution: Literal["uniform", "normal", "lognormal"] | None = None
    mean: float | None = None
    std: float | None = Field(None, gt=0)
    median: float | None = Field(None, gt=0)
    sigma: float | None = Field(None, gt=0)
    when: Condition | None = None

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.keys or ()) + ((self.key,) if self.key is not None else ())

    @property
    def label(self) -> str:
        return self.names[0] if self.names else ""

    def applies(self, chosen: Mapping[str, Value]) -> bool:
        """Whether the keys of this [[vary]] table vary in a run, given the values chosen before."""
        return self.when is None or (self.when.key in chosen and chosen[self.when.key] == self.when.value)

    def levels(self) -> tuple[Value, ...]:
        if self.values is not None:
            return tuple(self.values)
        assert self.low is not None and self.high is not None and self.count is not None
        space = np.geomspace if self.scale == "log" else np.linspace
        return tuple(space(self.low, self.high, self.count).tolist())

    def quantile(self, u: float) -> Value:
        """Return the value with the cumulative probability `u`, 0 < u < 1, in this [[vary]] table's distribution."""
        if self.values is not None:
            return self.values[min(int(u * len(self.values)), len(self.values) - 1)]
        if self.distribution in _DISTRIBUTION_KEYS:
            # Importing scipy is slow, and a grid does not need it.
            from scipy.special import ndtri

            if self.distribution == "normal":
                assert self.mean is not None and self.std is not None
                return float(self.mean + self.std * ndtri(u))
            assert self.median is not None and self.sigma is not None
            return float(self.median * math.exp(self.sigma * ndtri(u)))
        assert self.low is not None and self.high is not None
        if self.scale == "log":
            return float(self.low * (self.high / self.low) ** u)
        return float(self.low + u * (self.high - self.low))


def contradictions(vary: Vary, sampled: bool, known: Sequence[str]) -> list[str]:
    """Return errors for missing, superfluous or contradictory keys; `sampled` designs draw, grids have levels."""
    mistakes = _name_mistakes(vary)
    needed: tuple[str, ...] = _DISTRIBUTION_KEYS.get(vary.distribution or "", ("low", "high"))
    if vary.values is not None:
        needed = ()
        if len({(type(value) is bool, value) for value in vary.values}) < len(vary.values):
            mistakes.append("values: one is there twice; a run is counted once, remove one")
    allowed = {*needed, *(("count",) if not sampled and needed else ())}
    numbers = ("low", "high", "count", "mean", "std", "median", "sigma")
    given = {name for name in numbers if getattr(vary, name) is not None}
    mistakes += [f"missing key '{_TOML_KEYS.get(name, name)}'" for name in sorted(allowed - given)]
    mistakes += [f"{_TOML_KEYS.get(name, name)}: {_why_not(vary, name, sampled)}" for name in sorted(given - allowed)]
    if vary.distribution and (vary.values is not None or not sampled):
        why = "values are drawn evenly" if vary.values is not None else "a grid has levels"
        mistakes.append(f"distribution: {why}; remove it" + ("" if sampled else ", or choose another design"))
    if vary.low is not None and vary.high is not None:
        if vary.low >= vary.high:
            mistakes.append(f"from = {vary.low:g}, to = {vary.high:g}: expected from < to")
        elif vary.scale == "log" and vary.low <= 0.0:
            mistakes.append(f'from = {vary.low:g}: scale = "log" needs a number > 0')
    if vary.scale == "log" and needed != ("low", "high"):
        mistakes.append('scale = "log" belongs to from and to; remove it')
    if vary.when and vary.when.key not in known:
        named = f"known here are {', '.join(known)}" if known else "no table precedes this one"
        mistakes.append(f"when: '{vary.when.key}' is not decided before; {named}")
    return mistakes


def _name_mistakes(vary: Vary) -> list[str]:
    if (vary.key is None) == (vary.keys is None):
        return ["expected either key or keys"]
    if len(set(vary.names)) < len(vary.names):
        return ["keys: one is there twice; remove one"]
    if bad := [name for name in vary.names if not name.strip() or "=" in name]:
        return [f"key '{bad[0]}': expected a key of the experiment, such as contact.stiffness_N_per_m"]
    return ["'drive' cannot be varied as a key; name drives = [...] at the top"] if "drive" in vary.names else []


def _why_not(vary: Vary, name: str, sampled: bool) -> str:
    if name == "count" and sampled:
        return "belongs to a grid; the number of draws is runs, remove it"
    return "values define all levels; remove it" if vary.values is not None else "does not belong here; remove it"


DesignName = Literal["grid", "latin_hypercube", "sobol", "random", "saltelli"]


class SweepFile(_SweepTable):
    """Content of a sweep file (TOML): experiment, varied keys, design, drives, limits.

    Attributes:
        experiment: experiment file, searched from the sweep's folder upwards.
        runs: points per drive; None in a grid, whose levels determine the number. For design = "saltelli" the number of
            blocks; a block has two points more than there are parameters.
        claims: "fig4" to run each point with and without force control and judge the paper's claims on both runs.
        drives: drives that each run every point; empty for the experiment's own.
        limits: metric -> maximum.
    """

    experiment: str
    design: DesignName = "grid"
    runs: int | None = Field(None, ge=1)
    seed: int = Field(0, ge=0, lt=2**63)
    claims: Literal["fig4"] | None = None
    drives: list[str] = Field(default_factory=list)
    vary: list[Vary] = Field(default_factory=list)
    limits: dict[str, float] = Field(default_factory=dict)


def read_definition(path: Path) -> tuple[SweepFile, Path]:
    table = read_toml(path, "sweep file")
    # every experiment has a title, its own or that of the file it extends; a sweep file has neither
    if "experiment" not in table and table.keys() & {"title", "extends"}:
        raise InputRefused(no_sweep_message(path))
    definition = _validate_definition(table, str(path))
    return definition, locate_file(definition.experiment, path.resolve().parent)


def short_definition(experiment: Path, ranges: Sequence[str], drive: str | None) -> SweepFile:
    """Convert ranges of a command line, each "key=from:to:count", to the definition of a grid sweep."""
    tables = []
    for text in ranges:
        key, _, levels = text.partition("=")
        try:
            if not has_plain_digits(levels):
                raise ValueError
            low, high, count = levels.split(":")
            tables.append({"key": key.strip(), "from": float(low), "to": float(high), "count": int(count)})
        except ValueError:
            raise InputRefused(
                f"--sweep {text}: expected key=from:to:count, for example contact.stiffness_N_per_m=500:5000:10"
            ) from None
    table = {"experiment": str(experiment), "drives": [drive] if drive else [], "vary": tables}
    return _validate_definition(table, f"--sweep {' '.join(ranges)}")


def _validate_definition(table: dict[str, Any], place: str) -> SweepFile:
    try:
        definition = SweepFile.model_validate(table)
        mistakes = _disagreements(definition)
    except ValidationError as error:
        # pydantic's names of [[vary]] tables become those of the file
        mistakes = [
            sentence.replace("[.vary.when]", "[[vary]] when:").replace("[.vary]", "[[vary]]").removeprefix("[] ")
            for sentence in error_messages(error, SweepFile, "")
        ]
    if mistakes:
        raise InputRefused("\n".join(f"{place}: {mistake}" for mistake in mistakes))
    return definition


def _disagreements(definition: SweepFile) -> list[str]:
    """Return error messages for keys of a sweep file that contradict each other."""
    sampled = definition.design != "grid"
    mistakes = [] if definition.vary or definition.drives else ["varies nothing; add a table [[vary]], or drives"]
    if sampled and definition.runs is None:
        mistakes.append(f"design = \"{definition.design}\": missing key 'runs'")
    if sampled and not definition.vary:
        mistakes.append(f'design = "{definition.design}": nothing to draw; add a table [[vary]], or design = "grid"')
    if not sampled and definition.runs is not None:
        mistakes.append("runs: a grid has as many runs as its levels make; remove it, or choose another design")
    if definition.design == "saltelli":
        mistakes += why_not_saltelli(definition.vary)
    if definition.design in ("sobol", "saltelli") and (runs := definition.runs or 1) & (runs - 1):
        below = 1 << (runs.bit_length() - 1)
        mistakes.append(
            f"runs = {runs}: a Sobol sequence is balanced at powers of 2 only; choose {below} or {2 * below}"
        )
    if repeated := sorted({name for name in definition.drives if definition.drives.count(name) > 1}):
        mistakes.append(f"drives: '{repeated[0]}' is named twice; a run is counted once, remove one")
    known = ["drive"] if definition.drives else []
    taken: set[str] = set()
    for number, vary in enumerate(definition.vary, start=1):
        found = contradictions(vary, sampled, known)
        found += [f"'{name}' varies already in another table; remove one" for name in vary.names if name in taken]
        mistakes += [f"[[vary]] {number}: {mistake}" for mistake in found]
        taken.update(vary.names)
        known.append(vary.label)
    return mistakes


def why_not_saltelli(tables: Sequence[Vary]) -> list[str]:
    """Return an error for each key "values" or "when" of the [[vary]] tables; the design "saltelli" supports neither.

    `values` gives equal draws; `when` makes a parameter depend on another one.
    """
    return [
        f'[[vary]] {number}: {key} does not go with design = "saltelli", whose parameters are independent numbers; '
        "remove it, or choose another design"
        for number, vary in enumerate(tables, start=1)
        for key in ("values", "when")
        if getattr(vary, key) is not None
    ]


@dataclass(frozen=True)
class DesignPoint:
    """A point of a sweep's design: drive (None for the experiment's own) and value of each varied key."""

    drive: str | None
    parameters: dict[str, Value]


def largest_count(definition: SweepFile) -> int:
    """Return an upper limit of a sweep's number of runs, without generating them: as if every condition held."""
    if definition.design == "grid":
        points = math.prod(len(vary.values) if vary.values else vary.count or 1 for vary in definition.vary)
    else:
        points = definition.runs or 0
    if definition.design == "saltelli":
        points *= block_width(len(definition.vary))
    return points * max(1, len(definition.drives))


def points(definition: SweepFile) -> list[DesignPoint]:
    """Generate all distinct points of a sweep's design; each drive runs the same points for comparison."""
    if (count := largest_count(definition)) > MAX_PLANNED_RUNS:
        raise InputRefused(
            f"{count:,} runs: more than {MAX_PLANNED_RUNS:,} cannot be planned; take fewer levels, or draw"
        )
    cube = None if definition.design == "grid" else unit_cube(definition)
    found: dict[tuple[object, ...], DesignPoint] = {}
    drives: list[str | None] = [*definition.drives] or [None]
    for drive in drives:
        start: dict[str, Value] = {} if drive is None else {"drive": drive}
        rows = grid(definition.vary, start) if cube is None else (_draw_point(definition.vary, start, u) for u in cube)
        for chosen in rows:
            chosen.pop("drive", None)
            # A condition can drop keys, and two draws can then be the same run.
            found.setdefault((drive, *((type(v), k, v) for k, v in chosen.items())), DesignPoint(drive, chosen))
    return list(found.values())


def grid(tables: list[Vary], chosen: dict[str, Value]) -> Iterator[dict[str, Value]]:
    """Yield every combination of levels, the last table varying fastest; skip tables whose condition fails."""
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
    """Draw the samples of a sweep's design, (runs, tables), inside 0 .. 1; the seed makes them reproducible.

    Sources: Latin hypercube after McKay, Beckman and Conover (1979), Sobol' scrambled after Owen.
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
    return np.clip(draws, _END_MARGIN, 1.0 - _END_MARGIN)


def _draw_point(tables: list[Vary], chosen: dict[str, Value], u: NDArray[np.float64]) -> dict[str, Value]:
    chosen = dict(chosen)
    for vary, share in zip(tables, u, strict=True):
        if vary.applies(chosen):
            chosen[vary.label] = vary.quantile(float(share))
    return chosen


def block_width(dimensions: int) -> int:
    return dimensions + 2


def saltelli_cube(blocks: int, dimensions: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw the samples, (blocks * (d + 2), d), of a Saltelli design for Sobol' indices; `blocks` is a power of 2.

    A block of d + 2 runs is a row of the matrices A, B, A_B^1 .. A_B^d of Saltelli et al. (2010), "Variance based
    sensitivity analysis of model output", Computer Physics Communications 181: A_B^i is A with parameter i of B. Blocks
    are consecutive, so that an interrupted sweep has complete blocks. A and B are the two halves of a scrambled Sobol'
    sequence in 2 d dimensions, as Saltelli et al. advise (Sec. 3).
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
    """A planned run of a sweep: number from 1, and hash of all inputs, see `SweepPlan`."""

    run: int
    key: str
    drive: str | None
    parameters: dict[str, Value]
    settings: tuple[str, ...]


@dataclass(frozen=True)
class SweepPlan:
    """The validated plan of a sweep: all of its runs.

    Attributes:
        tasks: all runs, once each. A key is the hash of all inputs of the result: version of twin, the experiment's
            values, the FMUs' SHA-256, drive and settings.
        metrics: names of the metrics that a run can have.
        configuration: hash of each input shared by all runs, by its name in error messages.
    """

    name: str
    definition: SweepFile
    experiment: Path
    tasks: tuple[Task, ...]
    metrics: tuple[str, ...]
    configuration: dict[str, str]


def read_plan(path: Path) -> SweepPlan:
    definition, experiment = read_definition(path)
    return plan_of(definition, experiment, path.stem, str(path))


def plan_of(definition: SweepFile, experiment: Path, name: str, source: str, settings: Sequence[str] = ()) -> SweepPlan:
    """Plan the runs of a sweep, each with `settings`, after loading the first and the extreme runs.

    Error messages begin with `source`, the origin of the definition.
    """
    drafts = [(point, (*settings, *_settings(definition, point))) for point in points(definition)]
    if not drafts:
        raise InputRefused(f"{source}: makes no run; no condition holds")
    files = _RunFiles(source, experiment, definition.claims is not None)
    loaded = [files.load(point.drive, draft)[0] for point, draft in _extremes(drafts)]
    metrics = metric_names(loaded[0].measures)
    for metric in definition.limits:
        require_metric(f"{source}: [limits]", metric, metrics)
    twin, tasks = version("twin"), []
    for number, (point, draft) in enumerate(drafts, start=1):
        digest, pins = files.digest_and_pins(point.drive, draft)
        key = _hash([twin, digest, point.drive, draft])[:16]
        tasks.append(Task(number, key, point.drive, point.parameters, (*draft, *pins)))
    configuration = {
        "the sweep": _hash([definition.model_dump(mode="json"), settings]),
        "the experiment, a body or an FMU": _hash(sorted(digest for digest, _ in files.found.values())),
        "the version of twin": twin,
    }
    return SweepPlan(name, definition, experiment, tuple(tasks), metrics, configuration)


def _settings(definition: SweepFile, point: DesignPoint) -> tuple[str, ...]:
    """Return a design point's settings, "key=value"; JSON and TOML write numbers, texts and booleans alike."""
    return tuple(
        f"{name}={json.dumps(point.parameters[vary.label])}"
        for vary in definition.vary
        if vary.label in point.parameters
        for name in vary.names
    )


Draft = tuple[DesignPoint, tuple[str, ...]]


def _extremes(drafts: Sequence[Draft]) -> Iterable[Draft]:
    """Select per drive the first run, the runs with the smallest and largest of each number, one per other value."""
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


def text_settings(settings: Sequence[str]) -> tuple[str, ...]:
    """Return the settings with a text, which alone can name a file (a body, an FMU): equal ones read the same files."""
    return tuple(text for text in settings if text.endswith('"'))


def files_digest(experiment: Path, drive: str | None, settings: tuple[str, ...]) -> str:
    """Return the hash of the files that a run reads, and of their values; only `text_settings` count."""
    return _RunFiles(str(experiment), experiment, False).load(drive, text_settings(settings))[1]


class _RunFiles:
    """Cache of the hashes of files that a sweep's runs read, per drive and text settings."""

    def __init__(self, source: str, experiment: Path, judged: bool):
        self._source, self._experiment, self._judged = source, experiment, judged
        self.found: dict[tuple[str | None, tuple[str, ...]], tuple[str, tuple[str, ...]]] = {}

    def digest_and_pins(self, drive: str | None, settings: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
        """Return the hash of a run's files, and settings that pin the SHA-256 of its third-party parts."""
        files = drive, text_settings(settings)
        if files not in self.found:
            _, digest, parts = self.load(*files)
            self.found[files] = digest, tuple(f'{role}.sha256="{of}"' for role, of in parts.items())
        return self.found[files]

    def load(self, drive: str | None, settings: tuple[str, ...]) -> "tuple[Experiment, str, dict[str, str]]":
        """Load the experiment of a run; return it with its file hash and the SHA-256 of its third-party parts."""
        # Importing the FMU tool chain is slow.
        from twin.robot.assembly.drives import plan_drive as planned_drive
        from twin.robot.assembly.load import load_experiment
        from twin.robot.assembly.roles import part_sha256
        from twin.studies.sweep.claims import require_fig4_claims

        where = ", ".join(filter(None, [f"drive {drive}" if drive else "", *settings])) or "its own values"
        try:
            loaded = load_experiment(self._experiment, settings, drive)
            if self._judged:
                require_fig4_claims(loaded)
            tables = {table.model_dump_json(): table for table in loaded.drives}
            plans = [planned_drive(table) for table in tables.values()]
            parts = {role: part_sha256(role, table) for role, table in loaded.stand_ins.items()}
        except InputRefused as refusal:
            raise InputRefused(f"{self._source}: the run with {where} cannot be made:\n{refusal}") from None
        fmus = [fmu.sha256 for plan in plans for fmu in plan.parts.values()]
        # The hash is unchanged without third-party parts, so that the keys of older sweeps stay valid.
        return loaded, _hash([_without_paths(loaded.values), [*fmus, *parts.values()]]), parts


def _without_paths(values: Any) -> Any:
    """Return values with FMU paths reduced to file names; locations have no effect, and contents are hashed."""
    if isinstance(values, dict):
        return {
            k: Path(v).name if k in FILE_KEYS and isinstance(v, str) else _without_paths(v) for k, v in values.items()
        }
    return values


def _hash(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
