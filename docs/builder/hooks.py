"""Where mkdocs calls: the site's own extension of Markdown, generated pages, links (mkdocs.org, "hooks")."""

import json
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from docs.builder.equations import Equations
from docs.builder.redirects import MOVED_PAGES, redirect_page
from docs.builder.repository import SHELF, Repository
from validation.survey import page_text

KEYS = "keys.md"
SURVEY_DATA = "compatibility.json"
SURVEY_PAGE = "compatibility.md"
"""Page of the site that is generated from the data of the survey of FMUs; docs/ has only the data."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Let Markdown know equations."""
    config.markdown_extensions.append(Equations())  # type: ignore[arg-type]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of files outside docs/, and the results of the survey of FMUs."""
    for page, markdown in _repository(config).pages().items():
        files.append(File.generated(config, page, content=markdown))
    facts = json.loads((Path(config.docs_dir) / SURVEY_DATA).read_text(encoding="utf-8"))
    files.append(File.generated(config, SURVEY_PAGE, content=page_text(facts)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links out of docs/ to those pages, in which nobody searches for words."""
    if page.file.src_uri.startswith(f"{SHELF}/"):
        page.meta["search"] = {"exclude": True}
    markdown = markdown.replace(f"({SURVEY_DATA})", f"({SURVEY_PAGE})")
    return _repository(config).linked(page.file.src_uri, markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Mark the tables of keys, whose rows a narrow screen shows as blocks (site.css)."""
    return html.replace("<table>", "<table data-keys>") if page.file.src_uri == KEYS else html


def on_post_build(config: MkDocsConfig) -> None:
    """Write a redirect for the old address of each page that was merged into another one."""
    site = Path(config.site_dir)
    for page in {key.partition("#")[0] for key in MOVED_PAGES}:
        (site / f"{page}.html").write_text(redirect_page(page, site), encoding="utf-8")


def _repository(config: MkDocsConfig) -> Repository:
    return Repository(Path(config.config_file_path).parent)
