"""docs/keys.md has every key that an experiment may have, with unit, default and bounds as the schema has them."""

import pytest

from tests.docs.schema_rows import PAGE, TABLES, cells, completed, rows


def written(table: str) -> dict[str, tuple[str, ...]]:
    """key -> unit, default, allowed, meaning in the section of `table`."""
    sections = PAGE.read_text().split("\n## ")
    body = next(section for section in sections if section.partition("\n")[0].replace("`", "") == table)
    return {cells(line)[0]: cells(line)[1:] for line in body.splitlines() if line.startswith("| `")}


@pytest.mark.parametrize("table", TABLES)
def test_the_page_says_of_a_table_what_the_schema_says(table: str):
    assert {key: said[:3] for key, said in written(table).items()} == rows(TABLES[table])


@pytest.mark.parametrize("table", TABLES)
def test_every_key_has_a_meaning(table: str):
    assert [key for key, said in written(table).items() if len(said[3]) < 8] == []


def test_what_the_page_lacks_is_written_of_the_declaration_and_nothing_else_is():
    page = PAGE.read_text()
    assert completed(page) == page
    row = next(line for line in page.splitlines() if line.startswith("| `corner_Hz`"))
    assert "| `corner_Hz` | Hz | needed | > 0 | swings slower than this are not damped |" in completed(
        page.replace(f"{row}\n", "")
    )
    assert row in completed(page.replace(row, row.replace("> 0", "> 1")))
