"""The page of a sweep in a real browser: it loads nothing, says nothing, and fits a phone in light and dark."""

from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from playwright.sync_api import Browser

from tests.studies.sweep.statistics.rows import kept, row
from twin.report.page.plain import write_sweep_page
from twin.studies.sweep.show.parts import SweepQuery
from twin.studies.sweep.show.pictures import write_pictures

pytestmark = pytest.mark.slow

ASKED = SweepQuery("force_error_N", "lateral_error_mm", 5)


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweep")
    rng = np.random.default_rng(0)
    rows = [
        row(n, {f"plant.parameter_{i}": rng.random() for i in range(8)}, "ab"[n % 2],
            force_error_N=rng.random(), lateral_error_mm=rng.random())
        for n in range(40)
    ]  # fmt: skip
    sweep = kept(rows)
    return write_sweep_page(sweep, ASKED, write_pictures(sweep, ASKED, None, None, folder), folder)


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_it_loads_nothing_says_nothing_and_does_not_scroll_sideways(
    browser: Browser, page_file: Path, width: int, scheme: Literal["light", "dark"]
):
    page = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme)
    messages: list[str] = []
    requests: list[str] = []
    page.on("console", lambda message: messages.append(message.text))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(page_file.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate("[...document.images].every(image => image.naturalWidth > 0)")
    background = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert background == ("rgb(255, 255, 255)" if scheme == "light" else "rgb(20, 22, 26)")
    assert [url for url in requests if not url.startswith("data:")] == [page_file.as_uri()] and messages == []
    page.close()
