"""Hazard table of a TOML file, after the structure of ISO 14971: hazard, harm, causes, limit, control, evidence.

Every table is checked before the first run.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from pydantic import model_validator

from twin.kernel.errors import InputRefused
from twin.kernel.settings import Settings, optional, setting
from twin.robot.experiment.fault import FAULT_KINDS, find_kind, refuse_target
from twin.robot.experiment.measure import parse_requirement
from twin.robot.experiment.mistakes import check_table, numbered_tables
from twin.robot.experiment.source import read_source

LIMIT_KINDS = {"limit_N": "peak force", "limit_kPa": "pressure over the head", "limit_s": "time above 10 N"}
PAIR_SEPARATOR, ORDER_SEPARATOR = " + ", ", then "
"""Separators of fault kinds: of faults that begin together, and of a second fault after the trip of the first."""
ASSUMED_PREFIX = "assumed"
"""Prefix of the `source` of an unpublished number."""


class HazardFile(Settings):
    """Top-level keys of a hazard table's file."""

    title: str = setting(min_length=1, help="for people")
    use: str = setting(min_length=1, help="intended use, and who may come to harm")
    experiment: str = setting(help="of which the table is")
    head_radius: float = setting("mm", gt=0, help="of the flat round head: pressure is force over its area")


class Evidence(Settings):
    """Table [hazard.evidence]: bodies, places and number of the runs behind a hazard."""

    bodies: tuple[str, ...] = setting(min_length=1, help="bodies that are pressed on")
    points: tuple[tuple[float, float], ...] = setting(
        "mm", into=None, default=((0.0, 0.0),), min_length=1, help="where, x and y from where the tasks are"
    )
    reach: float = setting("mm", default=0.0, ge=0, help="search and draws move the tasks by up to this much more")
    search: int = setting(default=16, ge=0, le=10_000, help="runs spent on looking for a worse case")
    draws: int = setting(default=0, ge=0, le=10_000, help="runs drawn at random, for the share that is seen")
    seed: int = setting(default=0, ge=0, lt=2**31, help="of search and draws")


class Threshold(Settings):
    """Table [[threshold]]: pressure, or force, of the onset of pain."""

    name: str = setting(min_length=1, help="where, and of whom")
    pressure: float | None = optional("kPa", gt=0, example=130.0, help="under a probe of about the head's area")
    force: float | None = optional("N", gt=0, example=30.0, help="in place of a pressure")
    source: str = setting(min_length=1, help="where it is published, or 'assumed: ...'")

    @model_validator(mode="after")
    def _is_one(self) -> "Threshold":
        if (self.pressure is None) == (self.force is None):
            raise ValueError("expected one of pressure_kPa, force_N")
        return self

    @property
    def has_publication(self) -> bool:
        return not self.source.startswith(ASSUMED_PREFIX)


class Variant(Settings):
    """Table [[variant]]: other hardware, used to repeat the worst runs."""

    name: str = setting(min_length=1, help="for people")
    set: tuple[str, ...] = setting(min_length=1, help="key=value of the experiment")
    why: str = setting(min_length=1, help="what it is")


class Sensitivity(Settings):
    """Table [sensitivity]: monitor thresholds to vary, for false trips of healthy robots and for the worst peaks."""

    keys: tuple[str, ...] = setting(min_length=1, help="keys of [monitor], one at a time")
    factors: tuple[float, ...] = setting(min_length=2, help="by which each is multiplied")
    bodies: tuple[str, ...] = setting(min_length=1, help="of the healthy fleet")
    fleet: tuple[tuple[str, ...], ...] = setting(
        default=((),), help="key=value of each robot of the fleet: heights, friction, noise"
    )


