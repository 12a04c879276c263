"""Whose page may watch a run: a real browser, which says so itself."""

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from tests.laws.runs import shipped
from tests.robot.live.viewer import Viewer, address_in
from twin.robot.live.server import LiveServer
from twin.robot.run.run import execute

pytestmark = pytest.mark.slow

KNOCK = """address => new Promise(done => {
    const socket = new WebSocket(address, ["foxglove.sdk.v1"]);
    socket.onmessage = event => done(JSON.parse(event.data).op);
    socket.onclose = () => done("closed");
})"""


@pytest.mark.parametrize(
    ("page", "server", "heard"),
    [
        ("localhost", "127.0.0.1", "serverInfo"),
        ("127.0.0.1", "localhost", "serverInfo"),
        # resolved to this machine by every browser, and yet the name of somebody else
        ("evil.localhost", "127.0.0.1", "closed"),
        ("localhost", "evil.localhost", "closed"),
        ("evil.localhost", "evil.localhost", "closed"),
    ],
)
def test_a_page_hears_of_a_run_only_if_both_names_are_ours(
    live: str, pages: int, browser: Browser, page: str, server: str, heard: str
):
    tab = browser.new_page()
    tab.goto(f"http://{page}:{pages}/")
    assert tab.evaluate("origin") == f"http://{page}:{pages}"
    assert tab.evaluate(KNOCK, live.replace("127.0.0.1", server)) == heard
    tab.close()


def test_a_frame_without_rights_is_nobodys(live: str, pages: int, browser: Browser):
    tab = browser.new_page()
    tab.goto(f"http://localhost:{pages}/")
    tab.set_content("<iframe sandbox='allow-scripts' srcdoc='<p>frame</p>'></iframe>")
    frame = tab.frames[1]
    assert frame.evaluate("origin") == "null"
    assert frame.evaluate(KNOCK, live) == "closed"
    tab.close()


class Blank(BaseHTTPRequestHandler):
    """The same page whatever is asked for, and nothing on standard error."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<title>page</title>")

    def log_message(self, *told: object) -> None:
        pass


@pytest.fixture(scope="module")
def pages() -> Iterator[int]:
    """The port of a server of pages; a page that does not come from this machine would be held back by the browser."""
    with ThreadingHTTPServer(("127.0.0.1", 0), Blank) as server:
        serving = threading.Thread(target=server.serve_forever)
        serving.start()
        yield server.server_port
        server.shutdown()
        serving.join()


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a run that waits for its first viewer, token included; at the end one comes."""
    addresses: list[str] = []
    waits = threading.Event()

    def announce(text: str) -> None:
        addresses.append(address_in(text))
        waits.set()

    def serve(folder: Path) -> None:
        with LiveServer(0, announce) as server:
            execute(shipped("fig4_position", "duration_s=0.1"), folder, viewer=server)

    serving = threading.Thread(target=serve, args=(tmp_path_factory.mktemp("live"),))
    serving.start()
    assert waits.wait(60)
    yield addresses[0]
    with Viewer(addresses[0]) as viewer:
        viewer.subscribe("/plant")
        viewer.to_the_end()
    serving.join(60)
