"""The explorer as a user has it: in a real browser, while a slider moves."""

import os
import re
import shlex
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, BrowserContext, Dialog, Locator, Page, WebSocketRoute, expect

from tests.browser.explorer import Explorer
from tests.kernel.process.hostile import HANG, NONE, SEGFAULT, hostile_drive
from twin.kernel.cache_folder import cache_folder
from twin.kernel.recording.reader import read
from twin.robot.assembly.load import load_experiment
from twin.robot.run.trace import run_in_memory

pytestmark = pytest.mark.slow

SPRING = "robot.k_s_Nm_per_rad"
GAIN = "controller.force.kp_mm_per_N"
FORCE = "rms force error"


@pytest.fixture(scope="module")
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


def wait_until(page: Page, condition: str, argument: object = None) -> None:
    """Until a function of JavaScript says so; the page's policy lets nothing evaluate it there again and again."""
    deadline = time.monotonic() + 30.0
    while not page.evaluate(condition, argument):
        assert time.monotonic() < deadline, condition
        page.wait_for_timeout(20)


class Opened:
    """The page, and what its console said."""

    def __init__(self, page: Page, address: str):
        self.page = page
        self.messages: list[str] = []
        page.on("console", lambda message: self.messages.append(message.text))
        page.on("pageerror", lambda error: self.messages.append(str(error)))
        page.goto(address)
        self.wait()

    def wait(self) -> None:
        """Until the first picture is there."""
        self.page.locator(".plot canvas").first.wait_for()
        self.page.locator(".box").first.wait_for()

    def row(self, key: str) -> Locator:
        return self.page.locator(f".setting[data-key='{key}']")

    def number(self, name: str) -> str:
        return self.page.locator(".box", has_text=name).first.locator("strong").inner_text()

    def type(self, key: str, text: str) -> None:
        """Type a value and wait for its picture, or its refusal."""
        field = self.row(key).locator(".entry input")
        before = self.answers()
        field.fill(text)
        field.press("Enter")
        wait_until(
            self.page,
            "n => performance.getEntriesByName('twin-follow').length > n"
            " || document.getElementById('picture').classList.contains('old')",
            before,
        )

    def answers(self) -> int:
        found: int = self.page.evaluate("performance.getEntriesByName('twin-follow').length")
        return found

    def drag(self, key: str, start: float, end: float, steps: int = 20) -> None:
        """Move a slider's thumb from one share of its length to another."""
        box = self.row(key).locator("input[type=range]").bounding_box()
        assert box is not None
        y = box["y"] + box["height"] / 2
        self.page.mouse.move(box["x"] + box["width"] * start, y)
        self.page.mouse.down()
        for step in range(1, steps + 1):
            self.page.mouse.move(box["x"] + box["width"] * (start + (end - start) * step / steps), y)
            self.page.wait_for_timeout(30)
        self.page.mouse.up()


@pytest.fixture
def opened(context: BrowserContext, explorer: Explorer) -> Opened:
    return Opened(context.new_page(), explorer.address)


def test_the_picture_follows_while_a_slider_is_dragged_and_the_change_is_marked(opened: Opened):
    before, drawn = opened.number(FORCE), opened.answers()
    opened.drag(SPRING, 0.5, 0.8)
    # several pictures on the way, not one at the end
    assert opened.answers() > drawn + 3
    expect(opened.row(SPRING)).to_have_class("setting changed")
    wait_until(opened.page, "old => document.querySelector('.box strong').innerText !== old", before)
    assert opened.number(FORCE).startswith(f"{before.removesuffix(' N')} → ")
    assert SPRING in opened.page.url
    opened.row(SPRING).locator(".back").click()
    expect(opened.row(SPRING)).to_have_class("setting")
    expect(opened.page.locator(".box", has_text=FORCE).locator("strong")).to_have_text(before)
    assert opened.messages == []


