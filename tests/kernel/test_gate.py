"""Who may connect, and who may tune."""

import pytest
from websockets.datastructures import Headers

from twin.kernel.errors import InputRefused
from twin.kernel.gate import Gate, viewer_policy


def refusal(*headers: tuple[str, str], origins: tuple[str, ...] = ()) -> str:
    return Gate(viewer_policy(origins)).refusal(Headers(headers))


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost", "LOCALHOST:1", "[::1]:8765"])
@pytest.mark.parametrize(
    "origin",
    [
        "https://app.foxglove.dev",
        "https://lichtblick-suite.github.io",
        "file://",
        "http://localhost:8080",
        "http://127.0.0.1",
        "https://[::1]:3000",
    ],
)
def test_viewers_of_this_machine_and_the_known_ones_may_come(host: str, origin: str):
    assert refusal(("Host", host), ("Origin", origin)) == ""
    assert refusal(("Host", host)) == ""


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:8765",
        "localhost.evil.example",
        "evil@localhost",
        "localhost:8765:80",
        "127.0.0.1.nip.io",
        "127.0.0.2",
        "0.0.0.0:8765",
        "localhost ",
        "",
    ],
)
def test_a_name_that_is_not_ours_is_refused(host: str):
    assert refusal(("Host", host)).startswith(f"Host {host}: ")


def test_there_is_one_host_and_at_most_one_origin():
    assert refusal() != ""
    assert refusal(("Host", "localhost"), ("Host", "localhost")) != ""
    assert refusal(("Host", "localhost"), ("Origin", "file://"), ("Origin", "file://")) != ""


@pytest.mark.parametrize(
    "origin",
    [
        "null",
        "",
        "http://evil.example",
        "https://app.foxglove.dev.evil.example",
        "https://app.foxglove.dev:444",
        "http://app.foxglove.dev",
        "http://localhost.evil.example",
        "http://localhost@evil.example",
        "http://evil.example/http://localhost",
        "http://localhost:8080/",
        "file:///etc",
    ],
)
def test_other_pages_are_refused(origin: str):
    assert refusal(("Host", "localhost"), ("Origin", origin)).startswith(f"a page of {origin}: ")


def test_an_origin_can_be_added():
    viewer = "https://viewer.example:8443"
    assert refusal(("Host", "localhost"), ("Origin", viewer)) != ""
    assert refusal(("Host", "localhost"), ("Origin", viewer), origins=(viewer,)) == ""
    assert refusal(("Host", "evil.example"), ("Origin", viewer), origins=(viewer,)) != ""


@pytest.mark.parametrize("origin", ["null", "*", "https://*", "viewer.example", "https://viewer.example/", ""])
def test_what_is_no_origin_cannot_be_added(origin: str):
    with pytest.raises(InputRefused, match=r"^origin .*: expected scheme://host"):
        viewer_policy([origin])


def test_the_token_is_known_by_itself_only():
    gate = Gate(viewer_policy())
    assert len(gate.token) == 22
    assert gate.token != Gate(viewer_policy()).token
    assert gate.knows(f"/?token={gate.token}") is True
    assert gate.knows(f"/any/path?a=b&token={gate.token}") is True
    assert gate.knows("/") is None
    for wrong in (gate.token[:-1], f"{gate.token}x", "", "%C3%A9"):
        assert not gate.knows(f"/?token={wrong}")
