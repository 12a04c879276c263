"""The rows of a sweep: JSON lines on disk, only appended to, and columns for statistics.

The folder of a sweep: definition, rows, recordings, Parquet; whether it may be continued.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, wraps
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Concatenate, NotRequired, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, with_config

# pydantic takes no other before Python 3.12
from typing_extensions import TypedDict

from twin.kernel.errors import ComponentFailed, InputRefused, disk_refusals
from twin.kernel.files import open_regular, read_bytes
from twin.kernel.writing import made_folder, write_json, written

if TYPE_CHECKING:
    from twin.studies.sweep.plan import SweepPlan

Row = dict[str, Any]
Numbers = NDArray[np.float64]
Positions = NDArray[np.intp]
Asked = ParamSpec("Asked")
Answer = TypeVar("Answer")


@dataclass(frozen=True, eq=False)
class Words:
    """A column of texts, truth values, whole numbers or None: of row i it is `words[codes[i]]`.

    Attributes:
        codes: (n,), int32.
        words: each once, with its type: 1, 1.0 and True are three.
    """

    codes: NDArray[np.int32]
    words: Sequence[Any]

    @classmethod
    def of(cls, values: Sequence[Any]) -> "Words":
        """The column of `values`."""
        typed = list(zip(map(type, values), values, strict=True))
        codes = {word: code for code, word in enumerate(dict.fromkeys(typed))}
        return cls(np.fromiter(map(codes.__getitem__, typed), np.int32, len(typed)), [word for _, word in codes])

    def __getitem__(self, row: int) -> Any:
        return self.words[self.codes[row]]

    def __iter__(self) -> Iterator[Any]:
        return (self.words[code] for code in self.codes.tolist())

    def at(self, rows: Positions | NDArray[np.bool_]) -> "Words":
        """The column of those rows."""
        return Words(self.codes[rows], self.words)

    def are(self, is_so: Callable[[Any], bool]) -> NDArray[np.bool_]:
        """Of which rows the word is so; each word is asked once."""
        return np.array([is_so(word) for word in self.words], bool)[self.codes]

    @property
    def counts(self) -> dict[Any, int]:
        """How many rows have each word that some row has, in the order of rows."""
        codes, first, counts = np.unique(self.codes, return_index=True, return_counts=True)
        return {self.words[codes[n]]: int(counts[n]) for n in np.argsort(first)}


Column = Numbers | Words


@dataclass(frozen=True, eq=False)
class Columns:
    """Rows, one value of each column for each.

    Attributes:
        of: by name. As in a row: "run", "seconds", "stepping_s" (numbers), "drive", "status", "reason",
            "within_limits", "key", "no_hold" (words). Besides "has_metrics", "has_curves" (words); "parameters/LABEL"
            (numbers if all are floats, else words); "metrics/NAME", "values/CLAIM" (numbers); "verdicts/CLAIM" (words).
            nan, None: the row has none.
    """

    of: dict[str, Column]
    _found: dict[tuple[Any, ...], Any] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.numbers("run"))

    def numbers(self, name: str) -> Numbers:
        """A column of numbers, (n,)."""
        found = self.of[name]
        assert isinstance(found, np.ndarray)
        return found

    def words(self, name: str) -> Words:
        """A column of words, (n,)."""
        found = self.of[name]
        assert isinstance(found, Words)
        return found

    def under(self, group: str) -> dict[str, str]:
        """Names of the columns of a group, by what follows the stroke."""
        return {name.partition("/")[2]: name for name in self.of if name.startswith(f"{group}/")}

    def run(self, row: int) -> int:
        """Number of the run of a row."""
        return int(self.numbers("run")[row])

    def at(self, rows: Positions | NDArray[np.bool_]) -> "Columns":
        """Those rows."""
        return Columns({name: one.at(rows) if isinstance(one, Words) else one[rows] for name, one in self.of.items()})

    def by_run(self) -> "Columns":
        """In the order of runs."""
        run = self.numbers("run")
        return self if bool(np.all(run[1:] >= run[:-1])) else self.at(np.argsort(run, kind="stable"))


def once(work: Callable[Concatenate[Columns, Asked], Answer]) -> Callable[Concatenate[Columns, Asked], Answer]:
    """`work` with a memory: of the same columns the same is found out once."""

    @wraps(work)
    def found(columns: Columns, *args: Asked.args, **kwargs: Asked.kwargs) -> Answer:
        asked = (work, *args, *kwargs.items())
        if asked not in columns._found:
            columns._found[asked] = work(columns, *args, **kwargs)
        answer: Answer = columns._found[asked]
        return answer

    return found


def columns_of(rows: Sequence[Row]) -> Columns:
    """`rows` as columns, in their order."""
    found: dict[str, Column] = {
        name: np.array([row[name] for row in rows], np.float64) for name in ("run", "seconds", "stepping_s")
    }
    for name in ("drive", "status", "reason", "within_limits", "key"):
        found[name] = Words.of([row[name] for row in rows])
    found["no_hold"] = Words.of([row.get("no_hold") for row in rows])
    found["has_metrics"] = Words.of([bool(row["metrics"]) for row in rows])
    found["has_curves"] = Words.of([bool(row.get("curves")) for row in rows])
    for label, values in _columns([row["parameters"] for row in rows]):
        all_floats = {*map(type, values)} <= {float, type(None)}
        found[f"parameters/{label}"] = np.array(values, np.float64) if all_floats else Words.of(values)
    for metric, values in _columns([row["metrics"] for row in rows]):
        found[f"metrics/{metric}"] = np.array(values, np.float64)
    for claim, answers in _columns([row.get("claims") or {} for row in rows]):
        found[f"verdicts/{claim}"] = Words.of([answer and answer["verdict"] for answer in answers])
        found[f"values/{claim}"] = np.array([answer and answer["value"] for answer in answers], np.float64)
    return Columns(found)


def _columns(tables: Sequence[dict[str, Any]]) -> Iterator[tuple[str, list[Any]]]:
    """(key, its value in each of the tables, None where it is not) of every key that there is."""
    for key in dict.fromkeys(chain.from_iterable(tables)):
        yield key, [table.get(key) for table in tables]


def joined(parts: Sequence[Columns]) -> Columns:
    """The rows of all `parts`, one after the other; at least one."""
    names = dict.fromkeys(chain.from_iterable(part.of for part in parts))
    return Columns({name: _joined([(part.of.get(name), len(part)) for part in parts]) for name in names})


def _joined(parts: Iterable[tuple[Column | None, int]]) -> Column:
    """A column out of those of parts with so many rows each, some of which have none."""
    parts = list(parts)
    if not any(isinstance(one, Words) for one, _ in parts):
        return np.concatenate([np.full(n, np.nan) if one is None else one for one, n in parts])  # type: ignore[list-item]
    known: dict[tuple[type, Any], int] = {}
    codes = []
    for one, n in parts:
        if one is None:
            one = Words.of([None] * n)
        elif not isinstance(one, Words):
            one = Words.of([None if number != number else number for number in one.tolist()])
        lookup = [known.setdefault((type(word), word), len(known)) for word in one.words]
        codes.append(np.array(lookup, np.int32)[one.codes])
    return Words(np.concatenate(codes), [word for _, word in known])


ROWS = "rows.jsonl"
LARGEST = 2**32
"""Bytes; a hundred thousand rows with curves take a quarter of it."""
MOST_RUNS = 20_000_000
"""Of a sweep; statistics have an entry for each of them."""
AT_ONCE = 1_000
"""Rows that are in memory as they are written, which takes ten times as much as their columns."""
Whole = Annotated[int, Field(ge=-(2**63), lt=2**64)]
# another version may write more
_LOOSE = ConfigDict(extra="ignore", strict=True, allow_inf_nan=False)


class FileShape(BaseModel):
    """What a file of a sweep's folder looks like; whatever else somebody made of it is refused."""

    model_config = _LOOSE


