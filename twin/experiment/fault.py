"""[[fault]]: what breaks during the experiment. Each kind has a magnitude of its own, with its unit in the key."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import create_model

from twin.errors import InputRefused
from twin.experiment.fault_catalogue import Kind, kind_named, refuse_target
from twin.experiment.mistakes import checked, numbered
from twin.experiment.ticks import whole_ticks
from twin.settings import Settings, setting

NEVER = 1 << 62
"""The end, in ticks, of a fault that stays."""


@dataclass(frozen=True)
class Fault:
    """What breaks, where, when and how badly.

    Attributes:
        kind: a key of `CATALOGUE`.
        target: one of that kind's targets.
        onset, end: active in ticks onset <= k < end. Of a continuous component: in the steps that begin at these.
        magnitude: SI (rad, m, s, a share, a factor); 0 where the kind has none.
        share: of an encoder's samples that a glitch hits, 0..1.
        ramp: ticks over which a parameter fault grows from nothing to its magnitude; 0: at once.
        seed: of the random kinds; the same seed gives the same faults.
    """

    kind: str
    target: str
    onset: int
    end: int = NEVER
    magnitude: float = 0.0
    share: float = 0.0
    ramp: int = 0
    seed: int = 0


class FaultTable(Settings):
    """The keys that every kind has; without `duration_s` the fault stays, without `target` it hits the kind's first."""

    kind: str
    target: str | None = setting(default=None, help="what breaks; without it the kind's first")
    onset: float = setting("s", ge=0, help="when it begins")
    duration: float | None = setting(
        "s", default=None, gt=0, examples=[2.0], help="how long it lasts; without it to the end"
    )
    seed: int = setting(default=0, ge=0, lt=2**63, help="of what is random in it")


def table_of(known: Kind) -> type[FaultTable]:
    """The [[fault]] table of one kind: `FaultTable` and the keys that only this kind or its mechanism has."""
    own: dict[str, Any] = {}
    if known.magnitude_key:
        own["magnitude"] = (float, setting(known.unit or "", help="how much", **dict[str, Any](known.bounds)))
    if known.has_share:
        # more than every second sample could not be single ones
        own["share"] = (float, setting(gt=0, le=0.5, help="of the samples that it hits"))
    if known.mechanism == "parameter":
        own["ramp"] = (float | None, setting("s", default=None, gt=0, help="time in which it grows"))
    return create_model("FaultTable", __base__=FaultTable, __doc__=known.meaning, **own)


def checked_faults(tables: Any, tick: float, mistakes: list[str]) -> tuple[Fault, ...]:
    """The faults of the array of tables [[fault]], in whole ticks and SI.

    Args:
        tables: what the file says; () if nothing.
        tick: (s).
        mistakes: gets a sentence for each mistake, with the number of its fault, counted from 1.

    Returns:
        Those that are right.
    """
    faults = []
    for number, table in numbered(tables, "fault", mistakes):
        found: list[str] = []
        fault = _checked(number, table, tick, found)
        mistakes += found
        if fault is not None and not found:
            faults.append(fault)
    return tuple(faults)


def _checked(number: int, table: Any, tick: float, mistakes: list[str]) -> Fault | None:
    if not isinstance(table, dict):
        mistakes.append(f"[[fault]] {number} = {table!r}: expected a table")
        return None
    name = table.get("kind")
    try:
        known = kind_named(number, name if isinstance(name, str) else str(name))
        refuse_target(number, str(name), str(table.get("target", known.targets[0])))
    except InputRefused as problem:
        mistakes.append(str(problem))
        if str(problem).startswith(f"[[fault]] {number} kind"):
            return None
    model = table_of(known)
    wrong = [key for key in table if key.startswith("magnitude") and key != known.magnitude_key]
    mistakes += [f"[[fault]] {number} {key}: {name} takes {known.magnitude_key or 'no magnitude'}" for key in wrong]
    told: list[str] = []
    values = checked(model, {key: value for key, value in table.items() if key not in wrong}, "[fault]", told)
    instead = f"missing key '{known.magnitude_key}'"
    mistakes += [
        text.replace("[[fault]]", f"[[fault]] {number}", 1) for text in told if not (wrong and text.endswith(instead))
    ]
    return None if values is None else _in_ticks(number, known, values.model_dump(), tick, mistakes)


def _in_ticks(number: int, known: Kind, values: Mapping[str, Any], tick: float, mistakes: list[str]) -> Fault:
    lengths = {"onset_s": values["onset"], "duration_s": values["duration"], "ramp_s": values.get("ramp")}
    if known.unit == "ms":
        lengths["magnitude_ms"] = values["magnitude"]
    ticks = {}
    for key, length in lengths.items():
        ticks[key] = whole_ticks(length or 0.0, tick) or 0
        if length and whole_ticks(length, tick) is None:
            mistakes.append(f"[[fault]] {number} {key}: {length:g} s is not a whole number of ticks of {tick:g} s")
    return Fault(
        kind=values["kind"],
        target=values["target"] or known.targets[0],
        onset=ticks["onset_s"],
        end=NEVER if values["duration"] is None else ticks["onset_s"] + ticks["duration_s"],
        magnitude=values.get("magnitude", 0.0),
        share=values.get("share", 0.0),
        ramp=ticks["ramp_s"],
        seed=values["seed"],
    )
