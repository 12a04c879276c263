"""Equations on the pages: MathML, without a script."""

import re
from itertools import pairwise
from pathlib import Path

import pytest
from markdown import markdown

from docs.builder.equations import BLOCK, INLINE, TAG, Equations, block_of
from tests.docs.code_blocks import Block, blocks

PAGE = "docs/equations.md"
NUMBERS = ("3-6", "7, 8", "11, 12", "14, 15", "16, 17", "18, 20", "19", "25", "26, 27", *(f"P{n}" for n in (1, 5, 7)))
COMPUTED = re.compile(r"# \(([^)]+)\)")
"""How a line of the page's Python names the equation that it computes."""


def html(text: str) -> str:
    return markdown(text, extensions=["tables", "fenced_code", Equations()])


def test_a_block_is_mathml_with_its_number_beside_it():
    found = html("before\n\n```math\na = \\frac{b}{c} \\tag{P7}\n```\n\nafter")
    assert '<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">' in found
    assert "<mfrac>" in found
    assert '<span class="number">(P7)</span></div>' in found
    assert "tag" not in found


def test_an_equation_in_a_line_is_mathml_and_its_underscores_are_no_emphasis():
    found = html("torque $`\\tau_l`$ and $`\\tau_m`$")
    assert found.count("<math") == 2
    assert "<em>" not in found


def test_a_table_keeps_the_bars_of_an_equation():
    assert html("| a | b |\n|---|---|\n| $`|x|`$ | y |").count("<td>") == 2


def test_code_is_left_alone():
    assert "<math" not in html("```text\n$`x`$\n```")


@pytest.mark.parametrize("number", NUMBERS)
def test_the_page_has_the_equation(root: Path, number: str):
    assert f"\\tag{{{number}}}" in (root / "docs" / "equations.md").read_text()


def test_every_command_of_every_equation_is_understood(root: Path):
    for page in (root / "docs").glob("*.md"):
        text = page.read_text()
        latex = BLOCK.findall(text) + re.findall(INLINE, text)
        assert [source for source in latex if "\\" in re.sub(r"<[^>]*>", "", block_of(source))] == []


def uncomputed(page: list[Block]) -> list[str]:
    """Equations that the Python before the next equations does not compute, and those without a number."""
    missing, waiting = [], []
    for block, after in pairwise([*page, None]):
        assert block is not None
        if block.language == "math":
            waiting += TAG.findall(block.text) or [f"line {block.line} has no number"]
        elif block.language == "python":
            waiting = [number for number in waiting if number not in COMPUTED.findall(block.text)]
            if after is None or after.language == "math":
                missing += waiting
                waiting = []
    return [*missing, *waiting]


def test_each_equation_of_the_page_is_computed_by_the_pages_own_code(root: Path):
    assert uncomputed(blocks(root, PAGE)) == []


def test_an_equation_without_a_number_and_one_that_is_not_computed_are_found():
    def block(language: str, text: str) -> Block:
        return Block(PAGE, 7, language, text, "")

    page = [block("math", "a \\tag{P7}"), block("math", "b"), block("python", "assert c  # (P8)")]
    assert uncomputed(page) == ["P7", "line 7 has no number"]
    assert uncomputed([block("math", "a \\tag{P8}"), *page[2:], block("math", "b \\tag{P8}")]) == ["P8"]