@with_config(_LOOSE)
class ClaimShape(TypedDict):
    """What a run said to a claim."""

    verdict: str
    value: float | None


@with_config(_LOOSE)
class CurvesShape(TypedDict):
    """What `twin.studies.sweep.claims.packed` makes; a run without any has an empty table."""

    period_s: NotRequired[Annotated[float, Field(gt=0, le=1e6)]]
    of: NotRequired[dict[str, str]]


@with_config(_LOOSE)
class RowShape(TypedDict):
    """A line of rows.jsonl."""

    run: Annotated[int, Field(ge=1, le=MOST_RUNS)]
    key: str
    drive: str | None
    parameters: dict[str, bool | Whole | float | str]
    status: str
    reason: str
    metrics: dict[str, float | None]
    within_limits: bool | None
    seconds: float | None
    stepping_s: float | None
    no_hold: NotRequired[str]
    claims: NotRequired[dict[str, ClaimShape]]
    curves: NotRequired[CurvesShape | None]


_ROW: TypeAdapter[Any] = TypeAdapter(RowShape)


def parsed(text: str | bytes, shape: type[BaseModel]) -> dict[str, Any] | None:
    """What the JSON in `text` says if it is of `shape`; None if not."""
    return _checked(text, TypeAdapter(shape))


def _checked(text: str | bytes, shape: TypeAdapter[Any]) -> dict[str, Any] | None:
    try:
        found = json.loads(text)
        shape.validate_python(found)
    # pydantic's ValidationError is a ValueError, too
    except (ValueError, RecursionError):
        return None
    return found


