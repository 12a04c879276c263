"""Drives in processes of their own: a crash ends one drive only, and single-instance FMUs fit.

A step is a request and a reply through shared memory. As only one side works at a time, all processes share one
processor: switching between two processes there takes 2.5 us, waking another processor ten times as long.
"""

import atexit
import base64
import ctypes
import os
import pickle
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Self

import numpy as np

from twin.kernel.cosim.component import Component, Holder
from twin.kernel.cosim.port import width
from twin.kernel.cosim.python_class import STEP_FUNCTION
from twin.kernel.cosim.state import SavedState, StatePlaces
from twin.kernel.errors import ComponentFailed, InputRefused, TwinError
from twin.kernel.process.black_box import exit_phrase
from twin.kernel.process.guard import POLL_INTERVAL, JobFailure, Watchdog, raise_failure
from twin.kernel.process.job import JobLimits
from twin.kernel.process.process import GuardedProcess, cpu_clock
from twin.kernel.process.reporter import PipeReporter, ProcessProxy, Reporter, called_function, own_reporter
from twin.kernel.process.shared_memory import (
    CALLER_TYPE,
    HOST_DIED,
    HOST_STUCK,
    NO_STEP,
    SERVE_IDLE,
    SERVE_ORDERED,
    SERVE_STOPPED,
    SLEEP_INTERVAL,
    SharedPage,
    ask,
    serve,
    syscall_numbers,
)
from twin.kernel.process.states import compiled_names
from twin.robot.assembly.drives import DrivePlan, Start, drive, plan_drive
from twin.robot.experiment.schema import Drive

HOST_JOB = "twin.robot.assembly.isolated_drive:hosted_drive"
SAVE_ORDER, RESTORE_ORDER = 1, 2
REFUSED_STATUS = 3
"""Reply of a host to an order that failed; the error message follows the page."""
_spare: list[GuardedProcess] = []
"""Idle processes kept for reuse: starting one takes a second, and a study may need three a hundred times."""


class IsolatedDrives:
    """Factory for drives in other processes. A context manager that ends the processes, or keeps them for reuse.

    Args:
        reporter: receives each process, so that the supervisor watches its memory; None for this process' own reporter.
        step: timeout of one call into a drive (s).
        count: number of processes to start in advance, as starting takes a while.
        keep: whether to reuse the processes of drives that have ended normally.
    """

    one_process = False

    def __init__(
        self, reporter: Reporter | None = None, step: float = JobLimits.step, count: int = 3, keep: bool = False
    ):
        # raises on systems without futex, before anything is started
        syscall_numbers()
        self._reporter, self._limits, self._keep = reporter or own_reporter(), JobLimits(step=step), keep
        self._processors = os.sched_getaffinity(0)
        self._idle = _spare_processes(count) if keep else []
        self._idle += [GuardedProcess(HOST_JOB, helper=True) for _ in range(count - len(self._idle))]
        self._all = list(self._idle)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        _spare.extend(self._idle if self._keep else ())
        for process in self._all:
            if process not in _spare:
                process.close()
        os.sched_setaffinity(0, self._processors)

    def drive(self, name: str, plan: DrivePlan, tick: float, theta_m: Start, tau_load: Start) -> Component:
        """Create the component of a drive that runs in another process."""
        processor = ctypes.CDLL(None).sched_getcpu()
        os.sched_setaffinity(0, {processor})
        process = self._idle.pop(0)
        self._reporter.helper(name, process.pid)
        order = {"name": name, "table": plan.table, "switched": plan.switched, "ticks": plan.ticks}
        order["ramped"] = plan.ramped
        process.start({**order, "tick": tick, "theta_m": theta_m, "tau_load": tau_load, "processor": processor})
        watch = Watchdog(process, self._limits)
        try:
            while True:
                for report in process.reports(POLL_INTERVAL):
                    watch.account.update(report)
                    raise_failure(report)
                    if "note" in report:
                        return IsolatedDrive(name, plan, watch, report["note"]["ports"], self._release)
                watch.raise_if_over()
        except BaseException:
            process.end()
            raise

    def _release(self, process: GuardedProcess) -> None:
        if self._keep and process.memory < 0.5 * self._limits.memory:
            self._idle.append(process)
        else:
            process.end()


