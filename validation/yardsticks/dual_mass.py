"""Two masses and three springs in two FMUs of OMSimulator's tests, beside the whole system that they were cut from."""

import io
import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg import expm

from validation.joined import joined
from validation.pinned import pinned
from validation.yardstick import Yardstick

TESTS, OSCILLATOR = "testsuite/tests", "DualMassOscillator"
FILES = pinned("dual_mass")
SEEN = ("first.x1", "second.x2")
WIRES = (("second.F", "first.F"), ("first.x1", "second.x1"), ("first.v1", "second.v1"), ("first.a1", "second.a1"))


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

    def exact(self, step: float, count: int) -> np.ndarray:
        """x_1, v_1, x_2, v_2 of the whole system every `step` seconds, (count, 4)."""
        k_1, k_2, k_3, c_1, c_2, c_3 = self.k_1, self.k_2, self.k_3, self.c_1, self.c_2, self.c_3
        first, second = [-(k_1 + k_2), -(c_1 + c_2), k_2, c_2], [k_2, c_2, -(k_2 + k_3), -(c_2 + c_3)]
        over = expm(step * np.array([[0, 1, 0, 0], first, [0, 0, 0, 1], second]))
        rows = [np.array([self.x_1, 0.0, self.x_2, 0.0])]
        for _ in range(count - 1):
            rows.append(over @ rows[-1])
        return np.array(rows)

    @property
    def settings(self) -> list[str]:
        """For the two FMUs."""
        given = {"first.x1_start": self.x_1, "first.k1": self.k_1, "first.c1": self.c_1, "second.x2_start": self.x_2}
        given |= {"second.k2": self.k_2, "second.c2": self.c_2, "second.k3": self.k_3, "second.c3": self.c_3}
        return [f"{name}={value!r}" for name, value in given.items()]


SOFT = Masses(10.0, 10.0, 20.0, 0.2, 0.5, 0.3, 0.0, 0.5)
"""The FMUs' own numbers."""
STIFF = Masses(1e4, 1e6, 1e5, 2.0, 14.1421, 6.3246, 1.0, 2.0)
"""Those of OMSimulator's reference results, natural frequency of the coupling 1,414 rad/s."""


def coupled(masses: Masses, stop: float, tick: float, every: int) -> np.ndarray:
    """x_1, x_2 every so many ticks, in `twin cosim SSP --loops solve --kind model_exchange --solver rk4`."""
    from twin.kernel.systems.choice import MasterChoice

    choice = MasterChoice(tick=tick, loops="solve", kinds={"": "model_exchange"}, solver="rk4")
    with tempfile.TemporaryDirectory() as folder:
        fmus = {
            name: FILES.packed(f"{TESTS}/resources/{OSCILLATOR}.{part}", Path(folder) / f"{name}.fmu")
            for name, part in (("first", "System1"), ("second", "System2"))
        }
        return np.column_stack([*joined(fmus, choice, stop, SEEN, WIRES, masses.settings, every=every).values()])


def beside_the_whole() -> Mapping[str, float]:
    """How far both masses are from the exact solution in 10 s (m)."""
    exact = SOFT.exact(0.01, 1001)[:, [0, 2]]
    return dict(zip(("x1", "x2"), np.abs(coupled(SOFT, 10.0, 1e-4, 100) - exact).max(axis=0).tolist(), strict=True))


def order() -> Mapping[str, float]:
    """By how much the order of the coupling is not 1."""
    exact = SOFT.exact(0.01, 1001)[:, [0, 2]]
    errors = [np.abs(coupled(SOFT, 10.0, tick, round(0.01 / tick)) - exact).max() for tick in (1e-3, 1e-4)]
    return {"order": abs(float(np.log10(errors[0] / errors[1])) - 1.0)}


def printed() -> dict[str, list[float]]:
    """x_1 and x_2 at 10 s by OMSimulator: of FMUs for co-simulation, and of both for model exchange as one system."""
    found = {}
    for number, name in ((1, "co-simulation"), (2, "model exchange")):
        text = FILES.content(f"{TESTS}/simulation/{OSCILLATOR}{number}.py").decode()
        numbers = re.findall(r"^## info: +default\.system\d\.x\d: (\S+)", text, re.MULTILINE)
        found[name] = [float(one) for one in numbers[-2:]]
    return found


def nearer() -> Mapping[str, float]:
    """The error at 10 s, over that of what OMSimulator prints."""
    exact, own = SOFT.exact(10.0, 2)[-1, [0, 2]], coupled(SOFT, 10.0, 1e-4, 100)[-1]
    return {
        f"{name}, {kind}": abs(float(own[i] - exact[i])) / abs(theirs[i] - float(exact[i]))
        for kind, theirs in printed().items()
        for i, name in enumerate(("x1", "x2"))
    }


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
        "the same: error at 10 s over that of the numbers that OMSimulator's tests expect, same step",
        MADE,
        "of OMSimulator's error",
        0.5,
        "OMSimulator hands values on a step later",
        nearer,
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
