"""A sweep as one HTML file that needs neither network nor script."""

from collections.abc import Mapping
from pathlib import Path

from twin.kernel.writing import write_text
from twin.report.page.markup import Markup, element, joined, table
from twin.report.page.page import plain_page
from twin.report.page.picture import figure
from twin.studies.sweep.rows import SweepRows
from twin.studies.sweep.show.parts import Asked, ReportPart, headline, parts

PAGE = "sweep.html"
CAPTIONS = {
    "bands": "Fig. 4 over all runs. Line: median, dark: 25 to 75 %, light: 5 to 95 % at each time. A to D: as the "
    "robot estimates it, as in the paper; E, F: what is true.",
    "map": "The metric over two parameters; of a grid the best run of each cell. Orange cross: a run without a number.",
    "front": "Runs over two metrics, less is better of both; circled: those that no other beats.",
    "metrics": "Each metric over all runs.",
}
BESIDE = {"bands": "claims", "map": "best", "front": "front", "metrics": "metrics"}
"""The part that a picture belongs to; where there is none it comes last."""
NAMES = {
    "claims": "Claims", "best": "Best runs", "drives": "Drives", "correlation": "Rank correlation",
    "indices": "Sobol indices", "front": "Pareto front", "metrics": "Metrics", "reasons": "Not done",
}  # fmt: skip
"""Of parts in the list of contents."""


def write_sweep_page(sweep: SweepRows, asked: Asked, pictures: Mapping[str, Path], folder: Path) -> Path:
    """Write the page into `folder`; its path. The same rows give the same text.

    Args:
        pictures: files (PNG) by the names of `CAPTIONS`.

    Raises:
        NotWritten: it cannot be written.
    """
    path = folder / PAGE
    write_text(path, sweep_page(sweep, asked, pictures))
    return path


def sweep_page(sweep: SweepRows, asked: Asked, pictures: Mapping[str, Path]) -> str:
    """The HTML of `write_sweep_page`."""
    drawn = {name: figure(path.read_bytes(), CAPTIONS[name]) for name, path in pictures.items()}
    found = [("verdict", "Verdict", element("p", headline(sweep, asked.by), class_="headline plain"))]
    for number, part in enumerate(parts(sweep, asked)):
        its = [drawn.pop(name) for name, key in BESIDE.items() if key == part.key and name in drawn]
        found.append((f"{part.key}-{number}", part.title, joined([*_content(part), *its])))
    if drawn:
        found.append(("pictures", "Pictures", joined(drawn.values())))
    links = [(key, NAMES.get(key.partition("-")[0], title)) for key, title, _ in found]
    sections = [(key, title[0].upper() + title[1:], html) for key, title, html in found]
    return plain_page(f"Sweep {sweep.name}", _subtitle(sweep), sections, links, " from the rows of the sweep alone")


def _subtitle(sweep: SweepRows) -> str:
    drives = f" | {', '.join(sweep.drives)}" if sweep.drives else ""
    return (
        f"{len(sweep.columns)} of {sweep.runs} runs | design {sweep.design} | varies {', '.join(sweep.labels)}{drives}"
    )


def _content(part: ReportPart) -> list[Markup]:
    shown = [position for position, title in enumerate(part.head) if title not in part.text_only]
    rows = [[_cell(row[position], part) for position in shown] for row in part.rows]
    inside = [table([part.head[position] for position in shown], rows, part.title)] if rows else []
    return inside + [element("p", remark, class_="hint") for remark in part.remarks]


def _cell(text: str, part: ReportPart) -> str:
    # the two ends of an interval stay on one line
    unbroken = text.replace(" .. ", "\u00a0..\u00a0")
    note = part.notes.get(text)
    return joined([unbroken, element("small", note)]) if note else unbroken
