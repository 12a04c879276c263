"""A component written as a plain Python class.

Its step works in the master's memory. With `NamedPorts` around it a class takes and gives dictionaries by the names of
ports, which is slower, and nothing can be written by mistake: so a user writes a part of the robot.
"""

import ctypes
import hashlib
import inspect
import json
import os
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from twin.kernel.cosim.component import Component, Holder
from twin.kernel.cosim.port import Port, port_slices, width
from twin.kernel.cosim.state import decode_json, encode_json
from twin.kernel.errors import ComponentFailed, InputRefused, nearest
from twin.kernel.files import parse_json, read_bytes
from twin.kernel.units import known_unit, weight_hint

STEP_FAILED = 2
STATE_METHODS = ("state", "restore")
"""Methods of a class whose state can be saved: `state()` gives numbers, texts and arrays, in lists and dictionaries;
`restore(state)` goes back to what it gave, tuples as lists."""
STEP_FUNCTION = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)
MAX_EXCEPTION_TEXT = 200
"""Of an exception that is quoted."""


class PythonModel(Protocol):
    """What a plain class needs to take part.

    Plain class attributes serve as the three properties.
    """

    @property
    def inputs(self) -> Sequence[Port]:
        """Its input ports."""

    @property
    def outputs(self) -> Sequence[Port]:
        """Its output ports."""

    @property
    def sampled(self) -> bool:
        """See `Component`."""

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        """Read inputs `u`, write outputs `y` in place; raise to stop the run."""


class PythonComponent(Component):
    """A `PythonModel` as a component, slower than a compiled one: a callback per step.

    Args:
        name: of the component.
        model: it.
        period: in ticks.
        initial_outputs: zeros if not given.
        label: what an error calls it; its class if not given.
    """

    def __init__(
        self,
        name: str,
        model: PythonModel,
        period: int = 1,
        initial_outputs: Sequence[float] | None = None,
        label: str = "",
    ):
        inputs, outputs = tuple(model.inputs), tuple(model.outputs)
        views: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}
        self.exception: BaseException | None = None

        def callback(_self: int, t: float, h: float, u: int, y: int) -> int:
            if (u, y) not in views:
                views[u, y] = (doubles_view(u, width(inputs)), doubles_view(y, width(outputs)))
            try:
                model.step(t, h, *views[u, y])
            # Anything that leaves a callback would be printed and lost; it is kept for `explain`.
            except BaseException as exception:
                self.exception = exception
                return STEP_FAILED
            return 0

        function = STEP_FUNCTION(callback)
        self._states = ObjectStates(label or type(model).__name__, getattr(model, "stateful", model))
        super().__init__(
            name=name,
            inputs=inputs,
            outputs=outputs,
            sampled=model.sampled,
            step_address=ctypes.cast(function, ctypes.c_void_p).value or 0,
            self_address=0,
            initial_outputs=np.zeros(width(outputs))
            if initial_outputs is None
            else np.asarray(initial_outputs, dtype=float),
            period=period,
            label=label or type(model).__name__,
            keep=function,
        )

    def holders(self) -> dict[str, Holder]:
        return {"object": self._states}

    def lacks_state(self, portable: bool = True) -> str:
        return self._states.lacking

    def explain(self, status: int) -> str:
        if isinstance(self.exception, KeyboardInterrupt):
            raise self.exception
        if isinstance(self.exception, InvalidOutputs):
            return str(self.exception)
        return exception_phrase(self.exception)


class ObjectStates:
    """The states of a Python object, a `Holder`: its tokens are what it would write down.

    Args:
        label: what an error calls it.
        model: the object.

    Attributes:
        lacking: why it has no state, as the verb phrase of a sentence; "" if it has one.
    """

    def __init__(self, label: str, model: Any):
        self._label, self._model = label, model
        missing = [name for name in STATE_METHODS if not callable(getattr(model, name, None))]
        self.lacking = f"is a Python class without {' and '.join(f'{name}()' for name in missing)}" if missing else ""

    def save_state(self) -> bytes:
        return self._call_method("state", lambda: json.dumps(encode_json(self._model.state()))).encode()

    def restore_state(self, token: bytes) -> None:
        state = decode_json(parse_json(token, self._label), self._label)
        self._call_method("restore", lambda: self._model.restore(state))

    def free(self, token: bytes) -> None:
        """Nothing is held."""

    def pack(self, token: bytes) -> bytes:
        return token

    def unpack(self, content: bytes) -> bytes:
        return content

    def _call_method(self, name: str, call: Callable[[], Any]) -> Any:
        try:
            return call()
        except Exception as problem:
            raise ComponentFailed(f"{self._label}: {name}() {exception_phrase(problem)}") from None


