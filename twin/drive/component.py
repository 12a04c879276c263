"""An FMU as a component: FMPy brings it into step mode, the compiled adapter steps it by address."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.cosim.component import Component
from twin.cosim.port import Port, by_port
from twin.cosim.rewind import Rewind
from twin.drive import adapter, fmu_state, plain_adapter, reuse
from twin.drive.adapter import DO_STEP, GET, GROUP, ITEM_SIZES, SET, TERMINATE
from twin.drive.description import FmuDescription, Variable
from twin.drive.fmu_state import RESTORE, SAVE
from twin.drive.instance import Instance, Setting, Setup
from twin.errors import InputRefused

STATUSES = {2: "Discard", 3: "Error", 4: "Fatal", 5: "Pending"}


@dataclass(frozen=True)
class FmuPort:
    """A port and the FMU variable behind it: port value (SI) = gain * FMU value + offset."""

    port: Port
    variable: Variable
    gain: float = 1.0
    offset: float = 0.0

    def in_fmu(self, value: float | np.ndarray) -> float | np.ndarray:
        """`value` of the port as the FMU wants it."""
        return (value - self.offset) / self.gain


class FmuComponent(Component):
    """One FMU instance as a component, a continuous one if nothing else is said.

    Args:
        name: of the component and the FMU instance.
        description: the checked FMU.
        folder: where it is unpacked.
        inputs, outputs: its ports.
        settings: values set before initialisation, in the FMU's own units.
        inputs_at_start: port -> value (SI) in initialisation mode; 0 where nothing is said.
        outputs_at_start: port -> value (SI) that the output is taken to have at t = 0: an angle's zero is arbitrary,
            and the shaft is coupled where it stands.
        setup: of the run.
        sampled: whether it is evaluated at t_k; what its outputs are before the first time is nobody's business then.

    Raises:
        InputRefused: the FMU cannot be brought into step mode, or an output is not finite then.
    """

    def __init__(
        self,
        name: str,
        description: FmuDescription,
        folder: Path,
        inputs: Sequence[FmuPort],
        outputs: Sequence[FmuPort],
        settings: Sequence[Setting] = (),
        inputs_at_start: Mapping[str, float | np.ndarray] | None = None,
        outputs_at_start: Mapping[str, float | np.ndarray] | None = None,
        setup: Setup = Setup(),  # noqa: B008, it is frozen
        sampled: bool = False,
    ):
        wanted = inputs_at_start or {}
        started = [(p.variable, p.in_fmu(wanted.get(p.port.name, 0.0))) for p in inputs]
        # of sampled parts nobody has proved that a reset makes them new
        make = Instance if sampled else reuse.instance
        self.instance = make(name, description, folder, settings, started, setup)
        raw = self.instance.read([p.variable for p in outputs])
        if sampled:
            raw[:] = 0.0
        sizes = [p.port.size for p in outputs]
        initial = np.repeat([p.gain for p in outputs], sizes) * raw + np.repeat([p.offset for p in outputs], sizes)
        shift = np.zeros(len(initial))
        start = 0
        for p in outputs:
            if p.port.name in (outputs_at_start or {}):
                here = slice(start, start + p.port.size)
                shift[here] = (outputs_at_start or {})[p.port.name] - initial[here]
            start += p.port.size
        if not np.all(np.isfinite(initial)):
            self.instance.close()
            raise InputRefused(f"{description.path}: an output is not finite after initialisation: {initial}")
        self._shift, self._returned = shift, np.zeros(16, dtype=np.uint8)
        self._groups = (self._grouped(inputs, "Set"), self._grouped(outputs, "Get", shift))
        self._state: np.ndarray | None = None
        address, memory = self._plain() if self._is_plain(inputs, outputs, shift) else self._general()
        memory["final"] = 1
        self._memory = memory
        super().__init__(
            name=name,
            inputs=tuple(p.port for p in inputs),
            outputs=tuple(p.port for p in outputs),
            sampled=sampled,
            step_address=address,
            self_address=memory.ctypes.data,
            initial_outputs=initial + shift,
            label=description.path.name,
            keep=memory,
        )

    def zero(self, name: str) -> float:
        """Value of the output port `name` where the FMU's own is 0."""
        return float(by_port(self.outputs, self._shift)[name][0])

    def explain(self, status: int) -> str:
        prefix = f"fmi{self.instance.description.version}"
        said = f" ('{self.instance.messages[-1]}')" if self.instance.messages else ""
        if status == TERMINATE:
            return f"{prefix}DoStep asked to terminate the simulation{said}"
        functions = {SET: "Set", DO_STEP: "DoStep", GET: "Get", SAVE: f"Get{self._state_name}"}
        functions[RESTORE] = f"Set{self._state_name}"
        called = functions[status // 16 * 16]
        code = STATUSES.get(status % 16, f" status {status % 16}")
        may = code == "Discard" and not self.sampled
        shorter = "; it may do with shorter steps: raise [drive] substeps" if may else ""
        return f"{prefix}{called} returned {prefix}{code}{said}{shorter}"

    def rewind(self) -> Rewind | None:
        if not self.instance.description.model.coSimulation.canGetAndSetFMUstate:
            return None
        # from now on a step may be repeated
        self._memory["final"] = 0
        memory = self._state = np.zeros(1, dtype=fmu_state.MEMORY)
        m = memory[0]
        m["instance"] = self.instance.handle
        m["get"], m["set"] = (self.instance.address(f"{verb}{self._state_name}") for verb in ("Get", "Set"))
        m["cell"] = memory["state"].ctypes.data
        return Rewind(fmu_state.save.address, fmu_state.restore.address, memory.ctypes.data, memory)

    @property
    def _state_name(self) -> str:
        """What the state is called in names of functions, which changed from FMI 2.0 to 3.0."""
        return "FMUstate" if self.instance.description.version == 2 else "FMUState"

    def keep_time(self, clock: np.ndarray) -> None:
        self.instance.clock = clock

    def said(self) -> list[tuple[int, str]]:
        return self.instance.unheard()

    def close(self) -> None:
        state, self._state = self._state, None
        try:
            if state is not None and state[0]["state"]:
                self.instance.forget(int(state[0]["state"]))
        finally:
            if self.sampled:
                self.instance.close()
            else:
                reuse.let_go(self.instance)

    def _is_plain(self, inputs: Sequence[FmuPort], outputs: Sequence[FmuPort], shift: np.ndarray) -> bool:
        """Whether values can go as they are: Real, unscaled, no more than one output shifted."""
        ports = (*inputs, *outputs)
        alike = all(p.variable.type == "Real" and p.gain == 1.0 and p.offset == 0.0 for p in ports)
        return alike and bool(inputs) and bool(outputs) and int(np.count_nonzero(shift)) <= 1

    def _plain(self) -> tuple[int, np.ndarray]:
        (set_,), (get,) = (table for table, _ in self._groups)
        memory = np.zeros(1, dtype=plain_adapter.MEMORY)
        m = memory[0]
        m["instance"], m["do_step"] = self.instance.handle, self.instance.address("DoStep")
        m["set_real"], m["inputs"], m["input_references"] = set_["access"], set_["variables"], set_["references"]
        m["get_real"], m["outputs"], m["output_references"] = get["access"], get["variables"], get["references"]
        m["shifted"] = np.argmax(np.abs(self._shift))
        m["shift"] = self._shift[m["shifted"]]
        return plain_adapter.step.address, memory

    def _general(self) -> tuple[int, np.ndarray]:
        memory = np.zeros(1, dtype=adapter.MEMORY)
        m = memory[0]
        m["version"], m["instance"] = self.instance.description.version, self.instance.handle
        m["do_step"], m["returned"] = self.instance.address("DoStep"), self._returned.ctypes.data
        for side, (table, _) in zip(("input", "output"), self._groups, strict=True):
            m[f"{side}s"], m[f"{side}_groups"] = len(table), table.ctypes.data
        return adapter.step.address, memory

    def _grouped(
        self, ports: Sequence[FmuPort], access: str, shift: np.ndarray | None = None
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Table of `adapter.GROUP`, one row per FMI type, and the arrays it points to."""
        starts = np.concatenate([[0], np.cumsum([p.port.size for p in ports])]).astype(int)
        extra = np.zeros(starts[-1]) if shift is None else shift
        types = list(dict.fromkeys(self.instance.type_name(p.variable) for p in ports))
        table, kept = np.zeros(len(types), dtype=GROUP), []
        for row, name in zip(table, types, strict=True):
            members = [i for i, p in enumerate(ports) if self.instance.type_name(p.variable) == name]
            slots = np.concatenate([np.arange(starts[i], starts[i + 1]) for i in members])
            arrays = {
                "references": np.array([ports[i].variable.reference for i in members], dtype=np.uint32),
                "slots": slots.astype(np.uint64),
                "gain": np.concatenate([np.full(ports[i].port.size, ports[i].gain) for i in members]),
                "offset": np.concatenate([np.full(ports[i].port.size, ports[i].offset) for i in members])
                + extra[slots],
                "buffer": np.zeros(len(slots) * ITEM_SIZES[ports[members[0]].variable.kind], dtype=np.uint8),
            }
            row["kind"] = ports[members[0]].variable.kind
            row["access"] = self.instance.address(access + name)
            row["variables"], row["values"] = len(members), len(slots)
            for field, array in arrays.items():
                row[field] = array.ctypes.data
                kept.append(array)
        return table, kept
