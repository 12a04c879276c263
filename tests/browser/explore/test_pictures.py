"""What the page draws: zoom, faults, loops, claims, layouts of the paper, maps."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import BrowserContext, expect

from tests.browser.explore.explorer import GAIN, SPRING, Explorer, Opened, wait_until
from tests.laws.runs import shipped
from twin.report.explore.figures import fig4_runs
from twin.report.explore.page_state import PageBase, parse_state
from twin.studies.faults.onsets import default_onsets, healthy_run
from twin.studies.paper.claim import tally
from twin.studies.paper.fig4 import fig4_score

pytestmark = pytest.mark.slow


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


def test_a_fault_is_placed_on_the_time_axis_moved_and_repaired(context: BrowserContext, tmp_path: Path):
    with Explorer(tmp_path, "pressing") as explorer:
        opened = Opened(context.new_page(), explorer.address)
        page, before = opened.page, opened.number("largest force")
        page.click("#faults summary")
        page.select_option("#faults select", "drive_runaway")
        page.click("#faults button")
        # it begins where twin faults lets it begin in contact
        experiment = shipped("pressing")
        contact = default_onsets(healthy_run(experiment))[1] * experiment.cosim.tick
        expect(page.get_by_label("at (s)").last).to_have_value(f"{contact:g}", timeout=20_000)
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
        opened.page.get_by_text("Remove").click()
        expect(page.locator("#problem")).to_be_hidden()
        expect(page.locator(".box", has_text="largest force").first.locator("strong")).to_have_text(before)


def test_a_fault_without_a_monitor_says_that_there_is_none(context: BrowserContext, explorer: Explorer):
    page = Opened(context.new_page(), explorer.address).page
    page.click("#faults summary")
    page.select_option("#faults select", "encoder_bias")
    page.click("#faults button")
    reaction = page.locator(".box", has_text="monitor trips after the fault")
    expect(reaction).to_contain_text("no monitor here", timeout=20_000)
    expect(reaction.locator("strong")).to_have_text("none")


def test_the_first_numbers_are_what_a_controller_is_chosen_by(opened: Opened):
    boxes = opened.page.locator("#numbers .box").all_inner_texts()
    assert boxes[:6] == [
        "0.094 N\nhold error", "0.0 %\novershoot", "0.85 s\nsettling time", "none\nchatter\nbelow 0.05 N",
        "2.77 mm\nlateral error while held", "4.96 N\nlargest force",
    ]  # fmt: skip


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
    score = fig4_score(fig4_runs(parse_state(PageBase("fig4_force_position"), {})))
    (held, judged), (own, checks) = tally(score.claims), tally(score.quality)
    expect(page.locator("#score .hint")).to_contain_text(
        f"{held} of {judged} of the paper's text, {own} of {checks} of this run's own checks hold; "
        "0 turned over. All four runs of Fig. 4"
    )
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


def test_an_experiment_of_tasks_has_the_claims_of_fig_5_and_no_layout(context: BrowserContext, tmp_path: Path):
    with Explorer(tmp_path, "rolling") as explorer:
        opened = Opened(context.new_page(), explorer.address)
        page = opened.page
        expect(page.locator("#layout option")).to_have_count(1)
        page.click("#score summary")
        expect(page.locator("#score summary")).to_have_text("Scorecard of Fig. 5")
        expect(page.locator("#score tbody tr", has_text="1 roll: radius over that asked for")).to_contain_text("holds")
        assert opened.messages == []
