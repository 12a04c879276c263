"""The report as a reader has it: in a browser, with mouse, keyboard, phone and printer."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Locator, Page

from tests.browser.conftest import Opened
from tests.report.page.test_followed_page import recorded_session
from twin.kernel.recording.reader import Recording
from twin.report.page.page import write_report

pytestmark = pytest.mark.slow

SECTIONS = [
    "Verdict",
    "Replay",
    "Claims and measures",
    "Figure",
    "Events",
    "Drives and FMUs",
    "Parameters",
    "Timing",
    "Repeat this run",
]
BLUE, VERMILION, GREEN, ORANGE = (0, 114, 178), (213, 94, 0), (0, 158, 115), (230, 159, 0)
INK = (22, 24, 29)


def pixels(locator: Locator) -> np.ndarray:
    """What is on the screen there, (height, width, 3)."""
    return np.asarray(Image.open(BytesIO(locator.screenshot())).convert("RGB")).astype(int)


def share(picture: np.ndarray, rgb: tuple[int, int, int]) -> float:
    """How much of a picture has a colour, edges that are blended aside."""
    return float(np.mean(np.all(np.abs(picture - rgb) <= 12, axis=2)))


def drawn(page: Page) -> str:
    """The picture of the robot."""
    return page.locator("#robot canvas").evaluate("canvas => canvas.toDataURL()")


def test_the_verdict_stands_first_and_nothing_is_said_in_the_console(opened: Opened):
    page = opened.page
    assert page.locator("h2").all_inner_texts() == SECTIONS
    assert page.locator(".headline").inner_text().endswith("; 5 of 5 of this run's own checks hold")
    box = page.locator(".headline").bounding_box()
    assert box is not None and box["y"] < 300
    opened.settle()
    assert opened.messages == []
    assert opened.requests == []


def test_values_under_the_cursor_are_those_of_the_recording(opened: Opened, force_position: Recording):
    page = opened.page
    opened.go("12")
    legend = page.locator(".plot").first.locator(".legend button")
    shown = {one.locator("span").inner_text(): one.locator("output").text_content() for one in legend.all()}
    # three decimals, and half a unit of the last
    true = -force_position["plant.F_ee_B"][12000, 2]
    assert float((shown["true"] or "nan").removesuffix(" N")) == pytest.approx(true, abs=5.1e-4)
    assert float((shown["estimated"] or "nan").removesuffix(" N")) == pytest.approx(
        force_position["controller.F_z"][6000], abs=5.1e-4
    )


def test_a_click_plays_the_robot_and_another_stops_it(opened: Opened):
    page = opened.page
    before = drawn(page)
    page.select_option("#speed", "5")
    page.click("#play")
    assert page.inner_text("#play") == "Pause"
    page.wait_for_timeout(700)
    page.click("#play")
    stopped = opened.time()
    assert 0.5 < stopped < 10.0
    opened.settle()
    assert drawn(page) != before
    page.wait_for_timeout(150)
    assert opened.time() == stopped and page.inner_text("#play") == "Play"


def test_space_plays_and_arrows_turn_the_robot(opened: Opened):
    canvas = opened.page.locator("#robot canvas")
    before = drawn(opened.page)
    canvas.press("ArrowLeft")
    assert drawn(opened.page) != before
    canvas.press(" ")
    assert opened.page.inner_text("#play") == "Pause"


def test_scrubbing_moves_the_cursor_of_every_plot(opened: Opened):
    page = opened.page
    cursor = page.locator(".cursor").first
    places = []
    for time in ("5", "15"):
        opened.go(time)
        box = cursor.bounding_box()
        assert box is not None
        places.append(box["x"])
    stage = page.locator(".stage").first.bounding_box()
    assert stage is not None
    # half of the run is half of the plot, between its margins of 58 and 10 pixels
    assert places[1] - places[0] == pytest.approx((stage["width"] - 68) / 2, abs=1.5)


def test_pointing_into_a_plot_moves_the_player(opened: Opened):
    page = opened.page
    stage = page.locator(".stage").first
    stage.scroll_into_view_if_needed()
    box = stage.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 58 + 0.5 * (box["width"] - 68), box["y"] + 60)
    # a pixel is 30 ms
    assert opened.time() == pytest.approx(10.0, abs=0.06)


def test_a_zoom_in_one_plot_is_a_zoom_in_all(opened: Opened):
    page = opened.page
    stage = page.locator(".stage").first
    stage.scroll_into_view_if_needed()
    box = stage.bounding_box()
    assert box is not None
    inner = box["width"] - 68
    page.mouse.move(box["x"] + 58 + 0.25 * inner, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + 58 + 0.5 * inner, box["y"] + 60, steps=4)
    page.mouse.up()
    page.locator(".stage:not([data-from='0'])").first.wait_for()
    spans = set()
    for plot in page.locator(".stage").all():
        plot.scroll_into_view_if_needed()
        opened.settle()
        spans.add((plot.get_attribute("data-from"), plot.get_attribute("data-to")))
    assert len(spans) == 1
    start, end = (float(time or "nan") for time in spans.pop())
    assert start == pytest.approx(5.0, abs=0.06) and end == pytest.approx(10.0, abs=0.06)
    page.click("#all")
    opened.wait_for_span("0", "20")


def test_keys_zoom_and_move_the_time(opened: Opened):
    stage = opened.page.locator(".stage").first
    opened.go("10")
    stage.press("+")
    stage.press("ArrowRight")
    opened.wait_for_span("5", "15")
    # a two hundredth of 10 s
    assert opened.time() == pytest.approx(10.05, abs=1e-9)


def test_an_event_leads_to_its_time(opened: Opened):
    opened.page.click("button.at")
    assert opened.time() == 5.606


def test_every_part_of_the_page_is_drawn_in_its_place(opened: Opened):
    page = opened.page
    opened.go("12")
    tops = page.eval_on_selector_all("section", "nodes => nodes.map(node => node.getBoundingClientRect().top)")
    assert len(tops) == len(SECTIONS) and tops == sorted(tops)
    robot = pixels(page.locator("#robot canvas"))
    # a proximal link of 60 by 3 mm in a picture of 236 mm is 3/1000 of it; the one that points away is a third as long
    for leg in (BLUE, VERMILION, GREEN):
        assert share(robot, leg) > 0.0005, leg
    assert share(robot, ORANGE) > 0.00015 and share(robot, INK) > 0.0003
    force = pixels(page.locator(".stage").first)
    for curve in (INK, ORANGE, BLUE):
        assert share(force, curve) > 0.002, curve


def test_runs_lie_over_each_other_in_colours_of_their_own(browser: Browser, two_runs: Path):
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    opened = Opened(page, two_runs)
    first = page.locator(".stage").first
    both = pixels(first)
    assert share(both, BLUE) > 0.001 and share(both, VERMILION) > 0.001
    page.locator("#runs input").nth(1).uncheck()
    opened.settle()
    assert share(pixels(first), VERMILION) < 0.0005
    opened.go("6")
    before = drawn(page)
    page.select_option("#run", "1")
    assert drawn(page) != before
    assert opened.messages == []
    page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_all_without_scrolling_sideways(browser: Browser, two_runs: Path, scheme: str):
    context = browser.new_context(
        viewport={"width": 360, "height": 740}, has_touch=True, color_scheme="dark" if scheme == "dark" else "light"
    )
    opened = Opened(context.new_page(), two_runs)
    assert opened.page.evaluate("document.documentElement.scrollWidth") == 360
    ground = pixels(opened.page.locator("h1")).mean()
    assert (ground < 90) == (scheme == "dark")
    assert opened.messages == []
    context.close()


def test_an_alarm_of_a_session_leads_to_its_time_on_a_phone_too(browser: Browser, tmp_path: Path):
    page = browser.new_page(viewport={"width": 400, "height": 800})
    opened = Opened(page, Path(write_report([recorded_session(tmp_path)]).facts["page"]))
    assert page.evaluate("document.documentElement.scrollWidth") == 400
    page.locator("#alarms button.at").first.click()
    assert 3.0 < opened.time() < 4.5
    opened.settle()
    assert opened.messages == []
    page.close()


def test_on_paper_the_page_is_light_whole_and_without_controls(browser: Browser, one_run: Path):
    context = browser.new_context(color_scheme="dark", viewport={"width": 900, "height": 900})
    opened = Opened(context.new_page(), one_run)
    page = opened.page
    page.evaluate("window.printed = []")
    page.evaluate(
        "addEventListener('beforeprint', () => printed.push(document.querySelectorAll('details:not([open])').length))"
    )
    pdf = page.pdf()
    assert pdf.count(b"/Type /Page\n") > 3
    assert page.evaluate("printed") == [0]
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    assert not page.locator("#play").is_visible()
    last = pixels(page.locator(".stage").last)
    assert last.mean() > 200 and share(last, BLUE) > 0.001
    context.close()


def test_everything_that_can_be_used_has_a_name(opened: Opened):
    nameless = opened.page.evaluate(
        """() => [...document.querySelectorAll("button, input, select, canvas[role], [tabindex='0']")].filter(node =>
          !(node.getAttribute("aria-label") || node.textContent.trim() || node.labels?.length)).map(n => n.outerHTML)"""
    )
    assert nameless == []


def height_of(page: Page, selector: str) -> float:
    """Of the upper edge in the window, in pixels from above."""
    box = page.locator(selector).bounding_box()
    assert box is not None
    return box["y"]


def test_the_player_is_in_the_first_screen_and_a_click_on_an_event_leads_to_it(browser: Browser, two_runs: Path):
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    opened = Opened(page, two_runs)
    line = page.locator("#time").bounding_box()
    assert line is not None and line["y"] + line["height"] < 900
    page.locator("#events button.at").first.click()
    # smooth scrolling takes its time, and the page's policy lets nobody wait for a condition of a script
    places = [height_of(page, "#replay")]
    while len(places) < 100 and (len(places) < 4 or len(set(places[-3:])) > 1):
        page.wait_for_timeout(200)
        places.append(height_of(page, "#replay"))
    assert abs(places[-1]) < 20
    assert page.locator("#readout").inner_text() == "5.606 s" and opened.messages == []
    page.close()


def test_tables_use_the_width_and_pictures_are_dark_on_a_dark_page(browser: Browser, two_runs: Path):
    page = browser.new_page(viewport={"width": 1400, "height": 900}, color_scheme="dark")
    Opened(page, two_runs)
    widths = page.locator("#numbers table").evaluate_all("tables => tables.map((table) => table.offsetWidth)")
    # those that are folded away have none
    assert any(widths) and all(width > 1200 for width in widths if width)
    picture = page.locator(".picture")
    picture.scroll_into_view_if_needed()
    assert np.median(pixels(picture)) < 60
    page.close()
