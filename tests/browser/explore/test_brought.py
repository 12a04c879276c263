"""Drives and logs that are brought in through the page, and drives that crash."""

import re
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import BrowserContext, expect

from tests.browser.explore.explorer import FORCE, Explorer, Opened, wait_until
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


def test_an_fmu_is_asked_about_before_it_is_loaded_tried_on_the_bench_and_swapped_in(
    opened: Opened, root: Path, explorer: Explorer
):
    page, before = opened.page, opened.number(FORCE)
    page.set_input_files("#fmu", root / "fmus/ideal_velocity/ideal_velocity.fmu")
    page.locator("#brought[open]").wait_for()
    expect(page.locator("#brought")).to_contain_text("An FMU is native code")
    expect(page.locator("#brought-omega_ref")).to_have_value("omega_ref")
    folder = Path(f"/proc/{explorer.process.pid}/cwd").resolve() / "results/explored"
    # nothing of it was kept, let alone loaded, before somebody has agreed
    assert not folder.exists()
    page.click("#agree")
    page.locator("#swap:visible").wait_for(timeout=120_000)
    expect(page.locator("#verdict")).to_contain_text("ideal_velocity")
    page.click("#swap")
    expect(page.locator("#drive")).to_have_value("ideal_velocity (brought in)")
    wait_until(page, "old => document.querySelector('.box strong').innerText !== old", before)
    expect(page.locator("#command")).to_contain_text("--drive results/explored/ideal_velocity-")
    assert list(folder.glob("*/mapping.toml"))


def test_what_is_no_fmu_is_refused_with_a_sentence(opened: Opened, tmp_path: Path):
    (tmp_path / "empty.fmu").write_bytes(b"no zip")
    opened.page.set_input_files("#fmu", tmp_path / "empty.fmu")
    expect(opened.page.locator("#out")).to_have_text(re.compile("^empty.fmu: not a complete FMU"))
    (tmp_path / "..fmu").write_bytes(b"x")
    opened.page.set_input_files("#fmu", tmp_path / "..fmu")
    expect(opened.page.locator("#out")).to_contain_text("expected the name of an .fmu, .csv")
    assert not opened.page.locator("#brought[open]").count()


def test_a_log_of_a_robot_is_dropped_mapped_laid_beside_and_brought_back_by_the_link(
    opened: Opened, context: BrowserContext, tmp_path: Path
):
    trace = run_in_memory(load_experiment("fig4_force_position", ["duration_s=8"]))
    t, counts = trace.time("encoder"), np.hstack([trace["encoder.count_m"], trace["encoder.count_l"]])
    names = [f"q_{side}_{i}" for side in ("motor", "joint") for i in (1, 2, 3)]
    np.savetxt(
        tmp_path / "robot.csv", np.column_stack([t, counts]), "%.9g", ",", header="t," + ",".join(names), comments=""
    )
    page = opened.page
    page.evaluate(
        """text => {
            const files = new DataTransfer();
            files.items.add(new File([text], "robot.csv"));
            const how = { dataTransfer: files, bubbles: true, cancelable: true };
            document.body.dispatchEvent(new DragEvent("drop", how));
        }""",
        (tmp_path / "robot.csv").read_text(),
    )
    page.locator("#log[open]").wait_for()
    # what the proposal leaves in doubt is a comment, and the sentence says what is missing
    assert "# time = " in page.input_value("#log-map")
    page.fill("#log-map", 'time = "t"\n"encoder.count_m[0]" = "nothing"')
    page.click("#lay")
    expect(page.locator("#log-problem")).to_contain_text("nothing")
    lines = ['time = { column = "t", unit = "s" }']
    lines += [
        f'"encoder.count_{c}[{i}]" = "q_{n}_{i + 1}"' for c, n in (("m", "motor"), ("l", "joint")) for i in range(3)
    ]
    page.fill("#log-map", "\n".join(lines))
    page.click("#lay")
    expect(page.locator(".pinned")).to_have_count(2)
    page.locator("#plots .several").first.wait_for()
    value = page.locator("#plots .legend button", has_text="estimated").first.locator(".value").nth(1)
    expect(value).to_be_visible()
    other = Opened(context.new_page(), page.url)
    expect(other.page.locator(".pinned input")).to_have_value(re.compile(r"^robot-\w{8}\.csv$"))
    other.page.locator("#plots .several").first.wait_for()
    assert opened.messages == other.messages == []
