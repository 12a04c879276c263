"""[[vary]]: one dimension of a sweep: which keys, which values, under which condition."""

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

Value = bool | int | float | str
_SHAPES = {"normal": ("mean", "std"), "lognormal": ("median", "sigma")}
_KEYS = {"low": "from", "high": "to"}


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Condition(_Table):
    """when = { key, value }: the keys vary only in runs in which an earlier `key` has `value`."""

    key: str
    value: Value


class Vary(_Table):
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
