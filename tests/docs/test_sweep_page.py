"""docs/sweep_reference.md has every key of a sweep file, and every column of a row."""

import re
from pathlib import Path

from twin.studies.sweep.measures import METRICS, run_fields
from twin.studies.sweep.plan import SweepFile, Vary


def named(page: str, header: str) -> set[str]:
    """Keys in the first column of the first table with that header."""
    rows = page.split(f"{header}\n|---|---|\n")[1].split("\n\n")[0].splitlines()
    return {name for row in rows for name in re.findall(r"`\[*(\w+)\]*`", row.split("|")[1])}


def test_every_key_of_a_sweep_file_is_documented_and_no_other(root: Path):
    page = (root / "docs/sweep_reference.md").read_text()
    assert named(page, "| key | meaning |") == set(SweepFile.model_fields)
    assert named(page, "| key of `[[vary]]` | meaning |") == {
        field.alias or n for n, field in Vary.model_fields.items()
    }


def test_every_part_of_a_row_and_every_metric_is_documented(root: Path):
    page = (root / "docs/sweep_reference.md").read_text().split("## A row")[1]
    found = run_fields("done", "", {}, 0.0, 0.0, claims={}, curves={}, no_hold="no force loop")
    assert {*found, "run", "key", "drive", "parameters", "within_limits"} == named(page, "| | |")
    assert all(f"`{metric}`" in page for metric in METRICS)