def _row(line: bytes) -> Row | None:
    """The row in `line`; half of what the standard library takes, which knows texts that no other parser does."""
    try:
        found: Row = _ROW.validate_json(line)
    except ValidationError:
        return _checked(line, _ROW)
    return found


class DiskFailed(ComponentFailed):
    """A row could not be written; those before are kept."""


def read_rows(path: Path) -> list[Row]:
    """Whole rows of the file at `path`, oldest first, each with all that is in it; of two with a key the first.

    Raises:
        InputRefused: as `read_columns`.
    """
    rows: dict[str, Row] = {}
    for row, line, _ in _each(path):
        rows.setdefault(row["key"], json.loads(line))
    return list(rows.values())


def read_columns(path: Path) -> tuple[Columns, int]:
    """(whole rows of the file at `path`, oldest first, of two with a key the first; bytes that they take up).

    What a power cut tore off after them is left out.

    Raises:
        InputRefused: it cannot be read, or a line in it is none of ours.
    """
    parts, end, each = [], 0, _each(path)
    while some := list(islice(each, AT_ONCE)):
        parts.append(columns_of([row for row, _, _ in some]))
        end = some[-1][-1]
    found = joined(parts or [columns_of([])])
    _, first = np.unique(found.words("key").codes, return_index=True)
    return (found if len(first) == len(found) else found.at(np.sort(first))), end


def _each(path: Path) -> Iterator[tuple[Row, bytes, int]]:
    """(row, its line, bytes up to its end) of every whole line of the file at `path`; nothing if there is no file."""
    if not os.path.lexists(path):
        return
    end = 0
    with open_regular(path, LARGEST) as file, disk_refusals(path, "cannot be read", InputRefused):
        for number, line in enumerate(file, start=1):
            if not line.endswith(b"\n"):
                return
            row = _row(line)
            if row is None:
                raise InputRefused(
                    f"{path}: line {number} is no row of a sweep; remove the line, its run is then done again"
                )
            end += len(line)
            yield row, line, end


