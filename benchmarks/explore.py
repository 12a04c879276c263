"""The explorer: how soon the picture follows the hand, in headless Chromium; what it costs while nothing moves.

Every value is one that was never asked before. A key moves once per round, so that those that make a new assembly (the
spring, the delay, another drive) come as often as gains.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median, quantiles
from subprocess import DEVNULL, PIPE
from typing import Any

from benchmarks.measurement import Measurement
from twin.kernel.process.process import environment, processor_time, resident_memory

BROWSER = "chromium"
NUMBERS = (
    "robot.k_s_Nm_per_rad",
    "controller.force.kp_mm_per_N",
    "contact.stiffness_N_per_m",
    "controller.delay_ticks",
)
DRIVES = ("velocity_servo", "ideal_velocity")
ROUNDS = 12
FEWER = 8
"""Times of what takes longer, the first one left out."""
DRAG = 10.0
"""s, of one movement without a pause."""
IDLE = 5.0
"""s, in which nothing moves."""
FEW, MANY = 200, 2000
"""Changes after which memory is looked at."""

FOLLOW = """async ([key, share]) => {
    const last = () => performance.getEntriesByName("twin-follow").at(-1)?.detail ?? 0;
    const before = last();
    const slider = document.querySelector(`.setting[data-key='${key}'] input[type=range]`);
    slider.value = Math.round(1000 * share);
    slider.dispatchEvent(new Event("input", { bubbles: true }));
    while (last() === before) await new Promise((done) => setTimeout(done, 1));
    return performance.getEntriesByName("twin-follow").at(-1).duration;
}"""
CHOOSE = """async (name) => {
    const last = () => performance.getEntriesByName("twin-follow").at(-1)?.detail ?? 0;
    const before = last();
    const select = document.getElementById("drive");
    select.value = name;
    select.dispatchEvent(new Event("change", { bubbles: true }));
    while (last() === before) await new Promise((done) => setTimeout(done, 1));
    return performance.getEntriesByName("twin-follow").at(-1).duration;
}"""
DRAGGED = """async ([key, seconds]) => {
    performance.clearMeasures("twin-follow");
    const slider = document.querySelector(`.setting[data-key='${key}'] input[type=range]`);
    const began = performance.now();
    while (performance.now() - began < 1000 * seconds) {
        slider.value = 200 + Math.round(600 * (performance.now() - began) / (1000 * seconds));
        slider.dispatchEvent(new Event("input", { bubbles: true }));
        await new Promise(requestAnimationFrame);
    }
    return performance.getEntriesByName("twin-follow").length / seconds;
}"""
FOLLOWED = """async ([id, key, first]) => {
    const box = document.getElementById(id);
    box.open = true;
    while (!box.querySelector("tbody tr") || box.ariaBusy === "true") await new Promise((done) => setTimeout(done, 20));
    const slider = document.querySelector(`.setting[data-key='${key}'] input[type=range]`);
    for (let i = 0; i < 8; i++) {
        slider.value = first + i;
        slider.dispatchEvent(new Event("input", { bubbles: true }));
        await new Promise((done) => setTimeout(done, 40));
    }
    const moved = performance.now();
    while (box.ariaBusy === "true") await new Promise((done) => setTimeout(done, 1));
    return performance.now() - moved;
}"""
CHANGED = """async ([key, first, count]) => {
    const slider = document.querySelector(`.setting[data-key='${key}'] input[type=range]`);
    const last = () => performance.getEntriesByName("twin-follow").at(-1)?.detail ?? 0;
    for (let i = first; i < first + count; i++) {
        const before = last();
        slider.value = 300 + (i * 7) % 400;
        slider.dispatchEvent(new Event("input", { bubbles: true }));
        while (last() === before) await new Promise((done) => setTimeout(done, 1));
    }
}"""


def measurements(root: Path) -> list[Measurement]:
    """The lines of the table; `root` holds experiments/."""
    names = "explore: picture follows, Fig. 4, median", "explore: the same, 95th percentile"
    program = shutil.which(BROWSER)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return [Measurement(name, None, "", remark="playwright is not installed") for name in names]
    if program is None:
        return [Measurement(name, None, "", remark=f"no {BROWSER} here") for name in names]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        of_fig4 = _explored(browser, root / "experiments/fig4_force_position.toml", True)
        fig4, ready, rate, idle, growth, loops, score = of_fig4
        massage, *_ = _explored(browser, root / "experiments/massage.toml", False)
        browser.close()
    return [
        Measurement(names[0], median(fig4), "ms", at_most=80.0),
        Measurement(names[1], quantiles(fig4, n=20)[-1], "ms", at_most=150.0),
        Measurement("explore: picture follows, massage, median", median(massage), "ms", at_most=300.0),
        Measurement("explore: loops follow, after the last movement, median", loops, "ms", at_most=500.0),
        Measurement("explore: scorecard of Fig. 4, after the last movement, median", score, "ms", at_most=400.0),
        Measurement("explore: pictures per second of a drag", rate, "1/s", at_least=10.0),
        Measurement("explore: page ready after the command", ready, "s", at_most=2.0),
        Measurement("explore: processor while nothing moves", 100.0 * idle, "%", at_most=1.0),
        Measurement(f"explore: memory after {MANY} changes / {FEW}", growth, "x", at_most=1.1),
    ]


def _explored(
    browser: Any, experiment: Path, whole: bool
) -> tuple[list[float], float, float, float, float, float, float]:
    """(times in ms, s until the page is ready, pictures per second, share of a processor while idle, growth, medians of
    loops and scorecard in ms)."""
    with tempfile.TemporaryDirectory() as scratch:
        if whole:
            # what is compiled is there from now on
            with _started(experiment, Path(scratch)) as (process, address):
                tab = browser.new_page()
                tab.goto(address)
                tab.wait_for_selector(".box")
                tab.close()
        tab = browser.new_page(viewport={"width": 1400, "height": 900})
        began = time.perf_counter()
        with _started(experiment, Path(scratch)) as (process, address):
            tab.goto(address)
            tab.wait_for_selector(".plot canvas")
            ready = time.perf_counter() - began
            tab.wait_for_selector(".box")
            found = []
            for number in range(ROUNDS + 1):
                share = 0.35 + 0.25 * number / ROUNDS
                times = [tab.evaluate(FOLLOW, [key, share]) for key in NUMBERS if _there(tab, key)]
                times.append(tab.evaluate(CHOOSE, DRIVES[number % len(DRIVES)]))
                # of the first round each needs what is loaded once
                found += times if number else []
            if not whole:
                tab.close()
                return found, ready, 0.0, 0.0, 0.0, 0.0, 0.0
            rate = tab.evaluate(DRAGGED, [NUMBERS[0], DRAG])
            tab.wait_for_timeout(500)
            pids = _family(process.pid)
            before = sum(map(processor_time, pids))
            time.sleep(IDLE)
            idle = (sum(map(processor_time, pids)) - before) / IDLE
            tab.evaluate(CHANGED, [NUMBERS[1], 0, FEW])
            early = sum(map(resident_memory, _family(process.pid)))
            tab.evaluate(CHANGED, [NUMBERS[1], FEW, MANY - FEW])
            late = sum(map(resident_memory, _family(process.pid)))
            panels = []
            for box in ("loops", "score"):
                tab.evaluate("() => { for (const box of document.querySelectorAll('details')) box.open = false; }")
                times = [tab.evaluate(FOLLOWED, [box, NUMBERS[0], 400 + 10 * n]) for n in range(FEWER)]
                panels.append(median(times[1:]))
            tab.close()
    return found, ready, rate, idle, late / early, panels[0], panels[1]


def _there(tab: Any, key: str) -> bool:
    return bool(tab.locator(f".setting[data-key='{key}'] input[type=range]").count())


@contextmanager
def _started(experiment: Path, folder: Path) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """The program and the address that it has printed."""
    command = [sys.executable, "-m", "twin", "explore", str(experiment), "--no-browser", "--port", "0"]
    process = subprocess.Popen(command, cwd=folder, env=environment(), stdout=PIPE, stderr=DEVNULL, text=True)
    assert process.stdout is not None
    try:
        found = re.search(r"http://\S+", process.stdout.readline())
        assert found
        yield process, found.group()
    finally:
        process.terminate()
        process.wait()
        process.stdout.close()


def _family(pid: int) -> list[int]:
    """A process and its children."""
    children = Path(f"/proc/{pid}/task/{pid}/children")
    others = Path(f"/proc/{pid}/task").glob("*/children")
    found = {int(word) for file in {children, *others} if file.exists() for word in file.read_text().split()}
    return [pid, *found]
