"""A part that left the twin: its step against the twin's own, how long it takes to build, and how large it is."""

import tempfile
import time
import zipfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

from benchmarks.c_loop import CLoop, NoCompiler
from benchmarks.measurement import Measurement, Rounds
from benchmarks.start_up import process
from twin.kernel.cosim.component import NativeComponent
from twin.robot.assembly.load import load_experiment
from twin.studies.build.fmu import build_fmu
from twin.studies.build.linking import PLATFORMS
from twin.studies.build.part import part_of

TICKS = 20_000
ROUNDS = 31
BUILDS = 3
TICK = 1e-3
# the motors turned a little further than the robot rests: it moves, and then presses no more
TURNED = 0.05
PRESSED = "plant.p_B[3]"


def build_seconds(experiment: Path, folder: Path, *more: str) -> float:
    """`twin build` of the plant as a whole process (s)."""
    arguments = ["build", str(experiment), "--fmu", "plant", "--out", str(folder / "timed.fmu"), *more]
    return process(["-m", "twin", *arguments])[0]


def opened(file: Path, folder: Path) -> tuple[FMU2Slave, dict[str, int]]:
    """An instance of an FMI 2.0 FMU before its first step, and its value references."""
    model = read_model_description(str(file))
    slave = FMU2Slave(
        guid=model.guid, unzipDirectory=extract(str(file), str(folder)), instanceName="it",
        modelIdentifier=model.coSimulation.modelIdentifier,
    )  # fmt: skip
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    return slave, {v.name: v.valueReference for v in model.modelVariables}


def measurements(experiment: Path) -> list[Measurement]:
    """The lines of the table."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        try:
            loop = CLoop(folder)
        except NoCompiler as problem:
            title = "build: doStep of the plant / the twin's own step"
            return [Measurement(title, None, "x", at_most=1.1, remark=str(problem))]
        return [*_steps(experiment, folder, loop), *_builds(experiment, folder)]


def _steps(experiment: Path, folder: Path, loop: CLoop) -> list[Measurement]:
    file = folder / "plant.fmu"
    build_fmu(experiment, "plant", "2.0", [], file, [], lambda what: None)
    slave, references = opened(file, folder / "unpacked")
    part = part_of(load_experiment(experiment), "plant")
    plant = part.component("plant")
    assert isinstance(plant, NativeComponent)
    turned = part.starts["theta_m"][1] + TURNED
    slave.setReal([references[f"theta_m[{n}]"] for n in (1, 2, 3)], list(turned))
    ends, done = np.empty(0), 0

    def own() -> float:
        nonlocal ends
        began = time.perf_counter()
        ends = loop.component_steps(plant, turned, TICK, TICKS)
        return time.perf_counter() - began

    def exported() -> float:
        nonlocal done
        began = time.perf_counter()
        loop.slave_steps(slave, TICK, done, TICKS)
        done += TICKS
        return time.perf_counter() - began

    rounds = Rounds({"exported": exported, "own": own}, ROUNDS)
    names = [port.name for port in plant.outputs for _ in range(port.size)]
    mine = ends[names.index("p_B") + 2]
    theirs = slave.getReal([references[PRESSED]])[0]
    slave.freeInstance()
    if mine != theirs:
        raise RuntimeError(f"the twin's plant and the exported one end differently: {mine!r}, {theirs!r}")
    return [
        Measurement("build: the twin's own step of the plant", 1e9 * rounds.typical("own") / TICKS, "ns"),
        Measurement("build: doStep of the exported plant", 1e9 * rounds.typical("exported") / TICKS, "ns"),
        Measurement("build: doStep / the twin's own step", rounds.ratio("exported", "own"), "x", at_most=1.1),
    ]


def _builds(experiment: Path, folder: Path) -> list[Measurement]:
    titles = {"one": "build: twin build --fmu plant, warm", "all": "build: the same for all platforms of FMI 3.0"}
    everywhere = ["--fmi", "3", "--platform", "all"]
    subjects = {"one": lambda: build_seconds(experiment, folder)}
    if find_spec("ziglang") is not None:
        subjects["all"] = lambda: build_seconds(experiment, folder, *everywhere)
    for subject in subjects.values():
        # what the compiler keeps is there from now on
        subject()
    rounds = Rounds(subjects, BUILDS)
    lines = [Measurement(titles[name], rounds.typical(name), "s", at_most=10.0) for name in subjects]
    if "all" not in subjects:
        return [*lines, Measurement(titles["all"], None, "s", at_most=10.0, remark="ziglang is not installed")]
    with zipfile.ZipFile(folder / "timed.fmu") as archive:
        packed = {Path(e.filename).parent.name: e.compress_size for e in archive.infolist()}
    return lines + [Measurement(f"build: {name}", packed[name] / 1e3, "KB", at_most=100.0) for name in PLATFORMS]