class RowFile:
    """The file at `path`, open for more rows; a context manager. One process at a time has it.

    Attributes:
        before: rows that were in it when it was opened, oldest first.
        count: rows that are in it now.

    Raises:
        InputRefused: it cannot be opened, is no file of rows, or another sweep writes to it.
    """

    def __init__(self, path: Path):
        # Windows has no fcntl, and no guarded processes either
        import fcntl

        self.path = path
        with disk_refusals(path, kind=InputRefused, remedy="choose another --out"):
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.before, self._end = read_columns(path)
        except BlockingIOError:
            os.close(self._fd)
            raise InputRefused(f"{path}: another twin sweep is writing there; wait for it, or choose --out") from None
        except InputRefused:
            os.close(self._fd)
            raise
        os.ftruncate(self._fd, self._end)
        self.count = len(self.before)

    def __enter__(self) -> "RowFile":
        return self

    def __exit__(self, *failure: object) -> None:
        os.close(self._fd)

    def add(self, batch: list[Row]) -> None:
        """Append `batch`; when this returns, no crash and no power cut takes it back.

        Raises:
            DiskFailed: no space, or worse; nothing of the batch is in the file then.
        """
        content = b"".join(json.dumps(row, allow_nan=False).encode() + b"\n" for row in batch)
        remedy = f"{self.count} finished runs are kept. Make room, then give the same command to go on"
        with disk_refusals(self.path, kind=DiskFailed, remedy=remedy):
            try:
                rest = memoryview(content)
                while rest:
                    rest = rest[os.write(self._fd, rest) :]
                os.fsync(self._fd)
            except OSError:
                os.ftruncate(self._fd, self._end)
                raise
        self._end += len(content)
        self.count += len(batch)


HOME = Path("results/sweeps")
FACTS = "sweep.json"
MARGINS = "margins.json"


class Facts(FileShape):
    """sweep.json; its keys as in `SweepRows`, and what all runs have in common."""

    sweep: str
    runs: int = Field(ge=1, le=MOST_RUNS)
    design: str
    drives: list[str]
    labels: list[str]
    metrics: list[str]
    limits: dict[str, float]
    configuration: dict[str, str]


@with_config(_LOOSE)
class RunMargins(TypedDict):
    """Margins of the force loop where the robot presses, the smallest over the places.

    Attributes:
        run: its number.
        gain: factor by which the gain may grow; None: by any.
        phase_rad: None if the loop's gain never reaches 1.
        reason: why there are no margins; "" if there are.
    """

    run: Whole
    gain: float | None
    phase_rad: float | None
    reason: str


_FACTS, _MARGINS = TypeAdapter(Facts), TypeAdapter(dict[str, RunMargins])


@dataclass(frozen=True)
class SweepRows:
    """What a folder holds.

    Attributes:
        name: of the sweep.
        runs: planned, of all drives.
        design, drives, limits: see `Definition`.
        labels: what varies, in the order of the file.
        metrics: that a run may have.
        columns: rows of finished runs, by run.
        read: reads these rows as they are written.
        margins: of the best runs, by the keys of their rows; empty: none were computed.
    """

    name: str
    runs: int
    design: str
    drives: tuple[str, ...]
    labels: tuple[str, ...]
    metrics: tuple[str, ...]
    limits: dict[str, float]
    columns: Columns
    read: Callable[[], list[Row]]
    margins: dict[str, RunMargins] = field(default_factory=dict)

    @cached_property
    def rows(self) -> list[Row]:
        """As they are written, with curves, by run: for what needs more than columns, as it takes ten times as long."""
        return sorted(self.read(), key=lambda row: row["run"])


