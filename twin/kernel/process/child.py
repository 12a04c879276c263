"""`python -m twin.kernel.process.child BOX PARENT`: the guarded process.

Standard input brings the job's name, then its arguments, a line for each time that it is to be done, and orders;
standard output takes the reports, so whatever is printed by FMUs or anybody else is sent to standard error first.
"""

import contextlib
import ctypes
import json
import os
import pickle
import queue
import signal
import sys
import threading
from collections.abc import Iterator

from twin.kernel.process.job import STOP_ORDER, failure_report, interrupt_main, load_function, retry_lost_interrupts

_PR_SET_PDEATHSIG = 1


def main() -> None:
    """Do the one job of this process as often as is asked, until the parent has gone or it could not be begun."""
    box, parent = map(int, sys.argv[1:])
    orders, reports = os.dup(0), os.fdopen(os.dup(1), "w", encoding="utf-8")
    with open(os.devnull) as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    # the parent may have had it ignored
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # a service that ends all its processes ends this one as its parent would
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    retry_lost_interrupts()
    _exit_with_parent(parent)
    lines = _lines(orders)
    name = next(lines)
    begun: queue.SimpleQueue[str] = queue.SimpleQueue()
    reporter = None
    while True:
        try:
            if reporter is None:
                job = load_function(name)
                # after the job's own imports: what it needs of them is loaded while the arguments are still being made
                from twin.kernel.hooks import HOOKS
                from twin.kernel.process.reporter import PipeReporter

                reporter = PipeReporter(reports, box)
                HOOKS.fmi_call.append(reporter.announcer.announce_call)
                HOOKS.compiling.append(reporter.announcer.compiling)
                HOOKS.memory, HOOKS.reporter = reporter.stepping, reporter
                threading.Thread(target=_process_orders, args=(lines, begun), daemon=True).start()
            arguments = pickle.loads(bytes.fromhex(begun.get()))
            last = {"finished": job(reporter, **arguments)}
        except KeyboardInterrupt:
            last = {"interrupted": None}
        except Exception as problem:
            last = {"failed": failure_report(problem)}
        with contextlib.suppress(BrokenPipeError):
            reports.write(json.dumps(last) + "\n")
            reports.flush()
        # without cleaning up, because nothing of value is left to clean
        if "finished" not in last:
            os._exit(0)


def _exit_with_parent(parent: int) -> None:
    """On Linux the kernel ends this process with `parent`, also one that hangs; elsewhere the closed pipe has to do."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    # it may have died before that was in force
    if os.getppid() != parent:
        os._exit(1)


def _lines(fd: int) -> Iterator[str]:
    """Lines that arrive at `fd`; the end of the process if no writer is left."""
    rest = b""
    while True:
        line, found, rest = rest.partition(b"\n")
        if found:
            yield line.decode()
            continue
        more = os.read(fd, 65536)
        if not more:
            os._exit(1)
        rest = line + more


def _process_orders(lines: Iterator[str], begun: "queue.SimpleQueue[str]") -> None:
    for line in lines:
        if line == STOP_ORDER:
            interrupt_main()
        else:
            begun.put(line)


if __name__ == "__main__":
    main()