class HazardTable(Settings):
    """Table [[hazard]] without its causes, its limit and its evidence."""

    id: str = setting(min_length=1, help="short name, by which pages are compared")
    hazard: str = setting(min_length=1, help="source of harm")
    harm: str = setting(min_length=1, help="what a person would suffer")
    severity: str = setting(min_length=1, help="in words")
    control: str = setting(min_length=1, help="measure that reduces the risk")
    residual: str = setting(min_length=1, help="risk that is left, in words")
    beyond: str = setting(default="", help="why the limit is exceeded all the same; '': it is not to be")


@dataclass(frozen=True)
class Cause:
    """Cause of a hazard: faults, or a requirement of the healthy robot.

    Attributes:
        faults: (kind, target) of each fault; empty for a requirement.
        requirement: formula that the healthy robot must keep; "" for faults.
        ordered: whether the second fault begins after the trip of the first; otherwise they begin together.
    """

    faults: tuple[tuple[str, str], ...] = ()
    requirement: str = ""
    ordered: bool = False

    def __str__(self) -> str:
        return self.requirement or (ORDER_SEPARATOR if self.ordered else PAIR_SEPARATOR).join(
            f"{kind} of {target}" for kind, target in self.faults
        )


@dataclass(frozen=True)
class Hazard:
    """Line of the hazard table; `limit` is in the unit of `limit_key`, "" if all causes are requirements."""

    table: HazardTable
    causes: tuple[Cause, ...]
    limit_key: str
    limit: float
    evidence: Evidence

    @property
    def limit_text(self) -> str:
        """Limit of the hazard as text, `peak force of 22.5 N`."""
        unit = self.limit_key.rpartition("_")[2]
        return f"{LIMIT_KINDS[self.limit_key]} of {self.limit:g} {unit}" if self.limit_key else "the requirement itself"


@dataclass(frozen=True)
class SafetyTable:
    """Checked hazard table of a file, its tables in order; `sensitivity` is None without [sensitivity]."""

    path: Path
    head: HazardFile
    hazards: tuple[Hazard, ...]
    thresholds: tuple[Threshold, ...]
    variants: tuple[Variant, ...]
    sensitivity: Sensitivity | None


def read_hazards(path: Path) -> SafetyTable:
    values = dict(read_source(path).values)
    mistakes: list[str] = []
    tables = {key: values.pop(key, ()) for key in ("hazard", "threshold", "variant")}
    asked = values.pop("sensitivity", None)
    head = check_table(HazardFile, values, "head", mistakes)
    hazards = [_hazard(n, table, mistakes) for n, table in numbered_tables(tables["hazard"], "hazard", mistakes)]
    if not hazards:
        mistakes.append("[[hazard]]: none; expected at least one line")
    thresholds = [
        check_table(Threshold, t, f"threshold {n}", mistakes) for n, t in _each(tables, "threshold", mistakes)
    ]
    variants = [check_table(Variant, t, f"variant {n}", mistakes) for n, t in _each(tables, "variant", mistakes)]
    sensitivity = None if asked is None else check_table(Sensitivity, asked, "sensitivity", mistakes)
    names = [hazard.table.id for hazard in hazards if hazard]
    mistakes += [f'[[hazard]] id = "{n}": given twice; expected one each' for n in set(names) if names.count(n) > 1]
    if mistakes or head is None:
        raise InputRefused("\n".join(f"{path}: {mistake.replace('[head] ', '')}" for mistake in mistakes))
    return SafetyTable(
        path,
        head,
        tuple(hazard for hazard in hazards if hazard),
        tuple(threshold for threshold in thresholds if threshold),
        tuple(variant for variant in variants if variant),
        sensitivity,
    )


def _each(tables: Mapping[str, Any], name: str, mistakes: list[str]) -> Sequence[tuple[int, Any]]:
    return list(numbered_tables(tables[name], name, mistakes))


