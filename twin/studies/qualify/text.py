"""Checked and compared drives as text of at most 80 columns."""

from collections.abc import Mapping, Sequence
from typing import Any

from twin.studies.lines import WIDTH, markdown, wrapped
from twin.studies.qualify.comparison import DriveTrials
from twin.studies.qualify.true_run import COMPARED

SHOWN_IN = {"s": (1e3, "ms"), "m": (1e3, "mm")}
"""SI unit -> (factor, unit) that people read."""

ROUNDING = 1e-9
"""In SI units: what double precision leaves of angles and speeds after seconds of turning."""


def check_text(facts: Mapping[str, Any]) -> str:
    """The verdict, then the evidence.

    Args:
        facts: of `Qualification.facts`.
    """
    verdict = "QUALIFIED" if facts["qualified"] else "NOT QUALIFIED: " + ", ".join(facts["failed"])
    versions = " + ".join(fmu["standard"] for fmu in facts["fmus"])
    lines = [f"{facts['drive']}  {verdict}", f"  {versions}, commanded with a {facts['command']}", ""]
    for name, check in facts["checks"].items():
        lines += _hanging(f"  {check['verdict']:4}  {name:10} ", check["detail"])
    lines.append("")
    for measure in facts["measures"].values():
        lines += _hanging(f"  {measure['text']:20} {_quantity(measure['value'], measure['unit'])} ", measure["remark"])
    for warning in facts["warnings"]:
        lines += wrapped(f"warning: {warning}", later=2)
    return "\n".join(line.rstrip() for line in lines)


def measures_table(checked: Sequence[Mapping[str, Any]]) -> str:
    """A Markdown table of the measures, one line per drive.

    Args:
        checked: `Qualification.facts` of each.
    """
    measures = checked[0]["measures"].items()
    head = ["drive", *(f"{one['text']} ({_unit_in_table(one['unit'], name)})" for name, one in measures)]
    rows = []
    for facts in checked:
        drive = facts["drive"].removesuffix(".fmu") + ("" if facts["qualified"] else " (NOT qualified)")
        rows.append([drive, *(_table_cell(name, measure) for name, measure in facts["measures"].items())])
    return markdown(head, rows)


def verdict_text(sentences: Sequence[str]) -> str:
    """What comes first: who is better in what."""
    return "\n".join(line for sentence in sentences for line in wrapped(sentence, later=2, whole=True))


def compare_text(compared: DriveTrials) -> str:
    """One line per drive, and what there is to say about gaps."""
    trials = compared.trials
    shown = {name: _unit_shown(name) for name in COMPARED}
    columns = {name: 1 + max(6, len(COMPARED[name].text), len(unit)) for name, (_, unit) in shown.items()}
    first = WIDTH - sum(columns.values())
    lines = [
        " " * first + "".join(f"{COMPARED[name].text:>{width}}" for name, width in columns.items()),
        f"{_cut(compared.name, first - 1):{first}}"
        + "".join(f"{shown[name][1]:>{width}}" for name, width in columns.items()),
    ]
    notes: dict[str, list[str]] = {}
    for trial in trials:
        cells = ""
        for measure in trial.measures:
            cells += f"{_cell(measure.value, shown[measure.name][0]):>{columns[measure.name]}}"
            if measure.value is None and not trial.failure:
                notes.setdefault(f"{COMPARED[measure.name].text}: {measure.remark}", []).append(trial.name)
        lines.append(f"{_cut(trial.name, first - 1):{first}}{cells}")
    lines += _wrapped("- ", [f"{note} ({', '.join(names)})" for note, names in notes.items()])
    lines += _wrapped("FAILED ", [f"{trial.name}: {trial.failure}" for trial in trials if trial.failure])
    return "\n".join(lines)


def shown_value(name: str, value: float) -> str:
    """A measure of `COMPARED` in the unit people read: `0.45 N`."""
    factor, unit = _unit_shown(name)
    return f"{_digits(value, factor)} {unit}"


def _quantity(value: float | None, unit: str) -> str:
    factor, shown = SHOWN_IN.get(unit, (1.0, unit))
    if value is not None and unit == "s" and abs(value) < 1e-3:
        factor, shown = 1e6, "us"
    return f"{_digits(value, factor):>10} {'' if value is None else shown:14}"


def _digits(value: float | None, factor: float) -> str:
    """Three digits; what rounding left of nothing is nothing."""
    if value is None:
        return "-"
    return "0" if abs(value) < ROUNDING else format(factor * value, "#.3g").rstrip(".")


def _cell(value: float | None, factor: float) -> str:
    """The same in six characters, for narrow columns."""
    small = value is not None and abs(value) >= ROUNDING and abs(factor * value) < 0.01
    return format(factor * (value or 0.0), ".4f") if small else _digits(value, factor)


def _unit_in_table(unit: str, name: str) -> str:
    return "us" if name == "cost" else SHOWN_IN.get(unit, (1.0, unit))[1]


def _table_cell(name: str, measure: Mapping[str, Any]) -> str:
    factor = 1e6 if name == "cost" else SHOWN_IN.get(measure["unit"], (1.0, ""))[0]
    if measure["value"] is None:
        return measure["remark"]
    return "0" if name == "droop" and measure["remark"] else _digits(measure["value"], factor)


def _unit_shown(name: str) -> tuple[float, str]:
    if name == "settling_time":
        return 1.0, "s"
    return (1e6, "us/tick") if name == "cost" else SHOWN_IN.get(COMPARED[name].unit, (1.0, COMPARED[name].unit))


def _hanging(head: str, text: str) -> list[str]:
    return wrapped(text, head) or [head]


def _wrapped(mark: str, texts: Sequence[str]) -> list[str]:
    return [line for text in texts for line in wrapped(mark + text, later=2)]


def _cut(name: str, most: int) -> str:
    return name if len(name) <= most else "..." + name[-(most - 3) :]
