"""The guarded process: `python -m twin.kernel.process.child BOX PARENT`.

Standard input carries the job's name, then one line of arguments per call, and orders. Standard output carries the
reports, so the output of FMUs and other code is redirected to standard error first.
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
    """Run the job of a guarded process once per request, until the parent process has gone or the job fails."""
    box, parent = map(int, sys.argv[1:])
    orders, reports = os.dup(0), os.fdopen(os.dup(1), "w", encoding="utf-8")
    with open(os.devnull) as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    # the parent may ignore SIGINT
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # a service manager that terminates all its processes must end this one in the same way as its parent
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
                # imported after the job, so that its own imports load while the parent still prepares the arguments
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
        # without clean-up, because no unsaved data is left
        if "finished" not in last:
            os._exit(0)


def _exit_with_parent(parent: int) -> None:
    """Make the Linux kernel end this process with its parent, even if it hangs; elsewhere the closed pipe ends it."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    # the parent may have died before the prctl took effect
    if os.getppid() != parent:
        os._exit(1)


def _lines(fd: int) -> Iterator[str]:
    """Yield the lines read from the pipe `fd`; end the process when all writers have closed it."""
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
