"""Docstrings and comments of the program read as those of the field."""

import re
from collections import defaultdict
from pathlib import Path

import pytest

from tests.docs.prose import MARKERS, marked_sentences, sentences

LIMIT = 0.05
"""Largest share of marked sentences, in all and in each room of `MIN_SENTENCES` or more."""
MIN_SENTENCES = 100


def test_few_sentences_of_any_room_are_foreign_to_the_field(root: Path):
    count: dict[str, int] = defaultdict(int)
    marked: dict[str, list[str]] = defaultdict(list)
    for path in sorted((root / "twin").rglob("*.py")):
        parts = path.relative_to(root / "twin").parts
        number, found = marked_sentences(path)
        count[parts[0]] += number
        marked[parts[0]] += [f"{path.relative_to(root)}:{line}: {sentence}" for line, sentence in found]
    assert sum(count.values()) > 5_000
    assert sum(map(len, marked.values())) <= LIMIT * sum(count.values())
    for room, number in count.items():
        assert number < MIN_SENTENCES or len(marked[room]) <= LIMIT * number, "\n".join(marked[room])


@pytest.mark.parametrize(
    ("sentence", "kind"),
    [
        ("Of the file's bytes, in hexadecimal.", "begins with 'Of'"),
        ("columns: of each signal.", "begins with 'Of'"),
        ("Return what was found.", "'what' as a noun"),
        ("The value from which it starts.", "preposition and 'which'"),
        ("Values beside those of the run.", "'those of', 'that of'"),
        ("A limit; none for a log.", "'none'"),
        ("There is no such file.", "'is no'"),
        ("Called by whoever reads it.", "persons"),
        ("The run goes on here.", "'go on', 'anew', 'besides'"),
        ("The file says so.", "say, tell"),
    ],
)
def test_a_foreign_construction_is_noticed(tmp_path: Path, sentence: str, kind: str):
    path = tmp_path / "module.py"
    path.write_text(f'"""{sentence}\n\nReturn the SHA-256 of a file as hex.\n"""\n')
    assert marked_sentences(path) == (2, [(1, sentence)])
    assert [name for name, pattern in MARKERS.items() if re.search(pattern, sentence)] == [kind]


def test_sentences_are_those_of_docstrings_attributes_arguments_and_comments(tmp_path: Path):
    path = tmp_path / "module.py"
    text = 'A = 1\n"""Maximum (N), see Eq. 3."""\n\n\ndef f(a, b):\n    """Add two numbers.\n\n    Args:\n'
    text += '        a: a first number.\n        b: a second one.\n    """\n    # a comment of\n    # two lines\n'
    path.write_text(text)
    assert marked_sentences(path) == (5, [])
    assert sentences("Read `what` and write it.", False) == ["Read `x` and write it."]