def _hazard(number: int, table: Any, mistakes: list[str]) -> Hazard | None:
    if not isinstance(table, Mapping):
        mistakes.append(f"[[hazard]] {number} = {table!r}: expected a table")
        return None
    words = dict(table)
    name = f'[[hazard]] "{words.get("id", number)}"'
    causes = _causes(name, words.pop("causes", ()), mistakes)
    evidence = words.pop("evidence", None)
    given = [key for key in words if key.startswith("limit")]
    limits = {key: words.pop(key) for key in given}
    found = check_table(HazardTable, words, f"hazard {number}", mistakes)
    proof = None
    if evidence is None:
        mistakes.append(f"{name}: no evidence; expected [hazard.evidence] with the bodies that its causes are tried on")
    else:
        proof = check_table(Evidence, evidence, f"hazard {number}.evidence", mistakes)
    key, limit = _limit(name, limits, causes, mistakes)
    if found is None or proof is None or not causes or (limit is None and any(c.faults for c in causes)):
        return None
    return Hazard(found, causes, key, limit or 0.0, proof)


def _limit(
    name: str, limits: Mapping[str, Any], causes: Sequence[Cause], mistakes: list[str]
) -> tuple[str, float | None]:
    known = ", ".join(LIMIT_KINDS)
    for key in limits:
        if key not in LIMIT_KINDS:
            mistakes.append(f"{name} {key}: a limit without a unit, or of another kind; expected one of {known}")
    right = {key: value for key, value in limits.items() if key in LIMIT_KINDS}
    if len(limits) > 1:
        mistakes.append(f"{name}: {len(limits)} limits ({', '.join(limits)}); expected one")
    if not limits and any(cause.faults for cause in causes):
        mistakes.append(f"{name}: no limit; expected one of {known}")
    for key, value in right.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
            mistakes.append(f"{name} {key} = {value!r}: expected a positive number")
            return key, None
        return key, float(value)
    return "", None


def _causes(name: str, given: Any, mistakes: list[str]) -> tuple[Cause, ...]:
    if not isinstance(given, list | tuple) or not given:
        mistakes.append(f'{name}: no causes; expected causes = [{{fault = "KIND"}}, {{requirement = "FORMULA"}}]')
        return ()
    return tuple(cause for one in given if (cause := _cause(name, one, mistakes)) is not None)


def _cause(name: str, one: Any, mistakes: list[str]) -> Cause | None:
    keys = set(one) if isinstance(one, Mapping) else set()
    if keys == {"requirement"}:
        try:
            parse_requirement(str(one["requirement"]))
        except ValueError as problem:
            mistakes.append(f'{name} requirement = "{one["requirement"]}": {problem}')
            return None
        return Cause(requirement=str(one["requirement"]))
    others = keys & {"and", "then"}
    if not keys <= {"fault", "target", "and", "then"} or "fault" not in keys or len(others) > 1:
        mistakes.append(
            f"{name} cause {one!r}: expected fault = with target = and one of and =, then =, or requirement ="
        )
        return None
    faults = []
    for part in (one, *(one[key] for key in others)):
        kind = str(part.get("fault")) if isinstance(part, Mapping) else str(part)
        try:
            known = find_kind(0, kind)
            target = str(part.get("target", known.targets[0])) if isinstance(part, Mapping) else known.targets[0]
            refuse_target(0, kind, target)
        except InputRefused as problem:
            problem_text = str(problem).replace("[[fault]] 0 ", "")
            mistakes.append(f"{name} cause: no kind of fault states it: {problem_text}")
            return None
        faults.append((kind, target))
    return Cause(tuple(faults), ordered="then" in keys)


def magnitudes_of(cause: Cause, signs: Mapping[str, Sequence[float]]) -> list[tuple[float | None, ...]]:
    """List the magnitudes to run, one per fault: all of a single fault, the largest of several; `signs` by kind."""
    each: list[list[float | None]] = []
    for kind, _ in cause.faults:
        known = FAULT_KINDS[kind].magnitudes
        sizes = known if known and len(cause.faults) == 1 else known[-1:] if known else (None,)
        each.append([None if size is None else sign * size for size in sizes for sign in signs[kind]])
    return list(product(*each))
