"""docs/validation.md says what docs/validation.json says, and that is about the yardsticks there are."""

import pickle
import re
from pathlib import Path

from twin.kernel.files import read_json
from validation.page import BEGIN, table
from validation.trial import names, of_file
from validation.yardstick import Finding

AGAIN = "docs/validation.md is out of date: make validation"


def test_the_page_says_what_the_data_say(root: Path):
    facts = read_json(root / "docs" / "validation.json")
    assert (root / "docs" / "validation.md").read_text().partition(BEGIN)[2] == f"\n{table(facts)}", AGAIN


def test_the_data_are_of_the_yardsticks_there_are_and_judged_by_their_bounds(root: Path):
    rows = read_json(root / "docs" / "validation.json")["findings"]
    stated = [(name, one) for name in names() for one in of_file(name)]
    assert len(rows) == len(stated), AGAIN
    for row, (name, one) in zip(rows, stated, strict=True):
        come = {key: row[key] for key in ("difference", "quantity", "remark", "versions")}
        finding = Finding(name, one, **come, ran=row["verdict"] != "not run")
        assert row == finding.facts, AGAIN
        assert finding.verdict in ("holds", "not run")


def test_a_finding_travels_from_the_process_that_ran_it():
    for name in names():
        for one in of_file(name):
            assert (
                pickle.loads(pickle.dumps(Finding(name, one, 0.0, "F_z"))).facts == Finding(name, one, 0.0, "F_z").facts
            )


def test_the_data_name_no_place_of_the_machine_they_were_made_on(root: Path):
    assert re.findall(r"(?<![\w./:-])/\w[\w.-]*/", (root / "docs" / "validation.json").read_text()) == []


def test_the_page_of_the_parts_has_the_same_figures(root: Path):
    rows = read_json(root / "docs" / "validation.json")["findings"]
    page = (root / "docs" / "ssp_reference.md").read_text()
    for row in rows:
        if "beside the twin's own run" in row["claim"] and row["difference"]:
            assert f"| {row['difference']:.2g} of a signal's range |" in page
