"""Bounds on the number of pages and on the words of each, and the question that each how-to begins with."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

MAX_PAGES = 54
MAX_WORDS = 3_500
"""Words of a page but what is generated."""
WRITTEN = "<!-- from here on written by "
"""Marks the rest of a page as the output of a command."""
TABLES = ("keys.md", "run_measures.md", "faults_reference.md", "roles_reference.md", "recording.md", "how_it_works.md")
"""Pages whose tables a test holds equal to the code, or a command prints."""


def by_hand(page: Path) -> int:
    """Words of a page as `wc -w` counts them, less what is generated."""
    text = page.read_text().partition(WRITTEN)[0]
    lines = [line for line in text.splitlines() if page.name not in TABLES or not line.startswith("|")]
    return len(" ".join(lines).split())


def pages_of(entry: Any) -> Iterator[str]:
    """Files below an entry of the navigation."""
    for inner in entry.values() if isinstance(entry, dict) else entry if isinstance(entry, list) else ():
        yield from pages_of(inner)
    if isinstance(entry, str):
        yield entry


def test_pages_are_few_and_none_is_long(root: Path):
    words = {page.name: by_hand(page) for page in (root / "docs").glob("*.md")}
    assert 40 < len(words) <= MAX_PAGES
    assert {name: count for name, count in words.items() if count > MAX_WORDS} == {}


def how_tos(root: Path) -> list[str]:
    nav = yaml.safe_load((root / "mkdocs.yml").read_text())["nav"]
    (section,) = (entry["How to"] for entry in nav if "How to" in entry)
    return list(pages_of(section))


def test_every_how_to_begins_with_its_question(root: Path):
    names = how_tos(root)
    assert len(names) > 15
    for name in names:
        text = (root / "docs" / name).read_text()
        first = text.split("\n\n")[1]
        assert first.startswith("*") and first.endswith("?*"), f"{name} begins with: {first}"


@pytest.mark.parametrize(("text", "words"), [("a b c", 3), (f"a b\n{WRITTEN}make x -->\nc d", 2)])
def test_what_a_command_writes_does_not_count(tmp_path: Path, text: str, words: int):
    page = tmp_path / "page.md"
    page.write_text(text)
    assert by_hand(page) == words
