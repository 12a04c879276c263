"""FMUs in FMPy's hands: another master than ours, which knows nothing of the twin."""

import ctypes
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from numpy.typing import NDArray

TICK = 0.001


class Slave:
    """One instance; its messages are kept in `said`.

    Args:
        file: the FMU.
        parameters: set before initialisation, by name.
        inputs: the same during initialisation.
        stop: the time at which it is to be told that the run ends (s), if any.
    """

    def __init__(
        self,
        file: Path,
        parameters: Mapping[str, Any] | None = None,
        inputs: dict[str, Any] | None = None,
        stop: float | None = None,
    ):
        self.model = read_model_description(str(file))
        self.folder = extract(str(file))
        self.said: list[str] = []
        self.variables = {v.name: v for v in self.model.modelVariables}
        self.new = self.model.fmiVersion.startswith("3")
        self.sizes = {
            v.valueReference: int(np.prod([d.start for d in v.dimensions])) if self.new else 1
            for v in self.model.modelVariables
        }
        about = {
            "guid": self.model.guid, "unzipDirectory": self.folder, "instanceName": "it",
            "modelIdentifier": self.model.coSimulation.modelIdentifier,
        }  # fmt: skip
        if self.new:
            self.fmu: Any = FMU3Slave(**about)
            self.fmu.instantiate(logMessage=lambda environment, status, category, text: self.said.append(text.decode()))
        else:
            self.fmu = FMU2Slave(**about)
            self.fmu.instantiate()
        self.set(parameters or {})
        if self.new:
            self.fmu.enterInitializationMode(startTime=0.0, stopTime=stop)
        else:
            self.fmu.setupExperiment(startTime=0.0, stopTime=stop)
            self.fmu.enterInitializationMode()
        self.set(inputs or {})

    def ready(self) -> "Slave":
        """Out of initialisation."""
        self.fmu.exitInitializationMode()
        return self

    def references(self, name: str) -> list[int]:
        """Of a variable, or of the elements that FMI 2.0 makes of an array."""
        if name in self.variables:
            return [self.variables[name].valueReference]
        elements = [v for v in self.variables if v.startswith(f"{name}[")]
        assert elements, name
        return [self.variables[element].valueReference for element in elements]

    def outputs(self) -> list[str]:
        """All outputs; the elements that FMI 2.0 makes of an array are one."""
        return list(dict.fromkeys(v.name.partition("[")[0] for v in self.variables.values() if v.causality == "output"))

    def set(self, values: Mapping[str, Any]) -> None:
        """Values by name."""
        for name, value in values.items():
            self.put(self.references(name), np.ravel(value))

    def put(self, references: list[int], values: Any) -> None:
        """Values by reference."""
        (self.fmu.setFloat64 if self.new else self.fmu.setReal)(references, list(values))

    def take(self, references: list[int]) -> list[float]:
        """The same, read."""
        if self.new:
            return list(self.fmu.getFloat64(references, nValues=sum(self.sizes[r] for r in references)))
        return list(self.fmu.getReal(references))

    def get(self, name: str) -> NDArray[np.float64]:
        """The values of a variable."""
        return np.array(self.take(self.references(name)))

    def step(self, tick: int, ticks: int = 1) -> None:
        """From one tick to another."""
        self.fmu.doStep(currentCommunicationPoint=tick * TICK, communicationStepSize=ticks * TICK)

    def close(self) -> None:
        """Free it."""
        self.fmu.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)


class Ends:
    """Some values of a slave, in its calls' own form: what is done tens of thousands of times should cost little.

    Args:
        slave: whose.
        references: of the variables.

    Attributes:
        values: what `take` has read, or `put` writes.
    """

    def __init__(self, slave: Slave, references: Sequence[int]):
        self.values = np.zeros(sum(slave.sizes[reference] for reference in references))
        ends = (ctypes.c_uint32 * len(references))(*references), len(references)
        there = self.values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        self._arguments = (slave.fmu.component, *ends, there, *([len(self.values)] if slave.new else []))
        prefix, kind = ("fmi3", "Float64") if slave.new else ("fmi2", "Real")
        self._get, self._set = (getattr(slave.fmu.dll, f"{prefix}{verb}{kind}") for verb in ("Get", "Set"))

    def take(self) -> NDArray[np.float64]:
        """They, read anew."""
        assert self._get(*self._arguments) == 0
        return self.values

    def put(self, values: NDArray[np.float64]) -> None:
        """Write `values`."""
        self.values[:] = values
        assert self._set(*self._arguments) == 0


class Kept:
    """Some outputs of a slave, tick by tick."""

    def __init__(self, slave: Slave, names: Sequence[str], rows: int):
        parts = [slave.references(name) for name in names]
        sizes = [sum(slave.sizes[reference] for reference in part) for part in parts]
        ends = np.cumsum(sizes)
        self.columns = {name: slice(end - size, end) for name, end, size in zip(names, ends, sizes, strict=True)}
        self.rows = np.zeros((rows, sum(sizes)))
        self.ends = Ends(slave, [reference for part in parts for reference in part])

    def keep(self, row: int) -> None:
        self.rows[row] = self.ends.take()

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        found = self.rows[:, self.columns[name]]
        return found[:, 0] if found.shape[1] == 1 else found
