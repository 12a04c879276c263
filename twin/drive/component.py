"""Drive FMUs as components: FMPy unpacks, instantiates and initialises, the compiled adapter steps."""

import ctypes
import os
import shutil
import tempfile
from collections.abc import Mapping
from ctypes import byref, c_void_p
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import extract, fmi2
from fmpy.logging import addLoggerProxy

from twin.cosim.component import Component
from twin.drive.adapter import FUNCTIONS, MEMORY, STATUSES, step
from twin.drive.description import DriveDescription
from twin.errors import InputRefused


class DriveShop:
    """Unpacks each FMU once and makes drives of it; closing frees all instances and removes what was unpacked."""

    def __init__(self) -> None:
        self._folders: dict[str, Path] = {}
        self._drives: list[Drive] = []

    def drive(
        self, name: str, description: DriveDescription, parameters: Mapping[str, float], theta_m: float, tau_load: float
    ) -> "Drive":
        """An initialised drive; see `Drive`."""
        if description.sha256 not in self._folders:
            folder = Path(tempfile.mkdtemp(prefix="twin-fmu-"))
            self._folders[description.sha256] = folder
            extract(str(description.path), folder)
        drive = Drive(name, description, self._folders[description.sha256], parameters, theta_m, tau_load)
        self._drives.append(drive)
        return drive

    def close(self) -> None:
        while self._drives:
            self._drives.pop().close()
        for folder in self._folders.values():
            shutil.rmtree(folder, ignore_errors=True)
        self._folders.clear()


class Drive(Component):
    """One FMI 2.0 drive instance.

    The FMU's own zero of theta_m is arbitrary: the shaft is coupled such that it stands at `theta_m` when the FMU is
    initialised, so no FMU needs a parameter for its initial angle.

    Args:
        name: component name, also the FMU's instance name.
        description: the checked FMU. folder: where it was unpacked.
        parameters: values by name, set before initialisation.
        theta_m: motor angle at t = 0 (rad). tau_load: load at t = 0 (N m).

    Raises:
        InputRefused: the FMU cannot be loaded, instantiated or initialised.
    """

    def __init__(
        self,
        name: str,
        description: DriveDescription,
        folder: Path,
        parameters: Mapping[str, float],
        theta_m: float,
        tau_load: float,
    ):
        self.messages: list[str] = []
        self._description = description
        values = description.checked_parameters(parameters)
        inputs = tuple(role.port for role in description.roles if role.causality == "input")
        outputs = tuple(role.port for role in description.roles if role.causality == "output")
        references = np.array(description.references, dtype=np.uint32)
        self._in, self._out = references[: len(inputs)].copy(), references[len(inputs) :].copy()
        self._fmu = self._instantiated(name, folder)
        initial = self._initialised(values, np.array([0.0, tau_load]))
        memory = np.zeros(1, dtype=MEMORY)
        memory["instance"] = self._fmu.component
        memory["set_real"] = self._address("fmi2SetReal")
        memory["do_step"] = self._address("fmi2DoStep")
        memory["get_real"] = self._address("fmi2GetReal")
        memory["inputs"], memory["input_references"] = len(self._in), self._in.ctypes.data
        memory["outputs"], memory["output_references"] = len(self._out), self._out.ctypes.data
        memory["theta_m_offset"] = theta_m - initial[0]
        initial[0] = theta_m
        super().__init__(
            name=name,
            inputs=inputs,
            outputs=outputs,
            sampled=False,
            step_address=step.address,
            self_address=memory.ctypes.data,
            initial_outputs=initial,
            label=description.path.name,
            keep=memory,
        )

    def explain(self, status: int) -> str:
        function, fmi_status = FUNCTIONS[status // 16 * 16], STATUSES.get(status % 16, f"status {status % 16}")
        said = f" ('{self.messages[-1]}')" if self.messages else ""
        return f"{function} returned {fmi_status}{said}"

    def close(self) -> None:
        """Free the instance; safe to call twice."""
        if self._fmu is not None:
            self._fmu.freeInstance()
            self._fmu = None

    def _address(self, function: str) -> int:
        return ctypes.cast(getattr(self._fmu.dll, function), c_void_p).value or 0

    def _instantiated(self, name: str, folder: Path) -> Any:
        model, file = self._description.model, self._description.path
        here = os.getcwd()
        try:
            fmu = fmi2.FMU2Slave(
                guid=model.guid,
                unzipDirectory=str(folder),
                modelIdentifier=model.coSimulation.modelIdentifier,
                instanceName=name,
            )
        # FMPy raises bare Exception for a library that does not load or lacks a function, ctypes AttributeError
        except Exception as problem:
            raise InputRefused(f"{file}: its binary does not load: {problem}") from None
        # FMPy goes to the library's folder to load it, and stays there if that fails
        finally:
            os.chdir(here)
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(self._log)
        callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
        callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
        addLoggerProxy(byref(callbacks))
        try:
            fmu.instantiate(callbacks=callbacks, loggingOn=False)
        except Exception:
            fmu.component = None
        if not fmu.component:
            raise InputRefused(
                f"{file}: fmi2Instantiate refused{self._said()}; the GUID {model.guid} in modelDescription.xml "
                "may not be the binary's own: export the FMU again"
            )
        return fmu

    def _initialised(self, parameters: dict[int, float], inputs: np.ndarray) -> np.ndarray:
        """Bring the instance through initialisation mode; returns its outputs."""
        try:
            if parameters:
                self._fmu.setReal(list(parameters), list(parameters.values()))
            self._fmu.setupExperiment(startTime=0.0)
            self._fmu.enterInitializationMode()
            self._fmu.setReal(self._in.tolist(), inputs.tolist())
            self._fmu.exitInitializationMode()
            outputs = np.array(self._fmu.getReal(self._out.tolist()))
        # FMPy's own FMICallException and anything below it: this FMU cannot be used
        except Exception as problem:
            self.close()
            raise InputRefused(f"{self._description.path}: cannot be initialised: {problem}{self._said()}") from None
        if not np.all(np.isfinite(outputs)):
            self.close()
            raise InputRefused(f"{self._description.path}: an output is not finite after initialisation: {outputs}")
        return outputs

    def _said(self) -> str:
        return f" (it said: {'; '.join(self.messages)})" if self.messages else ""

    def _log(self, environment: Any, instance: bytes, status: int, category: bytes, message: bytes) -> None:
        if status > 0 and message:
            del self.messages[:-2]
            self.messages.append(message.decode(errors="replace").strip())
