"""An explorer of Fig. 4, and a browser that may use the clipboard."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, BrowserContext

from tests.browser.explore.explorer import Explorer, Opened


@pytest.fixture(scope="package")
def explorer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Explorer]:
    # other tests have explorers of their own meanwhile
    with Explorer(tmp_path_factory.mktemp("explored"), "fig4_force_position", "--linger-s", "3600") as started:
        yield started


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    made = browser.new_context(viewport={"width": 1400, "height": 900})
    made.grant_permissions(["clipboard-read", "clipboard-write"])
    yield made
    made.close()


@pytest.fixture
def opened(context: BrowserContext, explorer: Explorer) -> Opened:
    return Opened(context.new_page(), explorer.address)
