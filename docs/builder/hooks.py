"""Where mkdocs calls: the site's own extension of Markdown, generated pages, links (mkdocs.org, "hooks")."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from docs.builder.equations import Equations
from docs.builder.repository import SHELF, Repository

KEYS = "keys.md"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Let Markdown know equations."""
    config.markdown_extensions.append(Equations())  # type: ignore[arg-type]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of files outside docs/."""
    for page, markdown in _repository(config).pages().items():
        files.append(File.generated(config, page, content=markdown))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links out of docs/ to those pages, in which nobody searches for words."""
    if page.file.src_uri.startswith(f"{SHELF}/"):
        page.meta["search"] = {"exclude": True}
    return _repository(config).linked(page.file.src_uri, markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Mark the tables of keys, whose rows a narrow screen shows as blocks (site.css)."""
    return html.replace("<table>", "<table data-keys>") if page.file.src_uri == KEYS else html


def _repository(config: MkDocsConfig) -> Repository:
    return Repository(Path(config.config_file_path).parent)
