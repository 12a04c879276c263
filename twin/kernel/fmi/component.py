"""FMU components: an FMU of any kind, initialised, brought into step mode, and stepped by address.

Each run creates a new instance. FMI's `reset` is only used to check it, as it initialises again but restores no state.
The saved state of a component consists of the FMU's internal state and the record of reported messages.
"""

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from twin.kernel.cache_folder import cache_base, cache_folder
from twin.kernel.cosim.component import Component, Holder, Rewind
from twin.kernel.cosim.port import by_port
from twin.kernel.errors import ComponentFailed, InputRefused, TwinError
from twin.kernel.files import parse_json
from twin.kernel.fmi.description import FmuDescription
from twin.kernel.fmi.exchange import ExchangeStepping, ModelExchange, react
from twin.kernel.fmi.groups import TERMINATE_REQUEST
from twin.kernel.fmi.instance import Instance
from twin.kernel.fmi.lifecycle import CosimInstance
from twin.kernel.fmi.solvers import Solver
from twin.kernel.fmi.stepping import FmuPort, PortSlots, Stepping, port_slots
from twin.kernel.fmi.variable import Setting, Setup

STATELESS_FOLDER = "without_state"
"""Cache folder with a file for each FMU (by SHA-256) whose restored state was found to differ from the saved one."""


def mark_stateless(sha256: str, reason: str) -> None:
    """Mark an FMU as unable to save its state for a `reason`, in all of this user's processes; "" removes the mark."""
    file = cache_folder(STATELESS_FOLDER) / sha256
    if reason:
        file.write_text(reason)
    else:
        file.unlink(missing_ok=True)


def is_marked_stateless(sha256: str) -> bool:
    """Whether an FMU is marked as having no usable state, see `mark_stateless`; creates no folder."""
    return (cache_base() / STATELESS_FOLDER / sha256).exists()


class FmuStates:
    """Saved states of an FMU (FMI 2.0.4, 2.1.8; FMI 3.0, 2.2.5) as a `Holder`; tokens are their addresses.

    While tokens exist, its step announces to the FMU that a state may be restored.
    """

    def __init__(self, instance: Instance, stepping: Stepping):
        self._instance, self._stepping = instance, stepping
        self._tokens: dict[int, Any] = {}

    def save_state(self) -> int:
        return self._register(self._instance.save_state())

    def restore_state(self, token: int) -> None:
        self._instance.restore_state(self._tokens[token])

    def free(self, token: int) -> None:
        if self._tokens.pop(token, None) is not None:
            if not self._tokens:
                self._stepping.memory["final"] = self._final
            try:
                self._instance.free_state(token)
            except ComponentFailed as failure:
                # called by finalizers, whose exceptions are lost
                self._instance.report(str(failure))

    def pack(self, token: int) -> bytes:
        return self._instance.serialize_state(self._tokens[token])

    def unpack(self, content: bytes) -> int:
        return self._register(self._instance.deserialize_state(content))

    def close(self) -> None:
        for token in list(self._tokens):
            self.free(token)

    def _register(self, state: Any) -> int:
        if not self._tokens:
            self._final = int(self._stepping.memory["final"][0])
            self._stepping.allow_repeats()
        self._tokens[state.value] = state
        return int(state.value)


class RememberedMessages:
    """Messages and discarded steps that an FMU and its step, which report each once, have reported, as a `Holder`."""

    def __init__(self, label: str, instance: Instance, stepping: Stepping):
        self._label, self._instance, self._stepping = label, instance, stepping

    def save_state(self) -> list[Any]:
        instance = self._instance
        return [list(instance.messages), list(instance.pending_messages), self._stepping.discard_reported]

    def restore_state(self, token: list[Any]) -> None:
        self._instance.messages, self._instance.pending_messages = list(token[0]), list(token[1])
        self._stepping.discard_reported = token[2]

    def free(self, token: list[Any]) -> None:
        """Do nothing: the token is a list of messages, which owns no resources."""

    def pack(self, token: list[Any]) -> bytes:
        return json.dumps(token).encode()

    def unpack(self, content: bytes) -> list[Any]:
        try:
            messages, unheard, reported = parse_json(content, self._label)
            return [list(map(str, messages)), [(int(tick), str(text)) for tick, text in unheard], bool(reported)]
        except (TypeError, ValueError, OverflowError):
            raise InputRefused(f"{self._label}: no messages that twin saved") from None


