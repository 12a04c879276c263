"""Where mkdocs calls: the site's own extension of Markdown, generated pages, links (mkdocs.org, "hooks")."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pygments.formatters import HtmlFormatter

from docs.builder.equations import Equations
from docs.builder.repository import Repository


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Let Markdown know equations."""
    config.markdown_extensions.append(Equations())  # type: ignore[arg-type]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of files outside docs/, and the colours of code."""
    for page, markdown in _repository(config).pages().items():
        files.append(File.generated(config, page, content=markdown))
    files.append(File.generated(config, "css/code.css", content=_colours()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links out of docs/ to those pages."""
    return _repository(config).linked(page.file.src_uri, markdown)


def _repository(config: MkDocsConfig) -> Repository:
    return Repository(Path(config.config_file_path).parent)


def _colours() -> str:
    light = HtmlFormatter(style="default").get_style_defs(".codehilite")
    dark = HtmlFormatter(style="github-dark").get_style_defs(".codehilite")
    return f"{light}\n@media (prefers-color-scheme: dark) {{\n{dark}\n}}\n"