def test_a_double_click_takes_the_files_value_and_undo_the_one_before(opened: Opened):
    opened.type(GAIN, "3")
    opened.row(GAIN).locator("input[type=range]").dblclick()
    expect(opened.row(GAIN)).to_have_class("setting")
    opened.page.keyboard.press("Control+z")
    expect(opened.row(GAIN).locator(".entry input")).to_have_value("3")
    opened.page.keyboard.press("Control+z")
    expect(opened.row(GAIN).locator(".entry input")).to_have_value("2")
    opened.page.keyboard.press("Control+Shift+z")
    expect(opened.row(GAIN).locator(".entry input")).to_have_value("3")


def test_a_double_click_takes_the_default_where_a_key_has_one(context: BrowserContext, tmp_path: Path):
    # the file says 0.1 where the default is 0
    with Explorer(tmp_path, "massage") as explorer:
        opened = Opened(context.new_page(), explorer.address)
        opened.page.fill("#search", "dead_zone")
        row = opened.row("controller.dead_zone_deg")
        expect(row.locator(".entry input")).to_have_value("0.1")
        row.locator("input[type=range]").dblclick()
        expect(row.locator(".entry input")).to_have_value("0")
        expect(row).to_have_class("setting changed")
        row.locator(".back").click()
        expect(row.locator(".entry input")).to_have_value("0.1")


def test_every_key_is_found_by_its_name_or_its_meaning(opened: Opened):
    opened.page.fill("#search", "bristle stiff")
    expect(opened.row("contact.bristle_N_per_m")).to_be_visible()
    expect(opened.row(SPRING)).to_have_count(0)
    opened.page.fill("#search", "")
    expect(opened.row(SPRING)).to_be_visible()


def test_a_typed_value_out_of_bounds_is_refused_with_the_files_sentence_and_the_picture_turns_grey(opened: Opened):
    before = opened.number(FORCE)
    opened.type(GAIN, "-1")
    expect(opened.page.locator("#problem")).to_contain_text("kp_mm_per_N = -1.0: expected a number >= 0")
    expect(opened.page.locator("#picture")).to_have_class("old")
    assert opened.number(FORCE) == before
    opened.type(GAIN, "2 mm/N")
    expect(opened.page.locator("#problem")).to_be_hidden()
    expect(opened.page.locator("#picture")).to_have_class("")


def test_an_experiment_that_cannot_be_assembled_says_so_and_keeps_the_last_picture(opened: Opened):
    opened.page.fill("#search", "l_b_mm")
    opened.type("robot.l_b_mm", "20")
    expect(opened.page.locator("#problem")).to_contain_text("out of reach")
    assert opened.page.locator(".plot canvas").count() > 0


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
    opened.page.locator(".pinned", has=opened.page.locator("input")).first.get_by_text("go").click()
    expect(opened.row(GAIN).locator(".entry input")).to_have_value("2")
    opened.page.get_by_label("Unpin as it was").click()
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
    expect(opened.page.locator("#out")).to_contain_text("Recorded: ", timeout=60_000)
    popup.value.locator("#replay.ready").wait_for()
    folder = Path(opened.page.inner_text("#out").split()[1])
    assert command[:2] == ["twin", "run"]
    words = [sys.executable, "-m", "twin", *command[1:], "--out", str(tmp_path / "again")]
    subprocess.run(words, cwd=folder.parents[2], env=os.environ | {"PYTHONPATH": os.getcwd()}, check=True)
    assert (folder / "run.mcap").read_bytes() == (tmp_path / "again" / "run.mcap").read_bytes()
    assert read(folder / "run.mcap").metadata["origins"][GAIN] == "set on the command line"
    opened.page.select_option("#beside", index=1)
    expect(opened.page.locator(".pinned")).to_have_count(2)


def test_a_zoom_asks_for_finer_samples_and_pins_follow(opened: Opened):
    stage = opened.page.locator(".stage").first
    box = stage.bounding_box()
    assert box is not None
    drawn = opened.answers()
    opened.page.mouse.move(box["x"] + 150, box["y"] + 60)
    opened.page.mouse.down()
    opened.page.mouse.move(box["x"] + 250, box["y"] + 60, steps=4)
    opened.page.mouse.up()
    opened.page.locator(".stage:not([data-from='0'])").first.wait_for()
    wait_until(opened.page, "n => performance.getEntriesByName('twin-follow').length > n", drawn)
    start = float(stage.get_attribute("data-from") or "nan")
    assert 3.0 < start < 8.0
    opened.page.keyboard.down("Shift")
    opened.page.mouse.move(box["x"] + 250, box["y"] + 60)
    opened.page.mouse.down()
    opened.page.mouse.move(box["x"] + 200, box["y"] + 60, steps=4)
    opened.page.mouse.up()
    opened.page.keyboard.up("Shift")
    wait_until(opened.page, "t => Number(document.querySelector('.stage').dataset.from) > t + 0.1", start)


