"""docs/keys.md has every key that an experiment may have, with unit, default and bounds as the schema has them."""

import re
from pathlib import Path

import pytest

from tests.docs.schema_rows import TABLES, rows


def written(root: Path, table: str) -> dict[str, tuple[str, ...]]:
    """key -> unit, default, allowed, meaning in the section of `table`."""
    sections = (root / "docs" / "keys.md").read_text().split("\n## ")
    body = next(section for section in sections if section.partition("\n")[0].replace("`", "") == table)
    cells = [re.split(r"(?<!\\)\|", line.strip("|")) for line in body.splitlines() if line.startswith("| `")]
    return {cell[0].strip(" `"): tuple(text.strip().replace("`", "") for text in cell[1:]) for cell in cells}


@pytest.mark.parametrize("table", TABLES)
def test_the_page_says_of_a_table_what_the_schema_says(root: Path, table: str):
    assert {key: cells[:3] for key, cells in written(root, table).items()} == rows(TABLES[table])


@pytest.mark.parametrize("table", TABLES)
def test_every_key_has_a_meaning(root: Path, table: str):
    assert [key for key, cells in written(root, table).items() if len(cells[3]) < 8] == []
