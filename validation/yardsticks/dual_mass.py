"""Two masses and three springs in two FMUs of OMSimulator's tests, beside the whole system that they were cut from."""

import io
import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.linalg import expm

from twin.kernel.systems.choice import MasterChoice
from validation.masters.in_omsimulator import values
from validation.masters.wired import MODEL_EXCHANGE, Wired
from validation.pinned import pinned
from validation.yardstick import Yardstick

TESTS, OSCILLATOR = "testsuite/tests", "DualMassOscillator"
FILES = pinned("dual_mass")
SEEN = ("first.x1", "second.x2")
WIRES = (("second.F", "first.F"), ("first.x1", "second.x1"), ("first.v1", "second.v1"), ("first.a1", "second.a1"))
CO_SIMULATION = MasterChoice(scheme="jacobi")
EXCHANGE = MasterChoice(loops="solve", kinds=MODEL_EXCHANGE, solver="rk4")


@dataclass(frozen=True)
class Masses:
    """Wall, k_1 and c_1, 1 kg at x_1, k_2 and c_2, 1 kg at x_2, k_3 and c_3, wall (N/m, N s/m, m)."""

    k_1: float
    k_2: float
    k_3: float
    c_1: float
    c_2: float
    c_3: float
    x_1: float
    x_2: float

    @property
    def matrix(self) -> np.ndarray:
        """A of the whole system, (4, 4): the derivative of x_1, v_1, x_2, v_2 is A times them."""
        k_1, k_2, k_3, c_1, c_2, c_3 = self.k_1, self.k_2, self.k_3, self.c_1, self.c_2, self.c_3
        first, second = [-(k_1 + k_2), -(c_1 + c_2), k_2, c_2], [k_2, c_2, -(k_2 + k_3), -(c_2 + c_3)]
        return np.array([[0, 1, 0, 0], first, [0, 0, 0, 1], second])

    def stepped(self, over: np.ndarray, count: int) -> np.ndarray:
        """x_1 and x_2 after each of so many steps, (count, 2); `over` carries x_1, v_1, x_2, v_2 over one."""
        rows = [np.array([self.x_1, 0.0, self.x_2, 0.0])]
        for _ in range(count - 1):
            rows.append(over @ rows[-1])
        return np.array(rows)[:, [0, 2]]

    def exact(self, step: float, count: int) -> np.ndarray:
        """The same of the exact solution."""
        return self.stepped(expm(step * self.matrix), count)

    @property
    def settings(self) -> dict[str, float]:
        """Of the two FMUs."""
        given = {"first.x1_start": self.x_1, "first.k1": self.k_1, "first.c1": self.c_1, "second.x2_start": self.x_2}
        return given | {"second.k2": self.k_2, "second.c2": self.c_2, "second.k3": self.k_3, "second.c3": self.c_3}


SOFT = Masses(10.0, 10.0, 20.0, 0.2, 0.5, 0.3, 0.0, 0.5)
"""The FMUs' own numbers."""
STIFF = Masses(1e4, 1e6, 1e5, 2.0, 14.1421, 6.3246, 1.0, 2.0)
"""Those of OMSimulator's reference results, natural frequency of the coupling 1,414 rad/s."""


@contextmanager
def wired(masses: Masses, stop: float, tick: float) -> Iterator[Wired]:
    """The two FMUs."""
    parts = {"first": "System1", "second": "System2"}
    with tempfile.TemporaryDirectory() as folder:
        fmus = {
            name: FILES.packed(f"{TESTS}/resources/{OSCILLATOR}.{part}", Path(folder) / f"{name}.fmu")
            for name, part in parts.items()
        }
        yield Wired(fmus, WIRES, SEEN, tick, round(stop / tick), masses.settings)


def coupled(masses: Masses, stop: float, tick: float, every: int, choice: MasterChoice = EXCHANGE) -> np.ndarray:
    """x_1, x_2 every so many ticks, in `twin cosim SSP --loops solve --kind model_exchange --solver rk4`."""
    with wired(masses, stop, tick) as given:
        return given.in_twin(replace(choice, tick=tick), every)


def beside(own: np.ndarray, theirs: np.ndarray) -> Mapping[str, float]:
    """The largest difference of each mass (m)."""
    return dict(zip(("x1", "x2"), np.abs(own - theirs).max(axis=0).tolist(), strict=True))


def beside_the_whole() -> Mapping[str, float]:
    """How far both masses are from the exact solution in 10 s (m)."""
    return beside(coupled(SOFT, 10.0, 1e-4, 100), SOFT.exact(0.01, 1001))


def order() -> Mapping[str, float]:
    """By how much the order of the coupling is not 1."""
    exact = SOFT.exact(0.01, 1001)
    errors = [np.abs(coupled(SOFT, 10.0, tick, round(0.01 / tick)) - exact).max() for tick in (1e-3, 1e-4)]
    return {"order": abs(float(np.log10(errors[0] / errors[1])) - 1.0)}


