"""Share of sentences in docstrings, attribute docs and comments that use constructions foreign to the field.

The same markers find 1.7 % in SciPy (integrate, signal, optimize), 2.3 % in python-control, 3.1 % in diffrax.
"""

import ast
import inspect
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

MARKERS = {
    "begins with 'Of'": r"^(?:[\w, *]+: )?Of\b|^[a-z_, *]+: (?:of|as of)\b",
    "begins with 'what'": r"^(?:[\w, *]+: )?[Ww]hat\b",
    "'what' as a noun": r"\bwhat\b|^What\b",
    "preposition and 'which'": r"\b(?:of|from|by|with|in|to|on|for|at|behind) which\b",
    "'those of', 'that of'": r"\b[Tt]h(?:ose|at) of\b|\b[Tt]hose (?:that|who|which)\b",
    "'none'": r"\bnone\b",
    "'is no'": r"\b(?:is|are|was|be) no\b",
    "persons": r"\b(?:[Nn]obody|[Ss]omebody|[Ww]hoever|anybody)\b|(?:^|[:;,.] |for |by |of |to )who ",
    "'go on', 'anew', 'besides'": r"\b(?:go|goes|going|went|gone) on\b|\banew\b|\bbesides\b",
    "say, tell": r"\b(?:said|says|told|tells)\b",
}
ANY_MARKER = re.compile("|".join(f"(?:{pattern})" for pattern in MARKERS.values()))
ABBREVIATION = re.compile(r"(Eqs?|Sec|Figs?|e\.g|i\.e|cf|vs|No|etc|Ref|approx|pp?)\.$")
SECTION = re.compile(r"^(Args|Attributes|Returns|Raises|Yields|Examples?|Notes?):\s*$")


def marked_sentences(path: Path) -> tuple[int, list[tuple[int, str]]]:
    """Number of sentences in a Python file, and line and text of the marked ones."""
    count, marked = 0, []
    for line, text, is_comment in texts(path.read_text("utf-8")):
        for sentence in sentences(text, is_comment):
            count += 1
            if ANY_MARKER.search(sentence):
                marked.append((line, sentence))
    return count, marked


def texts(source: str) -> Iterator[tuple[int, str, bool]]:
    """Yield line, text and whether it is a comment of each docstring, attribute doc and block of comments."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if (text := ast.get_docstring(node, clean=False)) is not None:
            yield node.body[0].lineno, text, False
        for statement, following in zip(node.body, node.body[1:], strict=False):
            if not isinstance(statement, ast.Assign | ast.AnnAssign) or not isinstance(following, ast.Expr):
                continue
            if isinstance(following.value, ast.Constant) and isinstance(following.value.value, str):
                yield following.lineno, following.value.value, False
    yield from _comment_blocks(source)


def _comment_blocks(source: str) -> Iterator[tuple[int, str, bool]]:
    block: list[str] = []
    first, last = 0, (-2, -1)
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT:
            continue
        row, column = token.start
        if (row - 1, column) != last and block:
            yield first, " ".join(block), True
            block = []
        first = first if block else row
        block.append(token.string.lstrip("# "))
        last = (row, column)
    if block:
        yield first, " ".join(block), True


def sentences(text: str, is_comment: bool) -> list[str]:
    """Split a text into sentences of three words or more; each entry of a section such as Args begins a new one."""
    found = []
    for paragraph in _paragraphs([text] if is_comment else inspect.cleandoc(text).split("\n")):
        sentence = ""
        for piece in re.split(r"(?<=[.!?])\s+", " ".join(paragraph.split())):
            sentence = f"{sentence} {piece}".strip()
            if not ABBREVIATION.search(sentence):
                found.append(sentence)
                sentence = ""
    # names of code are not prose
    return [re.sub(r"`[^`]*`", "`x`", one) for one in found if len(one.split()) > 2]


def _paragraphs(lines: list[str]) -> Iterator[str]:
    current: list[str] = []
    in_section = False
    for line in [*lines, ""]:
        is_header = bool(SECTION.match(line))
        starts = not line.strip() or is_header or (in_section and re.match(r"^ {4}\S", line))
        if (starts or re.match(r"^\s*([-*]|\d\.) ", line)) and current:
            yield " ".join(current)
            current = []
        in_section = is_header or (in_section and not re.match(r"^\S", line))
        if line.strip() and not is_header:
            current.append(line)
