"""What things are called, and how docstrings say what they take."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

Documented = ast.FunctionDef | ast.ClassDef
SECTION = re.compile(r"\n( *)(?:Args|Attributes):\n((?:\1 +.*(?:\n|$))*)")
ANOTHER = re.compile(r"[.;] (\w+): ")
"""Within a line: the name of one more argument."""


def modules(root: Path) -> Iterator[tuple[str, ast.Module]]:
    for path in sorted((root / "twin").rglob("*.py")):
        name = ".".join(path.relative_to(root).with_suffix("").parts)
        yield name.removesuffix(".__init__"), ast.parse(path.read_text())


def arguments(node: Documented) -> set[str]:
    """Of a function; of a class its fields, and with what it is made."""
    if isinstance(node, ast.FunctionDef):
        return {one.arg for one in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)}
    fields = {one.target.id for one in node.body if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)}
    made = [one for one in node.body if isinstance(one, ast.FunctionDef) and one.name == "__init__"]
    return fields.union(*map(arguments, made))


def packed(node: Documented) -> Iterator[str]:
    """Arguments of which the docstring tells in the line of another one."""
    for _, items in SECTION.findall(f"{ast.get_docstring(node, clean=False) or ''}\n"):
        for line in items.splitlines():
            yield from (name for name in ANOTHER.findall(line) if name in arguments(node))


def test_an_argument_in_the_line_of_another_one_is_noticed():
    (node,) = ast.parse('def f(a, b):\n    """Do.\n\n    Args:\n        a: one. b: two: three.\n    """\n').body
    assert isinstance(node, ast.FunctionDef)
    assert list(packed(node)) == ["b"]


def test_every_argument_has_a_line_of_its_own(root: Path):
    found = [
        f"{module}: {node.name}: {name}"
        for module, tree in modules(root)
        for node in ast.walk(tree)
        if isinstance(node, Documented)
        for name in packed(node)
    ]
    assert not found


PRIVATE = re.compile(r"\b(told|whoever|nobody|of another make|they part)\b", re.IGNORECASE)
"""Words that a reader of the field stumbles over."""


def prose(page: Path) -> Iterator[str]:
    """Lines of a page but its fenced blocks and what a command writes."""
    fenced = False
    for line in page.read_text().partition("<!-- from here on written by ")[0].splitlines():
        fenced ^= line.startswith("```")
        if not fenced:
            yield line


def test_pages_use_the_words_of_the_field(root: Path):
    pages = [*(root / "docs").glob("*.md"), *(root / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"))]
    found = [f"{page.name}: {line}" for page in pages for line in prose(page) if PRIVATE.search(line)]
    assert len(pages) > 40
    assert not found


def test_a_private_word_in_prose_is_noticed_and_one_that_a_program_prints_is_not(tmp_path: Path):
    page = tmp_path / "page.md"
    page.write_text("It is Told.\n```text\nnobody\n```\n")
    assert [line for line in prose(page) if PRIVATE.search(line)] == ["It is Told."]


NO_WORD = re.compile(r"(?<![a-z])(told|whoever|nobody|of another make)(?![a-z])", re.IGNORECASE)
"""In no name, docstring, comment or message of the program; an underscore separates words."""

NO_NAME = re.compile(r"(^|_)(kept|said|what_is)(_|$)", re.IGNORECASE)
"""In no name: participles and a question name no value."""


def names(tree: ast.AST) -> Iterator[str]:
    """What a module gives a name to: functions, classes, arguments, variables, attributes."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr
        elif isinstance(node, ast.alias) and node.asname:
            yield node.asname


def test_the_program_uses_the_words_of_the_field(root: Path):
    files = [
        path
        for folder in ("twin", "fmus", "experiments", "examples", "benchmarks", "validation")
        for suffix in ("py", "c", "h", "js", "css", "toml", "md")
        for path in (root / folder).rglob(f"*.{suffix}")
    ]
    found = [
        f"{path.relative_to(root)}:{number}: {line.strip()}"
        for path in files
        for number, line in enumerate(path.read_text().splitlines(), start=1)
        if NO_WORD.search(line)
    ]
    assert len(files) > 300
    assert not found


def test_names_are_nouns_and_verbs_of_the_field(root: Path):
    assert not [f"{module}: {name}" for module, tree in modules(root) for name in names(tree) if NO_NAME.search(name)]


def test_a_private_word_in_a_name_or_a_message_is_noticed():
    assert all(map(NO_WORD.search, ("told", "as_told", "NOBODY", "Told of", "nobody's", "whoever asks")))
    assert not any(map(NO_WORD.search, ("extolled", "retold", "unit")))
    tree = ast.parse(
        "class Kept: ...\nkept_rows = 1\ndef said(what_is): self._kept = 2\nfrom a import b as said\nup = 1"
    )
    assert [name for name in names(tree) if not NO_NAME.search(name)] == ["up"]
    assert {name for name in names(tree) if NO_NAME.search(name)} == {"Kept", "kept_rows", "said", "what_is", "_kept"}


def test_a_class_name_has_one_meaning(root: Path):
    homes: dict[str, list[str]] = defaultdict(list)
    for module, tree in modules(root):
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                homes[node.name].append(module)
    assert len(homes) > 300
    assert not {name: found for name, found in homes.items() if len(found) > 1}
