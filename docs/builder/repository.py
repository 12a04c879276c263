"""Links that lead out of docs/: what they name becomes a page of the site, so that it needs no network.

A Markdown file becomes a page as it is, its own links followed likewise; any other file a page that shows its text.
"""

import re
from pathlib import Path
from posixpath import dirname, join, normpath, relpath

LINK = re.compile(r"(?<!!)\[[^\]]*\]\(([^)#\s:]+)(#[^)\s]*)?\)")
DOCS = "docs"
SHELF = "repository"
"""Folder of the site for what lies outside docs/."""
LANGUAGES = {".py": "python", ".toml": "toml", ".c": "c", ".h": "c", ".mo": "modelica"}


class Repository:
    """The files around docs/.

    Attributes:
        root: the repository.
    """

    def __init__(self, root: Path):
        self.root = root

    def pages(self) -> dict[str, str]:
        """Path in the site -> Markdown, of every file outside docs/ that some page leads to."""
        waiting = [f"{DOCS}/{path.name}" for path in sorted((self.root / DOCS).glob("*.md"))]
        found: dict[str, str] = {}
        # the list grows while it is walked: a Markdown file leads further
        for path in waiting:
            for target in self._targets(path):
                page = self._page(target)
                if not target.startswith(f"{DOCS}/") and page not in found and (self.root / target).is_file():
                    found[page] = self._shown(target)
                    if target.endswith(".md"):
                        waiting.append(target)
        return found

    def linked(self, page: str, markdown: str) -> str:
        """`markdown` of the site's `page` with its links led to the site's pages."""
        home = page.removeprefix(f"{SHELF}/") if page.startswith(f"{SHELF}/") else f"{DOCS}/{page}"
        if not (self.root / home).is_file():
            # a page that shows the text of another file: its brackets are code
            return markdown

        def led(found: re.Match[str]) -> str:
            target = normpath(join(dirname(home), found[1]))
            if not (self.root / target).is_file():
                return found[0]
            return found[0].replace(f"({found[1]}", f"({relpath(self._page(target), dirname(page) or '.')}")

        return LINK.sub(led, markdown)

    def _targets(self, path: str) -> list[str]:
        text = (self.root / path).read_text(encoding="utf-8")
        return [normpath(join(dirname(path), found[1])) for found in LINK.finditer(text)]

    def _page(self, target: str) -> str:
        if target.startswith(f"{DOCS}/"):
            return target.removeprefix(f"{DOCS}/")
        return f"{SHELF}/{target}" if target.endswith(".md") else f"{SHELF}/{target}.md"

    def _shown(self, target: str) -> str:
        text = (self.root / target).read_text(encoding="utf-8")
        if target.endswith(".md"):
            return text
        language = LANGUAGES.get(Path(target).suffix, "text")
        return f"# {Path(target).name}\n\n`{target}`\n\n~~~~{language}\n{text}~~~~\n"
