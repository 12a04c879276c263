"""Measures of a run: one table with unit, meaning, interval, floor and computation of each.

`Tally` accumulates them row by row while a run is stepped; `outcome_of` feeds a `Tally` with a recorded run, so both
give identical bits.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from twin.kernel.serialise import to_dict

if TYPE_CHECKING:
    # the process that supervises a run prints measures without loading NumPy
    from twin.robot.run.hold import HoldSums

FORCE_FLOOR = 0.05
"""Smallest force difference that counts (N): a step of the paper's scale."""
LENGTH_FLOOR = 2.5e-5
"""Smallest length difference that counts (m): one count of a joint encoder, at the platform."""
TIME_FLOOR = 0.05
"""Smallest difference of settling times that counts (s)."""
EFFORT_SHARE = 0.05
"""Smallest relative difference of current, torque, work and energy that counts."""
LEAST_CHATTER = 0.05
"""Minimum amplitude (N) that is reported as chatter."""
LARGE_OVERSHOOT = 0.05
"""Overshoot, as a share of the reference, above which the headline reports it."""
NOT_FOR_TASKS = "not defined for tasks"
"""Reason for the missing settling time of a run with tasks, whose force follows a ramp."""
NO_FORCE_LOOP = "no force loop"
"""Reason for missing force measures of a run in position mode."""
HELD_INTERVAL = "while a force is held"
RUN_INTERVAL = "the run, until the safety monitor trips"
WHOLE_INTERVAL = "the whole run"
NO_OUTPUT = "no output of these drives"
NO_TRIGGER = "the controller reports no trigger"
NO_REFERENCE = "the controller reports no reference of the force"
FROM_TOUCH = f"judged from the first touch on, as {NO_TRIGGER}"
"""Remark on the measures of a held force of a third-party controller without `triggered`."""
HEADLINE_KEYS = ("hold_error", "hold_overshoot", "hold_settling_time", "chatter")
"""Measures printed first."""
SECOND_KEYS = ("held_lateral_error", "held_z_error", "torque", "current", "shaft_work")
"""Measures printed after the headline."""
FORCE_KEYS = (
    *HEADLINE_KEYS, "chatter_frequency", "hold_mean_error", "hold_overshoot_force", "force_error", "peak", "peak_time",
    "end",
)  # fmt: skip
"""Measures computable from a force and its reference alone."""
_HOLD_KEYS = (*HEADLINE_KEYS, "chatter_frequency", "held_lateral_error", "held_z_error", "hold_mean_error",
              "hold_overshoot_force", "hold_begin", "hold_end", "holds",
              "felt_stiffness")  # fmt: skip


def fixed_point(value: float, digits: int, sign: str = "") -> str:
    """Format `value` with `digits` decimals, without a minus sign if it rounds to zero."""
    return f"{round(value, digits) + 0.0:{sign}.{digits}f}"


class ShownUnit(NamedTuple):
    """A unit of displayed numbers: symbol, form in keys and column names, number of these units per `SI` of JSON."""

    text: str
    ending: str
    per_SI: float = 1.0
    SI: str = ""


N, S, HZ, NM, A, J = (ShownUnit(text, text.replace(" ", "")) for text in ("N", "s", "Hz", "N m", "A", "J"))
MM, PERCENT, N_PER_M = (
    ShownUnit("mm", "mm", 1e3, "m"),
    ShownUnit("%", "percent", 100.0, "1"),
    ShownUnit("N/m", "N_per_m"),
)
COUNT = ShownUnit("", "count", 1.0, "1")


@dataclass(frozen=True)
class MeasuredValue:
    """The SI value of a measure with a remark, or None with the reason why it does not exist."""

    value: float | None
    reason: str = ""


Value = float | MeasuredValue | None
Values = Mapping[str, MeasuredValue]
"""Measured values by the keys of `ROWS_BY_KEY`."""


@dataclass(frozen=True)
class RunOutcome:
    """Summary numbers of the plant's true state, as opposed to the controller's belief.

    Attributes:
        peak, peak_time: largest pressing force (N) and its time (s).
        end: mean pressing force of the last second (N).
        end_x, end_y: mean force along x and y, by the robot on its surroundings, of the last second (N).
        force_error: rms of the pressing force minus its reference while the force loop is on (N), from the first touch
            on, as a robot in the air has no force to hold. None if the loop never was on, nothing was touched, or a
            third-party controller reports no trigger or no reference.
        lateral_error, z_error: rms deviation from the pre-defined reference, in x and y together, and in z (m). None if
            a third-party controller reports no reference.
        early_trigger: time with the force loop on before the first touch (s), or before the end without a touch; 0 if
            it was switched on in contact, None if never.
        measures: every measure by its key in `ROWS_BY_KEY`, SI.
    """

    peak: float
    peak_time: float
    end: float
    end_x: float
    end_y: float
    force_error: float | None
    lateral_error: float | None
    z_error: float | None
    early_trigger: float | None
    measures: Values = field(default_factory=dict)


