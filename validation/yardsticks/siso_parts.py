"""Parts with one input and one output: Dymola's PI, blocks of the Modelica library; in a role of the robot, and as a
system of OMSimulator's tests."""

import io
import re
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from validation.joined import joined
from validation.pinned import pinned
from validation.yardstick import Yardstick

ROOT = Path(__file__).parents[2]
BLOCKS, DYMOLA = pinned("modelica_blocks"), pinned("dymola_pi")
RESOURCES = "testsuite/tests/resources"
EXPERIMENT = ROOT / "experiments" / "fig4_force_position.toml"
PERIOD = 0.002
"""Of its controller (s)."""
JOINTS = (1, 2, 3)
THREE = ['controller.inputs.tau_l=["tau_1", "tau_2", "tau_3"]',
         'controller.outputs.omega_ref=["omega_1", "omega_2", "omega_3"]']  # fmt: skip


def block(name: str, folder: str) -> Path:
    """An FMU of OMSimulator's tests, such as "Math.Gain"."""
    return BLOCKS.packed(f"{RESOURCES}/Modelica.Blocks.{name}", Path(folder) / f"{name}.fmu")


def as_controller(file: Path, *settings: str) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
    """(times (s), signals) of half a second of Fig. 4 with `file` in the place of its controller."""
    from twin.kernel.recording.reader import read
    from twin.robot.assembly.load import load_experiment
    from twin.robot.run.run import execute

    with tempfile.TemporaryDirectory() as folder:
        asked = ["duration_s=0.5", f"controller.fmu={file}", *settings]
        recording = read(execute(load_experiment(EXPERIMENT, asked), Path(folder) / "run").recording)
        names = ("controller.omega_ref", "estimator.tau_l", "estimator.F_ee_B")
        return recording.time("controller"), {name: np.array(recording[name]) for name in names}


def copies(fmu: Path, u: str, folder: str, targets: Sequence[float]) -> Path:
    """Three of it in an archive, by examples/three_copies.py."""
    sys.path.insert(0, str(ROOT))
    from examples.three_copies import write_archive

    write_archive(fmu, u, "y", Path(folder) / "three.ssp", targets)
    return Path(folder) / "three.ssp"


def three_pis() -> Mapping[str, float]:
    """How far the speeds of three copies of Dymola's PI are from its law at the torques that they heard (rad/s)."""
    with tempfile.TemporaryDirectory() as folder:
        fmu = Path(folder) / "pi.fmu"
        fmu.write_bytes(DYMOLA.content("tests/resources/Controller.fmu"))
        file = copies(fmu, "u_s", folder, (0.0, 0.0, 0.0))
        values = ", ".join(f'"pi_{n}.PI.k"=2.0, "pi_{n}.PI.Ti"=0.5, "pi_{n}.PI.yMax"=50.0' for n in JOINTS)
        _, run = as_controller(file, *THREE, f"controller.parameters={{{values}}}")
    e = -run["estimator.tau_l"]
    law = 2.0 * (e + np.cumsum(e, axis=0) * PERIOD / 0.5)
    off = np.abs(run["controller.omega_ref"] - law).max(axis=0)
    return {f"omega_ref[{i}]": float(one) for i, one in enumerate(off)}


def blocks() -> Mapping[str, float]:
    """The same of Modelica's blocks: three Gains hold torques; one hears one value of three, and a Sine nothing, and
    both give one speed of three (rad/s)."""
    one, targets = 'controller.outputs."omega_ref[0]"="y"', (0.046, 0.081, 0.081)
    with tempfile.TemporaryDirectory() as folder:
        gain, sine = block("Math.Gain", folder), block("Sources.Sine", folder)
        values = ", ".join(f'"pi_{n}.k"=3.0' for n in JOINTS)
        _, three = as_controller(copies(gain, "u", folder, targets), *THREE, f"controller.parameters={{{values}}}")
        _, single = as_controller(gain, 'controller.inputs."F_ee_B[2]"="u"', one, "controller.parameters={k=0.1}")
        t, turning = as_controller(sine, one, "controller.parameters={amplitude=0.5, f=2.0}")
    zero = np.zeros((len(t), 2))
    laws = (
        ("three Gains", three, 3.0 * (np.array(targets) - three["estimator.tau_l"])),
        ("one Gain", single, np.column_stack([0.1 * single["estimator.F_ee_B"][:, 2], zero])),
        # a function of time that answers at the end of its step
        ("Sine", turning, np.column_stack([0.5 * np.sin(4.0 * np.pi * (t + PERIOD)), zero])),
    )
    return {name: float(np.abs(run["controller.omega_ref"] - law).max()) for name, run, law in laws}


