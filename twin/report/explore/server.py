"""HTTP and WebSocket server of the explorer on the loopback address, with one link to each of its pages.

A page sends requests as JSON; every request is answered. Only the newest request of each kind counts: older ones are
answered with "outdated", refused ones with "refused". The page gets JSON, or, if there are samples: the length of the
JSON (unsigned 32 bits), the JSON padded with spaces to a multiple of 4 bytes, and the samples as 32-bit floats, all
little-endian.
"""

import asyncio
import base64
import contextlib
import json
import logging
import re
import secrets
import socket
import struct
import sys
import threading
import time
from collections.abc import Mapping
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from twin.kernel.cache_folder import cache_folder
from twin.kernel.errors import ComponentFailed, InputRefused, SafetyTrip, TwinError, terminal_text
from twin.kernel.gate import LOOPBACK_HOST, Gate, own_page_policy
from twin.kernel.process.guard import JobFailure, JobLoadFailure, run_guarded
from twin.kernel.process.job import JobLimits
from twin.kernel.process.warm import WarmProcess
from twin.report.explore import ANSWER_JOB, EXPLORED_FOLDER

if TYPE_CHECKING:
    from twin.report.explore.session import LiveSession

MAX_MESSAGE_BYTES = 2**16
"""Maximum size of a page's message (bytes)."""
MAX_PAGES = 16
MAX_WAITING = 64
"""Maximum number of waiting requests of one page; at most one of each kind."""
ROBOT_INTERVAL = 0.2
"""Interval (s) between updates of a page with the robot's state."""
PROCESS_COUNT = 2
OUTDATED_TIMEOUT = 3.0
"""Maximum time (s) that an outdated request occupies a process."""
LINK_PATH = "/link"
CLOSE_TIMEOUT = 1.0
"""Timeout for closing connections (s)."""

# protocol errors are reported to the page; in the terminal they would only distract
_SILENT_LOGGER = logging.getLogger("twin.report.explore")
_SILENT_LOGGER.setLevel(logging.CRITICAL + 1)

EXPLORER_ASSETS = files("twin.report.explore") / "assets"
REPORT_ASSETS = files("twin.report.page") / "assets"
REPORT_SCRIPTS = ("data", "clock", "look", "plot", "plots", "scene", "player")
"""Scripts shared with the report, in the order of their dependencies."""
MEDIA_TYPES = {
    kind: f"text/{name}; charset=utf-8" for kind, name in (("css", "css"), ("js", "javascript"), ("html", "html"))
}
CONTENT_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; connect-src 'self' {link}; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
PAGE_OPERATIONS = (
    "describe", "show", "recorded", "runs", "log", "save", "command", "onset", "loops", "score",
)  # fmt: skip
"""Operations of a page that a process answers."""
SLOW_OPERATIONS = ("loops", "score")
"""Operations that take seconds. All pages share one process for them, so that another one is free for the pictures."""
STUDY_JOB = "twin.studies.command:answer_study"
RECORD_JOB = "twin.robot.live.runs:recorded_runs"
FORBIDDEN_TEXT = (
    "This page is shown only to the browser that twin explore has opened. Open the address that it has printed in the "
    "terminal; the part after # in yours may be appended to it.\n"
)


def read_assets() -> dict[str, tuple[bytes, str]]:
    """Return the files that an explorer page loads: path -> (content, media type)."""
    own = {
        asset.name: (asset.read_bytes(), MEDIA_TYPES[asset.name.rpartition(".")[2]])
        for asset in EXPLORER_ASSETS.iterdir()
    }
    found = {f"/{name}": content for name, content in own.items()}
    found["/"] = found.pop("/explore.html")
    shared = "\n".join((REPORT_ASSETS / f"{name}.js").read_text("utf-8") for name in REPORT_SCRIPTS)
    found["/report.css"] = (REPORT_ASSETS / "page.css").read_bytes(), MEDIA_TYPES["css"]
    found["/report.js"] = f'"use strict";\n{shared}'.encode(), MEDIA_TYPES["js"]
    return found


def lasting_token(port: int) -> str:
    """Return the access token of the server at `port`, the same after a restart, so that its pages reconnect."""
    path = cache_folder("explore") / f"{port}.token"
    with contextlib.suppress(OSError, UnicodeError):
        token = path.read_text("ascii").strip()
        if len(token) >= 32:
            return token
    token = secrets.token_urlsafe(32)
    with contextlib.suppress(OSError):
        path.touch(0o600)
        path.write_text(token, "ascii")
    return token


def error_message(problem: TwinError) -> str:
    """Return the message of an error for an explorer page; internal errors are printed in full on the terminal."""
    lines = terminal_text(str(problem)).splitlines()
    if type(problem) is not TwinError:
        return lines[0]
    print("\n".join(lines), file=sys.stderr)
    return f"an internal error of twin, see the terminal: {lines[-1]}"


