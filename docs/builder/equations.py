"""Equations in Markdown, as GitHub writes them, to MathML: browsers show it without a script.

A block is fenced by ```math, and may end in a number for the margin, \\tag{13}; inside a line it is $`x`$.
"""

import re
from html import escape
from xml.etree.ElementTree import Element

from latex2mathml.converter import convert
from markdown import Markdown
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor
from markdown.preprocessors import Preprocessor

BLOCK = re.compile(r"^```math\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INLINE = r"\$`([^`]+)`\$"
TAG = re.compile(r"\\tag\{([^}]*)\}")
# before fenced code (25) and before code in backticks (190), which would take the same characters
BEFORE_FENCES, BEFORE_BACKTICKS = 30, 195


def block_of(latex: str) -> str:
    """HTML of one equation on a line of its own, its number at the right."""
    number = "".join(f'<span class="number">({escape(found)})</span>' for found in TAG.findall(latex))
    return f'<div class="equation">{convert(TAG.sub("", latex).strip(), display="block")}{number}</div>'


class _Blocks(Preprocessor):
    def run(self, lines: list[str]) -> list[str]:
        def stored(found: re.Match[str]) -> str:
            return f"\n\n{self.md.htmlStash.store(block_of(found[1]))}\n\n"

        return BLOCK.sub(stored, "\n".join(lines)).split("\n")


class _Inline(InlineProcessor):
    def handleMatch(self, m: re.Match[str], data: str) -> tuple[Element | str | None, int | None, int | None]:
        return self.md.htmlStash.store(convert(m[1])), m.start(0), m.end(0)


class Equations(Extension):
    """Markdown extension: see the module."""

    def extendMarkdown(self, md: Markdown) -> None:
        md.preprocessors.register(_Blocks(md), "equations", BEFORE_FENCES)
        md.inlinePatterns.register(_Inline(INLINE, md), "equation", BEFORE_BACKTICKS)
