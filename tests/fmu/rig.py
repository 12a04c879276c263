"""A test rig for one drive: opens its .fmu with FMPy, sets it up and steps it."""

import atexit
import tempfile
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Self

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.model_description import ModelDescription

FMUS = Path(__file__).resolve().parents[2] / "fmus"
DRIVES = sorted(path.stem for path in FMUS.glob("*/*.fmu"))

_scratch = tempfile.TemporaryDirectory(prefix="drive_fmus_")
atexit.register(_scratch.cleanup)


def fmu_path(drive: str) -> Path:
    return FMUS / drive / f"{drive}.fmu"


@cache
def described(drive: str) -> ModelDescription:
    return read_model_description(fmu_path(drive))


@cache
def unpacked(drive: str) -> str:
    return str(extract(fmu_path(drive), unzipdir=Path(_scratch.name) / drive))


class Rig:
    """One instance of a drive; `with Rig("velocity_servo").start(droop=0.0) as drive: drive.run(1e-3, 20)`.

    Values are read and set by variable name: `drive["omega_m"]`, `drive["omega_ref"] = 0.5`.

    Attributes:
        slave: the FMPy object, for calls this class does not cover.
        messages: (status, text) of everything the FMU logged.
        time: the communication point reached, s.
    """

    def __init__(self, drive: str, guid: str | None = None):
        self.messages: list[tuple[int, str]] = []
        self.time = 0.0
        self.references = {v.name: v.valueReference for v in described(drive).modelVariables}
        self.callbacks = fmi2CallbackFunctions()
        self.callbacks.logger = fmi2CallbackLoggerTYPE(self._log)
        self.slave = FMU2Slave(
            guid=guid or described(drive).guid,
            modelIdentifier=drive,
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

    def step(self, h: float) -> None:
        """One communication step of h seconds."""
        self.slave.doStep(self.time, h)
        self.time += h

    def run(self, h: float, steps: int) -> None:
        """Several equal communication steps with the inputs left as they are."""
        for _ in range(steps):
            self.step(h)

    def values(self) -> list[float]:
        """All variables in the order of their value references."""
        return self.slave.getReal(list(self.references.values()))

    def __getitem__(self, name: str) -> float:
        return self.slave.getReal([self.references[name]])[0]

    def __setitem__(self, name: str, value: float) -> None:
        self.slave.setReal([self.references[name]], [value])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.slave.freeInstance()
