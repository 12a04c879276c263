"""The fenced blocks of a Markdown page, and what running each of them means.

A comment right above a block changes that: `<!-- slow -->` leaves it to `make endurance`, `<!-- not run: WHY -->` holds
its commands to their options only. A TOML, Python or C block whose first line is a comment with a path, `# experiments/
mine.toml` or `/* fmus/mine/model.c: ...`, is a file of that name for the blocks after it. Text right after commands
that are refused is what they say.
"""

import re
from dataclasses import dataclass
from pathlib import Path

FENCE = re.compile(
    r"(?:<!-- (?P<remark>slow|not run: [^>]+?) -->\n)?"
    r"^(?P<indent> *)(?P<fence>`{3,}|~{3,})(?P<language>[^\n`]*)\n(?P<text>.*?)^(?P=indent)(?P=fence)$",
    re.MULTILINE | re.DOTALL,
)
FILE_NAME = re.compile(r"(?:# (\S+\.(?:toml|py))\n|/\* (\S+\.c):)")
EXPECTED_EXIT = re.compile(r"\s+# exit (\d+)$")
PROSE = ("text", "math", "diff")
"""Fenced, but nothing that could be run: output, pictures made of characters, equations, patches."""


@dataclass(frozen=True)
class Block:
    """One fenced block.

    Attributes:
        page: the file, relative to the repository. line: of its opening fence, from 1.
        language: what stands behind the fence; "" if nothing.
        text: without the fences. remark: of the comment above it, "" without.
    """

    page: str
    line: int
    language: str
    text: str
    remark: str

    @property
    def place(self) -> str:
        return f"{self.page}:{self.line}"

    @property
    def file_name(self) -> str:
        """The name its first line gives it; "" if none."""
        named = FILE_NAME.match(self.text)
        return (named[1] or named[2]) if named else ""

    @property
    def commands(self) -> list[tuple[str, int]]:
        """(command, expected exit code) of a sh block, in order; a line that ends in a backslash goes on."""
        lines = [line for line in self.text.replace("\\\n", " ").splitlines() if line.strip()]
        found = []
        for line in lines:
            expected = EXPECTED_EXIT.search(line)
            found.append((EXPECTED_EXIT.sub("", line), int(expected[1]) if expected else 0))
        return found


def blocks(root: Path, page: str) -> list[Block]:
    """The fenced blocks of `page`, in order."""
    text = (root / page).read_text(encoding="utf-8")
    return [
        Block(
            page,
            1 + text.count("\n", 0, found.start("fence")),
            found["language"].strip(),
            found["text"],
            found["remark"] or "",
        )
        for found in FENCE.finditer(text)
    ]


def pages(root: Path) -> list[str]:
    """The pages whose code is run."""
    return ["README.md", *sorted(f"docs/{path.name}" for path in (root / "docs").glob("*.md"))]