class OutdatedAnswer(TwinError):
    """Exception that cancels an answer: a newer state was requested, and it exceeded `OUTDATED_TIMEOUT`."""


class AnsweringProcess:
    """A process kept running to answer requests of explorer pages."""

    def __init__(self, limits: JobLimits):
        self._process = WarmProcess(ANSWER_JOB, limits, self._raise_if_stale)
        self.close = self._process.close

    def answer(self, base: Mapping[str, Any], ask: Mapping[str, Any], outdated: threading.Event) -> dict[str, Any]:
        """Answer the request `ask` of a page of `PageBase` by `twin.report.explore.worker.answer_request`.

        `outdated` is set when a newer answer is requested. ComponentFailed: a drive crashed, hung or ended the process.
        OutdatedAnswer: the answer was cancelled. TwinError: an internal error.
        """
        self._outdated, self._began = outdated, time.monotonic()
        try:
            found: dict[str, Any] = self._process.answer(
                {"here": str(Path.cwd()), "base": dict(base), "ask": dict(ask)}
            )
        except (JobFailure, JobLoadFailure) as ended:
            raise ComponentFailed(str(ended)) from None
        return found

    def _raise_if_stale(self) -> None:
        if self._outdated.is_set() and time.monotonic() - self._began > OUTDATED_TIMEOUT:
            raise OutdatedAnswer("given up for a newer state")