def test_two_pages_do_not_disturb_each_other(opened: Opened, context: BrowserContext, explorer: Explorer):
    other = Opened(context.new_page(), explorer.address)
    before = other.number(FORCE)
    opened.type(GAIN, "4")
    other.page.wait_for_timeout(300)
    assert other.number(FORCE) == before
    other.type(SPRING, "3")
    expect(opened.row(SPRING).locator(".entry input")).to_have_value("1")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_all_without_scrolling_sideways(browser: Browser, explorer: Explorer, scheme: str):
    dark = scheme == "dark"
    made = browser.new_context(viewport={"width": 400, "height": 800}, color_scheme="dark" if dark else "light")
    opened = Opened(made.new_page(), explorer.address)
    assert opened.page.evaluate("document.documentElement.scrollWidth") == 400
    ground = opened.page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert ground == ("rgb(20, 22, 26)" if dark else "rgb(255, 255, 255)")
    # the picture and the settings are in sight together
    assert opened.page.locator("#numbers").is_visible() and opened.row(SPRING).is_visible()
    made.close()


def test_a_page_of_another_site_cannot_read_connect_or_start_anything(
    opened: Opened, context: BrowserContext, explorer: Explorer
):
    # another port of the same host: the cookie is sent there, and to us from there
    with Explorer(Path(f"/proc/{explorer.process.pid}/cwd").resolve(), "fig4_position") as other:
        page = context.new_page()
        page.goto(other.origin)
        assert page.inner_text("body").startswith("This page is shown only to the browser")
        page.goto("about:blank")
        page.set_content(f"<script src='{explorer.origin}/report.js'></script><img src='{explorer.origin}/'>")
        assert (
            page.evaluate(f"fetch('{explorer.origin}/', {{credentials: 'include'}}).then(() => 'read', () => 'no')")
            == "no"
        )
        knock = """address => new Promise(done => {
            const socket = new WebSocket(address);
            socket.onopen = () => done("open");
            socket.onclose = () => done("closed");
        })"""
        assert page.evaluate(knock, explorer.origin.replace("http", "ws") + "/link") == "closed"
        assert page.evaluate("typeof Clock") == "undefined"
    stranger = context.browser.new_context() if context.browser else None
    assert stranger is not None
    page = stranger.new_page()
    assert page.goto(explorer.origin).status == 403  # type: ignore[union-attr]
    stranger.close()


def test_a_page_says_that_the_server_was_killed_and_comes_back_with_its_state(browser: Browser, tmp_path: Path):
    context = browser.new_context(viewport={"width": 1400, "height": 900})
    first = Explorer(tmp_path, "fig4_force_position")
    opened = Opened(context.new_page(), first.address)
    opened.type(GAIN, "3")
    changed = opened.number(FORCE)
    first.kill()
    expect(opened.page.locator("#status")).to_contain_text("does not answer")
    expect(opened.page.locator("#picture")).to_have_class("old")
    with Explorer(tmp_path, "fig4_force_position", port=first.port):
        expect(opened.page.locator("#status")).to_have_text("", timeout=20_000)
        expect(opened.row(GAIN).locator(".entry input")).to_have_value("3")
        expect(opened.page.locator("#picture")).to_have_class("")
        assert opened.number(FORCE) == changed
    context.close()


