"""The memory of a compiled step: one FMU's functions, its states, and the solver that moves them."""

import ctypes
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from twin.drive.exchange.cvode import Cvode
from twin.drive.exchange.events import weigh
from twin.drive.exchange.memory import GUARD, MEMORY, UNTOUCHED
from twin.drive.exchange.sentences import sentence
from twin.drive.exchange.solver import USUAL_TOLERANCE, Solver
from twin.drive.exchange.step import step

if TYPE_CHECKING:
    from twin.drive.exchange.model import Model

_FUNCTIONS = {
    "set_time": "SetTime",
    "set_states": "SetContinuousStates",
    "states_of": "GetContinuousStates",
    "nominals_of": "GetNominalsOfContinuousStates",
    "derivatives_of": "GetDerivatives",
    "indicators_of": "GetEventIndicators",
    "enter_event_mode": "EnterEventMode",
    "update": "NewDiscreteStates",
    "enter_time_mode": "EnterContinuousTimeMode",
    "completed": "CompletedIntegratorStep",
}
_FUNCTIONS_3 = _FUNCTIONS | {
    "derivatives_of": "GetContinuousStateDerivatives",
    "update": "UpdateDiscreteStates",
    "number_of_states": "GetNumberOfContinuousStates",
}


class Integrator:
    """What steps one instance.

    Args:
        model: the instance, in continuous-time mode.
        solver: which.
        tables: of `adapter.GROUP`, inputs and outputs; none: they are set and read by somebody else.
        width: number of inputs.

    Attributes:
        memory: (1,) of `MEMORY`.
        block: all that a step changes of this memory, to be saved and brought back as bytes.

    Raises:
        InputRefused: there is no CVODE for this platform.
    """

    def __init__(
        self,
        model: "Model",
        solver: Solver = Solver(),  # noqa: B008, it is frozen
        tables: Sequence[np.ndarray] = (),
        width: int = 0,
    ):
        self._model, size = model, max(model.states, 1)
        tolerance = model.setup.tolerance or USUAL_TOLERANCE
        kept = {"x": size, "z_before": model.indicators, "last_inputs": width}
        scratch = {name: size for name in ("began", "k_1", "k_2", "k_3", "k_4", "scales")}
        scratch |= {"z": model.indicators, "info": GUARD}
        self.block, begins = _laid_out(kept, MEMORY.itemsize // 8)
        self._scratch, places = _laid_out(scratch)
        self.memory = self.block[: MEMORY.itemsize // 8].view(MEMORY)
        m = self.memory[0]
        for name, place in begins.items():
            m[name] = self.block.ctypes.data + 8 * place
        for name, place in places.items():
            m[name] = self._scratch.ctypes.data + 8 * place
        version = model.description.version
        for field, function in (_FUNCTIONS if version == 2 else _FUNCTIONS_3).items():
            m[field] = model.address(function)
        m["version"], m["instance"] = version, model.handle
        m["states"], m["size"], m["indicators"], m["width"] = model.states, size, model.indicators, width
        interface = model.description.interface
        skipped = (
            interface.completedIntegratorStepNotNeeded if version == 2 else not interface.needsCompletedIntegratorStep
        )
        m["needs_completed"], m["final"] = not skipped, 1
        for side, table in zip(("input", "output"), tables, strict=False):
            m[f"{side}s"], m[f"{side}_groups"] = len(table), table.ctypes.data
        m["fresh"] = m["restart"] = 1
        m["tolerance"], m["longest"] = tolerance, solver.step or 0.0
        m["next_event"] = model.next_event
        m["reached_at"] = self.memory["reached"].ctypes.data
        x = self.block[begins["x"] :][:size]
        scales = self._scratch[places["scales"] :][:size]
        x[:] = scales[:] = 1.0
        scales[: model.states] = model.nominals()
        weigh(scales, tolerance)
        self._cvode = None
        if solver.method == "cvode":
            self._cvode = Cvode(x, scales, tolerance, model.indicators, self.memory.ctypes.data)
            for field, address in self._cvode.addresses.items():
                m[field] = address
        self._call = ctypes.CFUNCTYPE(
            ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
        )(step.address)

    @property
    def address(self) -> int:
        """Of the compiled step, which works on `memory`."""
        return step.address

    def advance(self, t: float, h: float) -> int:
        """One step from `t` to `t` + `h` (s), inputs as somebody has set them; 0 or a bad status."""
        self.memory[0]["fresh"] = 1
        nothing = np.zeros(1)
        place = nothing.ctypes.data
        return int(self._call(self.memory.ctypes.data, t, h, place, place))

    def kept(self) -> np.ndarray:
        """What `take` brings back."""
        return self.block.copy()

    def take(self, kept: np.ndarray) -> None:
        """Go back to where `kept` was made; the FMU has to be brought back besides."""
        self.block[:] = kept
        self.memory[0]["restart"] = 1

    def explain(self, status: int) -> str:
        """What a bad `status` of the step means, as the verb phrase of a sentence; "" if it is none of its own."""
        return sentence(self.memory[0], status)

    def close(self) -> None:
        """Free the solver; safe to call twice."""
        if self._cvode is not None:
            self._cvode.close()
            self._cvode = None


def _laid_out(sizes: dict[str, int], first: int = 0) -> tuple[np.ndarray, dict[str, int]]:
    """One array for all, each with a guard behind it, after `first` numbers for something else; where each begins."""
    places, place = {}, first
    for name, size in sizes.items():
        places[name] = place
        place += size + GUARD
    block = np.full(place, UNTOUCHED)
    block[:first] = 0.0
    for name, size in sizes.items():
        block[places[name] : places[name] + size] = 0.0
    return block, places
