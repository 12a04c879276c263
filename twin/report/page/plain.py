"""Pages without network or script: the results of a sweep, and the comparison of drives."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twin.kernel.atomic_write import write_text
from twin.report.page.markup import Markup, element, join_markup, table
from twin.report.page.page import plain_page
from twin.report.page.picture import figure
from twin.robot.run.measures import ROWS_BY_KEY, measured_values, value_text
from twin.studies.metrics.standing import COMPARED_MEASURES
from twin.studies.qualify.comparison import FREE_RUN_MEASURES
from twin.studies.qualify.text import shown_value
from twin.studies.sweep.show.parts import ReportPart, SweepQuery, headline, parts
from twin.studies.sweep.stored import SweepRows

SWEEP_PAGE_FILE = "sweep.html"
PICTURE_CAPTIONS = {
    "bands": "Fig. 4 over all runs. Line: median, dark: 25 to 75 %, light: 5 to 95 % at each time. A to D: as the "
    "robot estimates it, as in the paper; E, F: what is true.",
    "map": "The metric over two parameters; of a grid the best run of each cell. Orange cross: a run without a number.",
    "front": "Runs over two metrics, less is better of both; circled: those that no other beats.",
    "metrics": "Each metric over all runs.",
}
PICTURE_PARTS = {"bands": "claims", "map": "best", "front": "front", "metrics": "metrics"}
"""Picture -> the part of the report that shows it; other pictures come last."""
PART_NAMES = {
    "claims": "Claims", "best": "Best runs", "margins": "Margins", "drives": "Drives",
    "correlation": "Rank correlation", "indices": "Sobol indices", "front": "Pareto front", "metrics": "Metrics",
    "reasons": "Not done",
}  # fmt: skip
"""Part -> its text in the table of contents."""
DRIVES_PAGE_FILE = "compare.html"


def write_sweep_page(sweep: SweepRows, asked: SweepQuery, pictures: Mapping[str, Path], folder: Path) -> Path:
    """Write a sweep's page, the same for equal rows, into `folder`; `pictures`: PNG files by `PICTURE_CAPTIONS`."""
    path = folder / SWEEP_PAGE_FILE
    write_text(path, sweep_page(sweep, asked, pictures))
    return path


def sweep_page(sweep: SweepRows, asked: SweepQuery, pictures: Mapping[str, Path]) -> str:
    """Return the HTML of the page of a sweep, see `write_sweep_page`."""
    drawn = {name: figure(path.read_bytes(), PICTURE_CAPTIONS[name]) for name, path in pictures.items()}
    found = [("verdict", "Verdict", element("p", headline(sweep, asked.by), class_="headline plain"))]
    for number, part in enumerate(parts(sweep, asked)):
        its = [drawn.pop(name) for name, key in PICTURE_PARTS.items() if key == part.key and name in drawn]
        found.append((f"{part.key}-{number}", part.title, join_markup([*_content(part), *its])))
    if drawn:
        found.append(("pictures", "Pictures", join_markup(drawn.values())))
    links = [(key, PART_NAMES.get(key.partition("-")[0], title)) for key, title, _ in found]
    sections = [(key, title[0].upper() + title[1:], html) for key, title, html in found]
    drives = f" | {', '.join(sweep.drives)}" if sweep.drives else ""
    done = f"{len(sweep.columns)} of {sweep.runs} runs | design {sweep.design}"
    subtitle = f"{done} | varies {', '.join(sweep.labels)}{drives}"
    return plain_page(f"Sweep {sweep.name}", subtitle, sections, links, " from the rows of the sweep alone")


def _content(part: ReportPart) -> list[Markup]:
    shown = [position for position, title in enumerate(part.head) if title not in part.text_only]
    rows = [[_cell(row[position], part) for position in shown] for row in part.rows]
    inside = [table([part.head[position] for position in shown], rows, part.title)] if rows else []
    return inside + [element("p", remark, class_="hint") for remark in part.remarks]


def _cell(text: str, part: ReportPart) -> str:
    # keep the two ends of an interval on one line
    unbroken = text.replace(" .. ", "\u00a0..\u00a0")
    note = part.notes.get(text)
    return join_markup([unbroken, element("small", note)]) if note else unbroken


def write_drives_page(facts: Mapping[str, Any], folder: Path) -> Path:
    """Write the page of `compare_drives` (facts, pictures in `folder`) into the folder; return its path.

    The same facts and pictures give the same text.
    """
    names = [drive["drive"] for drive in facts["experiments"][0]["drives"]]
    sentences = [element("p", sentence, class_="headline plain") for sentence in facts["verdict"]]
    definitions = facts["definitions"]
    meanings = [
        (ROWS_BY_KEY[key].text, f"{ROWS_BY_KEY[key].meaning}; {ROWS_BY_KEY[key].interval}") for key in COMPARED_MEASURES
    ]
    meanings += [(definitions[name]["text"], definitions[name]["meaning"]) for name in (*FREE_RUN_MEASURES, "cost")]
    found = [("verdict", "Verdict", join_markup(sentences))]
    for number, one in enumerate(facts["experiments"], start=1):
        text = f"{one['experiment']}: what is controlled, its approach, the error of z, the error in the second half."
        picture = figure(Path(one["picture"]).read_bytes(), text)
        found.append((f"experiment-{number}", one["experiment"], join_markup([_measures(one, definitions), picture])))
    found.append(("definitions", "What the measures mean", table(("measure", "is"), meanings, "definitions")))
    subtitle = " | ".join([*names, *facts["set"]])
    path = folder / DRIVES_PAGE_FILE
    write_text(path, plain_page(f"{len(names)} drives compared", subtitle, found))
    return path


def _measures(experiment: Mapping[str, Any], definitions: Mapping[str, Any]) -> Markup:
    drives = experiment["drives"]
    rows = []
    values = [measured_values(drive["run_measures"]) for drive in drives]
    for key in COMPARED_MEASURES:
        if any(one[key].value is not None for one in values):
            rows.append((ROWS_BY_KEY[key].text, *(value_text(key, one) for one in values)))
    held = any(one["hold_error"].value is not None for one in values)
    for name in ("cost",) if held else (*FREE_RUN_MEASURES, "cost"):
        rows.append((definitions[name]["text"], *(_measure_cell(name, drive["measures"][name]) for drive in drives)))
    failures = [
        element("p", f"{drive['drive']}: {drive['failure']}", class_="bad") for drive in drives if drive["failure"]
    ]
    head = ("measure", *(drive["drive"] for drive in drives))
    return join_markup([table(head, rows, f"measures in {experiment['experiment']}"), *failures])


def _measure_cell(name: str, measure: Mapping[str, Any]) -> Markup:
    if measure["value"] is None:
        return join_markup(["-", element("small", measure["remark"])])
    return join_markup([shown_value(name, measure["value"])])
