"""Drives that crash, and logs of robots that are laid beside."""

from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import BrowserContext, expect

from tests.browser.explore.explorer import Explorer, Opened
from tests.kernel.process.hostile import HANG, NONE, SEGFAULT, hostile_drive
from twin.robot.assembly.load import load_experiment
from twin.robot.run.trace import run_in_memory

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def hostile(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive that crashes or hangs at 0.999 s if its parameter droop says so."""
    return hostile_drive(root, tmp_path_factory.mktemp("hostile"))


@pytest.mark.parametrize(("attack", "sentence"), [(SEGFAULT, "crashed (SIGSEGV"), (HANG, "did not return within 1 s")])
def test_a_drive_that_crashes_or_hangs_costs_its_run_only_and_is_named(
    context: BrowserContext, tmp_path: Path, hostile: Path, attack: int, sentence: str
):
    words = ["fig4_position", "--drive", str(hostile), "--set", f"drive.parameters.droop={NONE}", "--limit-step", "1"]
    with Explorer(tmp_path, *words) as explorer:
        opened = Opened(context.new_page(), explorer.address)
        before = opened.number("largest force")
        opened.page.fill("#search", "droop")
        opened.type("drive.parameters.droop", str(attack))
        expect(opened.page.locator("#problem")).to_contain_text(f"hostile.fmu (drive_1) {sentence}", timeout=20_000)
        expect(opened.page.locator("#picture")).to_have_class("old")
        opened.row("drive.parameters.droop").locator(".back").click()
        expect(opened.page.locator("#problem")).to_be_hidden(timeout=20_000)
        assert opened.number("largest force") == before


def test_a_log_of_a_robot_is_laid_beside_with_the_map_that_lies_beside_it_and_brought_back_by_the_link(
    opened: Opened, context: BrowserContext, explorer: Explorer
):
    trace = run_in_memory(load_experiment("fig4_force_position", ["duration_s=8"]))
    t, counts = trace.time("encoder"), np.hstack([trace["encoder.count_m"], trace["encoder.count_l"]])
    names = [f"q_{side}_{i}" for side in ("motor", "joint") for i in (1, 2, 3)]
    folder = Path(f"/proc/{explorer.process.pid}/cwd").resolve()
    head = "t," + ",".join(names)
    np.savetxt(folder / "robot.csv", np.column_stack([t, counts]), "%.9g", ",", header=head, comments="")
    page = opened.page
    # which files there are is asked when a page is opened
    page.reload()
    page.locator("#beside option", has_text="robot.csv").wait_for(state="attached")
    page.select_option("#beside", "log robot.csv")
    page.locator("#log[open]").wait_for()
    page.click("#lay")
    expect(page.locator("#log-problem")).to_contain_text("twin log new")
    lines = ['time = { column = "t", unit = "s" }']
    lines += [
        f'"encoder.count_{c}[{i}]" = "q_{n}_{i + 1}"' for c, n in (("m", "motor"), ("l", "joint")) for i in range(3)
    ]
    (folder / "robot.map.toml").write_text("\n".join(lines))
    page.click("#lay")
    expect(page.locator(".pinned")).to_have_count(2)
    page.locator("#plots .several").first.wait_for()
    value = page.locator("#plots .legend button", has_text="estimated").first.locator(".value").nth(1)
    expect(value).to_be_visible()
    other = Opened(context.new_page(), page.url)
    expect(other.page.locator(".pinned input")).to_have_value("robot.csv")
    other.page.locator("#plots .several").first.wait_for()
    assert opened.messages == other.messages == []
