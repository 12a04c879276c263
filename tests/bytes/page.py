"""A page of the explorer, as a browser is one: it opens the printed address and asks over the link."""

import hashlib
import http.client
import json
import os
import re
import signal
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

TIMEOUT = 300.0
"""s, of one answer on a busy machine."""
ADDRESS = re.compile(r"http://127\.0\.0\.1:(\d+)/\?token=(\S+)")


def page_answers(
    words: str, asks: Sequence[Mapping[str, Any]], as_twin: Callable[[list[str], int, int], None]
) -> dict[str, str]:
    """Return the answers of `twin explore WORDS`: the greeting, then one per request, as text by number and operation.

    Args:
        words: the command line behind `explore`.
        asks: requests, each sent when the one before was answered.
        as_twin: ends the calling process as `twin`, see the worker.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.close(reading)
        as_twin(["explore", *words.split(), "--no-browser", "--port", "0", "--linger-s", "0"], writing, 2)
    os.close(writing)
    try:
        with os.fdopen(reading, encoding="utf-8") as output:
            printed = ""
            for line in output:
                printed += line
                if found := ADDRESS.search(line):
                    # it ends by itself after its last page
                    return _asked(int(found[1]), found[2], asks)
        return {"page": printed or "twin explore printed no address"}
    except BaseException:
        os.kill(child, signal.SIGTERM)
        raise
    finally:
        os.waitpid(child, 0)


def _asked(port: int, token: str, asks: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    from websockets.sync.client import connect

    first = http.client.HTTPConnection("127.0.0.1", port, timeout=TIMEOUT)
    first.request("GET", f"/?token={token}")
    cookie = (first.getresponse().getheader("Set-Cookie") or "").partition(";")[0]
    headers = {"Cookie": cookie, "Origin": f"http://127.0.0.1:{port}"}
    with connect(f"ws://127.0.0.1:{port}/link", additional_headers=headers, compression=None, max_size=None) as link:
        found = {"0: begin": _text(link.recv(TIMEOUT))}
        for number, ask in enumerate(asks, 1):
            link.send(json.dumps({**ask, "id": number}))
            found[f"{number}: {ask['op']}"] = _text(link.recv(TIMEOUT))
    return found


def _text(answer: str | bytes) -> str:
    """An answer as JSON with a value per line; of samples the digest."""
    if isinstance(answer, bytes):
        (size,) = struct.unpack_from("<I", answer)
        samples = hashlib.sha256(answer[4 + size :]).hexdigest()
        return f"{_text(answer[4 : 4 + size].decode())}\nsamples {samples}"
    return json.dumps(json.loads(answer), indent=1, sort_keys=True)