def doubles_view(address: int, count: int) -> np.ndarray:
    if count == 0:
        return np.empty(0)
    return np.ctypeslib.as_array((ctypes.c_double * count).from_address(address))


class InvalidOutputs(Exception):
    """What a step returned is not what its class has said."""


class DeclaredPorts:
    """Ports that a class names, with units of its own where it says so.

    Attributes:
        ports: of them, in the contract's order.
        gains: SI values per value of the class's, by port.
        units: of the class's values, by port.
    """

    def __init__(self, label: str, side: str, listed: Any, offered: Sequence[Port]):
        if isinstance(listed, str) or not isinstance(listed, Mapping | Sequence):
            raise InputRefused(f"{label}: {side} = {listed!r}; expected names, such as ({offered[0].name!r},)")
        units = dict(listed) if isinstance(listed, Mapping) else dict.fromkeys(listed)
        if len(units) != len(listed):
            raise InputRefused(f"{label}: {side} names one port twice; name each once")
        known = {port.name: port for port in offered}
        for name in units:
            if name not in known:
                raise InputRefused(f"{label}: {side} has {name!r}; {nearest(str(name), list(known), 'there are {}')}")
        self.ports = tuple(port for port in offered if port.name in units)
        self.gains = {port.name: _gain(label, port, units[port.name]) for port in self.ports}
        self.units = {port.name: units[port.name] or port.unit for port in self.ports}
        at = port_slices(self.ports)
        self.places = [(port.name, port.size, at[port.name], self.gains[port.name]) for port in self.ports]


def _gain(label: str, port: Port, unit: Any) -> float:
    if unit is None:
        return 1.0
    stated, si = (known_unit(str(unit)), known_unit(port.unit))
    if stated is None or si is None or stated.dimension != si.dimension:
        hint = weight_hint(stated.dimension, si.dimension) if stated and si else ""
        raise InputRefused(f"{label}: {port.name} in {unit!r}; expected a unit like {port.unit}{hint}")
    return stated.scale


class NamedPorts:
    """A `PythonModel` of one that takes and gives dictionaries, and nothing but copies: arrays into them, and back.

    Args:
        model: with `step(t, inputs) -> outputs`.
        inputs, outputs: what it has.

    Attributes:
        stateful: `model`, whose state is this one's.
    """

    sampled = True

    def __init__(self, model: Any, inputs: DeclaredPorts, outputs: DeclaredPorts):
        self.inputs, self.outputs, self.stateful = inputs.ports, outputs.ports, model
        self._model, self._inputs, self._outputs = model, inputs, outputs

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        # copies, so that what a class keeps stays what it was
        given = {n: u[p] / g if s > 1 else float(u[p][0]) / g for n, s, p, g in self._inputs.places}
        _write_outputs(self._model.step(t, given), self._outputs, y)


def _write_outputs(answer: Any, wanted: DeclaredPorts, into: np.ndarray) -> None:
    """Write what a step has returned to `into`.

    Raises:
        OutputsRefused: it is not what the class has said, as the verb phrase of a sentence.
    """
    if not isinstance(answer, Mapping):
        raise InvalidOutputs(f"returned {type(answer).__name__} from step (expected a dictionary of its outputs)")
    for name, size, place, gain in wanted.places:
        if name not in answer:
            raise InvalidOutputs(f"returned no {name!r} from step (its outputs name it)")
        try:
            value = np.asarray(answer[name], dtype=float)
        except (TypeError, ValueError):
            raise InvalidOutputs(
                f"returned {_short_repr(answer[name])} for {name} from step (expected numbers)"
            ) from None
        if value.size != size:
            raise InvalidOutputs(f"returned {value.size} values for {name} from step (expected {size})")
        into[place] = value.ravel() * gain
    if len(answer) > len(wanted.places):
        other = next(name for name in answer if name not in wanted.gains)
        raise InvalidOutputs(f"returned {_short_repr(other)} from step (its outputs do not name it)")


