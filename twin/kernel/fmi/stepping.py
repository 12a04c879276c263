"""Ports of an FMU instance, and the compiled step that fits them: one of three, with its memory."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from twin.kernel.cosim.component import Rewind, piece_table
from twin.kernel.cosim.port import Port, state_fields
from twin.kernel.fmi import cosim_step, groups
from twin.kernel.fmi.cosim_step import DISCARD_RECORD
from twin.kernel.fmi.instance import Instance, inexact_phrase
from twin.kernel.fmi.variable import ITEM_SIZES, Variable


@dataclass(frozen=True)
class FmuPort:
    """A component's port and the FMU variable behind it: port value (SI) = gain * FMU value + offset."""

    port: Port
    variable: Variable
    gain: float = 1.0
    offset: float = 0.0

    def to_fmu(self, value: float | np.ndarray) -> float | np.ndarray:
        """Convert a value of the port (SI) to the unit of the FMU variable."""
        return (value - self.offset) / self.gain

    def for_instant(self, instant: Literal["start", "end"]) -> "FmuPort":
        """Return a copy of the input port for the value at the start or the end of a step."""
        name = self.port.name + groups.END_SUFFIX * (instant == "end")
        return replace(self, port=replace(self.port, name=name, instant=instant))


@dataclass(frozen=True)
class PortSlots:
    """A port, the positions of its values among all its component's, and offsets `shift` (values,) added to them."""

    port: FmuPort
    slots: np.ndarray
    shift: np.ndarray


def port_slots(ports: Sequence[FmuPort], shift: np.ndarray | None = None) -> list[PortSlots]:
    """Assign consecutive positions (slots) to the values of `ports`; `shift` has an offset per value, None for 0."""
    ends = np.cumsum([0, *(p.port.size for p in ports)])
    shifts = np.zeros(ends[-1]) if shift is None else shift
    return [PortSlots(p, np.arange(a, b), shifts[a:b]) for p, a, b in zip(ports, ends, ends[1:], strict=False)]


