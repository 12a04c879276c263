"""Drives compared, as one HTML file that needs neither network nor script."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twin.kernel.writing import write_text
from twin.report.page.markup import Markup, element, joined, table
from twin.report.page.page import plain_page
from twin.report.page.picture import figure
from twin.studies.qualify.text import shown_value

PAGE = "compare.html"


def write_drives_page(facts: Mapping[str, Any], folder: Path) -> Path:
    """Write the page into `folder`; its path. The same facts and pictures give the same text.

    Args:
        facts: of `compare_drives`.
        folder: where its pictures are, too.

    Raises:
        NotWritten: it cannot be written.
    """
    path = folder / PAGE
    write_text(path, drives_page(facts))
    return path


def drives_page(facts: Mapping[str, Any]) -> str:
    """The HTML of `write_drives_page`."""
    names = [drive["drive"] for drive in facts["experiments"][0]["drives"]]
    sentences = [element("p", sentence, class_="headline plain") for sentence in facts["verdict"]]
    meanings = [(one["text"], one["meaning"]) for one in facts["definitions"].values()]
    found = [("verdict", "Verdict", joined(sentences))]
    for number, one in enumerate(facts["experiments"], start=1):
        text = f"{one['experiment']}: what is controlled, its approach, the error of z, the error in the second half."
        picture = figure(Path(one["picture"]).read_bytes(), text)
        found.append(
            (f"experiment-{number}", one["experiment"], joined([_measures(one, facts["definitions"]), picture]))
        )
    found.append(("definitions", "What the measures mean", table(("measure", "is"), meanings, "definitions")))
    subtitle = " | ".join([*names, *facts["set"]])
    return plain_page(f"{len(names)} drives compared", subtitle, found, [(key, title) for key, title, _ in found])


def _measures(experiment: Mapping[str, Any], definitions: Mapping[str, Any]) -> Markup:
    """A measure per line, a drive per column."""
    drives = experiment["drives"]
    rows = []
    for name, definition in definitions.items():
        cells = [drive["measures"][name] for drive in drives]
        rows.append((definition["text"], *(_cell(name, cell) for cell in cells)))
    failures = [
        element("p", f"{drive['drive']}: {drive['failure']}", class_="bad") for drive in drives if drive["failure"]
    ]
    head = ("measure", *(drive["drive"] for drive in drives))
    return joined([table(head, rows, f"measures in {experiment['experiment']}"), *failures])


def _cell(name: str, measure: Mapping[str, Any]) -> Markup:
    if measure["value"] is None:
        return joined(["-", element("small", measure["remark"])])
    return joined([shown_value(name, measure["value"])])
