"""Builds macro_loop.c on the spot and runs it over the memory of drive components."""

import ctypes
import os
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
from fmpy.fmi2 import FMU2Slave

from twin.kernel.cosim.component import NativeComponent
from twin.kernel.cosim.system import System
from twin.kernel.fmi.cosim_step import PLAIN_MEMORY, plain_step

SOURCE = Path(__file__).with_name("macro_loop.c")
IN_C = {"int64": "int64_t", "float64": "double"}


class NoCompiler(Exception):
    """This machine has no C compiler that works."""


class CLoop:
    """The compiled yardstick.

    Args:
        folder: where the library is built.

    Raises:
        NoCompiler: none found, or it failed.
    """

    def __init__(self, folder: Path):
        compiler = shutil.which(os.environ.get("CC", "cc")) or shutil.which("gcc")
        if compiler is None:
            raise NoCompiler("no C compiler found (cc, gcc or $CC)")
        library = folder / "macro_loop.so"
        (folder / "drive.h").write_text(_declared("Drive", PLAIN_MEMORY))
        command = [compiler, "-O2", "-shared", "-fPIC", f"-I{folder}", "-o", str(library), str(SOURCE)]
        built = subprocess.run(command, capture_output=True, text=True)
        if built.returncode != 0:
            raise NoCompiler(f"{compiler}: {built.stderr.strip()}")
        self._library = ctypes.CDLL(str(library))

    def macro_steps(self, system: System, ticks: int) -> tuple[float, np.ndarray]:
        """Seconds and last outputs of `ticks` Gauss-Seidel macro steps of a system of drives alone."""
        y = np.concatenate([c.initial_outputs for c in system.components])
        u = np.zeros(system.inputs_width)
        drives = _drives(system)
        began = time.perf_counter()
        status = self._library.macro_steps(
            _address(drives), len(drives), _address(system.sources), _address(u), _address(y),
            ctypes.c_double(system.tick), ctypes.c_int64(ticks),
        )  # fmt: skip
        seconds = time.perf_counter() - began
        if status:
            raise RuntimeError(f"drive {status} failed in the C loop")
        return seconds, y

    def calls_alone(self, system: System, ticks: int) -> float:
        """Seconds of the FMU calls of `ticks` macro steps, without any wiring between them."""
        u, y = np.zeros(system.inputs_width), np.zeros(system.outputs_width)
        drives = _drives(system)
        began = time.perf_counter()
        status = self._library.calls_alone(
            _address(drives), len(drives), _address(u), _address(y), ctypes.c_double(system.tick), ctypes.c_int64(ticks)
        )
        seconds = time.perf_counter() - began
        if status:
            raise RuntimeError(f"drive {status} failed in the C loop")
        return seconds

    def component_steps(self, component: NativeComponent, u: np.ndarray, tick: float, ticks: int) -> np.ndarray:
        """Step a component with held inputs; its last outputs."""
        y = component.initial_outputs.copy()
        status = self._library.component_steps(
            ctypes.c_void_p(component.step_address), ctypes.c_void_p(component.self_address), _address(u), _address(y),
            ctypes.c_double(tick), ctypes.c_int64(ticks),
        )  # fmt: skip
        if status:
            raise RuntimeError(f"{component.name} failed in the C loop")
        return y

    def slave_steps(self, slave: FMU2Slave, tick: float, first: int, ticks: int) -> None:
        """`fmi2DoStep` of a slave with held inputs, from tick `first` on."""
        do_step = ctypes.cast(slave.dll.fmi2DoStep, ctypes.c_void_p)
        instance = ctypes.c_void_p(slave.component)
        if self._library.slave_steps(
            do_step, instance, ctypes.c_double(tick), ctypes.c_int64(first), ctypes.c_int64(ticks)
        ):
            raise RuntimeError("the slave failed in the C loop")


def _drives(system: System) -> np.ndarray:
    """What the C loop needs of each drive: one FMI 2.0 instance with Real inputs and outputs."""
    assert all(component.step_address == plain_step.address for component in system.components)
    return np.concatenate([component.keep for component in system.components])


def _declared(name: str, memory: np.dtype) -> str:
    """The C struct of a record; its size is checked where it is compiled, its members' places by C's own alignment."""
    kinds = {field: memory[field].name for field in memory.names or ()}
    members = "".join(f"    {IN_C[kind]} {field};\n" for field, kind in kinds.items())
    size = f'_Static_assert(sizeof({name}) == {memory.itemsize}, "not the record");\n'
    return f"typedef struct {{\n{members}}} {name};\n{size}"


def _address(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