def as_euler_steps() -> Mapping[str, float]:
    """As co-simulation, how far from Euler steps of both, each with what the other was given for the step (m)."""
    k_1, k_2, k_3, c_1, c_2, c_3 = SOFT.k_1, SOFT.k_2, SOFT.k_3, SOFT.c_1, SOFT.c_2, SOFT.c_3
    x_1, v_1, x_2, v_2, h = SOFT.x_1, 0.0, SOFT.x_2, 0.0, 1e-3
    force, rows = k_2 * (x_2 - x_1) + c_2 * (v_2 - v_1), [(x_1, x_2)]
    for _ in range(10_000):
        a_1 = force - k_1 * x_1 - c_1 * v_1
        a_2 = -k_2 * (x_2 - x_1) - c_2 * (v_2 - v_1) - k_3 * x_2 - c_3 * v_2
        given_x_1, given_v_1 = x_1, v_1
        x_1, v_1, x_2, v_2 = x_1 + h * v_1, v_1 + h * a_1, x_2 + h * v_2, v_2 + h * a_2
        force = k_2 * (x_2 - given_x_1) + c_2 * (v_2 - given_v_1)
        rows.append((x_1, x_2))
    return beside(coupled(SOFT, 10.0, h, 1, CO_SIMULATION), np.array(rows))


def printed() -> Mapping[str, float]:
    """How far what OMSimulator's tests print at 10 s is from Euler steps of the whole (m): explicit, and implicit."""
    whole = 1e-4 * SOFT.matrix
    over = {1: np.eye(4) + whole, 2: np.linalg.inv(np.eye(4) - whole)}
    found = {}
    for number, name in ((1, "co-simulation"), (2, "model exchange")):
        text = FILES.content(f"{TESTS}/simulation/{OSCILLATOR}{number}.py").decode()
        numbers = re.findall(r"^## info: +default\.system\d\.x\d: (\S+)", text, re.MULTILINE)
        own = SOFT.stepped(over[number], 100_001)[-1]
        found[name] = float(np.abs(np.array([float(one) for one in numbers[-2:]]) - own).max())
    return found


def in_omsimulator() -> Mapping[str, float]:
    """How far co-simulation in OMSimulator is from explicit Euler steps of the whole (m)."""
    with wired(SOFT, 10.0, 1e-3) as given:
        return beside(values(given), SOFT.stepped(np.eye(4) + 1e-3 * SOFT.matrix, given.ticks + 1))


def beside_the_file() -> Mapping[str, float]:
    """How far both masses are from OMSimulator's reference results in 1 s (m)."""
    from scipy.io import loadmat

    content = FILES.content(f"{TESTS}/references/{OSCILLATOR}.ReferenceSystemEq.mat")
    theirs = loadmat(io.BytesIO(content), chars_as_strings=False)
    names = ["".join(letters).strip("\0 ") for letters in theirs["name"].T]
    rows = {name: theirs["data_2"][theirs["dataInfo"][1, names.index(name)] - 1] for name in ("s1", "s2")}
    t = theirs["data_2"][0]
    # every 2 ms; the last one twice
    own = coupled(STIFF, 1.0, 2e-7, 10_000)
    at = np.rint(t / 0.002).astype(int)
    return {name: float(np.abs(own[at, i] - rows[name]).max()) for i, name in enumerate(("s1", "s2"))}


MADE = "OMSimulator's tests, Open Source Modelica Consortium"
YARDSTICKS = (
    Yardstick(
        "two masses in two FMUs, model exchange, 10 s in steps of 0.1 ms: places beside the whole's exact solution",
        MADE,
        "m",
        2e-4,
        "inputs are held, which costs 1.2 m per second of a step; the masses begin 0.5 m apart. By ModelStructure "
        "no loop is algebraic, so that there is none to solve: the way around leads through states",
        beside_the_whole,
    ),
    Yardstick(
        "the same: order of the coupling, from 1 ms to 0.1 ms, less 1",
        MADE,
        "",
        0.05,
        "inputs are held: order 1",
        order,
    ),
    Yardstick(
        "the same FMUs for co-simulation, in steps of 1 ms: places beside Euler steps of two masses, the force that of "
        "the inputs of the step",
        MADE,
        "m",
        1e-11,
        "so these FMUs step; FMI defines no output of co-simulation for inputs that are set after a step (2.0.4, "
        "4.2.4), so that an output that follows from inputs at once is handed on a step later",
        as_euler_steps,
    ),
    Yardstick(
        "OMSimulator with them: places beside explicit Euler steps of the whole",
        MADE,
        "m",
        1e-11,
        "it sets inputs and asks for outputs again, along the wires, so that nothing is late",
        in_omsimulator,
    ),
    Yardstick(
        "the numbers that OMSimulator's tests expect at 10 s, steps of 0.1 ms, beside Euler steps of the whole: "
        "explicit as co-simulation, implicit as model exchange",
        MADE,
        "m",
        1e-11,
        "CVODE does not get beyond order 1 in them",
        printed,
    ),
    Yardstick(
        "two stiff masses, 1 s in steps of 0.2 us: places beside OMSimulator's reference results of the whole system",
        MADE,
        "m",
        0.01,
        "order 1 at 1,414 rad/s; the results themselves are 0.0012 m off the exact solution, the masses move by 2 m",
        beside_the_file,
    ),
)