def claim(folder: Path, plan: "SweepPlan") -> None:
    """Make `folder` that of `plan`, or find that it is already.

    Raises:
        InputRefused: it is another sweep's, or cannot be made.
        NotWritten: the disk refuses.
    """
    facts = _read(folder / FACTS, _FACTS)
    if facts:
        changed = [what for what, digest in plan.configuration.items() if facts["configuration"].get(what) != digest]
        if changed:
            raise InputRefused(
                f"{folder}: holds rows of another configuration, since then {' and '.join(changed)} changed; "
                "rows of both must not be mixed: choose another --out, or move the folder away"
            )
        return
    content = {
        "sweep": plan.name,
        "experiment": plan.experiment.name,
        "runs": len(plan.tasks),
        "design": plan.definition.design,
        "drives": plan.definition.drives,
        "labels": [vary.label for vary in plan.definition.vary],
        "metrics": plan.metrics,
        "limits": plan.definition.limits,
        "configuration": plan.configuration,
    }
    made_folder(folder)
    if (folder / ROWS).exists():
        raise InputRefused(f"{folder}: has rows but no {FACTS}, which describes them; choose another --out")
    write_json(folder / FACTS, content)


def stored_sweep(folder: Path) -> SweepRows:
    """What is in `folder`.

    Raises:
        InputRefused: no sweep's, or as `read_columns`.
    """
    facts = _read(folder / FACTS, _FACTS)
    if not facts:
        raise InputRefused(
            f"{folder}: not the folder of a sweep, {FACTS} is missing; expected one that twin sweep, or twin run with "
            "--sweep, wrote"
        )
    path = folder / ROWS
    columns = read_columns(path)[0].by_run()
    lists = {name: tuple(facts[name]) for name in ("drives", "labels", "metrics")}
    return SweepRows(
        facts["sweep"], facts["runs"], facts["design"], limits=facts["limits"],
        columns=columns, read=lambda: read_rows(path), margins=_read(folder / MARGINS, _MARGINS), **lists,
    )  # fmt: skip


def _read(path: Path, shape: TypeAdapter[Any]) -> dict[str, Any]:
    """What is in the JSON file at `path`; empty if there is none."""
    if not os.path.lexists(path):
        return {}
    facts = _checked(read_bytes(path), shape)
    if facts is None:
        raise InputRefused(f"{path}: not what twin sweep writes; choose another --out")
    return facts


def write_parquet(sweep: SweepRows, path: Path) -> None:
    """Write `sweep` to `path`, a line per run in the order of runs: the same rows make the same bytes.

    Columns: run, drive, each parameter by its key, each metric, status, reason, within_limits, seconds, stepping_s,
    key. What a run has not is null.

    Raises:
        InputRefused: pyarrow is not installed.
        NotWritten: the file cannot be written.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputRefused("--parquet: needs pyarrow; install it with: pip install 'pyarrow>=17'") from None
    columns = sweep.columns
    table = {"run": pa.array(columns.numbers("run").astype(int))}
    named = [("drive", "drive"), *((label, f"parameters/{label}") for label in sweep.labels)]
    named += [(metric, f"metrics/{metric}") for metric in sweep.metrics]
    named += [(name, name) for name in ("status", "reason", "within_limits", "seconds", "stepping_s", "key")]
    table |= {title: _array(pa, columns.of.get(name), len(columns)) for title, name in named}
    with written(path) as beside:
        pq.write_table(pa.table(table), beside)


def _array(pa: Any, column: Column | None, rows: int) -> Any:
    if isinstance(column, Words):
        kinds = {type(word) for word in column.words if word is not None}
        # a column has one type: numbers stay numbers, anything mixed becomes text
        one = float if kinds == {int, float} else str if len(kinds) > 1 else None
        words = [word if word is None or one is None else one(word) for word in column.words]
        # a file's name that is no text in UTF-8 may be in a reason
        words = [word.encode(errors="backslashreplace").decode() if isinstance(word, str) else word for word in words]
        return pa.array(words).take(pa.array(column.codes))
    if column is None or np.isnan(column).all():
        return pa.nulls(rows)
    return pa.array(column, from_pandas=True)
