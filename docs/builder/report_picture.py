"""docs/report.png: the first screen of a report, at 12 s. `python docs/builder/report_picture.py REPORT PICTURE`.

Needs playwright and Chromium, as the tests in tests/browser do.
"""

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

SCREEN = {"width": 1280, "height": 860}
SECONDS = 12


def main() -> None:
    """Open the page, go to the moment, take the picture."""
    report, picture = map(Path, sys.argv[1:])
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport=SCREEN, color_scheme="light")
        page.goto(report.resolve().as_uri())
        page.wait_for_selector("#replay.ready")
        slider = page.locator(".line input")
        slider.evaluate(
            "(slider, t) => { slider.value = t; slider.dispatchEvent(new Event('input', {bubbles: true})); }", SECONDS
        )
        # plots below the first ones are drawn a moment later
        page.wait_for_timeout(500)
        page.screenshot(path=picture)
        browser.close()


if __name__ == "__main__":
    main()
