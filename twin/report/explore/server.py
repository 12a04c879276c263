"""The server of the explorer: pages of its own on this machine's own address, and one link to each of them.

A page sends what it wants to see as JSON; of requests of one kind the newest counts, and what was not begun yet is
dropped. It gets JSON, or where there are samples: the length of the JSON (unsigned 32 bits), the JSON padded with
spaces to a multiple of 4 bytes, and the samples as 32 bit floats, all little-endian.
"""

import asyncio
import base64
import contextlib
import json
import secrets
import socket
import struct
import sys
import threading
from collections.abc import Awaitable, Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect
from websockets.datastructures import Headers

from twin.kernel.cache_folder import cache_folder
from twin.kernel.errors import InputRefused, SafetyTrip, TwinError, plain
from twin.kernel.live import OwnPageGate
from twin.kernel.process.guard import guarded
from twin.kernel.process.job import JobLimits
from twin.report.explore import EXPLORED_FOLDER
from twin.report.explore.processes import AnsweringProcess, Outdated

if TYPE_CHECKING:
    from twin.report.explore.session import LiveSession

LARGEST = 2**16
"""Bytes of the largest message of a page."""
PAGES = 16
"""Pages that may be open at the same time."""
MOST_WAITING = 64
"""Requests of one page that may wait; there is one of each kind at most."""
ROBOT_PACE = 0.2
"""s between two looks of a page at the robot."""
PROCESSES = 2
"""That run experiments."""
GOODBYE = 1.0
"""How long (s) connections may take to end."""

ASSETS = files("twin.report.explore") / "assets"
SHARED = files("twin.report.page") / "assets"
OF_REPORT = ("data", "clock", "look", "plot", "plots", "scene", "player")
"""Scripts that the explorer has in common with the report, in an order in which each finds what it needs."""
KINDS = {"css": "text/css", "js": "text/javascript", "html": "text/html"}
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; connect-src 'self' {link}; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
FROM_PAGES = (
    "describe", "show", "recorded", "runs", "log", "save", "command", "onset", "loops", "score",
)  # fmt: skip
"""What a page may ask a process for."""
STUDY_JOB = "twin.studies.command:answered"
"""A study in a process of its own."""
RECORD_JOB = "twin.robot.live.runs:recorded_runs"
"""What `twin run` does."""
STRANGER = (
    "This page is shown only to the browser that twin explore has opened. Open the address that it has printed in the "
    "terminal; what stands behind # in yours may be put behind that one.\n"
)


def read_assets() -> dict[str, tuple[bytes, str]]:
    """What a page loads: (content, media type) by its path."""
    own = {asset.name: (asset.read_bytes(), KINDS[asset.name.rpartition(".")[2]]) for asset in ASSETS.iterdir()}
    found = {f"/{name}": content for name, content in own.items()}
    found["/"] = found.pop("/explore.html")
    shared = "\n".join((SHARED / f"{name}.js").read_text("utf-8") for name in OF_REPORT)
    found["/report.css"] = (SHARED / "page.css").read_bytes(), KINDS["css"]
    found["/report.js"] = f'"use strict";\n{shared}'.encode(), KINDS["js"]
    return found


def lasting_token(port: int) -> str:
    """The token of the server at `port`: the same after it was started anew, so that its pages come back.

    Raises:
        InputRefused: there is no cache folder of the user's own.
    """
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


def sentence(problem: TwinError) -> str:
    """What a page shows of it; the whole of a mistake of ours goes to the terminal."""
    lines = plain(str(problem)).splitlines()
    if type(problem) is not TwinError:
        return lines[0]
    print("\n".join(lines), file=sys.stderr)
    return f"a mistake of twin, see the terminal: {lines[-1]}"


