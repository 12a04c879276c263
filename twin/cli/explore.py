"""The command `twin explore`: an experiment in the browser that is run again while a slider moves."""

import shlex
import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from twin.kernel.errors import InputRefused
from twin.kernel.process.job import JobLimits
from twin.studies.command import BodyName, DriveName, ExperimentName, LimitStep, Option, Settings, study

if TYPE_CHECKING:
    from twin.report.explore.session import LiveSession

DEFAULT_PORT = 8766
DEFAULT_LINGER = 60.0
"""Time (s) until the explorer ends without a page; a reloaded page reconnects by then."""


@study(json=False)
def explore(
    experiment: ExperimentName = Path("fig4_force_position"),
    drive: DriveName = None,
    body: BodyName = None,
    settings: Settings = (),
    browser: Annotated[
        bool, Option("Open the page, or only print its address.", flags="--browser/--no-browser")
    ] = True,
    follow: Annotated[
        str | None,
        Option("Also show a robot: the address that twin shadow --live prints; -: from standard input.", "ADDRESS"),
    ] = None,
    port: Annotated[int, Option("Port; 0: any free one.", "N", least=0, most=65535)] = DEFAULT_PORT,
    linger_s: Annotated[
        float, Option("Time until it ends after the last page was closed.", "S", least=0.0)
    ] = DEFAULT_LINGER,
    limit_step: LimitStep = JobLimits.step,
) -> None:
    """Change an experiment in the browser and see all its results follow.

    Each change runs the experiment again in memory; 'record' makes a real run.
    Only this machine can open the page, with the address that is printed. It
    ends with Ctrl-C, or a minute after its last page was closed. With --follow
    it shows the robot of a session, and has a button to accept twin's
    proposals. An address read from standard input is in no list of processes.

    Exit code: 0 the last page was closed, 2 refused, 130 interrupted.

    Example: twin explore experiments/fig4_force_position.toml
    """
    try:
        from twin.report.explore.server import ExplorerServer, lasting_token
    except ImportError as missing:
        if (missing.name or "").partition(".")[0] != "websockets":
            raise
        raise InputRefused("explore: websockets is not installed; pip install 'websockets>=14'") from None
    from twin.kernel.gate import LOOPBACK_HOST

    with socket.socket() as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((LOOPBACK_HOST, port))
        except OSError as problem:
            raise InputRefused(f"--port {port}: {problem}; choose another one, or 0 for any that is free") from None
        base = {"experiment": str(experiment), "drive": drive, "body": body}
        server = ExplorerServer(base, JobLimits(step=limit_step), linger_s, _session(follow))
        server.begin(list(settings))
        at = listening.getsockname()[1]
        token = lasting_token(at)
        address = f"http://{LOOPBACK_HOST}:{at}/?token={token}"
        listening.listen()
        print(f"{shlex.quote(str(experiment))}  open  {address}\nCtrl-C ends it", flush=True)
        if browser:
            # imported here: finding a browser may take a second
            import webbrowser

            webbrowser.open(address)
        server.serve(listening, token)


def _session(address: str | None) -> "LiveSession | None":
    """Create the viewer of the `twin shadow` session at `address`; None without an address."""
    if address is None:
        return None
    # imported here: it takes a while to load
    from twin.report.explore.session import LiveSession

    return LiveSession(sys.stdin.readline() if address == "-" else address)