def instance_class(description: FmuDescription) -> type[Instance]:
    """Return the class of an FMU's instances, for co-simulation or model exchange."""
    return ModelExchange if description.kind == "model_exchange" else CosimInstance


class _DeferredInstances:
    def __init__(self) -> None:
        self.now = False
        self.instances: list[Instance] = []


_instances_to_free = _DeferredInstances()


@contextmanager
def defer_release() -> Iterator[None]:
    """Defer the release of FMU instances that end in the block, as some FMUs crash when freed.

    Instances of FMUs that allow only one per process are freed immediately.
    """
    _instances_to_free.now = True
    try:
        yield
    finally:
        _instances_to_free.now = False


def release(instance: Instance) -> None:
    """Free an FMU instance after its run, or defer that within `defer_release`."""
    if _instances_to_free.now and not instance.description.single_instance:
        _instances_to_free.instances.append(instance)
    else:
        instance.close()


class FmuComponent(Component):
    """An FMU instance as a component of a co-simulation, with a solver for model exchange.

    Args:
        settings: values set before initialisation, in the FMU's units.
        inputs_at_start: port -> value (SI) in initialisation mode; 0 for other ports, but the start
            value of an enumeration.
        outputs_at_start: port -> value (SI) of the output at t = 0 after a shift: the zero of an angle is arbitrary,
            and the shaft is coupled at its present angle.
        sampled: whether it is evaluated at t_k; its outputs are then meaningless before the first evaluation.
        instance: FMU instance in step mode; None to create and initialise one.
        solver: solver for model exchange; None for CVODE.
        unread: names of output ports that nothing reads; they need not be finite.

    InputRefused: it cannot be initialised, an output is not finite afterwards, or CVODE is not available for this
    platform. ComponentFailed: an output cannot be read.
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
        instance: Instance | None = None,
        solver: Solver | None = None,
        unread: Collection[str] = (),
    ):
        wanted = inputs_at_start or {}
        # 0 may be no value of an enumeration
        given = [p for p in inputs if p.port.name in wanted or not p.variable.items]
        started = [(p.variable, p.to_fmu(wanted.get(p.port.name, 0.0))) for p in given]
        kind = CosimInstance if sampled else instance_class(description)
        self.instance = instance or kind(name, description, folder, settings, started, setup)
        try:
            initial = np.concatenate([np.zeros(0), *(p.gain * self._initial_values(p) + p.offset for p in outputs)])
            if sampled:
                initial[:] = 0.0
            # adding -0.0 leaves every value unchanged, adding 0.0 would turn -0.0 into 0.0
            shift = np.full(len(initial), -0.0)
            for p in port_slots(outputs):
                if p.port.port.name in (outputs_at_start or {}):
                    shift[p.slots] = (outputs_at_start or {})[p.port.port.name] - initial[p.slots]
            may = np.array([p.port.name in unread for p in outputs for _ in range(p.port.size)], dtype=np.int64)
            if not np.all(np.isfinite(initial) | (may > 0)):
                raise InputRefused(f"{description.path}: an output is not finite after initialisation: {initial}")
            self._stepping = (
                ExchangeStepping(self.instance, solver or Solver(), inputs, outputs, shift)
                if isinstance(self.instance, ModelExchange)
                else Stepping(self.instance, inputs, outputs, shift)
            )
        except TwinError:
            self.instance.close()
            raise
        self._shift = shift
        self._rewind: Rewind | None = None
        self._inside = FmuStates(self.instance, self._stepping)
        self._remembered = RememberedMessages(description.path.name, self.instance, self._stepping)
        super().__init__(
            name=name,
            inputs=tuple(p.port for p in self._stepping.inputs),
            outputs=tuple(p.port for p in outputs),
            sampled=sampled,
            step_address=self._stepping.address,
            self_address=self._stepping.memory.ctypes.data,
            initial_outputs=initial + shift,
            label=description.path.name,
            keep=self._stepping.memory,
            unread=may if unread else None,
        )
        self._unread_reported: set[str] = set()

    def zero(self, name: str) -> float:
        """Return the value (SI) of output port `name` that corresponds to an FMU output of 0."""
        return float(by_port(self.outputs, self._shift)[name][0])

    @property
    def ports(self) -> tuple[Sequence[FmuPort], Sequence[PortSlots]]:
        """Ports with their FMU variables: (input ports, output ports with slots)."""
        return self._stepping.inputs, self._stepping.outputs

    @property
    def step_call(self) -> str:
        """Name of the FMI function that a step of the FMU calls, for messages."""
        if isinstance(self.instance, ModelExchange):
            return "its equations of model exchange"
        return f"{self.instance.description.prefix}DoStep"

    def _initial_values(self, port: FmuPort) -> np.ndarray:
        """Return the outputs of the FMU before its first step; for clocked outputs the start values."""
        if port.variable.clocks:
            return np.full(port.port.size, np.nan_to_num(port.variable.start))
        return self.instance.read_floats([port.variable])

    def explain(self, status: int) -> str:
        return self._stepping.explain(status)

    def requests_end(self, status: int) -> bool:
        return status == TERMINATE_REQUEST

    def reaction(self) -> int:
        return react.address if isinstance(self.instance, ModelExchange) else 0

    def rewind(self) -> Rewind | None:
        if not self.instance.description.interface.canGetAndSetFMUstate:
            return None
        if self._rewind is None:
            self._rewind = self._stepping.make_rewind()
        return self._rewind

    def pieces(self) -> dict[str, np.ndarray]:
        return self._stepping.pieces()

    def holders(self) -> dict[str, Holder]:
        return {"fmu": self._inside, "messages": self._remembered}

    def lacks_state(self, portable: bool = True) -> str:
        interface, version = self.instance.description.interface, self.instance.description.version
        if not interface.canGetAndSetFMUstate:
            return "has no FMU state" + (" (FMI 1.0 does not define it)" if version == 1 else " (canGetAndSetFMUState)")
        if is_marked_stateless(self.instance.description.sha256):
            return "continues differently after a saved state is restored, as twin drive check found"
        if portable and not interface.canSerializeFMUstate:
            return "cannot write its FMU state down (canSerializeFMUState)"
        if isinstance(self._stepping, ExchangeStepping) and self._stepping.solver.method == "cvode":
            return 'is solved by CVODE, whose history cannot be saved; solver = "rk4" has none'
        return ""

    def keep_time(self, clock: np.ndarray) -> None:
        self.instance.clock, self.instance.stepped = clock, True

    def take_messages(self) -> list[tuple[int, str]]:
        messages = self.instance.pop_messages()
        since = self._stepping.discarded_since
        if since is not None and not self._stepping.discard_reported:
            self._stepping.discard_reported = True
            text = f"it discards steps, which are then made in parts, since t = {since:g} s"
            messages.append((int(self.instance.clock[0]), text))
        for name, marks in by_port(self.outputs, self.unread).items() if self.unread is not None else ():
            if marks.max(initial=0) > 1 and name not in self._unread_reported:
                self._unread_reported.add(name)
                text = f"returns NaN or infinity for {name}, which nothing reads"
                messages.append((int(marks[marks > 1].min()) - 2, text))
        return messages

    def close(self) -> None:
        if isinstance(self._stepping, ExchangeStepping):
            self._stepping.integrator.close()
        rewind, self._rewind = self._rewind, None
        self._inside.close()
        try:
            if rewind is not None and rewind.keep[0]["state"]:
                self.instance.free_state(int(rewind.keep[0]["state"]))
        finally:
            if self.sampled:
                self.instance.close()
            else:
                release(self.instance)
