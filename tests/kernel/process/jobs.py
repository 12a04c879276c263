"""Jobs for the tests of the guard; each is run in a process of its own."""

import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

from twin.kernel.compiled.native import compiling
from twin.kernel.fmi.groups import announce_call
from twin.kernel.process.reporter import Reporter
from twin.studies.identify.identification import NotIdentifiable


def echo(reporter: Reporter, **arguments: Any) -> dict[str, Any]:
    """Gives back what it got, after a note about each."""
    for name in arguments:
        reporter.note(name=name)
    return arguments


def refuse(reporter: Reporter) -> None:
    """Raises what a user has to be told."""
    raise NotIdentifiable("drive.fmu: is a teapot")


def typed(reporter: Reporter, **arguments: Any) -> list[str]:
    """The types of what it got."""
    return [type(value).__name__ for value in arguments.values()]


def blunder(reporter: Reporter) -> None:
    """Raises what no user should ever see."""
    raise ZeroDivisionError("a mistake of ours")


def vanish(reporter: Reporter) -> None:
    """Ends its process as if all were well."""
    print("so long", flush=True)
    os._exit(0)


def linger(reporter: Reporter, farewell: str, stubborn: bool = False) -> None:
    """Sleeps for longer than anybody waits; interrupted, writes the file `farewell`, and sleeps on if `stubborn`."""
    try:
        reporter.note(begun=True)
        time.sleep(1000)
    except KeyboardInterrupt:
        Path(farewell).touch()
        if stubborn:
            time.sleep(1000)
        raise


def variable(reporter: Reporter, name: str) -> str | None:
    """What its environment says."""
    return os.environ.get(name)


def surroundings(reporter: Reporter) -> dict[str, Any]:
    """What its process finds."""
    return {
        "arguments": len(sys.argv),
        "descriptors": len(os.listdir("/proc/self/fd")),
        "folder": os.getcwd(),
        "leads_its_session": os.getsid(0) == os.getpid(),
        "parent": os.getppid(),
        "stopped_by": str(signal.getsignal(signal.SIGINT)).partition(" at ")[0],
        "threads": threading.active_count(),
        "variables": {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"},
    }


def compile_within_a_call(reporter: Reporter, seconds: float) -> str:
    """Compiles for so long while a call into a component is announced."""
    with announce_call("a.fmu", "it", "fmi3UpdateDiscreteStates"), compiling():
        time.sleep(seconds)
    return "done"


def chatter(reporter: Reporter, lines: list[str]) -> str:
    """Prints lines."""
    print("\n".join(lines), flush=True)
    return "done"


def spin(reporter: Reporter) -> None:
    """Computes for ever."""
    while True:
        pass


def sleep_within_a_call(reporter: Reporter) -> None:
    """A call that waits for ever."""
    with announce_call("a.fmu", "it", "fmi2DoStep"):
        time.sleep(1000)


def crawl(reporter: Reporter, ticks: int) -> None:
    """Simulates so many `ticks` of what takes 5 ms for each."""
    # no other job waits for compiled code
    from tests.kernel.cosim.models import continuous
    from twin.kernel.cosim.simulation import Simulation
    from twin.kernel.cosim.system import System

    def step(t: float, h: float, u: object) -> float:
        time.sleep(5e-3)
        return 0.0

    Simulation(System([continuous("crawler", step)], [], 1e-3), ticks).run()


_count = 0


def warm(
    reporter: Reporter, echo: int = 0, leave: int = 0, sleep: float = 0.0, refuse: str = "", interrupt: bool = False
) -> dict[str, Any]:
    """Counts how often it was done, and does what it is asked for."""
    global _count
    _count += 1
    if leave:
        os._exit(leave)
    if refuse:
        raise NotIdentifiable(refuse)
    if interrupt:
        os.kill(os.getpid(), signal.SIGINT)
    time.sleep(sleep)
    return {"pid": os.getpid(), "count": _count, "echo": echo}