class Guard:
    """Lets no request through that is not of the server's own page; the first one brings the token in its address.

    Args:
        app: that it stands before.
        gate: asked about every request.
    """

    def __init__(self, app: ASGIApp, gate: OwnPageGate):
        self._app, self._gate = app, gate
        link = gate.origin.replace("http", "ws", 1)
        self._headers = HEADERS | {"Content-Security-Policy": POLICY.format(link=link)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """See ASGI."""
        if scope["type"] not in ("http", "websocket"):
            return
        headers = Headers([(name.decode("latin-1"), value.decode("latin-1")) for name, value in scope["headers"]])
        changes = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if refusal := self._gate.refusal(headers, changes):
            await self._refuse(f"{plain(refusal)}\n", scope, receive, send)
            return
        if not self._has_cookie(headers):
            await self._first(scope, receive, send)
            return

        async def dressed(message: Any) -> None:
            if message["type"] == "http.response.start":
                given = {name.lower() for name, _ in message.get("headers", [])}
                more = [(name.encode(), value.encode()) for name, value in self._headers.items()]
                added = [pair for pair in more if pair[0].lower() not in given]
                message = {**message, "headers": [*message.get("headers", []), *added]}
            await send(message)

        await self._app(scope, receive, dressed)

    def _has_cookie(self, headers: Headers) -> bool:
        pairs = [pair.strip().partition("=") for line in headers.get_all("Cookie") for pair in line.split(";")]
        return any(name == self._gate.cookie and self._gate.knows(value) for name, _, value in pairs)

    async def _first(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Of a browser without the cookie: it gets one for the token in the address, and nothing else."""
        if scope["type"] == "http" and scope["path"] == "/":
            given = Request(scope).query_params.get("token")
            if self._gate.knows(given):
                answer = RedirectResponse("/", 303, HEADERS)
                answer.set_cookie(self._gate.cookie, str(given), httponly=True, samesite="strict")
                await answer(scope, receive, send)
                return
        await self._refuse(STRANGER, scope, receive, send)

    async def _refuse(self, text: str, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": "refused"})
        else:
            await PlainTextResponse(text, 403, HEADERS)(scope, receive, send)


class ExplorerServer:
    """Answers pages until the last one has been closed for a while.

    Args:
        base: fields of `twin.report.explore.asked.Base`.
        limits: of each process that runs experiments.
        linger: how long (s) it goes on after the last page was closed.
        session: with a robot, that pages show; None: there is none.
    """

    def __init__(self, base: Mapping[str, Any], limits: JobLimits, linger: float, session: "LiveSession | None" = None):
        self.base, self.limits, self.session = {"settings": (), **base}, limits, session
        self._linger = linger
        self._processes = [AnsweringProcess(limits) for _ in range(PROCESSES)]
        self._reports: list[Path] = []
        self._answering: set[asyncio.Task[dict[str, Any]]] = set()
        self._pages = 0
        self._ending: asyncio.TimerHandle | None = None

    def begin(self, settings: list[str]) -> None:
        """Look at the command line.

        Raises:
            InputRefused: the experiment is refused.
            TwinError: see `AnsweringProcess.answer`.
        """
        found = self._processes[0].answer(self.base, {"op": "begin", "settings": settings}, threading.Event())
        if "refused" in found:
            raise InputRefused(found["refused"])
        self.base = found.pop("base")
        self._begun = found

    def serve(self, listening: socket.socket, token: str) -> None:
        """Until the last page has been closed for a while, or Ctrl-C.

        Raises:
            KeyboardInterrupt: Ctrl-C.
        """
        assets = read_assets()
        routes: list[Any] = [Route(path, _sending(*content)) for path, content in assets.items()]
        routes += [Route("/recorded/{number:int}", self._report), WebSocketRoute("/link", self._attend)]
        gate = OwnPageGate(listening.getsockname()[1], token)
        config = uvicorn.Config(
            Guard(Starlette(routes=routes), gate),
            log_level="critical",
            access_log=False,
            server_header=False,
            lifespan="off",
            ws_max_size=LARGEST,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=int(GOODBYE),
        )
        self._server = uvicorn.Server(config)
        try:
            self._server.run(sockets=[listening])
        finally:
            for process in self._processes:
                process.close()

    async def answer(self, ask: Mapping[str, Any], outdated: threading.Event) -> dict[str, Any]:
        """Of a process that has time; a sentence under "refused" or "failed" if there is no other answer."""
        task = asyncio.create_task(self._answer(ask, outdated))
        self._answering.add(task)
        task.add_done_callback(self._answering.discard)
        # a page that is closed meanwhile must not set a process free that is still at work
        return await asyncio.shield(task)

    async def _answer(self, ask: Mapping[str, Any], outdated: threading.Event) -> dict[str, Any]:
        process = await self._idle.get()
        try:
            return await asyncio.to_thread(process.answer, self.base, ask, outdated)
        except Outdated:
            return {"outdated": True}
        except TwinError as problem:
            return {"failed": sentence(problem)}
        finally:
            self._idle.put_nowait(process)

    async def accept(self, ask: Mapping[str, Any]) -> dict[str, Any]:
        """Ask the session's twin to accept what the page has shown."""
        if self.session is None:
            return {"refused": "--follow: twin explore was started without a session"}
        refused = await self.session.accept(ask.get("proposal"))
        return {"refused": refused} if refused else {}

    async def adopt(self, ask: Mapping[str, Any], outdated: threading.Event) -> dict[str, Any]:
        """A state of the page, of the robot that the session has accepted."""
        accepted = self.session.accepted if self.session else []
        if not accepted:
            return {"refused": "nothing was accepted in this session"}
        return await self.answer({**ask, "accepted": accepted}, outdated)

    async def record(self, ask: Mapping[str, Any]) -> dict[str, Any]:
        """Make a real run of a state, as `twin run` does, and its report."""
        found = await self.answer({**ask, "op": "command"}, threading.Event())
        if "refused" in found or "failed" in found:
            return found
        try:
            folder = await asyncio.to_thread(recorded, self.base["experiment"], found, self.limits)
        except TwinError as problem:
            return {"failed": sentence(problem)}
        self._reports.append(folder / "report.html")
        return {"recorded": str(folder), "report": f"/recorded/{len(self._reports) - 1}"}

    async def _report(self, request: Request) -> Response:
        number = request.path_params["number"]
        if number >= len(self._reports):
            return PlainTextResponse("no such report\n", 404)
        # the page of its own, of which nothing can reach this server
        return FileResponse(self._reports[number], headers={"Content-Security-Policy": "sandbox allow-scripts"})

    async def _attend(self, link: WebSocket) -> None:
        if self._pages >= PAGES:
            await link.close(1013)
            return
        if not hasattr(self, "_idle"):
            self._idle: asyncio.LifoQueue[AnsweringProcess] = asyncio.LifoQueue()
            for process in reversed(self._processes):
                self._idle.put_nowait(process)
            if self.session:
                self._listening = asyncio.create_task(self.session.attend())
        await link.accept()
        self._pages += 1
        if self._ending:
            self._ending.cancel()
        try:
            await PageLink(link, self).attend(self._begun)
        finally:
            self._pages -= 1
            if not self._pages:
                self._ending = asyncio.get_running_loop().call_later(self._linger, self._end)

    def _end(self) -> None:
        self._server.should_exit = True


class Lane:
    """Requests of one page that are answered one after the other; of each kind the newest counts.

    Attributes:
        outdated: set when a newer answer is wanted than the one under way.
    """

    def __init__(self) -> None:
        self.outdated = threading.Event()
        self._waiting: dict[str, dict[str, Any]] = {}
        self._some = asyncio.Event()
        self._kind = ""

    def put(self, kind: str, ask: dict[str, Any]) -> None:
        """A request comes; one too many is dropped."""
        if kind in self._waiting or len(self._waiting) < MOST_WAITING:
            self._waiting[kind] = ask
            if kind == self._kind:
                self.outdated.set()
            self._some.set()

    async def next(self) -> dict[str, Any]:
        """The one that has waited longest, or will come."""
        self._kind = ""
        while not self._waiting:
            self._some.clear()
            await self._some.wait()
        self._kind = next(iter(self._waiting))
        self.outdated = threading.Event()
        return self._waiting.pop(self._kind)


class PageLink:
    """The link to one page.

    Args:
        link: to it.
        server: that answers.
    """

    def __init__(self, link: WebSocket, server: ExplorerServer):
        self._link, self._server = link, server
        # what takes longer holds up no picture
        self._lanes = {name: Lane() for name in ("", "loops", "score", "accept")}
        self._tasks: set[asyncio.Task[None]] = set()

    async def attend(self, greeting: Mapping[str, Any]) -> None:
        """Say the `greeting`, then answer until the page is closed."""
        await self._send({"op": "begin", **greeting})
        answering = [asyncio.create_task(self._answer(lane)) for lane in self._lanes.values()]
        if self._server.session:
            answering.append(asyncio.create_task(self._show(self._server.session)))
        try:
            while True:
                self._take(await self._link.receive_text())
        # also of a frame that is no text
        except (WebSocketDisconnect, KeyError):
            pass
        finally:
            for task in (*answering, *self._tasks):
                task.cancel()
            for lane in self._lanes.values():
                lane.outdated.set()

    def _take(self, text: str) -> None:
        try:
            ask = json.loads(text)
        except (ValueError, RecursionError):
            return
        if not isinstance(ask, dict) or not isinstance(ask.get("op"), str):
            return
        kind = f"{ask['op']} {str(ask.get('slot', ''))[:40]}"
        if ask["op"] == "record":
            if not self._tasks:
                task = asyncio.create_task(self._aside(ask))
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)
        else:
            self._lanes.get(ask["op"], self._lanes[""]).put(kind, ask)

    async def _aside(self, ask: Mapping[str, Any]) -> None:
        """Record a run, which takes long and delays no other answer."""
        found = await self._server.record(ask)
        await self._send({"op": ask["op"], "id": ask.get("id"), **found})

    async def _answer(self, lane: "Lane") -> None:
        while True:
            ask = await lane.next()
            if ask["op"] in FROM_PAGES:
                found = await self._server.answer(ask, lane.outdated)
            elif ask["op"] == "accept":
                found = await self._server.accept(ask)
            elif ask["op"] == "adopt":
                found = await self._server.adopt(ask, lane.outdated)
            else:
                found = {"refused": "not understood"}
            await self._send({"op": ask["op"], "id": ask.get("id"), "slot": ask.get("slot"), **found})

    async def _show(self, session: "LiveSession") -> None:
        """What has become of the robot, as long as something is heard of it."""
        shown = -1
        while True:
            if shown != session.version:
                shown = session.version
                await self._send({"op": "robot", **session.facts()})
            await asyncio.sleep(ROBOT_PACE)

    async def _send(self, answer: dict[str, Any]) -> None:
        # the page may be gone
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            if "block" not in answer:
                await self._link.send_text(json.dumps(answer))
                return
            block = base64.b64decode(answer.pop("block"))
            head = json.dumps(answer).encode()
            head += b" " * (-len(head) % 4)
            await self._link.send_bytes(struct.pack("<I", len(head)) + head + block)


def _sending(content: bytes, kind: str) -> Callable[[Request], Awaitable[Response]]:
    async def send(request: Request) -> Response:
        return Response(content, media_type=kind)

    return send


def recorded(experiment: str, how: Mapping[str, Any], limits: JobLimits) -> Path:
    """The folder of a run that was made in a process of its own, with its report.

    Args:
        experiment: file or name.
        how: "drive", "body" and "settings" as `twin run` takes them.
        limits: of the process.

    Raises:
        TwinError: see `guarded`.
    """
    folders: list[str] = []

    def hear(note: dict[str, Any]) -> None:
        if "folder" in note:
            folders.append(note["folder"])

    arguments = {"experiments": [experiment], "out": None, "limit_step": limits.step, "results": str(EXPLORED_FOLDER)}
    arguments |= {key: how[key] for key in ("drive", "body", "settings")}
    # such a run is recorded all the same, and its report says so
    with contextlib.suppress(SafetyTrip):
        guarded(RECORD_JOB, arguments, limits, hear)
    report = {"study": "twin.report.page.page:write_report", "asked": {"runs": [Path(folders[0])]}}
    guarded(STUDY_JOB, report)
    return Path(folders[0])