class Stepping:
    """Compiled step of a co-simulation FMU instance in step mode, with its memory.

    `shift` are offsets added to the output values (SI). `inputs` are followed by a port for the value at the end of the
    step of each one that is interpolated, `outputs` have slots and shifts.
    """

    discard_reported = False

    def __init__(
        self,
        instance: Instance,
        inputs: Sequence[FmuPort] = (),
        outputs: Sequence[FmuPort] = (),
        shift: np.ndarray | None = None,
    ):
        self.instance = instance
        ramped = [i for i, p in enumerate(inputs) if instance.takes_ramp(p.variable)]
        self.inputs = [p.for_instant("start") if i in ramped else p for i, p in enumerate(inputs)]
        self.inputs += [inputs[i].for_instant("end") for i in ramped]
        self._into, self.outputs = port_slots(self.inputs), port_slots(outputs, shift)
        self._keep: list[Any] = []
        self._moving: list[np.ndarray] = []
        self._shorter = np.zeros(1, dtype=DISCARD_RECORD)
        description, s = instance.description, self._shorter[0]
        if description.version < 3:
            s["real_status"] = instance.address("GetRealStatus")
            # FMI 1.0 does not define the Boolean status
            s["boolean_status"] = instance.address("GetBooleanStatus") if description.version == 2 else 0
        s["value_at"], s["flag_at"] = (self._shorter[name].ctypes.data for name in ("value", "flag"))
        s["varies"] = description.model.coSimulation.canHandleVariableCommunicationStepSize
        into = [p for i, p in enumerate(self._into[: len(inputs)]) if i not in ramped]
        if ramped:
            self._fill_ramp([self._into[i] for i in ramped], self._into[len(inputs) :])
        eventful = description.model.coSimulation.hasEventMode or description.returns_early or ramped
        if description.version == 3 and eventful:
            self.address, self.memory = self._event_step(into)
        elif not ramped and self._is_plain(inputs, outputs, shift):
            self.address, self.memory = self._plain_step()
        else:
            self.address, self.memory = cosim_step.step.address, np.zeros(1, dtype=cosim_step.STEP_MEMORY)
            m = self.memory[0]
            m["version"], m["instance"], m["shorter"] = description.version, instance.handle, self._shorter.ctypes.data
            self._fill(m, self._group_table(into, "Set"), self._group_table(self.outputs, "Get"))
        self.memory["final"] = 1

    @property
    def state_name(self) -> str:
        """Name of the saved state in FMI functions: FMUstate in FMI 2.0, FMUState in FMI 3.0."""
        return "FMUstate" if self.instance.description.version == 2 else "FMUState"

    def explain(self, status: int) -> str:
        instance, note = self.instance, self.instance.note[0]
        message = f" ('{instance.messages[-1]}')" if instance.messages else ""
        if status == groups.INPUT_OUT_OF_RANGE:
            port, name = self._port_at(self._into, int(note["slot"]))
            return f"gets {note['value']:.17g} for {name}, {port.variable.range_phrase}"
        if status == groups.INEXACT_OUTPUT:
            port, name = self._port_at(self.outputs, int(note["slot"]))
            whole = int(note["whole"]) % (1 << 64 if port.variable.type == "UInt64" else 1 << 128)
            return inexact_phrase(name, port.variable.type, whole)
        functions = {groups.SAVE_FAILED: f"Get{self.state_name}", groups.RESTORE_FAILED: f"Set{self.state_name}"}
        for base, verb, ports in ((groups.SET_FAILED, "Set", self._into), (groups.GET_FAILED, "Get", self.outputs)):
            if status // 16 * 16 == base:
                variable = self._port_at(ports, int(note["slot"]))[0].variable
                functions[base] = f"{verb}{instance.standard.type_name(variable)}"
        holder = self.memory if "value" in (self.memory.dtype.names or ()) else self._shorter
        value, clock = float(holder[0]["value"]), instance.clock_name(0)
        events = (groups.ENDLESS_UPDATES, groups.EVENT_IN_PAST, groups.INVALID_INTERVAL)
        if instance.events is not None and (status in events or status // 16 * 16 == groups.INTERVAL_FAILED):
            e = instance.events[0]
            value, clock = float(e["value"]), instance.clock_name(int(e["culprit"]))
        sentence = groups.explain_status(
            status, instance.description.prefix, functions, value, clock, message, instance.invalid_status
        )
        if status == groups.DO_STEP_FAILED + 2:
            varies = instance.description.model.coSimulation.canHandleVariableCommunicationStepSize
            sentence += "; it may do with shorter steps: raise [drive] substeps, or lower --tick-ms of twin cosim"
            sentence += "" if varies else ", as it accepts no other step size"
        return sentence

    @staticmethod
    def _port_at(ports: Sequence[PortSlots], slot: int) -> tuple[FmuPort, str]:
        one = next(one for one in ports if slot in one.slots)
        name = one.port.variable.name
        return one.port, name if len(one.slots) == 1 else f"{name}[{slot - one.slots[0]}]"

    @property
    def discarded_since(self) -> float | None:
        """Time of the first step that the FMU discarded and made in parts (s); None without discarded steps."""
        s = self._shorter[0]
        return float(s["since"]) if s["discarded"] else None

    def make_rewind(self) -> Rewind:
        """Make the functions that save and restore the FMU's state to repeat a step."""
        self.allow_repeats()
        memory = np.zeros(1, dtype=cosim_step.STATE_MEMORY)
        m = memory[0]
        m["instance"], m["note"] = self.instance.handle, self.instance.note.ctypes.data
        m["get"], m["set"] = (self.instance.address(f"{verb}{self.state_name}") for verb in ("Get", "Set"))
        m["cell"] = memory["state"].ctypes.data
        moving = self.changing_arrays
        copies = np.empty(sum(array.nbytes for array in moving), dtype=np.uint8)
        table = piece_table(moving, copies.ctypes.data)
        m["pieces"], m["piece_table"] = len(table), table.ctypes.data
        self._keep += [table, copies]
        return Rewind(cosim_step.save.address, cosim_step.restore.address, memory.ctypes.data, memory)

    def allow_repeats(self) -> None:
        """Announce to the FMU that steps may be repeated from a saved state (not in FMI 1.0, whose flag differs)."""
        if self.instance.description.version > 1:
            self.memory["final"] = 0

    @property
    def changing_arrays(self) -> list[np.ndarray]:
        return [*self._moving, *self.instance.schedule]

    def pieces(self) -> dict[str, np.ndarray]:
        """Return `changing_arrays` and the record of discarded steps by name; they contain no addresses."""
        shorter = {field.name: field.view_in(self._shorter) for field in state_fields(DISCARD_RECORD)}
        return {f"memory_{number}": array for number, array in enumerate(self.changing_arrays, start=1)} | shorter

    def _group_table(self, ports: Iterable[PortSlots], access: str) -> np.ndarray:
        """Make the table of groups of FMU variables to "Set" or "Get", with one call each.

        The variables of a group have one type and one set of clocks, and one set of items if they are set.
        """
        instance = self.instance
        members: dict[tuple[str, tuple[float, ...], int], list[PortSlots]] = {}
        for p in ports:
            variable = p.port.variable
            items = tuple(sorted(variable.items.values())) if access == "Set" else ()
            key = instance.standard.type_name(variable), items, instance.clock_bits(variable)
            members.setdefault(key, []).append(p)
        table = np.zeros(len(members), dtype=groups.GROUP_RECORD)
        self._keep.append(table)
        for row, (type_name, items, bits), group in zip(table, members, members.values(), strict=True):
            variable = group[0].port.variable
            kind = variable.kind
            slots = np.concatenate([p.slots for p in group])
            arrays: dict[str, np.ndarray] = {
                "references": np.array([p.port.variable.reference for p in group], dtype=np.uint32),
                "slots": slots.astype(np.uint64),
                "gain": np.concatenate([np.full(len(p.slots), p.port.gain) for p in group]),
                "offset": np.concatenate([p.port.offset + p.shift for p in group]),
                "item_values": np.array(items),
                "buffer": np.zeros(len(slots) * ITEM_SIZES[kind], dtype=np.uint8),
                # bytes 0xFF match no input value, so the first value counts as new
                "last": np.full(len(slots) * ITEM_SIZES[kind], 0xFF, dtype=np.uint8),
            }
            wide = variable.type == "Boolean" and kind != groups.BOOLEAN_KIND
            row["kind"] = groups.BOOLEAN_32_KIND if wide else kind
            row["clocks"], row["bytes"] = bits, len(arrays["buffer"])
            row["note"] = instance.note.ctypes.data
            row["access"] = instance.address(access + type_name)
            row["variables"], row["values"], row["items"] = len(group), len(slots), len(items)
            for field, array in arrays.items():
                row[field] = array.ctypes.data
                (self._moving if field in ("buffer", "last") else self._keep).append(array)
        return table

    def _fill_ramp(self, starts: Sequence[PortSlots], ends: Sequence[PortSlots]) -> None:
        instance, r = self.instance, self.instance.ramp[0]
        kind = "Float64" if instance.description.version == 3 else "Real"
        slots = np.concatenate([p.slots for p in starts]).astype(np.uint64)
        arrays: dict[str, np.ndarray] = {
            "references": np.array([p.port.variable.reference for p in starts], dtype=np.uint32),
            "orders": np.ones(len(slots), dtype=np.int32),
            "starts": slots,
            "ends": np.concatenate([p.slots for p in ends]).astype(np.uint64),
            "gain": np.concatenate([np.full(len(p.slots), p.port.gain) for p in starts]),
            "offset": np.concatenate([np.full(len(p.slots), p.port.offset) for p in starts]),
            **{name: np.zeros(len(slots)) for name in ("begin", "slope", "buffer")},
        }
        for field, array in arrays.items():
            r[field] = array.ctypes.data
            self._keep.append(array)
        r["instance"], r["set"] = instance.handle, instance.address(f"Set{kind}")
        r["derivatives"] = instance.address("SetRealInputDerivatives") if instance.description.version < 3 else 0
        # set last, as the callback of FMI 3.0 checks whether there are any
        r["values"] = len(slots)

    def _is_plain(self, inputs: Sequence[FmuPort], outputs: Sequence[FmuPort], shift: np.ndarray | None) -> bool:
        """Whether no value of the FMU needs conversion: all Real and unscaled, and at most one output shifted."""
        ports = (*inputs, *outputs)
        alike = all(p.variable.type == "Real" and p.gain == 1.0 and p.offset == 0.0 for p in ports)
        return alike and bool(inputs) and bool(outputs) and (shift is None or int(np.count_nonzero(shift)) <= 1)

    def _plain_step(self) -> tuple[int, np.ndarray]:
        (set_,), (get,) = self._group_table(self._into, "Set"), self._group_table(self.outputs, "Get")
        memory = np.zeros(1, dtype=cosim_step.PLAIN_MEMORY)
        m = memory[0]
        m["instance"], m["do_step"] = self.instance.handle, self.instance.address("DoStep")
        m["set_real"], m["inputs"], m["input_references"] = set_["access"], set_["variables"], set_["references"]
        m["get_real"], m["outputs"], m["output_references"] = get["access"], get["variables"], get["references"]
        shift = np.concatenate([p.shift for p in self.outputs])
        m["shifted"] = np.argmax(np.abs(shift))
        m["shift"] = shift[m["shifted"]]
        m["shorter"], m["note"] = self._shorter.ctypes.data, self.instance.note.ctypes.data
        return cosim_step.plain_step.address, memory

    def _event_step(self, into: Sequence[PortSlots]) -> tuple[int, np.ndarray]:
        instance, abilities = self.instance, self.instance.description.model.coSimulation
        discrete = (
            [p for p in into if p.port.variable.variability != "continuous"] if instance.events is not None else []
        )
        held = [p for p in self.outputs if instance.clock_bits(p.port.variable)]
        memory = np.zeros(1, dtype=cosim_step.EVENT_MEMORY)
        m = memory[0]
        m["instance"] = instance.handle
        self._fill(
            m,
            self._group_table([p for p in into if p not in discrete], "Set"),
            self._group_table([p for p in self.outputs if p not in held], "Get"),
        )
        tables = self._group_table(discrete, "Set"), self._group_table(held, "Get")
        m["held"], m["held_groups"] = len(tables[1]), tables[1].ctypes.data
        m["early"], m["varies"] = instance.description.returns_early, abilities.canHandleVariableCommunicationStepSize
        m["discrete"], m["clocks"] = len(tables[0]), len(instance.clocks)
        m["next"] = instance.planned.ctypes.data
        if instance.events is not None:
            m["events"] = instance.events.ctypes.data
            for name, table in zip(("discrete", "held"), tables, strict=True):
                instance.events[name], instance.events[f"{name}_groups"] = len(table), table.ctypes.data
        return cosim_step.event_step.address, memory

    def _fill(self, m: Any, inputs: np.ndarray, outputs: np.ndarray) -> None:
        returned = np.zeros(16, dtype=np.uint8)
        self._keep.append(returned)
        ramp = self.instance.ramp[0]
        m["do_step"], m["returned"] = self.instance.address("DoStep"), returned.ctypes.data
        m["note"] = self.instance.note.ctypes.data
        m["ramp"] = self.instance.ramp.ctypes.data if ramp["values"] else 0
        m["inputs"], m["input_groups"] = len(inputs), inputs.ctypes.data
        m["outputs"], m["output_groups"] = len(outputs), outputs.ctypes.data
