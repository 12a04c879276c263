"""SWEEP.toml: the experiment, the keys that vary, the drives. Checked as one file."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from twin.kernel.errors import InputRefused
from twin.kernel.files import read_toml
from twin.kernel.places import located
from twin.robot.experiment.mistakes import sentences

Value = bool | int | float | str
_SHAPES = {"normal": ("mean", "std"), "lognormal": ("median", "sigma")}
_KEYS = {"low": "from", "high": "to"}


class _SweepTable(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Condition(_SweepTable):
    """when = { key, value }: the keys vary only in runs in which an earlier `key` has `value`."""

    key: str
    value: Value


class Vary(_SweepTable):
    """The keys of [[vary]].

    Attributes:
        key, keys: of the experiment, with their units; several get the same value.
        values: levels of a grid, or what is drawn from with equal probability.
        low, high: `from` and `to`: ends of an interval.
        count: levels of it in a grid.
        scale: whether levels and probability are even in the value or in its logarithm.
        distribution: of an uncertain value; uniform has `from` and `to`, normal `mean` and `std`, lognormal `median`
            and `sigma`, the standard deviation of the natural logarithm.
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
        """Every key that gets the value."""
        return tuple(self.keys or ()) + ((self.key,) if self.key is not None else ())

    @property
    def label(self) -> str:
        """The key that stands for all."""
        return self.names[0] if self.names else ""

    def applies(self, chosen: Mapping[str, Value]) -> bool:
        """Whether it varies in a run in which `chosen` has been decided, by label."""
        return self.when is None or (self.when.key in chosen and chosen[self.when.key] == self.when.value)

    def levels(self) -> tuple[Value, ...]:
        """Its values in a grid."""
        if self.values is not None:
            return tuple(self.values)
        assert self.low is not None and self.high is not None and self.count is not None
        space = np.geomspace if self.scale == "log" else np.linspace
        return tuple(space(self.low, self.high, self.count).tolist())

    def drawn(self, u: float) -> Value:
        """The value whose cumulative probability is `u`, 0 < u < 1: the inverse of the distribution function."""
        if self.values is not None:
            return self.values[min(int(u * len(self.values)), len(self.values) - 1)]
        if self.distribution in _SHAPES:
            # scipy takes a while to import, and a grid does not need it
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
    """What is wrong with a table whose keys are right by themselves.

    Args:
        sampled: whether the design draws; a grid has levels.
        known: labels that a condition may name.
    """
    mistakes = _of_names(vary)
    needed: tuple[str, ...] = _SHAPES.get(vary.distribution or "", ("low", "high"))
    if vary.values is not None:
        needed = ()
        if len({(type(value) is bool, value) for value in vary.values}) < len(vary.values):
            mistakes.append("values: one is there twice; a run is counted once, remove one")
    allowed = {*needed, *(("count",) if not sampled and needed else ())}
    numbers = ("low", "high", "count", "mean", "std", "median", "sigma")
    given = {name for name in numbers if getattr(vary, name) is not None}
    mistakes += [f"missing key '{_KEYS.get(name, name)}'" for name in sorted(allowed - given)]
    mistakes += [f"{_KEYS.get(name, name)}: {_why_not(vary, name, sampled)}" for name in sorted(given - allowed)]
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
        named = f"known here are {', '.join(known)}" if known else "no table stands before this one"
        mistakes.append(f"when: '{vary.when.key}' is not decided before; {named}")
    return mistakes


def _of_names(vary: Vary) -> list[str]:
    if (vary.key is None) == (vary.keys is None):
        return ["expected either key or keys"]
    if len(set(vary.names)) < len(vary.names):
        return ["keys: one is there twice; remove one"]
    if bad := [name for name in vary.names if not name.strip() or "=" in name]:
        return [f"key '{bad[0]}': expected a key of the experiment, such as contact.stiffness_N_per_m"]
    return ["'drive' is no key to vary; name drives = [...] at the top"] if "drive" in vary.names else []


def _why_not(vary: Vary, name: str, sampled: bool) -> str:
    if name == "count" and sampled:
        return "belongs to a grid; runs says how many are drawn, remove it"
    return "values say everything; remove it" if vary.values is not None else "does not belong here; remove it"


DESIGNS = Literal["grid", "latin_hypercube", "sobol", "random", "saltelli"]


class SweepFile(BaseModel):
    """The keys of a sweep file.

    Attributes:
        experiment: file, as seen from the sweep's folder upwards.
        runs: points per drive; None in a grid, whose levels say it. design = "saltelli": blocks of as many points as
            parameters and two more.
        seed: of sampled designs.
        claims: "fig4": each point is run with force control and without, and the paper's claims are judged on both.
        drives: each runs every point; empty: the experiment's own.
        limits: metric -> most that a run may have of it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    experiment: str
    design: DESIGNS = "grid"
    runs: int | None = Field(None, ge=1)
    seed: int = Field(0, ge=0, lt=2**63)
    claims: Literal["fig4"] | None = None
    drives: list[str] = Field(default_factory=list)
    vary: list[Vary] = Field(default_factory=list)
    limits: dict[str, float] = Field(default_factory=dict)


def read_definition(path: Path) -> tuple[SweepFile, Path]:
    """The sweep file at `path`, and the experiment that it names.

    Raises:
        InputRefused: no such file, not TOML, or with every mistake in it, one sentence each.
    """
    definition = _checked(read_toml(path, "sweep file"), str(path))
    return definition, located(definition.experiment, path.resolve().parent)


def short_definition(experiment: Path, ranges: Sequence[str], drive: str | None) -> SweepFile:
    """The grid of `ranges`, each "key=from:to:count".

    Raises:
        InputRefused: one is none, or a key is there twice.
    """
    tables = []
    for text in ranges:
        key, _, levels = text.partition("=")
        try:
            low, high, count = levels.split(":")
            tables.append({"key": key.strip(), "from": float(low), "to": float(high), "count": int(count)})
        except ValueError:
            raise InputRefused(
                f"--sweep {text}: expected key=from:to:count, for example contact.stiffness_N_per_m=500:5000:10"
            ) from None
    table = {"experiment": str(experiment), "drives": [drive] if drive else [], "vary": tables}
    return _checked(table, f"--sweep {' '.join(ranges)}")


def _checked(table: dict[str, Any], place: str) -> SweepFile:
    try:
        definition = SweepFile.model_validate(table)
        mistakes = _disagreements(definition)
    except ValidationError as error:
        mistakes = [_placed(sentence) for sentence in sentences(error, SweepFile, "")]
    if mistakes:
        raise InputRefused("\n".join(f"{place}: {mistake}" for mistake in mistakes))
    return definition


def _disagreements(definition: SweepFile) -> list[str]:
    """What no key can see alone."""
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
    """What in [[vary]] cannot be: the shares of a variance add up only if parameters are independent and all differ."""
    return [
        f'[[vary]] {number}: {key} does not go with design = "saltelli", whose parameters are independent numbers; '
        "remove it, or choose another design"
        for number, vary in enumerate(tables, start=1)
        for key in ("values", "when")
        if getattr(vary, key) is not None
    ]


def _placed(sentence: str) -> str:
    """The sentence without the brackets of the nameless table that the file is."""
    return sentence.replace("[.vary.when]", "[[vary]] when:").replace("[.vary]", "[[vary]]").removeprefix("[] ")
