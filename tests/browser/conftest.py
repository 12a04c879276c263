"""A real Chromium, without a screen."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

from twin.kernel.recording.reader import Recording
from twin.report.page.page import write_report

# on a busy machine an answer may take longer than the 5 s of playwright
expect.set_options(timeout=30_000)

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    """Debian's Chromium; locally tests are skipped without it, in CI they fail."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        told = f"no {', '.join(PROGRAMS)} on this machine; install Debian's package chromium"
        if "CI" in os.environ:
            pytest.fail(told)
        pytest.skip(told)
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture(scope="package")
def one_run(force_position: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report on the force-position run of Fig. 4."""
    return Path(write_report([force_position.path], tmp_path_factory.mktemp("one") / "report.html").facts["page"])


@pytest.fixture(scope="package")
def two_runs(force_position: Recording, position: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report on both runs of Fig. 4."""
    paths = [force_position.path, position.path]
    return Path(write_report(paths, tmp_path_factory.mktemp("two") / "report.html").facts["page"])


class Opened:
    """A report in the browser.

    Attributes:
        page: playwright's. messages: what the console said. requests: what it loaded besides the file itself.
    """

    def __init__(self, page: Page, path: Path):
        self.page = page
        self.messages: list[str] = []
        self.requests: list[str] = []
        page.on("console", lambda message: self.messages.append(message.text))
        page.on("pageerror", lambda error: self.messages.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_selector("#replay.ready")
        self.requests = [url for url in self.requests if not url.startswith(("data:", path.as_uri()))]

    def go(self, time: str) -> None:
        """Move the time line, with the plots in sight."""
        self.page.locator("#plots").scroll_into_view_if_needed()
        self.settle()
        self.page.fill("#time", time)
        self.settle()

    def wait_for_span(self, start: str, end: str) -> None:
        """Wait until a plot shows the times from `start` to `end`."""
        self.page.locator(f".stage[data-from='{start}'][data-to='{end}']").first.wait_for()

    def time(self) -> float:
        """Of the player."""
        return float(self.page.input_value("#time"))

    def settle(self) -> None:
        """Let what has been asked for be drawn."""
        self.page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


@pytest.fixture
def opened(browser: Browser, one_run: Path) -> Iterator[Opened]:
    """The report on one run, on a desktop."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    yield Opened(page, one_run)
    page.close()
