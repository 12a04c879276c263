"""The tables of docs/keys.md are made of the declarations of the keys; each key has a meaning."""

import pytest

from tests.docs.schema_rows import PAGE, TABLES, completed, rows


def test_the_page_has_the_rows_of_the_declarations():
    page = PAGE.read_text()
    assert completed(page) == page, "python -m tests.docs.schema_rows writes the rows"


@pytest.mark.parametrize("table", TABLES)
def test_every_table_is_on_the_page_and_every_key_has_a_meaning(table: str):
    assert f"\n## {table}\n" in PAGE.read_text().replace("`", "")
    assert [row for row in rows(TABLES[table]).values() if len(row.split(" | ")[-1]) < 8] == []


def test_a_missing_or_changed_row_is_written_of_the_declaration():
    page = PAGE.read_text()
    row = next(line for line in page.splitlines() if line.startswith("| `corner_Hz`"))
    assert (
        row
        == "| `corner_Hz` | Hz | needed | > 0 | corner of the high-pass of that torque; slower swings are not damped |"
    )
    assert row in completed(page.replace(f"{row}\n", ""))
    assert row in completed(page.replace(row, row.replace("> 0", "> 1")))
