"""Pages of the explorer, and pages of others: who may see it, and what becomes of one without its server."""

import signal
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, WebSocketRoute, expect

from tests.browser.explore.explorer import FORCE, GAIN, SPRING, Explorer, Opened, wait_until
from twin.kernel.cache_folder import cache_folder

pytestmark = pytest.mark.slow


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
