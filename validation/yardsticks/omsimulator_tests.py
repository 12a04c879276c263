"""Systems of FMUs of OMSimulator's tests, in OMSimulator and in `twin cosim`."""

import tempfile
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from twin.kernel.systems.choice import MasterChoice
from validation.masters.in_omsimulator import STRONGLY_COUPLED, WEAKLY_COUPLED, values
from validation.masters.wired import MODEL_EXCHANGE, Wired
from validation.pinned import pinned
from validation.yardstick import Yardstick

RESOURCES = "testsuite/tests/resources"
FILES = pinned("omsimulator_tests")
TICK = 1e-3
TIGHT = 1e-10
CO_SIMULATION = MasterChoice(scheme="jacobi", tick=TICK)
EXCHANGE = MasterChoice(tick=TICK, kinds=MODEL_EXCHANGE, solver="rk4")
SOLVED = MasterChoice(tick=TICK, kinds=MODEL_EXCHANGE, solver="rk4", loops="solve")
MOTOR = (
    ("stimuli_model.U", "emachine_model.U"),
    ("stimuli_model.M_load", "edrive_mass.M_B"),
    ("emachine_model.M", "edrive_mass.M_A"),
    ("edrive_mass.wA", "emachine_model.w"),
    ("edrive_mass.phiA", "emachine_model.phi"),
)
GAIN, FEEDBACK, SINE = "Modelica.Blocks.Math.Gain", "Modelica.Blocks.Math.Feedback", "Modelica.Blocks.Sources.Sine"
ALONE = {"VanDerPol": (("x0", "x1"), 5.0), "BouncingBall": (("h", "v"), 2.0), "Dahlquist": (("x",), 1.0)}
"""Outputs that are seen, and until when (s)."""


def fmu(name: str, folder: Path) -> Path:
    """An FMU of the tests: a folder there, or a file of `dcmotor`."""
    file = folder / f"{name}.fmu"
    packed = f"{RESOURCES}/dcmotor/resources/{name}.fmu"
    if packed not in FILES.files:
        return FILES.packed(f"{RESOURCES}/{name}", file)
    file.write_bytes(FILES.content(packed))
    return file


def apart(given: Wired, choice: MasterChoice, kind: int, tolerance: float = 0.0) -> Mapping[str, float]:
    """The largest difference of each seen output, of its range."""
    theirs, own = values(given, 1, kind, tolerance), given.in_twin(choice)
    return dict(zip(given.seen, (np.abs(own - theirs).max(axis=0) / np.ptp(theirs, axis=0)).tolist(), strict=True))


def motor() -> Mapping[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        parts = {name: fmu(name, Path(folder)) for name in ("stimuli_model", "emachine_model", "edrive_mass")}
        seen = ("emachine_model.M", "emachine_model.I", "edrive_mass.wB", "edrive_mass.phiB")
        return apart(Wired(parts, MOTOR, seen, TICK, 3000), CO_SIMULATION, WEAKLY_COUPLED)


def loop() -> Mapping[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        parts = {part: fmu(name, Path(folder)) for part, name in (("sine", SINE), ("sum", FEEDBACK), ("gain", GAIN))}
        wires = (("sine.y", "sum.u1"), ("sum.y", "gain.u"), ("gain.y", "sum.u2"))
        given = Wired(parts, wires, ("sine.y", "sum.y", "gain.y"), TICK, 1000, {"gain.k": 3.0, "sine.f": 1.0})
        return apart(given, SOLVED, STRONGLY_COUPLED)


def alone(choice: MasterChoice, kind: int, tolerance: float = 0.0) -> Mapping[str, float]:
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, (seen, stop) in ALONE.items():
            of_it = tuple(f"{name}.{output}" for output in seen)
            given = Wired({name: fmu(name, Path(folder))}, (), of_it, TICK, round(stop / TICK))
            found |= apart(given, choice, kind, tolerance)
    return found


MADE = "OMSimulator 3.0 and its tests, Open Source Modelica Consortium"
RANGE = "of the signal's range"
YARDSTICKS = (
    Yardstick(
        "Van der Pol, bouncing ball and Dahlquist's equation as co-simulation, each alone, steps of 1 ms: all outputs",
        MADE,
        RANGE,
        0.0,
        "the same FMUs with steps of the same length",
        partial(alone, CO_SIMULATION, WEAKLY_COUPLED),
    ),
    Yardstick(
        "the same as model exchange: Runge-Kutta and events here, CVODE (1e-10) there",
        MADE,
        RANGE,
        1e-6,
        "CVODE's errors add up; Runge-Kutta's are below 1e-11",
        partial(alone, EXCHANGE, STRONGLY_COUPLED, TIGHT),
    ),
    Yardstick(
        "a DC motor in three FMUs, 3 s in steps of 1 ms: torque, current, speed and angle",
        MADE,
        RANGE,
        1e-11,
        "OMSimulator adds up time; no output here follows from an input at once",
        motor,
    ),
    Yardstick(
        "a loop of gain 3 behind a sine, as model exchange, solved in every step: all outputs",
        MADE,
        RANGE,
        1e-11,
        "a linear loop is solved to the last bits; OMSimulator adds up time",
        loop,
    ),
)