def _spare_processes(most: int) -> list[GuardedProcess]:
    """Take up to `most` running spare processes from the pool; dead ones are closed."""
    found: list[GuardedProcess] = []
    while _spare and len(found) < most:
        process = _spare.pop()
        process.reports(0.0)
        if process.gone:
            process.close()
        else:
            found.append(process)
    return found


@atexit.register
def _end_spare() -> None:
    for process in _spare:
        process.close()


class IsolatedDrive(ProcessProxy):
    """Proxy component of a drive that runs in another process.

    As a `Holder` it packs the state of the `whole` drive, compatible with a drive in this process.

    Args:
        described: encoded interface of the drive, see `_packed_description`.
        over: called with the process when the drive has ended normally.
    """

    whole = True

    def __init__(
        self, name: str, plan: DrivePlan, watch: Watchdog, described: str, over: Callable[[GuardedProcess], None]
    ):
        inputs, outputs, initial, self.function, self.code, self._lacking = pickle.loads(base64.b64decode(described))
        self._watch, self._over, self._plan = watch, over, plan
        self._failed = self._closed = False
        self._process = process = watch.process
        self._page = page = SharedPage(process.box.fd, width(inputs), width(outputs))
        info = np.zeros(128, dtype=np.uint8)
        memory = np.zeros(1, dtype=CALLER_TYPE)
        m = memory[0]
        m["page"], m["inputs"], m["outputs"] = page.address, page.inputs, page.outputs
        m["naps"], m["nap"] = round(watch.limits.step / SLEEP_INTERVAL), page.nap.ctypes.data
        m["kernel"], m["pid"], m["info"] = page.kernel.ctypes.data, process.pid, info.ctypes.data
        m["clock"] = cpu_clock(process.pid)
        super().__init__(
            name=name,
            inputs=inputs,
            outputs=outputs,
            sampled=False,
            step_address=ask.address,
            self_address=memory.ctypes.data,
            initial_outputs=initial,
            label=plan.label,
            keep=(memory, info, page),
        )

    def holders(self) -> dict[str, Holder]:
        return {"process": self}

    def lacks_state(self, portable: bool = True) -> str:
        return self._lacking

    def save_state(self) -> bytes:
        self._send_order(SAVE_ORDER)
        return self._page.read_content()

    def restore_state(self, token: bytes) -> None:
        self._page.write_content(token)
        self._send_order(RESTORE_ORDER)

    def free(self, token: bytes) -> None:
        """Do nothing, because a saved state occupies no resource of the drive's process."""

    def pack(self, token: bytes) -> bytes:
        """Return the saved state unchanged, because it is valid in any process."""
        return token

    def unpack(self, content: bytes) -> bytes:
        """Return the packed state unchanged; the drive's process validates it when it is restored."""
        return content

    def _send_order(self, number: int) -> None:
        """Let the drive's process save or restore its state between two steps; ComponentFailed on failure."""
        u, y = np.zeros(max(1, self._page.inputs)), np.zeros(max(1, self._page.outputs))
        status = STEP_FUNCTION(ask.address)(self.self_address, float(number), NO_STEP, u.ctypes.data, y.ctypes.data)
        if status == REFUSED_STATUS:
            raise ComponentFailed(f"{self.label} ({self.name}): {self._page.read_content().decode()}")
        if status != 0:
            raise ComponentFailed(f"{self.label} ({self.name}) {self.explain(status)}")

    def rewind(self) -> None:
        alone = any(fmu.single_instance for fmu in self._plan.parts.values())
        raise InputRefused(
            f"{self.label}: a drive in a process of its own cannot go back to the start of a step, which iterations "
            f"above 1 need; use iterations = 1{'' if alone else ', or --isolate run'}"
        )

    def explain(self, status: int) -> str:
        self._failed = True
        if status == HOST_STUCK:
            self._process.end()
            limit = f"{self._watch.limits.step:g} s"
            return f"did not return from {self.function} within {limit} (if it is slow, not stuck, raise --limit-step)"
        if status == HOST_DIED:
            return f"{exit_phrase(self._process.end())} in {self.function} (report it to its supplier)"
        while not self._process.gone:
            for report in self._process.reports(POLL_INTERVAL):
                if "note" in report:
                    return report["note"]["explained"]
        return super().explain(status)

    def close(self) -> None:
        """Free the drive in another process, and end the process or keep it for reuse.

        Raises:
            JobEnded: it crashed or hung while being freed.
        """
        if self._closed or self._process.gone or self._process.has_exit_status:
            return
        self._closed = True
        self._page.close()
        self._watch.account.unstepped = "after the last step"
        while True:
            for report in self._process.reports(POLL_INTERVAL):
                self._watch.account.update(report)
                raise_failure(report)
                if "finished" in report:
                    self._process.end() if self._failed else self._over(self._process)
                    return
            try:
                self._watch.raise_if_over()
            except TwinError as failure:
                raise JobFailure(str(failure)) from None


