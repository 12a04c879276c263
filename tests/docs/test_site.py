"""The site is built without a warning, holds every page, and loads nothing from anywhere else."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
import yaml
from playwright.sync_api import sync_playwright

from docs.builder.hooks import SURVEY_PAGE
from docs.builder.redirects import MOVED_PAGES, redirect_page
from docs.builder.repository import Repository

LEFT_OVER = re.compile(r"^(?:<p>)?(?:[-*] |\d+\. |\|[ -]).*$|\$<|<code>(?:sh|python|toml|text)$", re.MULTILINE)


@pytest.fixture(scope="module")
def site(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    # the theme advertises its successor in the build
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return folder


def test_every_page_of_docs_is_in_the_navigation(root: Path):
    def named(entries: list) -> Iterator[str]:
        for entry in entries:
            (value,) = entry.values()
            yield from [value] if isinstance(value, str) else named(value)

    nav = yaml.safe_load((root / "mkdocs.yml").read_text())["nav"]
    pages = [*(path.name for path in (root / "docs").glob("*.md")), SURVEY_PAGE]
    assert sorted(named(nav)) == sorted(pages)


@pytest.mark.slow
def test_nothing_is_loaded_from_elsewhere(site: Path):
    assert {(page.name, url) for page, url in _loaded(site) if urlsplit(url).scheme or url.startswith("//")} == set()


@pytest.mark.slow
def test_everything_that_is_loaded_is_there(site: Path):
    missing = {
        (page.name, url)
        for page, url in _loaded(site)
        if page.name != "404.html" and not (page.parent / unquote(urlsplit(url).path)).exists()
    }
    assert missing == set()


@pytest.mark.slow
def test_every_link_leads_to_a_place_of_the_site(site: Path):
    pages = {page: _Page(page.read_text()) for page in site.rglob("*.html") if page.name != "404.html"}
    broken = []
    for page, found in pages.items():
        for url in found.links:
            parts = urlsplit(url)
            if parts.scheme or url == "#":
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            wanted = unquote(parts.fragment)
            target = target / "index.html" if target.is_dir() else target
            if not target.exists() or (wanted and target in pages and wanted not in pages[target].ids):
                broken.append((page.name, url))
    assert broken == []


def test_a_page_that_moved_has_no_file_and_a_section_of_its_new_page(root: Path):
    docs = root / "docs"
    for key, target in MOVED_PAGES.items():
        page, _, moved_id = key.partition("#")
        text = (docs / f"{target}.md").read_text()
        assert not (docs / f"{page}.md").exists(), page
        assert f"{{#{moved_id or page}}}" in text, key


def test_no_link_of_a_page_leads_to_a_page_that_moved(root: Path):
    old = "|".join(key for key in MOVED_PAGES if "#" not in key)
    link = re.compile(rf"\]\((?:docs/|(?:\.\./)+docs/)?(?:{old})\.md\b")
    pages = [*(root / "docs").glob("*.md"), *root.glob("*.md"), *(root / "fmus").rglob("*.md")]
    assert len(pages) > 40
    assert [page.name for page in pages if link.search(page.read_text())] == []


def test_a_redirect_leads_to_the_id_that_was_asked_for_or_to_the_section(tmp_path: Path):
    ids = ("sweep", "cluster", "security", "cluster-when-something-goes-wrong", "when-something-goes-wrong")
    (tmp_path / "sweep.html").write_text("".join(f'<h2 id="{name}">' for name in ids))
    html = redirect_page("cluster", tmp_path)
    (places,) = re.findall(r"const places = (.*);", html)
    found = json.loads(places)
    assert found["security"] == "sweep.html#security"
    assert found["when-something-goes-wrong"] == "sweep.html#cluster-when-something-goes-wrong"
    assert ': "sweep.html#cluster")' in html


@pytest.mark.slow
def test_an_old_address_leads_to_the_section_that_has_its_text(site: Path):
    for key in MOVED_PAGES:
        page, _, moved_id = key.partition("#")
        html = (site / f"{page}.html").read_text()
        assert not moved_id or f'"{moved_id}": "{MOVED_PAGES[key]}.html#{moved_id}"' in html
    assert not any(f'"location":"{key}.html' in (site / "search/search_index.js").read_text() for key in MOVED_PAGES)


@pytest.mark.slow
def test_a_link_into_the_code_shows_the_code(site: Path, root: Path):
    page = (site / "repository" / "twin" / "robot" / "mechanism" / "statics.py.html").read_text()
    text = re.sub(r"<[^>]+>", "", page)
    assert "def dead_zone(d, half_width):" in text
    assert 'href="repository/twin/robot/mechanism/statics.py.html"' in (site / "physics.html").read_text()


@pytest.mark.slow
def test_the_search_needs_no_server_and_looks_into_no_code(site: Path):
    index = (site / "search/search_index.js").read_text()
    assert index.startswith("var __index = {") and '"location":"tutorial.html' in index
    assert '"location":"repository/' not in index
    assert 'src="js/iframe-worker.js"' in (site / "index.html").read_text()


@pytest.mark.endurance
def test_a_word_is_found_in_a_site_that_is_opened_from_the_disk(site: Path):
    program = shutil.which("chromium")
    if program is None:
        pytest.skip("no chromium on this machine")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        page, asked = browser.new_page(), list[str]()
        page.on("request", lambda request: asked.append(request.url))
        page.goto((site / "index.html").as_uri())
        page.click(".md-search__input")
        page.keyboard.type("backlash", delay=30)
        page.wait_for_selector(".md-search-result__link")
        assert [url for url in asked if not url.startswith("file:")] == []
        browser.close()


@pytest.mark.slow
def test_no_markdown_is_left_over_in_a_page(site: Path):
    # what mkdocs does not know as a list, a table, an equation or a block it shows as it is written
    left = {
        (page.name, found)
        for page in site.glob("*.html")
        for found in LEFT_OVER.findall(re.sub(r"<pre.*?</pre>", "", page.read_text(), flags=re.DOTALL))
    }
    assert left == set()


def test_links_are_followed_from_page_to_page(tmp_path: Path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "parts").mkdir()
    (tmp_path / "docs" / "a.md").write_text("[parts](../parts/README.md) and [b](b.md#top) and [net](https://x.org)")
    (tmp_path / "docs" / "b.md").write_text("")
    (tmp_path / "parts" / "README.md").write_text("[code](part.py), [back](../docs/a.md)")
    (tmp_path / "ABOUT.md").write_text("[a](docs/a.md), [code](parts/part.py)")
    (tmp_path / "parts" / "part.py").write_text("x = 1\n")
    repository = Repository(tmp_path)
    assert set(repository.pages()) == {"repository/parts/README.md", "repository/parts/part.py.md"}
    assert repository.linked("a.md", (tmp_path / "docs" / "a.md").read_text()) == (
        "[parts](repository/parts/README.md) and [b](b.md#top) and [net](https://x.org)"
    )
    assert repository.linked("repository/parts/README.md", (tmp_path / "parts" / "README.md").read_text()) == (
        "[code](part.py.md), [back](../../a.md)"
    )
    assert repository.linked("repository/ABOUT.md", (tmp_path / "ABOUT.md").read_text()) == (
        "[a](../a.md), [code](parts/part.py.md)"
    )


class _Page(HTMLParser):
    """What an HTML page loads, where it leads, and what can be led to."""

    def __init__(self, html: str):
        super().__init__()
        self.loaded: list[str] = []
        self.links: list[str] = []
        self.ids: set[str] = set()
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        said = {name: value or "" for name, value in attrs}
        self.ids.add(said.get("id", ""))
        if tag == "a" and "href" in said:
            self.links.append(said["href"])
        elif tag == "link" and said.get("rel") not in ("canonical", "next", "prev"):
            self.loaded.append(said["href"])
        elif "src" in said:
            self.loaded.append(said["src"])


def _loaded(site: Path) -> Iterator[tuple[Path, str]]:
    """(page, address) of everything that a page or a style sheet of the site loads."""
    for page in site.rglob("*.html"):
        yield from ((page, url) for url in _Page(page.read_text()).loaded)
    for sheet in site.rglob("*.css"):
        # what is written into the sheet itself is not loaded
        addresses = re.findall(r"url\(['\"]?(?!data:)([^'\")]+)|@import ['\"]([^'\"]+)", sheet.read_text())
        yield from ((sheet, url or imported) for url, imported in addresses)
