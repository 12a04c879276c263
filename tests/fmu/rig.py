"""A test rig for one drive: opens its .fmu with FMPy, sets it up and steps it."""

import atexit
import tempfile
import tomllib
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from builder.drive import drive_names
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.model_description import ModelDescription

FMUS = Path(__file__).resolve().parents[2] / "fmus"
DRIVES = drive_names()
"""Of FMI 2.0, with the ceremony of fmus/fmi2."""

MIDDLING = {"brushed_dc": 1.5, "smart_servo": 5.0}
"""A command that turns the drive at about 0.5 rad/s, in the drive's own unit; 0.5 rad/s where none is given."""

_scratch = tempfile.TemporaryDirectory(prefix="drive_fmus_")
atexit.register(_scratch.cleanup)


def fmu_path(drive: str) -> Path:
    return FMUS / drive / f"{drive}.fmu"


@cache
def described(drive: str) -> ModelDescription:
    return read_model_description(fmu_path(drive), validate=False)


@cache
def mapping(drive: str) -> dict[str, Any]:
    """The drive's mapping.toml; empty for a drive that speaks the contract's names."""
    path = FMUS / drive / "mapping.toml"
    return tomllib.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def own_names(drive: str) -> dict[str, str]:
    """The drive's own names by role of the contract; `command` is the input that commands it, whatever its kind."""
    names: dict[str, str] = mapping(drive).get("inputs", {}) | mapping(drive).get("outputs", {})
    return {"command": names.get("omega_ref", "omega_ref"), **names}


@cache
def unpacked(drive: str) -> str:
    return str(extract(fmu_path(drive), unzipdir=Path(_scratch.name) / drive))


class Stepped:
    """What the rigs of both versions of FMI share: a slave that is stepped, and freed at the end."""

    slave: Any
    time: float

    def step(self, h: float) -> None:
        """One communication step of h seconds."""
        self.slave.doStep(self.time, h)
        self.time += h

    def run(self, h: float, steps: int) -> None:
        """Several equal communication steps with the inputs left as they are."""
        for _ in range(steps):
            self.step(h)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.slave.freeInstance()


class Rig(Stepped):
    """One instance of a drive; `with Rig("velocity_servo").start(droop=0.0) as drive: drive.run(1e-3, 20)`.

    Values are read and set by variable name, `drive["omega_m"]`, `drive["omega_ref"] = 0.5`, or by role of the
    contract where the drive has names of its own; always in its own units.

    Attributes:
        slave: the FMPy object, for calls this class does not cover.
        messages: (status, text) of everything the FMU logged.
        time: the communication point reached, s.
    """

    def __init__(self, drive: str, guid: str | None = None):
        self.messages: list[tuple[int, str]] = []
        self.time = 0.0
        self.references = {v.name: v.valueReference for v in described(drive).modelVariables}
        self.own_names = own_names(drive)
        self.callbacks = fmi2CallbackFunctions()
        self.callbacks.logger = fmi2CallbackLoggerTYPE(self._log)
        self.slave = FMU2Slave(
            guid=guid or described(drive).guid,
            modelIdentifier=described(drive).coSimulation.modelIdentifier,
            unzipDirectory=unpacked(drive),
            instanceName=drive,
        )
        self.slave.instantiate(callbacks=self.callbacks)

    def _log(self, environment: int, name: bytes, status: int, category: bytes, text: bytes) -> None:
        self.messages.append((status, text.decode()))

    def start(self, **values: float) -> Self:
        """Set start values and go through initialisation mode."""
        for name, value in values.items():
            self[name] = value
        self.slave.setupExperiment(startTime=self.time)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
        return self

    def values(self) -> list[float]:
        """All variables in the order of their value references."""
        return self.slave.getReal(list(self.references.values()))

    def reference(self, name: str) -> int:
        """Value reference of a variable or role."""
        return self.references[self.own_names.get(name, name)]

    def __getitem__(self, name: str) -> float:
        return self.slave.getReal([self.reference(name)])[0]

    def __setitem__(self, name: str, value: float) -> None:
        self.slave.setReal([self.reference(name)], [value])
