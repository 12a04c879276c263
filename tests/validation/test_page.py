"""docs/validation.md says what docs/validation.json says, and that is about the yardsticks there are."""

import re
from dataclasses import fields
from pathlib import Path

from twin.files import read_json
from validation.page import BEGIN, table
from validation.trial import names, of_file
from validation.yardstick import Finding

AGAIN = "docs/validation.md is out of date: make validation"
STATED = ("claim", "source", "unit", "bound", "reason")


def test_the_page_says_what_the_data_say(root: Path):
    facts = read_json(root / "docs" / "validation.json")
    assert (root / "docs" / "validation.md").read_text().partition(BEGIN)[2] == f"\n{table(facts)}", AGAIN


def test_the_data_are_of_the_yardsticks_there_are_and_judged_by_their_bounds(root: Path):
    rows = read_json(root / "docs" / "validation.json")["findings"]
    stated = [(name, *(getattr(one, key) for key in STATED)) for name in names() for one in of_file(name)]
    assert [tuple(row[key] for key in ("name", *STATED)) for row in rows] == stated, AGAIN
    for row in rows:
        finding = Finding(**{field.name: row[field.name] for field in fields(Finding)})
        assert row["verdict"] == finding.verdict != "EXCEEDED"


def test_the_data_name_no_place_of_the_machine_they_were_made_on(root: Path):
    assert re.findall(r"(?<![\w./:-])/\w[\w.-]*/", (root / "docs" / "validation.json").read_text()) == []


def test_the_page_of_the_parts_has_the_same_figures(root: Path):
    rows = read_json(root / "docs" / "validation.json")["findings"]
    page = (root / "docs" / "export_fmu.md").read_text()
    for row in rows:
        if "fig4" in row["claim"] and row["difference"]:
            assert f"| {row['difference']:.2g} of a signal's range |" in page
