"""The report page: how long it takes to write, how large it is, how soon a browser has it ready."""

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from benchmarks.measurement import Measurement

ROUNDS = 5
MANY = 10
BROWSER = "chromium"
MEGABYTE = 1e6


def measurements(experiment: Path) -> list[Measurement]:
    """The lines of the table; `experiment` is run once, 20 s at 1 kHz."""
    with tempfile.TemporaryDirectory() as scratch:
        folders = [Path(scratch) / f"run_{number}" for number in range(MANY)]
        _twin("run", experiment, "--out", folders[0])
        for folder in folders[1:]:
            shutil.copytree(folders[0], folder)
        page = Path(scratch) / "report.html"
        many = median(_twin("report", *folders, "--out", page) for _ in range(3))
        size_of_many = page.stat().st_size
        one = median(_twin("report", folders[0], "--out", page) for _ in range(ROUNDS))
        size = page.stat().st_size
        ready, remark = _ready(page)
    return [
        Measurement("report: twin report of one Fig. 4 run", one, "s", at_most=3.0),
        Measurement(f"report: twin report of {MANY} runs", many, "s", at_most=10.0),
        Measurement("report: its size, one run", size / MEGABYTE, "MB", at_most=8.0),
        Measurement(f"report: its size, {MANY} runs", size_of_many / MEGABYTE, "MB"),
        Measurement("report: ready in headless Chromium", ready, "s", at_most=2.0, remark=remark),
    ]


def _twin(*arguments: object) -> float:
    """Wall seconds of a command."""
    began = time.perf_counter()
    subprocess.run([sys.executable, "-m", "twin", *map(str, arguments)], capture_output=True, check=True)
    return time.perf_counter() - began


def _ready(page: Path) -> tuple[float | None, str]:
    """Seconds from the start of loading to plots drawn and player ready; None and why, without a browser."""
    program = shutil.which(BROWSER)
    if program is None:
        return None, f"no {BROWSER} here"
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return None, "playwright is not installed (pip install -e '.[test]')"

    times = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        for _ in range(ROUNDS):
            tab = browser.new_page(viewport={"width": 1280, "height": 900})
            tab.goto(page.as_uri())
            tab.wait_for_selector("#replay.ready")
            tab.wait_for_timeout(100)
            times.append(tab.evaluate("performance.getEntriesByName('twin-ready')[0].startTime") / 1e3)
            tab.close()
        browser.close()
    return median(times), ""
