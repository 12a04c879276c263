"""Macro steps of other masters beside the one of `twin cosim`: three FMUs in a ring, as an SSP archive.

Processor time: all steps in one call, in one process; what else a machine does matters little.
"""

import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import read_model_description

from benchmarks.macro_step import START, TICKS, fmpy_seconds, master_seconds
from benchmarks.measurement import Measurement, Rounds
from tests.kernel.fmi.exchange.fmus import NoCompiler, exchange_fmu
from tests.kernel.systems.archives import archive, component, connection, connector, structure, system, values
from twin.kernel.cosim.observers import simulate
from twin.kernel.errors import ComponentFailed
from twin.kernel.ssp.package import read_package
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.opening import open_system
from twin.robot.assembly.drives import plan_drive
from twin.robot.experiment.drive_files import load_drive
from twin.robot.experiment.schema import Drive
from validation.masters import in_omsimulator
from validation.masters.wired import Wired
from validation.yardstick import NotHere

ROOT = Path(__file__).parents[1]
FMU = ROOT / "fmus" / "ideal_velocity" / "ideal_velocity.fmu"
TICK = 1e-3
FEW = 2_000
"""Macro steps of a master that takes microseconds for each."""
ROUNDS = 15
CLOSE = 1e-12
"""rad, by which angles of two masters may differ: they reckon time in other last bits."""
NAMES = ("drive_0", "drive_1", "drive_2")
(THETA_M,) = (v.valueReference for v in read_model_description(FMU).modelVariables if v.name == "theta_m")
WIRED = Wired(
    dict.fromkeys(NAMES, FMU),
    tuple(
        (f"{NAMES[i - 1]}.{output}", f"{name}.{given}")
        for i, name in enumerate(NAMES)
        for output, given in (("theta_m", "omega_ref"), ("omega_m", "tau_load"))
    ),
    tuple(f"{name}.theta_m" for name in NAMES),
    TICK,
    FEW,
    {f"{name}.theta_m": start for name, start in zip(NAMES, START, strict=True)},
    units=False,
)
"""Each drive is fed the angle and the speed of the one before, which means nothing."""


def ring(file: Path, fmu: Path, starts: Sequence[float] | None = START) -> Path:
    """The ring of an FMU as an archive; `starts`: of its angles (rad)."""
    wires = [connection(start, end, more='suppressUnitConversion="true"') for start, end in WIRED.wires]
    # libcosim knows connectors that are listed
    kinds = {"omega_ref": "input", "tau_load": "input", "theta_m": "output", "omega_m": "output"}
    listed = [connector(*one) for one in kinds.items()]
    parts = [
        component(name, f"resources/{fmu.name}", listed, values(f"theta_m={starts[i]!r} rad") if starts else "")
        for i, name in enumerate(NAMES)
    ]
    ssd = structure(system(parts, wires), TICKS * TICK)
    return archive(file, ssd, {f"resources/{fmu.name}": fmu})


def twin_seconds(file: Path, choice: MasterChoice, clock: Callable[[], float] = time.process_time) -> float:
    """Seconds per macro step in `twin cosim`, nothing recorded."""
    with open_system(read_package(file), choice) as (plan, made):
        began = clock()
        simulate(made, plan.timing.ticks, (), TICKS + 1).require_success()
        return (clock() - began) / plan.timing.ticks


