"""An FMU that somebody on another machine steps: what a Dask worker does for them, and the process that has the FMU.

The worker only passes calls on, so an FMU that crashes ends its own process, and the worker lives.
"""

import contextlib
import tempfile
import threading
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from twin.kernel.compiled.machine import chosen_form
from twin.kernel.cosim.component import Rewind
from twin.kernel.cosim.python_class import STEP
from twin.kernel.cosim.state import SavedState, StatePlaces, SystemState
from twin.kernel.errors import ComponentFailed, TwinError
from twin.kernel.fmi.component import FmuComponent, opened
from twin.kernel.fmi.description import Kind, described
from twin.kernel.fmi.instance import Instance
from twin.kernel.fmi.solvers import Solver
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.fmi.unpacked import unpacked
from twin.kernel.fmi.variable import Setting, Setup, Variable
from twin.kernel.process.black_box import manner
from twin.kernel.process.guard import POLL
from twin.kernel.process.process import GuardedProcess
from twin.kernel.process.reporter import PipeReporter
from twin.kernel.writing import write_bytes

JOB = "twin.kernel.process.hosted:answer"
SAVE, RESTORE = "save", "restore"
"""What may come before a step."""
ENDED, FAILED, DONE = "ended", "failed", "done"
"""What a call may come to: no process any more, an error, a result."""
LOADING = 60.0
"""Longest time (s) until an FMU is there: its process starts and loads what it needs before."""


class HostedFmu:
    """A Dask actor that has one FMU in a process of its own.

    Args:
        limit: longest time of one call (s), of `make` LOADING.
    """

    def __init__(self, limit: float):
        self._limit = limit
        self._process: GuardedProcess | None = None
        self._lock = threading.Lock()

    def make(self, content: bytes, file: str, **order: Any) -> tuple[str, Any]:
        """Let the process make the FMU whose archive is `content` and was called `file`; the rest as of `call`."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / Path(file).name
            write_bytes(path, content)
            return self.call("make", path=str(path), **order)

    def call(self, what: str, **order: Any) -> tuple[str, Any]:
        """Pass a call on; (DONE, result), (FAILED, see `failure_report`) or (ENDED, how, as a verb phrase)."""
        with self._lock:
            # here, as a process ends with the thread that started it: this one lasts as long as the worker
            if self._process is None:
                self._process = GuardedProcess(JOB)
            if self._process.ended:
                return ENDED, "has ended"
            self._process.start({"what": what, "order": order})
            return self._outcome(self._process, LOADING if what == "make" else self._limit)

    def _outcome(self, process: GuardedProcess, limit: float) -> tuple[str, Any]:
        began = time.monotonic()
        while True:
            for report in process.reports(POLL):
                if "finished" in report:
                    return DONE, report["finished"]
                if "failed" in report:
                    process.end()
                    return FAILED, report["failed"]
            if process.gone:
                return ENDED, manner(process.end())
            waited = time.monotonic() - began - process.box.compiled()
            if waited > limit:
                process.end()
                return ENDED, f"did not return within {limit:g} s"

    def __del__(self) -> None:
        if self._process is not None:
            with contextlib.suppress(OSError):
                self._process.close()


class _Fmu:
    """The FMU of this process, and what states of it are held for the other machine, by their numbers."""

    instance: Instance
    component: FmuComponent
    rewind: Rewind
    states: ClassVar[dict[int, SystemState]] = {}


_fmu = _Fmu()
_numbers = count()


def answer(reporter: PipeReporter, what: str, order: dict[str, Any]) -> Any:
    """One call into the FMU of this process; a job of the guard.

    Raises:
        TwinError: the FMU refuses; whatever else it raises becomes its error.
    """
    try:
        return _CALLS[what](**order)
    except TwinError:
        raise
    # FMPy's FMICallException and whatever is below it
    except Exception as problem:
        raise ComponentFailed(str(problem)) from None


def _make(
    path: str, name: str, kind: Kind, values: dict[str, float], settings: list[Setting], setup: Setup
) -> dict[str, Any]:
    file = Path(path)
    description = described(file, kind).resized(values)
    folder = unpacked(file, description.sha256)
    _fmu.instance = opened(name, description, folder, settings, (), setup)
    return {"missing": _fmu.instance.missing, "processor": chosen_form().name}


def _read(variables: list[Variable]) -> str:
    return _fmu.instance.read(variables).tobytes().hex()


def _write(settings: list[Setting]) -> None:
    _fmu.instance.write(settings)


def _begin(
    name: str, inputs: list[FmuPort], outputs: list[FmuPort], settings: list[Setting], solver: Solver
) -> dict[str, Any]:
    instance = _fmu.instance
    instance.begin()
    component = _fmu.component = FmuComponent(
        name, instance.description, instance.folder, inputs, outputs, settings, setup=instance.setup,
        instance=instance, solver=solver,
    )  # fmt: skip
    return {
        "y": np.array(component.initial_outputs).tobytes().hex(),
        "called": component.called,
        "lacks": [component.lacks_state(portable) for portable in (False, True)],
    }


def _rewind() -> bool:
    rewind = _fmu.component.rewind()
    if rewind is not None:
        _fmu.rewind = rewind
    return rewind is not None


def _step(t: float, h: float, u: str, before: list[str], reacts: bool) -> dict[str, Any]:
    """One step, or the outputs for other inputs; `before` it saves its state, or goes back to the one it saved."""
    component = _fmu.component
    inputs, outputs, status = np.frombuffer(bytes.fromhex(u)), np.array(component.initial_outputs), 0
    for what in before:
        address = _fmu.rewind.save_address if what == SAVE else _fmu.rewind.restore_address
        status = status or STEP(address)(_fmu.rewind.self_address, t, h, 0, 0)
    if status == 0:
        address = component.reaction() if reacts else component.step_address
        status = STEP(address)(component.self_address, t, h, inputs.ctypes.data, outputs.ctypes.data)
    texts = [text for _, text in component.take_messages()]
    why = component.explain(status) if status not in (0, 1) else ""
    return {"status": status, "y": outputs.tobytes().hex(), "messages": texts, "why": why}


def _places() -> StatePlaces:
    """Of all that its steps change; what it gets and gives lies in the other machine's memory."""
    return StatePlaces([_fmu.component], np.zeros(0), np.zeros(0))


def _held(state: SystemState) -> int:
    number = next(_numbers)
    _fmu.states[number] = state
    return number


def _give_back(number: int) -> None:
    state = _fmu.states[number]
    state.places.put_back(state)


def _free(number: int) -> None:
    _fmu.states.pop(number).close()


def _close() -> None:
    _fmu.component.close()


_CALLS: dict[str, Callable[..., Any]] = {
    "make": _make,
    "read": _read,
    "write": _write,
    "begin": _begin,
    "rewind": _rewind,
    "step": _step,
    "take": lambda: _held(_places().take(0)),
    "give_back": _give_back,
    "free": _free,
    "pack": lambda number: _fmu.states[number].saved().to_bytes().hex(),
    "unpack": lambda content: _held(_places().taken(SavedState.from_bytes(bytes.fromhex(content), "it"))),
    "close": _close,
}
