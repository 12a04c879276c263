"""The seven questions are the same on every page, and their commands print the answers of docs/seven_questions.md."""

import re
import shlex
from itertools import pairwise
from pathlib import Path

import pytest

from tests.docs.code_blocks import Block, blocks
from tests.docs.workshop import Workshop

PAGE = "docs/seven_questions.md"


def listed(page: Path) -> list[str]:
    """Questions in the first column of the table of a page."""
    table = page.read_text().partition("\n## Seven questions")[2].partition("\n\n|")[2].partition("\n\n")[0]
    return [line.strip("|").split("|")[0].strip() for line in table.splitlines()[2:]]


def answers(root: Path, is_slow: bool) -> list[tuple[Block, Block]]:
    """Blocks of commands with the excerpt of their output that follows."""
    pairs = [(one, next_one) for one, next_one in pairwise(blocks(root, PAGE)) if one.language == "sh"]
    assert all(printed.language == "text" for _, printed in pairs)
    return [pair for pair in pairs if (pair[0].remark == "slow") is is_slow]


def print_answers(workshop: Workshop, pairs: list[tuple[Block, Block]]) -> None:
    for block, printed in pairs:
        text = "".join(workshop.twin(*shlex.split(command)[1:]) for command, _ in block.commands)
        lines = [line for line in printed.text.splitlines() if line not in text.splitlines()]
        assert not lines, f"{block.place}: not printed: {lines}\n{text}"


def test_the_questions_are_seven_and_the_same_on_every_page(root: Path):
    asked = re.findall(r"^\*\*(.+\?)\*\*", (root / PAGE).read_text(), re.MULTILINE)
    assert len(asked) == 7
    assert listed(root / "README.md") == listed(root / "docs" / "index.md") == asked


@pytest.mark.slow
def test_the_commands_print_their_answers(root: Path, tmp_path: Path):
    print_answers(Workshop(root, tmp_path), answers(root, is_slow=False))


@pytest.mark.endurance
def test_the_slow_commands_print_their_answers(root: Path, tmp_path: Path):
    print_answers(Workshop(root, tmp_path), answers(root, is_slow=True))