def test_a_page_that_was_cut_off_goes_on_with_what_was_changed_meanwhile(context: BrowserContext, explorer: Explorer):
    page, links, cut = context.new_page(), list[WebSocketRoute](), list[bool]()

    def pass_on(link: WebSocketRoute) -> None:
        if cut:
            link.close()
        else:
            link.connect_to_server()
            links.append(link)

    page.route_web_socket("**/link", pass_on)
    opened = Opened(page, explorer.address)
    cut.append(True)
    links[0].close()
    expect(page.locator("#status")).to_contain_text("does not answer")
    field, before = opened.row(GAIN).locator(".entry input"), opened.number(FORCE)
    field.fill("3")
    field.press("Enter")
    cut.clear()
    expect(page.locator("#status")).to_have_text("", timeout=20_000)
    wait_until(page, "old => document.querySelector('.box strong').innerText !== old", before)
    expect(field).to_have_value("3")
    expect(page.locator("#picture")).to_have_class("")


def test_after_another_token_the_page_says_what_to_do_and_the_printed_address_brings_it_back(
    browser: Browser, tmp_path: Path
):
    context = browser.new_context()
    first = Explorer(tmp_path, "fig4_force_position")
    opened = Opened(context.new_page(), first.address)
    opened.type(GAIN, "3")
    first.kill()
    expect(opened.page.locator("#status")).to_contain_text("does not answer")
    (token,) = cache_folder("explore").glob(f"{first.port}.token")
    token.unlink()
    with Explorer(tmp_path, "fig4_force_position", port=first.port) as again:
        expect(opened.page.locator("#status")).to_contain_text("open the address that it has printed", timeout=20_000)
        # the state goes along behind #
        other = Opened(context.new_page(), f"{again.address}#{opened.page.url.partition('#')[2]}")
        expect(other.row(GAIN).locator(".entry input")).to_have_value("3")
        expect(opened.page.locator("#status")).to_have_text("", timeout=20_000)
        expect(opened.page.locator("#picture")).to_have_class("")
        expect(opened.row(GAIN).locator(".entry input")).to_have_value("3")
    context.close()


def test_ctrl_c_ends_it(tmp_path: Path):
    started = Explorer(tmp_path, "fig4_force_position")
    assert started.kill(signal.SIGINT) == 130


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


def test_a_fault_is_placed_on_the_time_axis_moved_and_repaired(context: BrowserContext, tmp_path: Path):
    with Explorer(tmp_path, "pressing") as explorer:
        opened = Opened(context.new_page(), explorer.address)
        page, before = opened.page, opened.number("largest force")
        page.click("#faults summary")
        page.select_option("#faults select", "drive_runaway")
        page.click("#faults button")
        page.get_by_label("at (s)").last.fill("6")
        page.get_by_label("at (s)").last.press("Enter")
        expect(page.locator("#problem")).to_contain_text("safety monitor: joint 1")
        reacts = page.locator(".box", has_text="monitor trips after the fault").locator("strong")
        expect(reacts).to_have_text(re.compile(r"^0\.1\d+ s$"))
        assert opened.number("largest force") != before
        # its mark in a plot is grabbed: sideways the onset, upwards the size
        page.evaluate("scrollTo({top: 0, behavior: 'instant'})")
        mark = page.locator(".fault-mark").first
        box, stage = mark.bounding_box(), page.locator(".stage").first.bounding_box()
        assert box is not None and stage is not None
        size, drawn = page.get_by_label("how much").last.input_value(), opened.answers()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 40)
        page.mouse.down()
        page.mouse.move(box["x"] + box["width"] / 2 + 0.2 * stage["width"], box["y"] + 10, steps=8)
        wait_until(page, "n => performance.getEntriesByName('twin-follow').length > n", drawn)
        page.mouse.up()
        onset = float(page.get_by_label("at (s)").last.input_value())
        assert 7.0 < onset < 11.0 and float(page.get_by_label("how much").last.input_value()) > float(size)
        # which limit it is that a larger one meets first depends on the pixels that the mouse went
        expect(page.locator("#problem")).to_contain_text("safety monitor: ")
        # one step to take back
        page.keyboard.press("Control+z")
        expect(page.get_by_label("at (s)").last).to_have_value("6")
        mark.focus()
        page.keyboard.press("ArrowRight")
        expect(page.get_by_label("at (s)").last).to_have_value("6.05")
        opened.page.get_by_text("repair").click()
        expect(page.locator("#problem")).to_be_hidden()
        expect(page.locator(".box", has_text="largest force").first.locator("strong")).to_have_text(before)


