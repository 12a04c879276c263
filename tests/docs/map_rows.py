"""The studies and their commands in docs/how_it_works.md, written of the files; `python -m tests.docs.map_rows`."""

import ast
import re

from tests.conftest import ROOT
from twin.cli.catalogue import command_texts

PAGE = ROOT / "docs/how_it_works.md"
HEAD = "| study | commands | about |\n|---|---|---|\n"
TABLE = re.compile(re.escape(HEAD) + r"(\|.*\n)*")


def rows() -> dict[str, tuple[str, str]]:
    """Commands, and what it is about, of each study; those of files follow folders, those of twin/cli come last."""
    commands: dict[str, list[str]] = {}
    for words, one in command_texts().items():
        _, package, place, *_ = one.module.split(".")
        commands.setdefault(place if package == "studies" else "cli", []).append(f"`{words}`")
    studies = ROOT / "twin/studies"
    files = {file.parent.name: file for file in sorted(studies.glob("*/__init__.py"))}
    files |= {name: studies / f"{name}.py" for name in commands if (studies / f"{name}.py").exists()}
    files |= {"cli": ROOT / "twin/cli/__init__.py"}
    return {name: (", ".join(commands.get(name, ())), _about(file.read_text())) for name, file in files.items()}


def completed(page: str) -> str:
    """The text of `page` with the table as it is to be."""
    lines = [f"| `{name}` | {commands} | {about} |\n" for name, (commands, about) in rows().items()]
    return TABLE.sub(lambda found: HEAD + "".join(lines), page)


def _about(source: str) -> str:
    """The first paragraph of a module's docstring, as the end of a row."""
    text = " ".join((ast.get_docstring(ast.parse(source)) or "").partition("\n\n")[0].split()).rstrip(".")
    return text[:1].lower() + text[1:]


if __name__ == "__main__":
    PAGE.write_text(completed(PAGE.read_text()))