@dataclass(frozen=True)
class MeasureRow:
    """A measure of a run: its texts, unit, computation and smallest significant difference.

    Attributes:
        key: name in Python and JSON, where values are SI.
        text, unit: displayed name and unit.
        meaning: definition in one sentence.
        interval: time over which it is taken.
        value: computation from the sums over held rows and the outcome of the whole run; NaN or None if undefined.
        digits: displayed decimals.
        floor, share: smallest difference that counts, SI and as a share of the larger value.
        missing: reason if the value does not exist.
    """

    key: str
    text: str
    unit: ShownUnit
    meaning: str
    interval: str
    value: Callable[["HoldSums", RunOutcome], Value]
    digits: int = 3
    floor: float = 0.0
    share: float = 0.0
    missing: str = "the controller reports no reference"

    @property
    def column(self) -> str:
        """Name of a table column, with the unit: `hold_error_N`."""
        return f"{self.key}_{self.unit.ending}"

    def format_value(self, value: float) -> str:
        """Format a value (SI) in the displayed unit: `0.094 N`."""
        return f"{fixed_point(value * self.unit.per_SI, self.digits)} {self.unit.text}".rstrip()

    def differs(self, one: float, other: float) -> bool:
        """Whether two values differ by more than the floor or share."""
        return abs(one - other) > max(self.floor, self.share * max(abs(one), abs(other)))


def _overshoot(hold: "HoldSums", run: RunOutcome) -> Value:
    if hold.request.forces:
        return max((one.overshoot for one in hold.tasks if one.overshoot is not None), default=None)
    return (
        hold["above"] / hold["R_0"] if hold["R_0"] > 0.0 else MeasuredValue(None, "the reference is 0 N at first touch")
    )


def _overshoot_force(hold: "HoldSums", run: RunOutcome) -> Value:
    tasks = zip(hold.tasks, hold.request.forces, strict=True)
    if hold.request.forces:
        return max((one.overshoot, one.overshoot * force) for one, force in tasks if one.overshoot is not None)[1]
    return hold["above"]


def _settling(hold: "HoldSums", run: RunOutcome) -> Value:
    return MeasuredValue(None, NOT_FOR_TASKS) if hold.request.forces else hold.settling


def _torque(hold: "HoldSums", run: RunOutcome) -> Value:
    if hold["torque"] >= 0.0 or hold["load"] < 0.0:
        return _reported_value(hold["torque"])
    return MeasuredValue(hold["load"], "load of the springs; these drives report no motor torque")


def _force_error(hold: "HoldSums", run: RunOutcome) -> Value:
    if not hold.has("controller.triggered"):
        return MeasuredValue(None, NO_TRIGGER)
    return run.force_error if hold.has("controller.F_z_ref") else MeasuredValue(None, NO_REFERENCE)


def _early_trigger(hold: "HoldSums", run: RunOutcome) -> Value:
    return run.early_trigger if hold.has("controller.triggered") else MeasuredValue(None, NO_TRIGGER)


def _reported_value(largest: float) -> float | None:
    return largest if largest >= 0.0 else None


def _chatter(which: int) -> Callable[["HoldSums", RunOutcome], float | MeasuredValue]:
    def value(hold: "HoldSums", run: RunOutcome) -> float | MeasuredValue:
        found = hold.chatter
        return found[which] if found[0] >= LEAST_CHATTER else MeasuredValue(None, f"below {LEAST_CHATTER:g} N")

    return value


def _rms(name: str) -> Callable[["HoldSums", RunOutcome], float]:
    return lambda hold, run: math.sqrt(hold[name] / hold["count"])


