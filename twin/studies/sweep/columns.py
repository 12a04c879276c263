"""Rows of a sweep as columns, for statistics."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import wraps
from itertools import chain
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

Row = dict[str, Any]
Numbers = NDArray[np.float64]
Positions = NDArray[np.intp]
Asked = ParamSpec("Asked")
Answer = TypeVar("Answer")


@dataclass(frozen=True, eq=False)
class CategoricalColumn:
    """A column of texts, booleans, whole numbers or None: row i has the value `categories[codes[i]]`.

    Attributes:
        codes: category index per row, (n,), int32.
        categories: distinct values; values of different type differ, so 1, 1.0 and True are three categories.
    """

    codes: NDArray[np.int32]
    categories: Sequence[Any]

    @classmethod
    def from_values(cls, values: Sequence[Any]) -> "CategoricalColumn":
        typed = list(zip(map(type, values), values, strict=True))
        codes = {word: code for code, word in enumerate(dict.fromkeys(typed))}
        return cls(np.fromiter(map(codes.__getitem__, typed), np.int32, len(typed)), [word for _, word in codes])

    def __getitem__(self, row: int) -> Any:
        return self.categories[self.codes[row]]

    def __iter__(self) -> Iterator[Any]:
        return (self.categories[code] for code in self.codes.tolist())

    def select(self, rows: Positions | NDArray[np.bool_]) -> "CategoricalColumn":
        return CategoricalColumn(self.codes[rows], self.categories)

    def mask(self, is_so: Callable[[Any], bool]) -> NDArray[np.bool_]:
        return np.array([is_so(word) for word in self.categories], bool)[self.codes]

    @property
    def counts(self) -> dict[Any, int]:
        """Number of rows per category, in order of first appearance."""
        codes, first, counts = np.unique(self.codes, return_index=True, return_counts=True)
        return {self.categories[codes[n]]: int(counts[n]) for n in np.argsort(first)}


Column = Numbers | CategoricalColumn


@dataclass(frozen=True, eq=False)
class Columns:
    """Rows of a sweep, stored column by column.

    Attributes:
        by_name: column name -> column. As in a row: "run", "seconds", "stepping_s" (numbers), "drive", "status",
            "reason", "within_limits", "key", "no_hold" (categorical). Derived: "has_metrics", "has_curves"
            (categorical); "parameters/LABEL" (numbers if all are floats, else categorical); "metrics/NAME",
            "values/CLAIM" (numbers); "verdicts/CLAIM" (categorical). NaN or None where a row has no value.
    """

    by_name: dict[str, Column]
    _found: dict[tuple[Any, ...], Any] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.numbers("run"))

    def numbers(self, name: str) -> Numbers:
        found = self.by_name[name]
        assert isinstance(found, np.ndarray)
        return found

    def categorical(self, name: str) -> CategoricalColumn:
        found = self.by_name[name]
        assert isinstance(found, CategoricalColumn)
        return found

    def names_in_group(self, group: str) -> dict[str, str]:
        """Return the columns of a group such as metrics: name without the prefix `group/` -> full name."""
        return {name.partition("/")[2]: name for name in self.by_name if name.startswith(f"{group}/")}

    def run_number(self, row: int) -> int:
        return int(self.numbers("run")[row])

    def select(self, rows: Positions | NDArray[np.bool_]) -> "Columns":
        return Columns(
            {
                name: one.select(rows) if isinstance(one, CategoricalColumn) else one[rows]
                for name, one in self.by_name.items()
            }
        )

    def by_run(self) -> "Columns":
        run = self.numbers("run")
        return self if bool(np.all(run[1:] >= run[:-1])) else self.select(np.argsort(run, kind="stable"))


def cache_per_columns(
    work: Callable[Concatenate[Columns, Asked], Answer],
) -> Callable[Concatenate[Columns, Asked], Answer]:
    """Decorate a function of a sweep's columns so that its results are cached per `Columns` object."""

    @wraps(work)
    def found(columns: Columns, *args: Asked.args, **kwargs: Asked.kwargs) -> Answer:
        asked = (work, *args, *kwargs.items())
        if asked not in columns._found:
            columns._found[asked] = work(columns, *args, **kwargs)
        answer: Answer = columns._found[asked]
        return answer

    return found


def columns_of(rows: Sequence[Row]) -> Columns:
    found: dict[str, Column] = {
        name: np.array([row[name] for row in rows], np.float64) for name in ("run", "seconds", "stepping_s")
    }
    for name in ("drive", "status", "reason", "within_limits", "key"):
        found[name] = CategoricalColumn.from_values([row[name] for row in rows])
    found["no_hold"] = CategoricalColumn.from_values([row.get("no_hold") for row in rows])
    found["has_metrics"] = CategoricalColumn.from_values([bool(row["metrics"]) for row in rows])
    found["has_curves"] = CategoricalColumn.from_values([bool(row.get("curves")) for row in rows])
    for label, values in _columns([row["parameters"] for row in rows]):
        all_floats = {*map(type, values)} <= {float, type(None)}
        found[f"parameters/{label}"] = (
            np.array(values, np.float64) if all_floats else CategoricalColumn.from_values(values)
        )
    for metric, values in _columns([row["metrics"] for row in rows]):
        found[f"metrics/{metric}"] = np.array(values, np.float64)
    for claim, answers in _columns([row.get("claims") or {} for row in rows]):
        found[f"verdicts/{claim}"] = CategoricalColumn.from_values([answer and answer["verdict"] for answer in answers])
        found[f"values/{claim}"] = np.array([answer and answer["value"] for answer in answers], np.float64)
    return Columns(found)


def _columns(tables: Sequence[dict[str, Any]]) -> Iterator[tuple[str, list[Any]]]:
    """Yield (key, value in each of the tables or None) for every key of any table."""
    for key in dict.fromkeys(chain.from_iterable(tables)):
        yield key, [table.get(key) for table in tables]


def concatenate_columns(parts: Sequence[Columns]) -> Columns:
    names = dict.fromkeys(chain.from_iterable(part.by_name for part in parts))
    return Columns(
        {name: _concatenate_parts([(part.by_name.get(name), len(part)) for part in parts]) for name in names}
    )


def _concatenate_parts(parts: Iterable[tuple[Column | None, int]]) -> Column:
    """Concatenate one column over several parts, some of which may lack it."""
    parts = list(parts)
    if not any(isinstance(one, CategoricalColumn) for one, _ in parts):
        return np.concatenate([np.full(n, np.nan) if one is None else one for one, n in parts])  # type: ignore[list-item]
    known: dict[tuple[type, Any], int] = {}
    codes = []
    for one, n in parts:
        if one is None:
            one = CategoricalColumn.from_values([None] * n)
        elif not isinstance(one, CategoricalColumn):
            one = CategoricalColumn.from_values([None if number != number else number for number in one.tolist()])
        lookup = [known.setdefault((type(word), word), len(known)) for word in one.categories]
        codes.append(np.array(lookup, np.int32)[one.codes])
    return CategoricalColumn(np.concatenate(codes), [word for _, word in known])
