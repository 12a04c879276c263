"""FMPy's instances, loaded quickly: what they find out about their functions is the same for every one of a kind."""

from ctypes import c_char_p, c_int
from typing import Any, ClassVar
from weakref import proxy

from fmpy.fmi1 import FMU1Slave
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import FMU3Model, FMU3Slave

_complete: set[str] = set()
"""Binaries, by their places, of which it is known that they have every function."""


class _Asked(dict[str, Any]):
    """Functions of `slave` by their names, found when they are asked for: a run calls a third of them."""

    def __init__(self, slave: "_Remembering"):
        super().__init__()
        # the slave holds this
        self._slave = proxy(slave)

    def __missing__(self, name: str) -> Any:
        self[name] = found = self._slave._function(name)
        return found


class _Remembering:
    """Gives the functions of a binary the signatures that FMPy has worked out for the first one of this process.

    FMPy reads them from its own methods with `inspect`, a few milliseconds for each instance. The binary itself is
    loaded and let go for each, as ever: what it keeps in static memory must not reach from one run into the next.
    """

    _signatures: ClassVar[dict[str, tuple[Any, ...]]]
    _functions: dict[str, Any]
    dll: Any

    def _loadFunctions(self) -> None:
        known = type(self)._signatures
        if not known:
            super()._loadFunctions()  # type: ignore[misc]
            known.update({name: self._signature(name, f) for name, f in self._functions.items()})
        elif self.dll._name not in _complete:
            for name in known:
                self._functions[name] = self._function(name)
        else:
            self._functions = _Asked(self)
        _complete.add(self.dll._name)

    def _function(self, name: str) -> Any:
        """The function `name` of FMPy's, with its signature."""
        function = getattr(self.dll, self._exported(name))
        function.argnames, function.argtypes, function.restype = type(self)._signatures[name]
        return function

    def _exported(self, name: str) -> str:
        """What the binary calls the function `name` of FMPy's."""
        return name

    def _signature(self, name: str, function: Any) -> tuple[Any, ...]:
        return function.argnames, function.argtypes, function.restype


# FMPy tells the standard by how the class is called
class FMU1Drive(_Remembering, FMU1Slave):
    """An FMI 1.0 slave, whose functions have the model's name before theirs."""

    _signatures: ClassVar[dict[str, tuple[Any, ...]]] = {}

    def _exported(self, name: str) -> str:
        return f"{self.modelIdentifier}_{name.replace('fmi1', 'fmi')}"

    def _signature(self, name: str, function: Any) -> tuple[Any, ...]:
        # FMPy has several return text that return a status: read as an address, every bad one would crash
        if not name.endswith(("Version", "TypesPlatform")) and function.restype is c_char_p:
            function.restype = c_int
        return super()._signature(name, function)


class FMU2Drive(_Remembering, FMU2Slave):
    """An FMI 2.0 slave."""

    _signatures: ClassVar[dict[str, tuple[Any, ...]]] = {}


class FMU3Drive(_Remembering, FMU3Slave):
    """An FMI 3.0 slave."""

    _signatures: ClassVar[dict[str, tuple[Any, ...]]] = {}


class FMU2Exchange(_Remembering, FMU2Model):
    """An FMI 2.0 model."""

    _signatures: ClassVar[dict[str, tuple[Any, ...]]] = {}


_OF_OTHER_KINDS = {
    "fmi3ActivateModelPartition",
    "fmi3DoStep",
    "fmi3EnterStepMode",
    "fmi3GetOutputDerivatives",
    "fmi3InstantiateCoSimulation",
    "fmi3InstantiateScheduledExecution",
}


class FMU3Exchange(_Remembering, FMU3Model):
    """An FMI 3.0 model."""

    _signatures: ClassVar[dict[str, tuple[Any, ...]]] = {}

    def __dir__(self) -> list[str]:
        # FMPy looks here for the functions that a binary has to have, and these it need not have (FMI 3.0, 2.1.2)
        return [name for name in super().__dir__() if name not in _OF_OTHER_KINDS]
