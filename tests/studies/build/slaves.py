"""FMUs in FMPy's hands: another master than ours, which knows nothing of the twin."""

import shutil
from collections.abc import Mapping
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
    """

    def __init__(self, file: Path, parameters: Mapping[str, Any] | None = None, inputs: dict[str, Any] | None = None):
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
            self.fmu.enterInitializationMode(startTime=0.0)
        else:
            self.fmu.setupExperiment(startTime=0.0)
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


class Kept:
    """Some outputs of a slave, tick by tick."""

    def __init__(self, slave: Slave, names: list[str], rows: int):
        self.names = names
        parts = [slave.references(name) for name in names]
        self.references = [reference for part in parts for reference in part]
        self.ends = np.cumsum([sum(slave.sizes[reference] for reference in part) for part in parts])
        self.rows = np.zeros((rows, int(self.ends[-1])))
        self.slave = slave

    def keep(self, row: int) -> None:
        self.rows[row] = self.slave.take(self.references)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        n = self.names.index(name)
        start = self.ends[n - 1] if n else 0
        found = self.rows[:, start : self.ends[n]]
        return found[:, 0] if found.shape[1] == 1 else found