class PythonSource:
    """A Python file as it was read once; it is run by `load_class`, not before.

    Attributes:
        file: where it lies.
        sha256: of its bytes.

    Raises:
        InputRefused: it cannot be read, or is no Python.
    """

    def __init__(self, file: Path):
        content = read_bytes(file, kind="Python file")
        self.file, self.sha256 = file, hashlib.sha256(content).hexdigest()
        try:
            self._code = compile(content, str(file), "exec")
        except SyntaxError as problem:
            raise InputRefused(f"{file}, line {problem.lineno}: {problem.msg}") from None
        except ValueError as problem:
            raise InputRefused(f"{file}: no Python: {problem}") from None

    def load_class(self, name: str) -> type:
        """The class `name`, of a module made anew; the file can import those beside it.

        Raises:
            InputRefused: the file cannot be run, or has no such class.
        """
        module = ModuleType(f"{self.file.stem}_{self.sha256[:12]}")
        module.__file__ = str(self.file)
        # dataclasses look their module up
        sys.modules[module.__name__] = module
        sys.path.insert(0, str(self.file.parent))
        try:
            exec(self._code, module.__dict__)
        except KeyboardInterrupt:
            raise
        # whatever a file of somebody does when it is imported, it is a reason to refuse it
        except BaseException as problem:
            raise InputRefused(f"{self.file}: cannot be imported: it {exception_phrase(problem)}") from None
        finally:
            sys.path.remove(str(self.file.parent))
        found = getattr(module, name, None)
        if not isinstance(found, type):
            classes = [n for n, v in vars(module).items() if isinstance(v, type) and v.__module__ == module.__name__]
            raise InputRefused(f"{self.file}: has no class '{name}'; {nearest(name, classes, 'it has {}')}")
        return found


def declared_ports(
    label: str, kind: Any, inputs: Sequence[Port], outputs: Sequence[Port], required: Sequence[str]
) -> tuple[DeclaredPorts, DeclaredPorts]:
    """What a class, or an instance, says that it takes and gives.

    Args:
        label: what an error calls it.
        inputs, outputs: ports of the part of the robot that it is to be.
        required: outputs that it must have.

    Raises:
        InputRefused: it says nothing, or names what is not there; or it has no `step(t, inputs)`.
    """
    for attribute in ("inputs", "outputs", "step"):
        if not hasattr(kind, attribute):
            raise InputRefused(f"{label}: has no '{attribute}'; expected inputs, outputs and step(t, inputs)")
    found = DeclaredPorts(label, "inputs", kind.inputs, inputs), DeclaredPorts(label, "outputs", kind.outputs, outputs)
    for name in required:
        if name not in found[1].gains:
            raise InputRefused(f"{label}: outputs lacks {name!r}, which the robot needs")
    own = (None,) if isinstance(kind, type) else ()
    if not _accepts(kind.step, *own, 0.0, {}):
        raise InputRefused(f"{label}: step{_signature(kind.step)}; expected step(self, t, inputs)")
    return found


def make_instance(label: str, kind: type, parameters: Mapping[str, Any]) -> Any:
    """An instance.

    Raises:
        InputRefused: it has no such parameters, or refuses to be made.
    """
    try:
        known = list(inspect.signature(kind).parameters)
    except ValueError:
        known = []
    if not _accepts(kind, **parameters):
        other = next((name for name in parameters if name not in known), "")
        if other:
            raise InputRefused(f"{label}: no parameter '{other}'; {nearest(other, known, 'it has {}')}")
        raise InputRefused(f"{label}: takes ({', '.join(known)}); give those without a default a value in parameters")
    try:
        return kind(**parameters)
    except Exception as problem:
        raise InputRefused(f"{label}: cannot be made: it {exception_phrase(problem)}") from None


def exception_phrase(problem: BaseException | None) -> str:
    """`raised ValueError: text (my_controller.py, line 12)`: where in somebody's own file it came from."""
    frames = [
        f for f in traceback.extract_tb(problem.__traceback__ if problem else None) if not _is_this_file(f.filename)
    ]
    # what the user's file has called may be numpy's: the last line of the user's own is the one to look at
    own = [frame for frame in frames if "site-packages" not in frame.filename] or frames
    where = f" ({os.path.basename(own[-1].filename)}, line {own[-1].lineno})" if own else ""
    text = " ".join(str(problem).split())
    return f"raised {type(problem).__name__}{': ' if text else ''}{text[:MAX_EXCEPTION_TEXT]}{where}"


def _is_this_file(file: str) -> bool:
    return os.path.abspath(file) == os.path.abspath(__file__)


def _accepts(called: Callable[..., Any], *positional: Any, **named: Any) -> bool:
    try:
        inspect.signature(called).bind(*positional, **named)
    except (TypeError, ValueError):
        return False
    return True


def _signature(called: Callable[..., Any]) -> str:
    try:
        return str(inspect.signature(called))
    except (TypeError, ValueError):
        return ""


def _short_repr(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:40]}..."