MEASURE_ROWS = (
    MeasureRow("hold_error", "hold error", N, "rms of the true pressing force minus its reference", HELD_INTERVAL,
               _rms("squares"), floor=FORCE_FLOOR),
    MeasureRow("hold_overshoot", "overshoot", PERCENT,
               "largest true pressing force beyond its reference, as a share of it; of tasks the worst one",
               "2 s from the first touch with the force loop on; in tasks until 1 s after they begin to hold",
               _overshoot, 1, 0.01),
    MeasureRow("hold_settling_time", "settling time", S,
               "time until the true pressing force stays within 5 % of its reference; not for tasks",
               "from the first touch with the force loop on until the first hold ends", _settling, 2, TIME_FLOOR,
               missing="not within 5 %"),
    MeasureRow("chatter", "chatter", N, "amplitude of the force's swings above 2 Hz in the worst hold", HELD_INTERVAL,
               _chatter(0), 2, FORCE_FLOOR),
    MeasureRow("chatter_frequency", "chatter frequency", HZ, "frequency of these swings", HELD_INTERVAL, _chatter(1), 1,
               share=0.05),
    MeasureRow("held_lateral_error", "lateral error while held", MM,
               "rms distance of the true position from the reference in x and y", HELD_INTERVAL, _rms("lateral"), 2,
               LENGTH_FLOOR),
    MeasureRow("held_z_error", "z error while held", MM, "rms of the true z minus the commanded one",
               HELD_INTERVAL, _rms("z"), 3, LENGTH_FLOOR, missing="the controller reports no commanded position"),
    MeasureRow("torque", "largest torque", NM, "largest motor torque of any drive", RUN_INTERVAL, _torque,
               share=EFFORT_SHARE),
    MeasureRow("current", "largest current", A, "largest current of any drive", RUN_INTERVAL,
               lambda hold, run: _reported_value(hold["current"]), share=EFFORT_SHARE, missing=NO_OUTPUT),
    MeasureRow("shaft_work", "shaft work", J, "work of the three shafts on the springs where power is positive",
               RUN_INTERVAL, lambda hold, run: hold["work"], 4, share=EFFORT_SHARE, missing=NO_OUTPUT),
    MeasureRow("energy", "energy", J, "electrical energy that the drives draw", RUN_INTERVAL,
               lambda hold, run: hold["energy"], 2, share=EFFORT_SHARE, missing=NO_OUTPUT),
    MeasureRow("hold_mean_error", "mean force error while held", N,
               "mean of the true pressing force minus its reference", HELD_INTERVAL,
               lambda hold, run: hold["error"] / hold["count"], floor=FORCE_FLOOR),
    MeasureRow("hold_overshoot_force", "overshoot in force", N, "largest true pressing force beyond its reference",
               "as the overshoot", _overshoot_force, 2, FORCE_FLOOR),
    MeasureRow("hold_begin", "held from", S, "first held tick", HELD_INTERVAL,
               lambda hold, run: hold["first"] * hold["dt"]),
    MeasureRow("hold_end", "held until", S, "last held tick", HELD_INTERVAL,
               lambda hold, run: hold["last"] * hold["dt"]),
    MeasureRow("holds", "holds", COUNT, "number of times that a force is held without a break", HELD_INTERVAL,
               lambda hold, run: hold.holds, 0),
    MeasureRow("felt_stiffness", "stiffness felt", N_PER_M,
               "stiffness that the springs give the platform along z where it is held: z of J^T k_s N^2 eta J",
               HELD_INTERVAL, lambda hold, run: hold.felt_stiffness, 0, share=EFFORT_SHARE,
               missing="the robot is not known"),
    MeasureRow("force_error", "error since the first touch", N, "rms of the true pressing force minus its reference",
               "from the first touch on, force loop on", _force_error, 2, FORCE_FLOOR,
               missing="no touch with the force loop on"),
    MeasureRow("peak", "largest force", N, "largest true pressing force", WHOLE_INTERVAL, lambda hold, run: run.peak, 2,
               FORCE_FLOOR),
    MeasureRow("peak_time", "time of the largest force", S, "time of the largest true pressing force", WHOLE_INTERVAL,
               lambda hold, run: run.peak_time, 2),
    MeasureRow("end", "force at the end", N, "mean true pressing force", "the last second", lambda hold, run: run.end,
               2, FORCE_FLOOR),
    MeasureRow("lateral_error", "lateral error", MM,
               "rms distance of the true position from the pre-defined reference in x and y", WHOLE_INTERVAL,
               lambda hold, run: run.lateral_error, 2, LENGTH_FLOOR),
    MeasureRow("z_error", "z error", MM, "rms of the true z minus the pre-defined one, the indentation included",
               WHOLE_INTERVAL, lambda hold, run: run.z_error, 2, LENGTH_FLOOR),
    MeasureRow("early_trigger", "force loop on before the first touch", S, "time of the force loop in the air",
               WHOLE_INTERVAL, _early_trigger, missing="the force loop is never on"),
)  # fmt: skip
"""Every measure, in display order."""
ROWS_BY_KEY = {measure.key: measure for measure in MEASURE_ROWS}