class ExplorerServer:
    """Server of the explorer, for a `PageBase` and perhaps a session with a robot that pages show.

    It ends `linger` seconds after its last page was closed.
    """

    def __init__(self, base: Mapping[str, Any], limits: JobLimits, linger: float, session: "LiveSession | None" = None):
        self.base, self.limits, self.session = {"settings": (), **base}, limits, session
        self._linger = linger
        self._processes = [AnsweringProcess(limits) for _ in range(PROCESS_COUNT)]
        self._reports: list[Path] = []
        self._answering: set[asyncio.Task[dict[str, Any]]] = set()
        self._slow = asyncio.Lock()
        self._pages = 0
        self._ending: asyncio.TimerHandle | None = None

    def begin(self, settings: list[str]) -> None:
        """Check the explorer's command line and load its experiment."""
        found = self._processes[0].answer(self.base, {"op": "begin", "settings": settings}, threading.Event())
        if "refused" in found:
            raise InputRefused(found["refused"])
        self.base = found.pop("base")
        self._begun = found

    def serve(self, listening: socket.socket, token: str) -> None:
        """Serve explorer pages until the last one has been closed for a while, or Ctrl-C."""
        try:
            asyncio.run(self._serve(listening, token))
        finally:
            for process in self._processes:
                process.close()

    async def _serve(self, listening: socket.socket, token: str) -> None:
        port = listening.getsockname()[1]
        self._gate = Gate(own_page_policy(port), token)
        self._policy = CONTENT_POLICY.format(link=f"ws://{LOOPBACK_HOST}:{port}")
        self._assets = read_assets()
        self._loop, self._over = asyncio.get_running_loop(), asyncio.Event()
        self._idle: asyncio.LifoQueue[AnsweringProcess] = asyncio.LifoQueue()
        for process in reversed(self._processes):
            self._idle.put_nowait(process)
        following = asyncio.create_task(self.session.attend()) if self.session else None
        async with serve(
            self._attend,
            sock=listening,
            process_request=self._admit,
            compression=None,
            max_size=MAX_MESSAGE_BYTES,
            close_timeout=CLOSE_TIMEOUT,
            server_header=None,
            logger=_SILENT_LOGGER,
        ):
            await self._over.wait()
        if following:
            following.cancel()

    def end(self) -> None:
        """End the server's `serve`, from any thread."""
        self._loop.call_soon_threadsafe(self._over.set)

    async def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer an HTTP request; return None to admit a request that opens the WebSocket link.

        The first request of a browser carries the token in its address; the answer sets a cookie and redirects.
        """
        path = request.path.partition("?")[0]
        # websockets before 17 ends a connection with another method without an answer
        reads = getattr(request, "method", "GET") == "GET"
        if refusal := self._gate.refusal(request.headers, changes=path == LINK_PATH or not reads):
            return self._response(HTTPStatus.FORBIDDEN, f"{terminal_text(refusal)}\n")
        if not self._gate.knows_cookie(request.headers):
            if path != "/" or not reads or not self._gate.knows(request.path):
                return self._response(HTTPStatus.FORBIDDEN, FORBIDDEN_TEXT)
            cookie = f"{self._gate.policy.cookie}={self._gate.token}; HttpOnly; SameSite=Strict; Path=/"
            return self._response(HTTPStatus.SEE_OTHER, "", {"Location": "/", "Set-Cookie": cookie})
        if not reads:
            return self._response(HTTPStatus.METHOD_NOT_ALLOWED, "expected GET\n")
        if path == LINK_PATH:
            full = self._pages >= MAX_PAGES
            return self._response(HTTPStatus.SERVICE_UNAVAILABLE, f"{MAX_PAGES} pages are open\n") if full else None
        if path in self._assets:
            content, kind = self._assets[path]
            return self._response(HTTPStatus.OK, content, {"Content-Type": kind})
        return await self._report(path)

    async def _report(self, path: str) -> Response:
        found = re.fullmatch(r"/recorded/([0-9]{1,6})", path)
        if not found or int(found[1]) >= len(self._reports):
            return self._response(HTTPStatus.NOT_FOUND, "no such page\n")
        content = await asyncio.to_thread(self._reports[int(found[1])].read_bytes)
        # sandboxed: scripts of the report cannot reach this server
        alone = {"Content-Type": MEDIA_TYPES["html"], "Content-Security-Policy": "sandbox allow-scripts"}
        return self._response(HTTPStatus.OK, content, alone)

    def _response(self, status: HTTPStatus, body: str | bytes, more: Mapping[str, str] | None = None) -> Response:
        content = body.encode() if isinstance(body, str) else body
        headers = {
            **SECURITY_HEADERS,
            "Content-Security-Policy": self._policy,
            "Content-Type": "text/plain; charset=utf-8",
            "Content-Length": str(len(content)),
            "Connection": "close",
        }
        return Response(status, status.phrase, Headers({**headers, **(more or {})}), content)

    async def answer(self, ask: Mapping[str, Any], outdated: threading.Event) -> dict[str, Any]:
        """Answer a page's request with a free process; a message under "refused" or "failed" if that is impossible."""
        task = asyncio.create_task(self._answer(ask, outdated))
        self._answering.add(task)
        task.add_done_callback(self._answering.discard)
        # shielded: closing the page must not release a process that is still busy
        return await asyncio.shield(task)

    async def _answer(self, ask: Mapping[str, Any], outdated: threading.Event) -> dict[str, Any]:
        async with self._slow if ask["op"] in SLOW_OPERATIONS else contextlib.nullcontext():
            process = await self._idle.get()
            try:
                return await asyncio.to_thread(process.answer, self.base, ask, outdated)
            except OutdatedAnswer:
                return {"outdated": True}
            except TwinError as problem:
                return {"failed": error_message(problem)}
            finally:
                self._idle.put_nowait(process)

    async def accept(self, ask: Mapping[str, Any]) -> dict[str, Any]:
        """Forward a page's acceptance of proposed parameters to the session's twin."""
        if self.session is None:
            return {"refused": "--follow: twin explore was started without a session"}
        refused = await self.session.accept(ask.get("proposal"))
        return {"refused": refused} if refused else {}

    async def adopt(self, ask: Mapping[str, Any], outdated: threading.Event) -> dict[str, Any]:
        """Return the page's state with the robot's accepted parameters added."""
        accepted = self.session.accepted if self.session else []
        if not accepted:
            return {"refused": "nothing was accepted in this session"}
        return await self.answer({**ask, "accepted": accepted}, outdated)

    async def record(self, ask: Mapping[str, Any]) -> dict[str, Any]:
        """Record a run of a page's state, like `twin run`, and write its report."""
        found = await self.answer({**ask, "op": "command"}, threading.Event())
        if "refused" in found or "failed" in found:
            return found
        try:
            folder = await asyncio.to_thread(record_run, self.base["experiment"], found, self.limits)
        except TwinError as problem:
            return {"failed": error_message(problem)}
        self._reports.append(folder / "report.html")
        return {"recorded": str(folder), "report": f"/recorded/{len(self._reports) - 1}"}

    async def _attend(self, link: ServerConnection) -> None:
        self._pages += 1
        if self._ending:
            self._ending.cancel()
        try:
            await PageLink(link, self).attend(self._begun)
        finally:
            self._pages -= 1
            if not self._pages:
                self._ending = self._loop.call_later(self._linger, self._over.set)


class RequestQueue:
    """Queue of one page's requests, answered one after the other; only the newest of each kind counts.

    The event `outdated` is set when a newer answer of the kind being answered is requested.
    """

    def __init__(self) -> None:
        self.outdated = threading.Event()
        self._waiting: dict[str, dict[str, Any]] = {}
        self._some = asyncio.Event()
        self._kind = ""

    def add(self, kind: str, ask: dict[str, Any]) -> tuple[dict[str, Any] | None, dict[str, Any]]:
        """Add a page's request to the queue. Return the request that will not be served, if any, and its answer."""
        before = self._waiting.get(kind)
        if before is None and len(self._waiting) >= MAX_WAITING:
            return ask, {"refused": f"{MAX_WAITING} requests of this page are waiting; try again"}
        self._waiting[kind] = ask
        if kind == self._kind:
            self.outdated.set()
        self._some.set()
        return before, {"outdated": True}

    async def next(self) -> dict[str, Any]:
        """Return the request that has waited longest; if the queue is empty, wait for one."""
        self._kind = ""
        while not self._waiting:
            self._some.clear()
            await self._some.wait()
        self._kind = next(iter(self._waiting))
        self.outdated = threading.Event()
        return self._waiting.pop(self._kind)


