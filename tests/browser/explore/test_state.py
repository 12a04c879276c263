"""The state of the page: links, pins, saved files and copied commands bring it back."""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from playwright.sync_api import BrowserContext, Dialog, expect

from tests.browser.explore.explorer import GAIN, SPRING, Explorer, Opened, wait_until
from twin.kernel.recording.reader import read

pytestmark = pytest.mark.slow


def test_a_link_brings_the_whole_state_back(opened: Opened, context: BrowserContext, explorer: Explorer):
    opened.type(GAIN, "3")
    opened.page.click("#pin")
    opened.type(SPRING, "2")
    opened.page.select_option("#body", "forearm")
    wait_until(opened.page, "() => location.hash.includes('forearm')")
    other = Opened(context.new_page(), opened.page.url)
    expect(other.row(GAIN).locator(".entry input")).to_have_value("3")
    expect(other.row(SPRING).locator(".entry input")).to_have_value("2")
    expect(other.page.locator("#body")).to_have_value("forearm")
    expect(other.page.locator(".pinned input")).to_have_value("kp_mm_per_N 3")


@pytest.mark.parametrize(
    "state",
    [
        "robot.name=%22..%2F..%2Fetc%2Fpasswd%22",
        "drive=..%2F..%2Fevil.fmu",
        "body=%2Fetc%2Fpasswd",
        "drive.fmu=%22%2Ftmp%2Fevil.fmu%22",
        "controller.python=%22evil.py%3AC%22",
        "reference.t_s=" + "%5B" * 2000,
        "pin=%7B%22name%22%3A%22x%22%2C%22run%22%3A%22%2Fetc%22%7D",
        "__proto__=1",
    ],
)
def test_a_hostile_link_is_refused_with_a_sentence_and_starts_nothing(
    context: BrowserContext, explorer: Explorer, state: str
):
    page = context.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(f"{explorer.address}#{state}")
    wait_until(page, "() => document.getElementById('problem').innerText || document.getElementById('out').innerText")
    said = page.inner_text("#problem") + page.inner_text("#out")
    assert "no state" in said or "no such" in said or "no key" in said, said
    assert errors == []


def test_names_from_a_link_are_shown_as_text(context: BrowserContext, explorer: Explorer):
    pin = "%7B%22name%22%3A%22%3Cimg%20src%3Dx%20onerror%3Dalert(1)%3E%22%2C%22state%22%3A%7B%7D%7D"
    page = context.new_page()
    dialogs: list[str] = []

    def hear(dialog: Dialog) -> None:
        dialogs.append(dialog.message)
        dialog.dismiss()

    page.on("dialog", hear)
    opened = Opened(page, f"{explorer.address}#pin={pin}")
    expect(page.locator(".pinned input")).to_have_value("<img src=x onerror=alert(1)>")
    assert page.locator("#pins img").count() == 0 and dialogs == [] and opened.messages == []


def test_pinned_states_lie_beside_and_can_be_returned_to(opened: Opened):
    opened.page.click("#pin")
    opened.type(GAIN, "4")
    opened.page.click("#pin")
    expect(opened.page.locator(".pinned")).to_have_count(3)
    opened.page.locator(".pinned input").first.fill("as it was")
    opened.page.locator(".pinned input").first.press("Enter")
    opened.page.locator(".pinned", has=opened.page.locator("input")).first.get_by_text("Show").click()
    expect(opened.row(GAIN).locator(".entry input")).to_have_value("2")
    opened.page.get_by_label("Remove as it was").click()
    expect(opened.page.locator(".pinned")).to_have_count(2)
    assert opened.messages == []


def test_the_saved_experiment_extends_the_old_one_with_exactly_what_differs(opened: Opened, explorer: Explorer):
    opened.type(GAIN, "3")
    opened.page.once("dialog", lambda dialog: dialog.accept("stiffer"))
    opened.page.click("#save")
    expect(opened.page.locator("#out")).to_contain_text("Saved: stiffer.toml")
    folder = Path(f"/proc/{explorer.process.pid}/cwd").resolve()
    written = tomllib.loads((folder / "stiffer.toml").read_text())
    assert Path(written.pop("extends")).name == "fig4_force_position.toml"
    assert written == {"controller": {"force": {"kp_mm_per_N": 3.0}}}
    opened.page.once("dialog", lambda dialog: dialog.accept("../stiffer"))
    opened.page.click("#save")
    expect(opened.page.locator("#out")).to_contain_text("expected a name of letters")


def test_the_copied_command_records_the_bytes_that_record_does(opened: Opened, explorer: Explorer, tmp_path: Path):
    opened.type(GAIN, "3")
    opened.type("reference.t_s", "1.25")
    opened.page.click("#copy")
    expect(opened.page.locator("#out")).to_contain_text("clipboard")
    command = shlex.split(opened.page.evaluate("navigator.clipboard.readText()"))
    with opened.page.context.expect_page() as popup:
        opened.page.click("#record")
    # never the latest run of results/fig4_force_position
    expect(opened.page.locator("#out")).to_contain_text(
        re.compile(r"Recorded: .*/results/explored/fig4_force_position/[-0-9_]+  "), timeout=60_000
    )
    popup.value.locator("#replay.ready").wait_for()
    folder = Path(opened.page.inner_text("#out").split()[1])
    assert command[:2] == ["twin", "run"]
    words = [sys.executable, "-m", "twin", *command[1:], "--out", str(tmp_path / "again")]
    subprocess.run(words, cwd=folder.parents[3], env=os.environ | {"PYTHONPATH": os.getcwd()}, check=True)
    assert (folder / "run.mcap").read_bytes() == (tmp_path / "again" / "run.mcap").read_bytes()
    assert read(folder / "run.mcap").metadata["origins"][GAIN] == "set on the command line"
    opened.page.select_option("#beside", index=1)
    expect(opened.page.locator(".pinned")).to_have_count(2)
