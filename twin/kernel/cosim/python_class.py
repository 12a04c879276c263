"""Components written as Python classes.

The step of a `PythonModel` works in the master's memory. For users' classes, `NamedPorts` converts to and from
dictionaries by port name, which is slower and protects that memory.
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
"""Methods of a class whose state can be saved: `state()` returns numbers, strings and arrays, in lists and
dictionaries; `restore(state)` restores such a result; its tuples have become lists."""
STEP_FUNCTION = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)
MAX_EXCEPTION_TEXT = 200
"""Maximum length of a quoted exception (characters)."""


class PythonModel(Protocol):
    """Interface of a Python class that can be a component; plain class attributes serve as the three properties."""

    @property
    def inputs(self) -> Sequence[Port]:
        """Input ports of the Python component."""

    @property
    def outputs(self) -> Sequence[Port]:
        """Output ports of the Python component."""

    @property
    def sampled(self) -> bool:
        """Whether the component is evaluated at t_k, without advancing time; see `Component`."""

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        """Compute outputs `y` in place from inputs `u` for a step from `t` to `t` + `h` (s); raise to stop the run."""


class PythonComponent(Component):
    """A Python object as a component; slower than a compiled one, as each step is a callback."""

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
            # ctypes prints and drops an exception that leaves a callback, so it is stored for `explain`
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
    """Saved states of a Python object as a `Holder`, or why it is `lacking` them, as a verb phrase; "" if it has.

    Its tokens are the serialised state.
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
        """Do nothing: tokens are serialised states of a Python object, which own no resources."""

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
    """Error that a Python component's outputs do not match its declared ports; the message is a verb phrase."""


class DeclaredPorts:
    """Input or output ports that a Python class declares, in the order offered, optionally in units of its own.

    `gains` has the SI value per value in the class's unit by port, `units` that unit.
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
    """Adapter from a model with `step(t, inputs) -> outputs`, dictionaries of values, to a `PythonModel`.

    Arrays are copied in both directions. `stateful` is the model, which holds the state.
    """

    sampled = True

    def __init__(self, model: Any, inputs: DeclaredPorts, outputs: DeclaredPorts):
        self.inputs, self.outputs, self.stateful = inputs.ports, outputs.ports, model
        self._model, self._inputs, self._outputs = model, inputs, outputs

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        # copies, so that values that the class keeps do not change later
        given = {n: u[p] / g if s > 1 else float(u[p][0]) / g for n, s, p, g in self._inputs.places}
        _write_outputs(self._model.step(t, given), self._outputs, y)


def _write_outputs(answer: Any, wanted: DeclaredPorts, into: np.ndarray) -> None:
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
    """A Python source file with component classes, read and compiled once."""

    def __init__(self, file: Path):
        content = read_bytes(file, kind="Python file")
        self.file, self.sha256 = file, hashlib.sha256(content).hexdigest()
        try:
            self._code = compile(content, str(file), "exec")
        except SyntaxError as problem:
            raise InputRefused(f"{file}, line {problem.lineno}: {problem.msg}") from None
        except ValueError as problem:
            raise InputRefused(f"{file}: not a Python file: {problem}") from None

    def load_class(self, name: str) -> type:
        """Execute the Python file as a new module and return its class `name`; it can import from its own folder."""
        module = ModuleType(f"{self.file.stem}_{self.sha256[:12]}")
        module.__file__ = str(self.file)
        # dataclasses look up their module in sys.modules
        sys.modules[module.__name__] = module
        sys.path.insert(0, str(self.file.parent))
        try:
            exec(self._code, module.__dict__)
        except KeyboardInterrupt:
            raise
        # any exception, even SystemExit, while a user's file is imported is a reason to refuse it
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
    """Check the (inputs, outputs) that a Python component declares, of those offered and with those required."""
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
    """Describe an exception and its origin in a phrase: `raised ValueError: text (my_controller.py, line 12)`."""
    here = os.path.abspath(__file__)
    trace = traceback.extract_tb(problem.__traceback__ if problem else None)
    frames = [frame for frame in trace if os.path.abspath(frame.filename) != here]
    # the innermost frame may be in a library; the user needs the last line of their own file
    own = [frame for frame in frames if "site-packages" not in frame.filename] or frames
    where = f" ({os.path.basename(own[-1].filename)}, line {own[-1].lineno})" if own else ""
    text = " ".join(str(problem).split())
    return f"raised {type(problem).__name__}{': ' if text else ''}{text[:MAX_EXCEPTION_TEXT]}{where}"


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
