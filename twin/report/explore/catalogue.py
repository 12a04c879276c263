"""Catalogue of the values of an experiment that the explorer can change, with the range of a slider for each.

A setting declares the bounds of valid values, often only one of them, or no bound. A slider needs two ends: both
declared bounds if they are not too far apart, else a range around the file's value. Typed values may lie beyond the
ends.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args, get_origin

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.settings import Setting, Settings
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.schema import nested_tables
from twin.robot.experiment.source import value_at

FIRST_KEYS = (
    "robot.k_s_Nm_per_rad",
    "controller.force.reference_N",
    "controller.force.kp_mm_per_N",
    "controller.force.ki_mm_per_N_s",
    "controller.position.kp_per_s",
    "controller.damping.gain_rad_per_s_per_Nm",
    "reference.t_s",
    "approach.speed_mm_per_s",
    "contact.stiffness_N_per_m",
    "controller.delay_ticks",
    "contact.friction",
    "robot.joint_friction_Nm",
    "robot.joint_noise_deg",
    "robot.backlash_deg",
    "drive.parameters.droop",
)
"""Keys that are shown before any search."""
PACE_KEY = "reference.t_s"
"""Times of way points. They are changed together: the slider is a factor on the speed."""
HIDDEN_TABLES = ("recording",)
"""Tables without effect on the curves."""
LOG_SCALE_RATIO = 100.0
"""Minimum ratio of the declared bounds for a logarithmic slider."""
LINEAR_REACH, LOG_REACH = 4.0, 10.0
"""Undeclared end of a linear and of a logarithmic slider, as a multiple of the file's value."""
UNBOUNDED_REACH = 0.5
"""Reach of an unbounded slider to both sides, as a share of the file's value."""
DEFAULT_HIGHS = {"deg": 1.0, "ms": 20.0, "N m": 0.1, "mm": 10.0, "s": 5.0, "Hz": 20.0, "rad/s": 1.0, "N": 5.0}
"""Upper end of a slider without upper bound whose value is 0, by unit; 1 for other units."""
DEFAULT_WHOLE_HIGH = 20
"""The same upper end for integers, such as ticks of delay."""

Kind = Literal["number", "whole", "choice", "switch", "pace"]


@dataclass(frozen=True)
class Slider:
    """A key of the experiment that the explorer can change, dotted as for --set, with the range of its slider.

    `value` is the value in the file, None if missing. Without a default, `default` is None. `first` is the position
    among the keys shown before any search, None for the others. The unit is "" without one.
    """

    key: str
    unit: str
    help: str
    kind: Kind
    value: Any
    default: Any
    low: float
    high: float
    log: bool
    choices: tuple[Any, ...]
    first: int | None


def sliders(experiment: Experiment) -> dict[str, Slider]:
    """Return the explorer's sliders for the keys of an experiment, in the order of the documentation."""
    found = {slider.key: slider for slider in _all_sliders(experiment)}
    # keys without a value or default get no slider at the top
    shown = [key for key in FIRST_KEYS if key in found and (found[key].value, found[key].default) != (None, None)]
    # the order stays
    return found | {key: replace(found[key], first=place) for place, key in enumerate(shown)}


def _all_sliders(experiment: Experiment) -> Iterator[Slider]:
    values = experiment.values
    for name, model in DECLARED_TABLES.tables.items():
        if name in HIDDEN_TABLES or (name == "contact" and "contact" not in values):
            continue
        for path, table in nested_tables(model, name).items():
            # a missing table can be set key by key only if it requires none
            required = any(info.is_required() for info in table.model_fields.values())
            if isinstance(value_at(values, path), Mapping) or not required:
                yield from _table_sliders(path, table, values)
    for number, task in enumerate(values.get("task", ()), start=1):
        yield from _table_sliders(f"task.{number}", DECLARED_TABLES.tasks[task["kind"]], {"task": {str(number): task}})
    drive = experiment.drives[0]
    own = value_at(values, "drive.parameters") or {}
    for name, value in drive.parameters.items():
        # names of FMUs with dots are tables of TOML
        if isinstance(value, float | int) and not isinstance(value, bool) and name.replace("_", "a").isalnum():
            key = f"drive.parameters.{name}"
            low, high, log = _ends(float(value), {"ge": 0.0} if value >= 0.0 else {}, "")
            help_ = f"{name}: a parameter of the drive's FMU, in its own unit"
            yield Slider(key, "", help_, "number", own.get(name, value), None, low, high, log, (), None)