PI_PARTS = {
    "addP": "Math.Add", "P": "Math.Gain", "addI": "Math.Add3", "I": "Continuous.Integrator", "addPI": "Math.Add",
    "gainPI": "Math.Gain", "limiter": "Nonlinear.Limiter", "addSat": "Math.Add", "gainTrack": "Math.Gain",
}  # fmt: skip
PI_WIRES = (
    ("addP.y", "P.u"), ("addI.y", "I.u"), ("P.y", "addPI.u1"), ("I.y", "addPI.u2"), ("addPI.y", "gainPI.u"),
    ("gainPI.y", "limiter.u"), ("gainPI.y", "addSat.u2"), ("limiter.y", "addSat.u1"), ("addSat.y", "gainTrack.u"),
    ("gainTrack.y", "addI.u3"),
)  # fmt: skip
PI_SET = (
    "addP.k1=1", "addP.k2=-1", "addI.k2=-1", "I.y_start=0", "I.k=10", "gainPI.k=100", "limiter.uMax=12", "addSat.k2=-1",
    "gainTrack.k=0.1",
)  # fmt: skip
PI_FED = (("addP.u1", "setpoint", "speed"), ("addI.u1", "setpoint", "speed"), ("addP.u2", "drivetrain", "w"),
          ("addI.u2", "drivetrain", "w"))  # fmt: skip
"""PIController.py: nine FMUs along the signal, what joins them, what is set, and columns of two tables."""
TABLES = ("setpoint", "drivetrain")
STOP = 4.0
"""s."""


def pi_of_blocks(tick: float) -> float:
    """What enters the limiter after 4 s."""
    from twin.kernel.systems.choice import MasterChoice

    with tempfile.TemporaryDirectory() as folder:
        fmus = {name: block(kind, folder) for name, kind in PI_PARTS.items()}
        for table in TABLES:
            (Path(folder) / f"{table}.csv").write_bytes(BLOCKS.content(f"{RESOURCES}/{table}.csv"))
        fed = [f"{end}={folder}/{file}.csv:{column}" for end, file, column in PI_FED]
        (u,) = joined(fmus, MasterChoice(tick=tick), STOP, ["limiter.u"], PI_WIRES, PI_SET, fed).values()
    return float(u[-1])


def exact() -> float:
    """The same by the equations of the whole, in steps of 0.1 ms of fourth order."""
    h = 1e-4
    t = 0.5 * h * np.arange(2 * round(STOP / h) + 1)
    speed, turning = (
        np.interp(t, *np.loadtxt(io.BytesIO(BLOCKS.content(f"{RESOURCES}/{table}.csv")), delimiter=",", skiprows=1).T)
        for table in TABLES
    )
    e, xi = speed - turning, 0.0

    def rate(xi: float, e: float) -> float:
        v = 100.0 * (e + xi)
        return 10.0 * (e + 0.1 * (min(max(v, -12.0), 12.0) - v))

    for k in range(0, len(t) - 1, 2):
        k_1 = rate(xi, e[k])
        k_2 = rate(xi + 0.5 * h * k_1, e[k + 1])
        k_3 = rate(xi + 0.5 * h * k_2, e[k + 1])
        xi += h / 6.0 * (k_1 + 2.0 * (k_2 + k_3) + rate(xi + h * k_3, e[k + 2]))
    return float(100.0 * (e[-1] + xi))


def beside_the_equations() -> Mapping[str, float]:
    """How far what enters the limiter is from the equations (V), and by how much the order of the coupling is not 1."""
    errors = [abs(pi_of_blocks(tick) - exact()) for tick in (1e-3, 1e-4)]
    return {"limiter.u": errors[1], "order": abs(float(np.log10(errors[0] / errors[1])) - 1.0)}


def beside_the_test() -> Mapping[str, float]:
    """How far it is from what OMSimulator's test prints for the same steps (V)."""
    text = BLOCKS.content("testsuite/tests/simulation/PIController.py").decode()
    return {"limiter.u": abs(pi_of_blocks(1e-3) - float(re.findall(r"default\.limiter\.u: (\S+)", text)[-1]))}


DYMOLA_21 = "FMPy's tests, Dymola 2021x"
OPENMODELICA = "OMSimulator's tests, OpenModelica"
YARDSTICKS = (
    Yardstick(
        "three copies of Dymola's PI, wired as the robot's controller: speeds beside its law at the torques heard",
        DYMOLA_21,
        "rad/s",
        1e-12,
        "its own solver holds the inputs of a step, and so integrates them as the sum does; speeds reach 0.24 rad/s. "
        "It begins at an error of 0 only: elsewhere its own equations are singular at the start, in FMPy, too",
        three_pis,
    ),
    Yardstick(
        "Modelica's Gain three times, Gain and Sine alone as the robot's controller: speeds beside their laws",
        OPENMODELICA,
        "rad/s",
        1e-12,
        "products and a sine of the same numbers",
        blocks,
    ),
    Yardstick(
        "a PI with anti-windup of nine of Modelica's blocks, 4 s in steps of 0.1 ms: the limiter's input beside its "
        "equations; and the order of the coupling from 1 ms on, less 1",
        OPENMODELICA,
        "V, 1",
        0.02,
        "inputs are held: order 1, 0.037 V at 1 ms",
        beside_the_equations,
    ),
    Yardstick(
        "the same in steps of 1 ms beside the number that OMSimulator's test expects",
        OPENMODELICA,
        "V",
        0.08,
        "both hold inputs for 1 ms; from the equations' -10.012 V OMSimulator is 0.030 V off, twin 0.037 V",
        beside_the_test,
    ),
)