def hosted_drive(
    reporter: PipeReporter,
    name: str,
    table: Drive,
    switched: bool,
    ticks: int | None,
    ramped: bool,
    tick: float,
    theta_m: Start,
    tau_load: Start,
    processor: int,
) -> None:
    """Create a drive in this process and serve its steps to another process, on the given processor.

    Notes to the supervisor: {"ports"} when the drive is ready, {"explained"} after a failed step. See `drive` and
    `DrivePlan` for the arguments.
    """
    plan = replace(plan_drive(table), ticks=ticks, ramped=ramped)
    plan = plan.with_enable_input() if switched else plan
    component = drive(name, plan, tick, theta_m, tau_load)
    page = SharedPage(reporter.box, sum(p.size for p in component.inputs), sum(p.size for p in component.outputs))
    page.clear()
    # serves no request, but compiles or loads the code before the first one
    _serve_page(page, component)
    reporter.note(ports=_packed_description(component))
    os.sched_setaffinity(0, {processor})
    status = SERVE_IDLE
    while status != SERVE_STOPPED:
        status = _serve_page(page, component)
        if status == SERVE_ORDERED:
            _execute_order(page, component)
        elif status not in (SERVE_IDLE, SERVE_STOPPED):
            reporter.note(explained=component.explain(status))
    component.close()


def _execute_order(page: SharedPage, component: Component) -> None:
    """Save or restore the state of a drive in the shared memory that follows the page of its steps."""
    try:
        places = StatePlaces([component], np.zeros(0), np.zeros(0))
        if page.order == SAVE_ORDER:
            page.write_content(places.save_state(0).saved().to_bytes())
        else:
            places.restore_state(places.import_state(SavedState.from_bytes(page.read_content(), component.label)))
            component.refuse_index()
        page.answer(0)
    except TwinError as problem:
        page.write_content(str(problem).encode())
        page.answer(REFUSED_STATUS)


def _serve_page(page: SharedPage, component: Component) -> int:
    return serve(
        page.address, page.inputs, component.step_address, component.self_address, page.number,
        page.kernel.ctypes.data, page.nap.ctypes.data,
    )  # fmt: skip


def _packed_description(component: Component) -> str:
    """Encode ports, initial outputs and code of a component as text, for its proxy in another process."""
    initial, code = np.array(component.initial_outputs), tuple(compiled_names([component]))
    facts = component.inputs, component.outputs, initial, called_function(component), code, component.lacks_state()
    return base64.b64encode(pickle.dumps(facts)).decode()