class PageLink:
    """The WebSocket link of the explorer to one page."""

    def __init__(self, link: ServerConnection, server: ExplorerServer):
        self._link, self._server = link, server
        # separate queues, so that slow requests do not delay the picture
        self._lanes = {name: RequestQueue() for name in ("", *SLOW_OPERATIONS, "accept")}
        self._tasks: set[asyncio.Task[None]] = set()

    async def attend(self, greeting: Mapping[str, Any]) -> None:
        """Send the `greeting` to the page, then answer its requests until it is closed."""
        await self._send({"op": "begin", **greeting})
        answering = [asyncio.create_task(self._answer(lane)) for lane in self._lanes.values()]
        if self._server.session:
            answering.append(asyncio.create_task(self._show(self._server.session)))
        try:
            async for frame in self._link:
                await self._receive(frame)
        except ConnectionClosed:
            pass
        finally:
            for task in (*answering, *self._tasks):
                task.cancel()
            for lane in self._lanes.values():
                lane.outdated.set()

    async def _receive(self, frame: str | bytes) -> None:
        try:
            ask = json.loads(frame)
        except (ValueError, RecursionError):
            return
        if not isinstance(ask, dict) or not isinstance(ask.get("op"), str):
            return
        kind = f"{ask['op']} {str(ask.get('slot', ''))[:40]}"
        if ask["op"] != "record":
            unserved, answer = self._lanes.get(ask["op"], self._lanes[""]).add(kind, ask)
        elif self._tasks:
            unserved, answer = ask, {"refused": "a run of this page is being recorded; record again when it is done"}
        else:
            unserved, answer = None, {}
            task = asyncio.create_task(self._record(ask))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        if unserved is not None:
            await self._reply(unserved, answer)

    async def _record(self, ask: Mapping[str, Any]) -> None:
        """Record a run for the page without delaying other answers."""
        found = await self._server.record(ask)
        await self._reply(ask, found)

    async def _reply(self, ask: Mapping[str, Any], found: Mapping[str, Any]) -> None:
        await self._send({"op": ask["op"], "id": ask.get("id"), "slot": ask.get("slot"), **found})

    async def _answer(self, lane: "RequestQueue") -> None:
        while True:
            ask = await lane.next()
            if ask["op"] in PAGE_OPERATIONS:
                found = await self._server.answer(ask, lane.outdated)
            elif ask["op"] == "accept":
                found = await self._server.accept(ask)
            elif ask["op"] == "adopt":
                found = await self._server.adopt(ask, lane.outdated)
            else:
                found = {"refused": "not understood"}
            await self._reply(ask, found)

    async def _show(self, session: "LiveSession") -> None:
        shown = -1
        while True:
            if shown != session.version:
                shown = session.version
                await self._send({"op": "robot", **session.to_dict()})
            await asyncio.sleep(ROBOT_INTERVAL)

    async def _send(self, answer: dict[str, Any]) -> None:
        # the page may be gone
        with contextlib.suppress(ConnectionClosed):
            if "block" not in answer:
                await self._link.send(json.dumps(answer))
                return
            block = base64.b64decode(answer.pop("block"))
            head = json.dumps(answer).encode()
            head += b" " * (-len(head) % 4)
            await self._link.send(struct.pack("<I", len(head)) + head + block)


def record_run(experiment: str, how: Mapping[str, Any], limits: JobLimits) -> Path:
    """Record a run in its own process, write its report, return its folder; `how`: "drive", "body", "settings"."""
    folders: list[str] = []

    def on_note(note: dict[str, Any]) -> None:
        if "folder" in note:
            folders.append(note["folder"])

    arguments = {"experiments": [experiment], "out": None, "limit_step": limits.step, "results": str(EXPLORED_FOLDER)}
    arguments |= {key: how[key] for key in ("drive", "body", "settings")}
    # a run with a safety trip is recorded too, and its report shows it
    with contextlib.suppress(SafetyTrip):
        run_guarded(RECORD_JOB, arguments, limits, on_note)
    report = {"study": "twin.report.page.page:write_report", "asked": {"runs": [Path(folders[0])]}}
    run_guarded(STUDY_JOB, report)
    return Path(folders[0])
