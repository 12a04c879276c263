"""Settings of the explorer as a user has them: in a real browser, while a slider moves."""

from pathlib import Path

import pytest
from playwright.sync_api import BrowserContext, expect

from tests.browser.explore.explorer import FORCE, GAIN, SPRING, Explorer, Opened, wait_until

pytestmark = pytest.mark.slow


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
