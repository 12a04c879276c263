"""The robot beside the explored experiment: a click accepts what twin proposes, another one takes it over."""

import json
import re
import signal
from pathlib import Path
from urllib.parse import unquote

import pytest
from playwright.sync_api import BrowserContext, expect

from tests.browser.explore.explorer import Explorer, Opened
from tests.studies.shadow.live_sessions import SPRING, SoftRobot

pytestmark = pytest.mark.slow


def test_a_click_accepts_what_twin_proposes_and_another_one_asks_for_the_robot_as_it_is_now(
    context: BrowserContext, tmp_path: Path
):
    with (
        SoftRobot(tmp_path, speed=4.0) as robot,
        Explorer(tmp_path, "fig4_force_position", "--follow", robot.address) as explorer,
    ):
        opened = Opened(context.new_page(), explorer.address)
        page = opened.page
        before = opened.number("force at the end")
        beside = page.locator("#beside-robot")
        accept = beside.get_by_role("button", name="Accept")
        accept.wait_for(timeout=60_000)
        expect(beside).to_contain_text("Twin proposes: k_s of joint 2 was 1.0")
        expect(beside.locator(".line")).to_contain_text("500 Hz")
        expect(beside.locator(".forces span")).to_have_text(
            [re.compile(rf"^{name} -?\d\.\d\d N$") for name in ("robot, by its counts", "twin", "measured")]
        )
        # looking on changes nothing
        assert page.url == f"{explorer.origin}/"
        accept.click()
        expect(beside.locator(".accepted")).to_contain_text("Accepted by twin: k_s of joint 2", timeout=20_000)
        expect(accept).to_be_hidden()
        expect(beside).to_contain_text("No proposal.")
        events = [event.text for event in robot.end().events]
        sentence = beside.locator(".accepted").inner_text().removeprefix("Accepted by twin: ")
        assert f"accepted: {sentence}" in events
        expect(beside.locator(".problem")).to_contain_text("Trying again", timeout=20_000)
        # what was accepted can be asked for, also after the session
        beside.get_by_role("button", name="Use in this experiment").click()
        expect(page.locator(".fault label")).to_have_text("spring_softened", timeout=20_000)
        fault = json.loads(unquote(page.url.partition("#fault=")[2]))
        assert (fault["target"], fault["onset_s"]) == ("joint_2", 0) and abs(fault["magnitude"] - SPRING) < 0.01
        expect(page.locator(".box", has_text="force at the end").locator("strong")).to_contain_text(f"{before[:4]} → ")
        page.keyboard.press("Control+z")
        expect(page.locator(".fault")).to_have_count(0)
        expect(page.locator(".box", has_text="force at the end").locator("strong")).to_have_text(before)
        assert opened.messages == []
        # an end of the session does not hold up that of the explorer
        assert explorer.kill(signal.SIGINT) == 130