def _table_sliders(path: str, table: type[Settings], values: Mapping[str, Any]) -> Iterator[Slider]:
    for name, declared in table.settings.items():
        key = f"{path}.{declared.key(name)}"
        value = value_at(values, key)
        if key == PACE_KEY and value is not None:
            help_ = "times of the way points: a factor on the speed between them"
            yield Slider(key, "x", help_, "pace", 1.0, 1.0, 0.25, 4.0, True, (), None)
        elif found := _slider(key, declared, table.model_fields[name].annotation, value):
            yield found


def _slider(key: str, declared: Setting, annotation: Any, value: Any) -> Slider | None:
    """Return the explorer's slider for a setting; None unless it is a single number, choice or switch."""
    kinds = [part for part in (get_args(annotation) or (annotation,)) if part is not type(None)]
    default = None if declared.default is ... else declared.default
    head = key, declared.unit, declared.help
    if annotation is bool:
        return Slider(*head, "switch", value, default, 0.0, 1.0, False, (), None)
    if get_origin(annotation) is Literal:
        return Slider(*head, "choice", value, default, 0.0, 1.0, False, get_args(annotation), None)
    if kinds not in ([float], [int]):
        return None
    now = next((float(one) for one in (value, default, *declared.more.get("examples", ())) if one is not None), 0.0)
    if kinds == [float]:
        low, high, log = _ends(now, declared.more, declared.unit)
        return Slider(*head, "number", value, default, low, high, log, (), None)
    low, high, _ = _ends(now, declared.more, declared.unit)
    high = min(high, declared.more.get("le", math.inf), max(DEFAULT_WHOLE_HIGH, math.ceil(LINEAR_REACH * now)))
    return Slider(*head, "whole", value, default, math.floor(low), high, False, (), None)


def _ends(value: float, more: Mapping[str, Any], unit: str) -> tuple[float, float, bool]:
    """Choose a slider's (lower end, upper end, whether logarithmic) around `value`, within the bounds in `more`."""
    least, most = more.get("gt", more.get("ge", -math.inf)), more.get("lt", more.get("le", math.inf))
    usual = DEFAULT_HIGHS.get(unit, 1.0)
    if least == 0.0 and "gt" in more and value > 0.0:
        # 0 itself is excluded: the same factor up and down
        return value / LOG_REACH, min(value * LOG_REACH, most), True
    if least > 0.0 and most / least >= LOG_SCALE_RATIO:
        return least, min(most, max(value, least) * LOG_REACH), True
    if least >= 0.0:
        return least, min(most, LINEAR_REACH * value if value else usual), False
    if least > -math.inf and most < math.inf:
        return least, most, False
    reach = UNBOUNDED_REACH * abs(value) if value else usual
    return max(least, value - reach), min(most, value + reach), False


def check_value(known: Mapping[str, Slider], key: str, value: Any) -> Any:
    """Check the page's `value` for the experiment key `key`, and convert it to the type that a file would have."""
    if key not in known:
        raise InputRefused(f"{key}: no key that can be changed here; {nearest(key, known, 'see twin schema')}")
    slider = known[key]
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if slider.kind == "switch" and isinstance(value, bool):
        return value
    if slider.kind == "choice" and value in slider.choices:
        return slider.choices[slider.choices.index(value)]
    if slider.kind == "whole" and number and float(value).is_integer() and abs(value) < 2**53:
        return int(value)
    if slider.kind == "number" and number:
        return float(value)
    if slider.kind == "pace" and number and 1e-3 <= value <= 1e3:
        return float(value)
    expected = {
        "switch": "true or false",
        "choice": ", ".join(map(repr, slider.choices)),
        "whole": "a whole number",
        "number": "a number",
        "pace": "a factor between 0.001 and 1000",
    }
    raise InputRefused(f"{key} = {str(value)[:80]!r}: expected {expected[slider.kind]}")
