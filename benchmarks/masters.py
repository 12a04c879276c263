"""Macro steps of other masters beside the one of `twin cosim`: three FMUs in a ring, as an SSP archive.

OMSimulator's Python package holds no library, it fetches one from a server of its own when it is installed: one that
somebody has built is named in the environment, as for `make validation`.
"""

import tempfile
import time
import zipfile
from functools import partial
from pathlib import Path

from benchmarks.macro_step import TICKS, master_seconds
from benchmarks.measurement import Measurement, Rounds
from tests.kernel.fmi.exchange.fmus import NoCompiler, exchange_fmu
from tests.kernel.systems.archives import archive, component, connection, connector, structure, system
from twin.kernel.cosim.observers import simulate
from twin.kernel.errors import ComponentFailed
from twin.kernel.ssp.package import read_package
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.opening import opened
from twin.robot.assembly.drives import planned
from twin.robot.experiment.schema import Drive
from validation.yardstick import NotHere
from validation.yardsticks.omsimulator import WEAKLY_COUPLED, Library

ROOT = Path(__file__).parents[1]
FMU = ROOT / "fmus" / "ideal_velocity" / "ideal_velocity.fmu"
TICK = 1e-3
FEW = 2_000
"""Macro steps of a master that takes microseconds for each."""
ROUNDS = 15
NAMES = ("drive_0", "drive_1", "drive_2")


def ring(file: Path, fmu: Path) -> Path:
    """The archive: each drive is fed the angle and the speed of the one before, which means nothing."""
    more = 'suppressUnitConversion="true"'
    wires = []
    for i, name in enumerate(NAMES):
        wires.append(connection(f"{NAMES[i - 1]}.theta_m", f"{name}.omega_ref", more=more))
        wires.append(connection(f"{NAMES[i - 1]}.omega_m", f"{name}.tau_load", more=more))
    # libcosim knows connectors that are listed
    kinds = {"omega_ref": "input", "tau_load": "input", "theta_m": "output", "omega_m": "output"}
    listed = [connector(*one) for one in kinds.items()]
    parts = [component(name, f"resources/{fmu.name}", listed) for name in NAMES]
    ssd = structure(system(parts, wires), TICKS * TICK)
    return archive(file, ssd, {f"resources/{fmu.name}": fmu})


def twin_seconds(file: Path, choice: MasterChoice) -> float:
    """Seconds per macro step in `twin cosim`, nothing recorded."""
    with opened(read_package(file), choice) as (plan, made):
        return simulate(made, plan.timing.ticks, (), TICKS + 1).completed().stepping / plan.timing.ticks


def libcosim_seconds(file: Path, folder: Path) -> float:
    """The same in libcosim."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level

    log_output_level(CosimLogLevel.ERROR)
    if not (folder / "SystemStructure.ssd").exists():
        with zipfile.ZipFile(file) as packed:
            packed.extractall(folder)
    execution = CosimExecution.from_ssp_file(str(folder / "SystemStructure.ssd"), step_size=round(1e9 * TICK))
    began = time.perf_counter()
    for _ in range(FEW):
        if not execution.step():
            raise ComponentFailed("libcosim fails")
    return (time.perf_counter() - began) / FEW


def omsimulator_seconds(file: Path, folder: Path) -> float:
    """The same in OMSimulator.

    Raises:
        NotHere: its library is not here.
    """
    oms, model = Library(), "ring"
    system = f"{model}.root"
    folder.mkdir(exist_ok=True)
    oms.call("oms_setTempDirectory", str(folder))
    oms.call("oms_newModel", model)
    oms.call("oms_addSystem", system, WEAKLY_COUPLED)
    for name in NAMES:
        oms.call("oms_addSubModel", f"{system}.{name}", str(FMU))
    for i, name in enumerate(NAMES):
        for output, given in (("theta_m", "omega_ref"), ("omega_m", "tau_load")):
            source, target = f"{system}.{NAMES[i - 1]}.{output}", f"{system}.{name}.{given}"
            oms.call("oms_addConnection", source, target, True)
    oms.call("oms_setFixedStepSize", system, TICK)
    oms.call("oms_setStopTime", model, (FEW + 2) * TICK)
    oms.call("oms_setResultFile", model, "", 1)
    oms.call("oms_instantiate", model)
    oms.call("oms_initialize", model)
    began = time.perf_counter()
    for _ in range(FEW):
        oms.call("oms_doStep", model)
    took = (time.perf_counter() - began) / FEW
    oms.call("oms_terminate", model)
    oms.call("oms_delete", model)
    return took


def measurements() -> list[Measurement]:
    """The lines of the table."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        file, choice = ring(folder / "ring.ssp", FMU), MasterChoice(scheme="jacobi", tick=TICK)
        return [*_beside(file, folder, choice), *_exchange(folder)]


def _beside(file: Path, folder: Path, choice: MasterChoice) -> list[Measurement]:
    others = {"OMSimulator": omsimulator_seconds, "libcosim": libcosim_seconds}
    missing: dict[str, str] = {}
    for name, seconds in others.items():
        try:
            seconds(file, folder / name)
        except ImportError:
            missing[name] = "libcosimpy is not installed: make bench installs it"
        except NotHere as lacking:
            missing[name] = f"its package on the index holds no library; {lacking}"
    here = {name: partial(seconds, file, folder / name) for name, seconds in others.items() if name not in missing}
    rounds = Rounds({**here, "twin": lambda: twin_seconds(file, choice)}, ROUNDS)
    lines = [Measurement("twin cosim, three ideal_velocity: macro step", 1e9 * rounds.typical("twin"), "ns")]
    for name in others:
        title = f"three ideal_velocity: {name} / twin cosim"
        if name in missing:
            lines.append(Measurement(title, None, "x", at_least=10.0, remark=missing[name]))
            continue
        lines.append(Measurement(f"{name}, the same", 1e9 * rounds.typical(name), "ns"))
        lines.append(Measurement(title, rounds.ratio(name, "twin"), "x", at_least=10.0))
    return lines


def _exchange(folder: Path) -> list[Measurement]:
    title = "model exchange, RK4: twin cosim / drives"
    try:
        servo = exchange_fmu(folder, "servo", 2)
    except NoCompiler as problem:
        return [Measurement(title, None, "x", at_most=1.2, remark=str(problem))]
    file, choice = ring(folder / "servos.ssp", servo), MasterChoice(tick=TICK, solver="rk4")
    plan = planned(Drive.model_validate({"fmu": str(servo), "solver": "rk4"}))
    rounds = Rounds(
        {"system": lambda: twin_seconds(file, choice), "drives": lambda: master_seconds(plan, TICKS + 1)[0] / TICKS},
        ROUNDS,
    )
    return [Measurement(title, rounds.ratio("system", "drives"), "x", at_most=1.2)]