def test_loops_follow_with_margins_and_diagrams(opened: Opened):
    page = opened.page
    page.click("#loops summary")
    page.locator("#loops tbody tr").first.wait_for(timeout=60_000)
    force = page.locator("#loops tbody tr", has_text="force")
    before = force.inner_text()
    assert page.locator("#loops canvas").count() == 3
    opened.type(GAIN, "6")
    wait_until(page, "old => [...document.querySelectorAll('#loops tbody tr')].at(-1).innerText !== old", before)
    assert opened.messages == []


def test_claims_of_the_paper_turn_over_with_the_state(opened: Opened):
    page = opened.page
    page.click("#score summary")
    page.locator("#score tbody tr").first.wait_for(timeout=60_000)
    expect(page.locator("#score .hint")).to_contain_text("0 turned over. All four runs of Fig. 4")
    expect(page.locator("#score tbody tr", has_text="imperfect runs")).not_to_have_count(0)
    opened.type(SPRING, "8")
    page.locator("#score tr.turned").first.wait_for(timeout=60_000)
    expect(page.locator("#score tr.turned").first).to_contain_text("(was: holds)")
    assert opened.messages == []


def test_fig_4_as_the_paper_has_it_follows_and_a_link_brings_it_back(
    opened: Opened, context: BrowserContext, explorer: Explorer
):
    page = opened.page
    page.select_option("#layout", "fig4")
    expect(page.locator("figcaption").first).to_have_text("A: z position mm")
    expect(page.locator("#plots .plot")).to_have_count(4)
    drawn = opened.answers()
    opened.type(GAIN, "4")
    assert opened.answers() > drawn and page.locator("#plots .plot").count() == 4
    page.click("#pin")
    page.locator("#plots .several").first.wait_for()
    other = Opened(context.new_page(), page.url)
    expect(other.page.locator("figcaption").first).to_have_text("A: z position mm")
    expect(other.page.locator("#panels")).to_be_hidden()
    assert opened.messages == other.messages == []


def test_fig_5_has_its_tasks_side_by_side_and_its_own_claims(context: BrowserContext, tmp_path: Path):
    with Explorer(tmp_path, "rolling") as explorer:
        opened = Opened(context.new_page(), f"{explorer.address}#layout=fig5")
        page = opened.page
        expect(page.locator(".task h3")).to_have_text("C Rolling: 5 N, radius 5 mm at 1 Hz, 8 turns")
        expect(page.locator(".way figcaption")).to_have_text(["C: in space", "C: on the surface"])
        # pointing at the circle sets the one clock, and the coordinates have units
        page.locator(".way .stage canvas").last.scroll_into_view_if_needed()
        box = page.locator(".way .stage canvas").last.bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 90)
        expect(page.locator(".way .value").last).to_have_text(re.compile(r"^x [-\d.]+ mm, y [-\d.]+ mm$"))
        assert float(page.input_value("#time")) > 1.0
        page.locator(".way .legend button").last.click()
        expect(page.locator(".way .legend button").last).to_have_attribute("aria-pressed", "false")
        page.click("#score summary")
        expect(page.locator("#score summary")).to_have_text("Scorecard of Fig. 5")
        expect(page.locator("#score tbody tr", has_text="1 roll: radius over that asked for")).to_contain_text("holds")
        assert opened.messages == []


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


def test_a_map_fills_coarse_to_fine_and_a_click_goes_there(opened: Opened):
    page = opened.page
    page.click("#map summary")
    page.select_option("#map select >> nth=0", SPRING)
    page.select_option("#map select >> nth=1", GAIN)
    expect(page.locator("#map output")).to_have_text(re.compile("; (1[6-9]|[2-9][0-9]) of 256 points"), timeout=60_000)
    page.locator("#map canvas").scroll_into_view_if_needed()
    box = page.locator("#map canvas").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 0.75 * box["width"], box["y"] + 100)
    expect(opened.row(SPRING)).to_have_class("setting changed")
    expect(opened.row(GAIN)).to_have_class("setting changed")
    page.locator("#map summary").click()
    assert opened.messages == []
