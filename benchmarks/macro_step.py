"""What the compiled master adds to the FMUs' own time, against a C loop and against FMPy's own methods.

Three drives in a ring, nothing else: omega_ref is fed by the neighbour's theta_m, tau_load by its omega_m. Physically
meaningless, but every input changes in every step, and the C loop has to end with the same bits.
"""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from fmpy.fmi2 import FMU2Slave

from benchmarks.c_loop import CLoop, NoCompiler
from benchmarks.measurement import Measurement, Rounds
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.fmi.unpacked import unpacked
from twin.robot.assembly.drives import DrivePlan, drive, plan_drive
from twin.robot.experiment.drive_files import load_drive
from twin.robot.run.run import SLICE_TICKS

TICKS = 20_000
FMPY_TICKS = 1_000
ROUNDS = 31
WHOLE = 1.2
"""Maximum time of the master, in times of the C loop."""
# small angles that add up to 0: the ring then stays far from every limit of the drives for all ticks
START = (0.002, -0.001, -0.001)
TICK = 1e-3


@contextmanager
def ring(plan: DrivePlan) -> Iterator[System]:
    """Three fresh instances of a drive, wired in a ring."""
    drives = [drive(f"drive_{i}", plan, TICK, theta_m, 0.0) for i, theta_m in enumerate(START)]
    try:
        wires = []
        for i in range(3):
            wires.append((f"drive_{(i - 1) % 3}.theta_m", f"drive_{i}.omega_ref"))
            wires.append((f"drive_{(i - 1) % 3}.omega_m", f"drive_{i}.tau_load"))
        yield System(drives, wires, TICK)
    finally:
        for component in drives:
            component.close()


def master_seconds(plan: DrivePlan, slice_ticks: int) -> tuple[float, np.ndarray]:
    """Seconds of `TICKS` macro steps in the compiled master, and the last row."""
    with ring(plan) as system:
        simulation = Simulation(system, TICKS, slice_ticks)
        rows = np.empty(0)
        began = time.perf_counter()
        while not simulation.is_over:
            rows = simulation.advance()
        seconds = time.perf_counter() - began
        if simulation.failure:
            raise simulation.failure
        return seconds, rows[-1].copy()


def fmpy_seconds(plan: DrivePlan, clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds of `TICKS` macro steps with the methods of FMPy's `FMU2Slave`, from `FMPY_TICKS` of them."""
    (description,) = plan.parts.values()
    inputs, outputs = (
        [b.variable.reference for b in plan.bindings if b.role.causality == side] for side in ("input", "output")
    )
    slaves = [
        FMU2Slave(
            guid=description.model.guid,
            unzipDirectory=str(unpacked(description.path, description.sha256)),
            modelIdentifier=description.identifier,
            instanceName=f"drive_{i}",
        )
        for i in range(3)
    ]
    for slave in slaves:
        slave.instantiate()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
    names = [b.port.name for b in plan.bindings if b.role.causality == "output"]
    theta_m, omega_m = names.index("theta_m"), names.index("omega_m")
    y = [slave.getReal(outputs) for slave in slaves]
    for values, start in zip(y, START, strict=True):
        values[theta_m] = start
    began = clock()
    for k in range(FMPY_TICKS):
        for i, slave in enumerate(slaves):
            slave.setReal(inputs, [y[i - 1][theta_m], y[i - 1][omega_m]])
            slave.doStep(k * TICK, TICK)
            y[i] = slave.getReal(outputs)
    seconds = clock() - began
    for slave in slaves:
        slave.terminate()
        slave.freeInstance()
    return seconds * TICKS / FMPY_TICKS


def measurements(folder: Path) -> list[Measurement]:
    """The lines of the table for one drive FMU."""
    plan = plan_drive(load_drive(str(folder), folder.parent))
    name = folder.name
    with tempfile.TemporaryDirectory() as scratch:
        subjects = {
            "master": lambda: master_seconds(plan, TICKS + 1)[0],
            "fmpy": lambda: fmpy_seconds(plan),
        }
        try:
            loop = CLoop(Path(scratch))
        except NoCompiler as problem:
            rounds = Rounds(subjects, ROUNDS)
            against_c = [Measurement(f"{name}: master / C loop", None, "x", at_most=WHOLE, remark=str(problem))]
        else:
            refuse_different_results(plan, loop)

            def in_c() -> float:
                with ring(plan) as system:
                    return loop.macro_steps(system, TICKS)[0]

            def alone() -> float:
                with ring(plan) as system:
                    return loop.calls_alone(system, TICKS)

            rounds = Rounds({**subjects, "c": in_c, "fmu": alone}, ROUNDS)
            against_c = _against_c(name, rounds)
    return [
        Measurement(f"{name}: master, macro step", 1e9 * rounds.typical("master") / TICKS, "ns"),
        *against_c,
        Measurement(f"{name}: FMPy's methods / master", rounds.ratio("fmpy", "master"), "x", at_least=100.0),
    ]


def _against_c(name: str, rounds: Rounds) -> list[Measurement]:
    def net(subject: str) -> float:
        return 1e9 * (rounds.typical(subject) - rounds.typical("fmu")) / TICKS

    return [
        Measurement(f"{name}: C loop, macro step", 1e9 * rounds.typical("c") / TICKS, "ns"),
        Measurement(f"{name}: of it the FMU calls alone", 1e9 * rounds.typical("fmu") / TICKS, "ns"),
        Measurement(f"{name}: master / C loop", rounds.ratio("master", "c"), "x", at_most=WHOLE),
        Measurement(f"{name}: master beyond the FMU calls", net("master"), "ns"),
        Measurement(f"{name}: C loop beyond the FMU calls", net("c"), "ns"),
    ]


def refuse_different_results(plan: DrivePlan, loop: CLoop) -> None:
    """A race between loops that compute different things would mean nothing.

    Raises:
        RuntimeError: the last outputs differ in any bit.
    """
    with ring(plan) as system:
        _, in_c = loop.macro_steps(system, TICKS)
    _, in_master = master_seconds(plan, SLICE_TICKS)
    if not np.array_equal(in_c, in_master):
        raise RuntimeError(f"{plan.label}: C loop and master end differently: {in_c}, {in_master}")
