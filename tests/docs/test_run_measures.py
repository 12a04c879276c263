"""docs/run_measures.md has the table of measures."""

from pathlib import Path

from twin.robot.run.measures import MEASURE_ROWS, MeasureRow


def rows() -> list[str]:
    """The table of the page."""
    return [
        "| " + " | ".join((f"`{one.key}`", one.text, one.unit.text, one.meaning, one.interval, floor(one))) + " |"
        for one in MEASURE_ROWS
    ]


def floor(measure: MeasureRow) -> str:
    """`0.05 N`, `5 %`, or "" where values are not compared."""
    if measure.share:
        return f"{100.0 * measure.share:g} %"
    return f"{measure.floor * measure.unit.per_SI:g} {measure.unit.text}" if measure.floor else ""


def test_the_page_has_the_table_of_the_code(root: Path):
    page = (root / "docs/run_measures.md").read_text()
    head = "| key | name | unit | meaning | interval | floor |\n|---|---|---|---|---|---|\n"
    assert page.split(head)[1].split("\n\n")[0].splitlines() == rows()