@contextmanager
def in_libcosim(file: Path) -> Iterator[Any]:
    """The ring in libcosim, before its first step."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level

    log_output_level(CosimLogLevel.ERROR)
    with tempfile.TemporaryDirectory() as folder:
        with zipfile.ZipFile(file) as packed:
            packed.extractall(folder)
        execution = CosimExecution.from_ssp_file(f"{folder}/SystemStructure.ssd", step_size=round(1e9 * TICK))
        # start values of outputs in the archive it does not take
        for name, start in zip(NAMES, START, strict=True):
            execution.real_initial_value(execution.slave_index_from_instance_name(name), THETA_M, start)
        yield execution


def libcosim_seconds(file: Path) -> float:
    """The same in libcosim."""
    with in_libcosim(file) as execution:
        began = time.process_time()
        if not execution.step(step_count=FEW):
            raise ComponentFailed("libcosim fails")
        return (time.process_time() - began) / FEW


def libcosim_angles(file: Path) -> np.ndarray:
    """The angles after `FEW` steps (rad)."""
    from libcosimpy.CosimObserver import CosimObserver

    with in_libcosim(file) as execution:
        observer = CosimObserver.create_last_value()
        execution.add_observer(observer)
        execution.step(step_count=FEW)
        slaves = [execution.slave_index_from_instance_name(name) for name in NAMES]
        return np.array([observer.last_real_values(slave, [THETA_M])[0] for slave in slaves])


def omsimulator_seconds(given: Wired) -> float:
    """The same in OMSimulator, of the same wires."""
    with in_omsimulator.initialised(given) as oms:
        began = time.process_time()
        oms.call("oms_stepUntil", in_omsimulator.MODEL, FEW * TICK)
        return (time.process_time() - began) / FEW


def refuse_different_results(name: str, theirs: np.ndarray, own: np.ndarray) -> None:
    """A race between masters that compute different things would mean nothing.

    Raises:
        RuntimeError: the angles at the end are not the same.
    """
    if not np.allclose(theirs, own, rtol=0.0, atol=CLOSE):
        raise RuntimeError(f"{name} and twin cosim end differently: {theirs}, {own}")


def measurements() -> Iterator[Measurement]:
    """The lines of the table."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        file, choice = ring(folder / "ring.ssp", FMU), MasterChoice(scheme="jacobi", tick=TICK)
        yield from _beside(file, choice)
        yield from _exchange(folder)


def _beside(file: Path, choice: MasterChoice) -> Iterator[Measurement]:
    angles = {"OMSimulator": lambda: in_omsimulator.values(WIRED)[-1], "libcosim": lambda: libcosim_angles(file)}
    own = WIRED.in_twin(choice)[-1]
    missing: dict[str, str] = {}
    for name, of_it in angles.items():
        try:
            refuse_different_results(name, of_it(), own)
        except ImportError:
            missing[name] = "libcosimpy is not installed: make bench installs it"
        except NotHere as lacking:
            missing[name] = f"its package on the index holds no library; {lacking}"
    drive = plan_drive(load_drive(str(FMU.parent), FMU.parents[1]))
    others = {
        "OMSimulator": partial(omsimulator_seconds, WIRED),
        "libcosim": partial(libcosim_seconds, file),
        "FMPy's methods": lambda: fmpy_seconds(drive, time.process_time) / TICKS,
    }
    here = {name: seconds for name, seconds in others.items() if name not in missing}
    rounds = Rounds({**here, "twin": lambda: twin_seconds(file, choice)}, ROUNDS)
    yield Measurement("twin cosim, three ideal_velocity: macro step", 1e9 * rounds.typical("twin"), "ns")
    for name in others:
        title = f"three ideal_velocity: {name} / twin cosim"
        if name in missing:
            yield Measurement(title, None, "x", at_least=10.0, remark=missing[name])
            continue
        yield Measurement(f"{name}, the same", 1e9 * rounds.typical(name), "ns")
        yield Measurement(title, rounds.ratio(name, "twin"), "x", at_least=10.0)


def _exchange(folder: Path) -> Iterator[Measurement]:
    title = "model exchange, RK4: twin cosim / drives"
    try:
        servo = exchange_fmu(folder, "servo", 2)
    except NoCompiler as problem:
        yield Measurement(title, None, "x", at_most=1.2, remark=str(problem))
        return
    file, choice = ring(folder / "servos.ssp", servo, None), MasterChoice(tick=TICK, solver="rk4")
    plan = plan_drive(Drive.model_validate({"fmu": str(servo), "solver": "rk4"}))
    rounds = Rounds(
        {
            "system": lambda: twin_seconds(file, choice, time.perf_counter),
            "drives": lambda: master_seconds(plan, TICKS + 1)[0] / TICKS,
        },
        ROUNDS,
    )
    yield Measurement(title, rounds.ratio("system", "drives"), "x", at_most=1.2)
