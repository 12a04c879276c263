"""[[measure]]: what `twin check` measures of an experiment and holds against what it was."""

import re
from typing import Any, Literal

from pydantic import field_validator
from pydantic.config import JsonDict

from twin.experiment.mistakes import checked_kind, numbered
from twin.experiment.requirement import requirement
from twin.settings import Settings, setting

SIGNAL = re.compile(r"-?[a-z_]+(/[0-9]+)?\.[A-Za-z_]+(\[[0-9]+\])?")
_NAME = re.compile(r"[a-z0-9_]+")
_PATTERN: JsonDict = {"pattern": f"^({SIGNAL.pattern})$"}


class Window(Settings):
    """What every [[measure]] has: a name, and from when to when; without `until_s` to the end."""

    name: str = setting(examples=["z"], help="what its numbers are called by: small letters, digits, _")
    begin: float = setting("s", default=0.0, ge=0, help="from when on")
    until: float | None = setting("s", default=None, gt=0, examples=[3.5], help="until when; without it the end")

    @field_validator("name")
    @classmethod
    def _short(cls, name: str) -> str:
        if not _NAME.fullmatch(name):
            raise ValueError("expected small letters, digits and _")
        return name


class Watched(Window):
    """A [[measure]] of one signal."""

    signal: str = setting(
        examples=["plant.p_B[2]"],
        json_schema_extra=_PATTERN,
        help='as recorded, one component of it; "-" before it turns it round',
    )

    @field_validator("signal", "reference", check_fields=False)
    @classmethod
    def _named(cls, signal: str) -> str:
        if not SIGNAL.fullmatch(signal):
            raise ValueError("expected a recorded signal such as plant.p_B[2] or -plant.F_ee_B[2]")
        return signal


class Led(Watched):
    """A [[measure]] of a signal and its reference."""

    reference: str = setting(
        examples=["controller.p_ref_B[2]"], json_schema_extra=_PATTERN, help="the signal that it should be, likewise"
    )


class Step(Led):
    """[[measure]] kind = "step": the answer of a signal to a step of its reference at `begin_s`."""

    kind: Literal["step"]


class Tracking(Led):
    """[[measure]] kind = "tracking": how far a signal is from its reference."""

    kind: Literal["tracking"]


class Lag(Led):
    """[[measure]] kind = "lag": by how much a signal comes later than its reference, which has to move."""

    kind: Literal["lag"]
    longest: float = setting("s", default=2.0, gt=0, help="the most that it may lag; at most half the window")


class Spread(Watched):
    """[[measure]] kind = "spread": mean and standard deviation of a signal."""

    kind: Literal["spread"]


class Oscillation(Watched):
    """[[measure]] kind = "oscillation": the strongest sine in a signal."""

    kind: Literal["oscillation"]
    lowest: float = setting(
        "Hz", default=1.0, gt=0, help="slower motion is no oscillation; four periods of it fit the window"
    )


class Onset(Watched):
    """[[measure]] kind = "onset": when a signal that is true or false first is true."""

    kind: Literal["onset"]


class Path(Window):
    """[[measure]] kind = "path": how far the true platform is from the reference's path, whenever it was due there."""

    kind: Literal["path"]


class Effort(Window):
    """[[measure]] kind = "effort": how far the motors were sent, and the work of their shafts."""

    kind: Literal["effort"]


class Required(Window):
    """[[measure]] kind = "requirement": how far the run is from violating a formula."""

    kind: Literal["requirement"]
    formula: str = setting(
        examples=["always (|plant.F_ee_B| <= 18 N)"], help="what has to hold; docs/falsify.md has the words"
    )

    @field_validator("formula")
    @classmethod
    def _spelt(cls, formula: str) -> str:
        requirement(formula)
        return formula


Measure = Step | Tracking | Lag | Spread | Oscillation | Onset | Path | Effort | Required
KINDS: dict[str, type[Measure]] = {
    "step": Step, "tracking": Tracking, "lag": Lag, "spread": Spread, "oscillation": Oscillation, "onset": Onset,
    "path": Path, "effort": Effort, "requirement": Required,
}  # fmt: skip


def checked_measures(tables: Any, duration: float, mistakes: list[str]) -> tuple[Measure, ...]:
    """The measures of the array of tables [[measure]] that are right.

    Args:
        tables: what the file says; () if nothing.
        duration: of the experiment (s).
        mistakes: gets a sentence for each mistake, with the number of its measure, counted from 1.
    """
    measures: list[Measure] = []
    for number, table in numbered(tables, "measure", mistakes):
        measure = checked_kind(KINDS, table, f"measure {number}", mistakes)
        if measure is None:
            continue
        until = duration if measure.until is None else measure.until
        if until > duration:
            mistakes.append(f"[measure {number}] until_s = {until:g}: after the end at {duration:g} s")
        elif measure.begin >= until:
            mistakes.append(f"[measure {number}] begin_s = {measure.begin:g}: expected a time before {until:g} s")
        elif isinstance(measure, Lag) and until - measure.begin < 2.0 * measure.longest - 1e-9:
            length = until - measure.begin
            mistakes.append(
                f"[measure {number}] longest_s = {measure.longest:g}: {length:g} s are too short for such lags; "
                "expected at most half of that"
            )
        if measure.name in [other.name for other in measures]:
            mistakes.append(f'[measure {number}] name = "{measure.name}": another measure has that name')
        measures.append(measure)
    return tuple(measures)
