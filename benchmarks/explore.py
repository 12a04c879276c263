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
BOXES = (("loops", "loops follow", 500.0), ("score", "scorecard of Fig. 4", 400.0))
"""Boxes below the plots: id, what is measured, most ms."""
PATIENCE = 120.0
"""s, after which what the page waits for will not come."""
PRELUDE = f"""
    window.drawn = [];
    const listening = new PerformanceObserver((list) => drawn.push(...list.getEntriesByName("twin-follow")));
    listening.observe({{ type: "measure" }});
    window.until = async (there) => {{
        const end = performance.now() + {1000 * PATIENCE};
        const [picture, ...words] = ["picture", "problem", "status"].map((id) => document.getElementById(id));
        while (!there()) {{
            // refused, failed, or the server is gone: there will be no new picture
            if (picture.classList.contains("old")) throw new Error(words.map((box) => box.textContent).join(" "));
            if (performance.now() > end) throw new Error(`not within {PATIENCE:g} s: ${{there}}`);
            await new Promise((done) => setTimeout(done, 1));
        }}
    }};
    window.slide = (key, value) => {{
        const slider = document.querySelector(`.setting[data-key='${{key}}'] input[type=range]`);
        slider.value = value;
        slider.dispatchEvent(new Event("input", {{ bubbles: true }}));
    }};
    window.followed = async (act) => {{
        const before = drawn.length;
        act();
        await until(() => drawn.length > before);
        return drawn.at(-1).duration;
    }};
"""
FOLLOW = "([key, share]) => followed(() => slide(key, Math.round(1000 * share)))"
CHOOSE = """(name) => followed(() => {
    const select = document.getElementById("drive");
    select.value = name;
    select.dispatchEvent(new Event("change", { bubbles: true }));
})"""
DRAGGED = """async ([key, seconds]) => {
    const [before, began] = [drawn.length, performance.now()];
    while (performance.now() - began < 1000 * seconds) {
        slide(key, 200 + Math.round(600 * (performance.now() - began) / (1000 * seconds)));
        await new Promise(requestAnimationFrame);
    }
    return (drawn.length - before) / seconds;
}"""
OPEN = "(id) => { for (const box of document.querySelectorAll('details')) box.open = box.id === id; }"
FOLLOWED = """async ([id, key, first]) => {
    const box = document.getElementById(id);
    await until(() => box.querySelector("tbody tr") && box.ariaBusy !== "true");
    for (let i = 0; i < 8; i++) {
        slide(key, first + i);
        await new Promise((done) => setTimeout(done, 40));
    }
    const moved = performance.now();
    await until(() => box.ariaBusy !== "true");
    return performance.now() - moved;
}"""
CHANGED = """async ([key, first, count]) => {
    for (let i = first; i < first + count; i++) await followed(() => slide(key, 300 + (i * 7) % 400));
}"""


def measurements(root: Path) -> Iterator[Measurement]:
    """The lines of the table as they come; `root` holds experiments/."""
    names = "explore: picture follows, Fig. 4, median", "explore: the same, 95th percentile"
    program = shutil.which(BROWSER)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        yield from (Measurement(name, None, "", remark="playwright is not installed") for name in names)
        return
    if program is None:
        yield from (Measurement(name, None, "", remark=f"no {BROWSER} here") for name in names)
        return
    fig4, massage = (root / "experiments" / f"{name}.toml" for name in ("fig4_force_position", "massage"))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        with _opened(browser, fig4):
            # what is compiled is there from now on
            pass
        with _opened(browser, massage) as (tab, _, _):
            yield Measurement("explore: picture follows, massage, median", median(_times(tab)), "ms", at_most=300.0)
        with _opened(browser, fig4) as (tab, pid, ready):
            yield Measurement("explore: page ready after the command", ready, "s", at_most=2.0)
            times = _times(tab)
            yield Measurement(names[0], median(times), "ms", at_most=80.0)
            yield Measurement(names[1], quantiles(times, n=20)[-1], "ms", at_most=150.0)
            rate = tab.evaluate(DRAGGED, [NUMBERS[0], DRAG])
            yield Measurement("explore: pictures per second of a drag", rate, "1/s", at_least=10.0)
            tab.wait_for_timeout(500)
            yield Measurement("explore: processor while nothing moves", 100.0 * _idle(pid), "%", at_most=1.0)
            for box, what, bound in BOXES:
                tab.evaluate(OPEN, box)
                took = [tab.evaluate(FOLLOWED, [box, NUMBERS[0], 400 + 10 * n]) for n in range(FEWER)]
                title = f"explore: {what}, after the last movement, median"
                yield Measurement(title, median(took[1:]), "ms", at_most=bound)
            # some minutes
            tab.evaluate(OPEN, "")
            sizes = []
            for first, until in ((0, FEW), (FEW, MANY)):
                tab.evaluate(CHANGED, [NUMBERS[1], first, until - first])
                sizes.append(sum(map(resident_memory, _family(pid))))
            title = f"explore: memory after {MANY} changes / {FEW}"
            yield Measurement(title, sizes[1] / sizes[0], "x", at_most=1.1)
        browser.close()


@contextmanager
def _opened(browser: Any, experiment: Path) -> Iterator[tuple[Any, int, float]]:
    """(the page, the program, s from its command until the page is ready)."""
    tab = browser.new_page(viewport={"width": 1400, "height": 900})
    tab.set_default_timeout(1000 * PATIENCE)
    tab.add_init_script(PRELUDE)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch, _started(experiment, Path(scratch)) as (process, address):
        tab.goto(address)
        tab.wait_for_selector(".plot canvas")
        ready = time.perf_counter() - began
        tab.wait_for_selector(".box")
        yield tab, process.pid, ready
        tab.close()


def _times(tab: Any) -> list[float]:
    """From an event to the picture (ms), each key and drive in each round."""
    found: list[float] = []
    for number in range(ROUNDS + 1):
        # from 0.57 on springs of the massage are too stiff for what the monitor is to see, and it is refused
        share = 0.35 + 0.2 * number / ROUNDS
        times = [tab.evaluate(FOLLOW, [key, share]) for key in NUMBERS if _there(tab, key)]
        times.append(tab.evaluate(CHOOSE, DRIVES[number % len(DRIVES)]))
        # of the first round each needs what is loaded once
        found += times if number else []
    return found


def _idle(pid: int) -> float:
    """Share of a processor of the program and its processes while nothing moves."""
    pids = _family(pid)
    before = sum(map(processor_time, pids))
    time.sleep(IDLE)
    return (sum(map(processor_time, pids)) - before) / IDLE


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