def compute_measures(hold: "HoldSums", run: RunOutcome) -> dict[str, MeasuredValue]:
    """Compute every measure of the table from the sums of held rows and the outcome of the run."""
    no_hold = "" if hold["count"] else _no_hold(hold, run)
    remark = ", ".join(
        text
        for text, applies in (
            (FROM_TOUCH, not hold.request.forces and not hold.has("controller.triggered")),
            (f"recorded rows, every {1e3 * hold['dt']:g} ms", hold.request.thinned),
            ("until the safety monitor tripped", hold["tripped"] > 0.0),
        )
        if applies
    )
    found = {}
    for measure in MEASURE_ROWS:
        of_a_hold = measure.key in _HOLD_KEYS
        if of_a_hold and no_hold:
            found[measure.key] = MeasuredValue(None, no_hold)
            continue
        value = measure.value(hold, run)
        if isinstance(value, MeasuredValue):
            found[measure.key] = value
        elif to_dict(value) is None:
            found[measure.key] = MeasuredValue(None, measure.missing)
        else:
            found[measure.key] = MeasuredValue(value, remark if of_a_hold else "")
    return found


def _no_hold(hold: "HoldSums", run: RunOutcome) -> str:
    forces = hold.request.forces
    if not hold.request.force_loop:
        return NO_FORCE_LOOP
    if not hold["touched"]:
        return "it never touched"
    if hold["tripped"]:
        return "the safety monitor tripped before a force was held"
    if math.isnan(hold["R_last"]) and not forces:
        return NO_REFERENCE
    if forces:
        known = hold.has("controller.task") and hold.has("controller.phase")
        return "no task held a force" if known else "the controller reports no task and phase"
    if hold["s0"] < 0.0:
        return "the force loop is never on in contact"
    if hold["R_last"] <= 0.0:
        return "the reference is 0 N" if hold["R_last"] == 0.0 else "the reference is negative"
    if hold["rows"] - hold["s0"] > hold["grace"]:
        return "the force loop or its reference changed within every 2 s"
    return "the run ends before a force was held for 2 s"


def missing_measures(reason: str) -> dict[str, MeasuredValue]:
    """Return every measure as missing, all for the same reason."""
    return {measure.key: MeasuredValue(None, reason) for measure in MEASURE_ROWS}


def value_text(key: str, values: Values) -> str:
    """Format a measure: `0.094 N`, or `none (no force loop)`; a remark follows in brackets."""
    found = values.get(key, MeasuredValue(None, "not measured"))
    if found.value is None:
        return f"none ({found.reason})"
    return ROWS_BY_KEY[key].format_value(found.value) + (f" ({found.reason})" if found.reason else "")


def labelled_text(key: str, values: Values) -> str:
    """Format a measure with its name: `hold error 0.094 N`."""
    return f"{ROWS_BY_KEY[key].text} {value_text(key, values)}"


def drop_remark(values: Values) -> Values:
    """Remove the remark on the hold error from the values of all measures."""
    remark = values["hold_error"].reason
    return {
        key: MeasuredValue(one.value) if one.value is not None and one.reason == remark else one
        for key, one in values.items()
    }


def first_measures(values: Values) -> list[str]:
    """Format the measures of `HEADLINE_KEYS`, without those undefined for tasks; a shared remark appears once."""
    rest = drop_remark(values)
    shown = [key for key in HEADLINE_KEYS if values[key].reason != NOT_FOR_TASKS]
    return [labelled_text(key, rest if number else values) for number, key in enumerate(shown)]


def measured_values(facts: Mapping[str, Mapping[str, Any]]) -> dict[str, MeasuredValue]:
    """Convert the measures of a summary file to `MeasuredValue` objects."""
    return {key: MeasuredValue(one["value"], one["reason"]) for key, one in facts.items()}


def with_units(values: Values) -> dict[str, Any]:
    """Convert measures for JSON: value in SI, unit, reason."""
    return {
        key: {"value": one.value, "unit": unit.SI or unit.text, "reason": one.reason}
        for key, one in values.items()
        for unit in [ROWS_BY_KEY[key].unit]
    }
