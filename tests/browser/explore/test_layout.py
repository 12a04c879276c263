"""The layout of the explorer: what is on the first screen, and how large what is pressed is."""

import pytest
from playwright.sync_api import Browser, expect

from tests.browser.explore.explorer import GAIN, Explorer, Opened, wait_until

pytestmark = pytest.mark.slow

SMALL = """() => [...document.querySelectorAll("button, select, summary, input:not([type=checkbox])")]
    .filter((node) => node.checkVisibility() && !node.closest(".skip"))
    .map((node) => [node.id || node.className || node.tagName, node.getBoundingClientRect()])
    .filter(([, box]) => box.width < 23.5 || box.height < 23.5)
    .map(([name, box]) => `${name} ${box.width} x ${box.height}`)"""

SCROLLING = """() => [...document.querySelectorAll("main *, header *")]
    .filter((node) => node.checkVisibility() && node.scrollWidth > node.clientWidth + 1
        && ["auto", "scroll"].includes(getComputedStyle(node).overflowX))
    .filter((node) => node.tabIndex < 0 && !node.querySelector("a, button, input, select, summary, [tabindex='0']"))
    .map((node) => node.id || node.className || node.tagName)"""
"""What scrolls sideways and has nothing in it that takes the focus."""


def opened_at(browser: Browser, explorer: Explorer, width: int, height: int) -> Opened:
    return Opened(browser.new_page(viewport={"width": width, "height": height}), explorer.address)


@pytest.mark.parametrize("width", [1100, 1250, 1400, 1920])
def test_the_toolbar_is_one_row(browser: Browser, explorer: Explorer, width: int):
    page = opened_at(browser, explorer, width, 900).page
    boxes = [one.bounding_box() for one in page.locator("header .bar > *").all()]
    middles = [box["y"] + box["height"] / 2 for box in boxes if box]
    assert len(middles) == 8 and max(middles) - min(middles) < 4
    assert max(box["x"] + box["width"] for box in boxes if box) <= width
    page.close()


def test_the_first_curve_is_near_the_top_of_a_desktop(browser: Browser, explorer: Explorer):
    page = opened_at(browser, explorer, 1400, 900).page
    main, curve = page.locator("main").bounding_box(), page.locator(".plot canvas").first.bounding_box()
    assert main is not None and main["y"] <= 90
    assert curve is not None and curve["y"] <= 260
    page.close()


def test_a_phone_shows_a_whole_curve_above_the_settings(browser: Browser, explorer: Explorer):
    page = opened_at(browser, explorer, 390, 844).page
    curve, settings = page.locator(".plot canvas").first.bounding_box(), page.locator("#controls").bounding_box()
    assert curve is not None and settings is not None
    assert curve["y"] + curve["height"] <= settings["y"] < 844
    page.close()


@pytest.mark.parametrize("width", [1920, 1100, 1090, 390])
def test_the_robot_is_open_beside_the_curves_where_there_is_room(browser: Browser, explorer: Explorer, width: int):
    page = opened_at(browser, explorer, width, 900).page
    robot, curve = page.locator("#robot canvas"), page.locator(".plot canvas").first.bounding_box()
    assert robot.is_visible() is (width >= 1100) and curve is not None
    if width >= 1100:
        beside = robot.bounding_box()
        assert beside is not None and beside["x"] > curve["x"] + curve["width"]
        assert abs(beside["y"] - curve["y"]) < 60
        # closed, the curves have all of the width
        page.click("#player summary")
        wait_until(page, "w => document.querySelector('.plots, #plots').clientWidth > w + 100", curve["width"])
    page.close()


@pytest.mark.parametrize("width", [1400, 390])
def test_what_scrolls_is_reached_by_keyboard(browser: Browser, explorer: Explorer, width: int):
    page = opened_at(browser, explorer, width, 844).page
    page.click("#loops summary")
    page.click("#score summary")
    page.locator("#score tbody tr").first.wait_for(timeout=60_000)
    page.locator("#loops tbody tr").first.wait_for(timeout=60_000)
    assert page.evaluate(SCROLLING) == []
    page.close()


@pytest.mark.parametrize("width", [1400, 390])
def test_what_is_pressed_is_at_least_24_pixels_large(browser: Browser, explorer: Explorer, width: int):
    page = opened_at(browser, explorer, width, 844).page
    page.click("#pin")
    page.click("#faults summary")
    assert page.evaluate(SMALL) == []
    page.close()


def test_a_value_typed_back_is_not_marked(opened: Opened):
    opened.type(GAIN, "3")
    expect(opened.row(GAIN)).to_have_class("setting changed")
    opened.type(GAIN, "2")
    expect(opened.row(GAIN)).to_have_class("setting")
    wait_until(opened.page, "() => document.getElementById('reset').disabled")


def test_arrow_keys_that_are_held_are_one_step_of_undo(opened: Opened):
    field = opened.row(GAIN).locator(".entry input")
    opened.row(GAIN).locator("input[type=range]").focus()
    for _ in range(10):
        opened.page.keyboard.down("ArrowRight")
    opened.page.keyboard.up("ArrowRight")
    expect(field).not_to_have_value("2")
    opened.page.keyboard.press("Control+z")
    expect(field).to_have_value("2")


def test_arrow_keys_that_are_held_on_the_mark_of_a_fault_are_one_step_of_undo(opened: Opened):
    page = opened.page
    page.click("#faults summary")
    page.get_by_role("button", name="Add fault").click()
    mark, onset = page.locator(".fault-mark").first, page.get_by_label("at (s)").last
    mark.wait_for()
    before = onset.input_value()
    mark.focus()
    for _ in range(5):
        page.keyboard.down("ArrowRight")
    page.keyboard.up("ArrowRight")
    expect(onset).not_to_have_value(before)
    page.keyboard.press("Control+z")
    expect(onset).to_have_value(before)


def test_the_numbers_begin_with_the_held_force_and_hold_the_loops_margin(opened: Opened):
    names = opened.page.locator("#numbers .box > span:not(.why)").all_inner_texts()
    assert names[:7] == [
        "hold error", "overshoot", "settling time", "chatter", "lateral error while held", "largest force",
        "loops' margin",
    ]  # fmt: skip
    wait_until(opened.page, "() => /[0-9] dB/.test(document.getElementById('numbers').innerText)")
