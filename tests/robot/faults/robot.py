"""A robot of mocks with the names of the real one, and runs of it with and without faults."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.kernel.cosim.models import continuous, sampled
from twin.kernel.cosim.component import Component, NativeComponent, step_function
from twin.kernel.cosim.port import Port, width
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import End, Feeds, Scheme, Side, System, ends, wires
from twin.robot.assembly.inject import inject
from twin.robot.experiment.fault import Fault

TICK = 1e-3
PERIOD = 2
COUNTS = (4096.0, 16384.0)
SPEED_LIMIT = 8.0
K_S = 1.0
START = (0.3, 0.4, 0.5)

COUNT_PORTS = (Port("count_m", 3, kind="int"), Port("count_l", 3, kind="int"), Port("sample", kind="int"))
OMEGA_REF = Port("omega_ref", 3, "rad/s")
PARAMETERS = np.dtype(
    [("K", "f8"), *((name, "f8", (3,)) for name in ("k_s_share", "backlash_added", "b_j_added", "slip"))], align=True
)
PLANT = np.dtype([("parameters", PARAMETERS)], align=True)
ESTIMATOR = np.dtype([("belief", np.dtype([("k_s", "f8"), ("eta", "f8")], align=True))], align=True)


THETA_M = Port("theta_m", 3, "rad")
PLANT_OUTPUTS = (
    Port("seen", 3, "rad"), Port("tau_load", 3, "N m"), Port("k_s_share", 3), Port("backlash_added", 3),
    Port("b_j_added", 3), Port("slip", 3), Port("K"),
)  # fmt: skip
TOLD = (*COUNT_PORTS, Port("k_s"), Port("eta"))


@step_function(PLANT, (THETA_M,), PLANT_OUTPUTS)
def plant_step(m, t, h, u, y):
    p = m.parameters
    y.seen[:] = u.theta_m
    # a link that stands still at 0: the spring alone
    y.tau_load[:] = K_S * u.theta_m
    y.k_s_share[:], y.backlash_added[:], y.b_j_added[:] = p.k_s_share, p.backlash_added, p.b_j_added
    y.slip[:], y.K = p.slip, p.K
    return 0


@step_function(ESTIMATOR, COUNT_PORTS, TOLD)
def estimator_step(m, t, h, u, y):
    y.count_m[:], y.count_l[:], y.sample = u.count_m, u.count_l, u.sample
    y.k_s, y.eta = m.belief.k_s, m.belief.eta
    return 0


def plant() -> NativeComponent:
    """Springs at three motor shafts, with every parameter a fault may change; it tells what it sees and has."""
    memory = np.zeros(1, dtype=PLANT)
    memory["parameters"]["k_s_share"] = (1.0, 0.7, 1.1)
    memory["parameters"]["backlash_added"] = memory["parameters"]["slip"] = (0.0, 0.1, 0.2)
    memory["parameters"]["b_j_added"] = (0.0, 0.3, 0.1)
    memory["parameters"]["K"] = 1250.0
    initial = np.zeros(width(PLANT_OUTPUTS))
    initial[:3], initial[3:6] = START, K_S * np.array(START)
    return NativeComponent("plant", (THETA_M,), PLANT_OUTPUTS, False, plant_step, memory, initial)


def estimator() -> Component:
    """Tells the counts that it reads and what it believes; it lives on behind a NaN."""
    memory = np.zeros(1, dtype=ESTIMATOR)
    memory["belief"]["k_s"], memory["belief"]["eta"] = 1.0, 0.9
    outputs = (Port("read", 7), Port("k_s"), Port("eta"))
    component = NativeComponent("estimator", COUNT_PORTS, outputs, True, estimator_step, memory, period=PERIOD)
    component.finite = False
    return component


def counts(t: float, h: float, u: np.ndarray) -> np.ndarray:
    """An open-loop encoder message: whole counts that never stand still, and its rolling counter."""
    k = round(t / TICK)
    return np.array([200 + 3 * k, 100 - 2 * k, 5 * k + 7, 900 + 8 * k, -400 - 7 * k, 50 + 9 * k, k // PERIOD])


def command(t: float, h: float, u: np.ndarray) -> np.ndarray:
    """omega_ref of the controller, and another port that no fault may touch."""
    return np.array([np.sin(9.0 * t), 1.0 + 20.0 * t, -2.0 * np.cos(40.0 * t), t])


def driven(start: Sequence[float]) -> Any:
    """An ideal drive: its shaft has the commanded speed."""
    theta_m = np.array(start)

    def law(t: float, h: float, u: np.ndarray) -> np.ndarray:
        theta_m[:] += h * u[: len(theta_m)]
        return theta_m

    return law


def joined(components: Sequence[Component], pairs: Sequence[tuple[str, str]]) -> Feeds:
    """Feeds of wires as `System` takes them."""

    def of(text: str, side: Side) -> list[End]:
        name, _, port = text.partition(".")
        port, _, index = port.rstrip("]").partition("[")
        found = ends([component for component in components if component.name == name], side, port)
        return [found[int(index)]] if index else found

    return {
        target: source
        for output, fed in pairs
        for source, target in zip(of(output, "output"), of(fed, "input"), strict=True)
    }


@dataclass(frozen=True)
class Robot:
    """How the mock robot is built.

    Attributes:
        three_axes: one component drives all joints. power_off: the tick at which the monitor takes the power away;
            without it there is no monitor.
    """

    three_axes: bool = False
    power_off: int | None = None

    def parts(self) -> tuple[list[Component], Feeds]:
        """Fresh components, and what feeds them."""
        commander = "controller" if self.power_off is None else "monitor"
        components: list[Component] = [
            sampled("encoder", counts, outputs=COUNT_PORTS, period=PERIOD),
            estimator(),
            sampled("controller", command, outputs=(OMEGA_REF, Port("dp_z")), period=PERIOD),
        ]
        pairs = [(f"encoder.{port.name}", f"estimator.{port.name}") for port in COUNT_PORTS]
        if self.power_off is not None:
            components.append(self._monitor(self.power_off))
            pairs.append(("controller.omega_ref", "monitor.omega_ref"))
        size = 3 if self.three_axes else 1
        ports = (Port("omega_ref", size, "rad/s"), Port("tau_load", size, "N m"))
        for i, name in enumerate(["drive"] if self.three_axes else ["drive_1", "drive_2", "drive_3"]):
            start = START[i : i + size]
            index = "" if self.three_axes else f"[{i}]"
            theta_m = (Port("theta_m", size, "rad"),)
            components.append(continuous(name, driven(start), ports, outputs=theta_m, initial_outputs=start))
            pairs += [
                (f"{commander}.omega_ref{index}", f"{name}.omega_ref"),
                (f"plant.tau_load{index}", f"{name}.tau_load"),
                (f"{name}.theta_m", f"plant.theta_m{index}"),
            ]
        components.append(plant())
        return components, joined(components, pairs)

    def _monitor(self, power_off: int) -> Component:
        def law(t: float, h: float, u: np.ndarray) -> list[float]:
            return [*u, 1.0 if round(t / TICK) < power_off else 0.0]

        return sampled("monitor", law, (OMEGA_REF,), outputs=(OMEGA_REF, Port("power", kind="bool")))


class Run:
    """A finished run: `run["estimator.read"]`, one row per tick."""

    def __init__(self, robot: Robot, faults: Sequence[Fault], last_tick: int, scheme: Scheme = "gauss_seidel"):
        components, feeds = inject(*robot.parts(), faults, TICK, COUNTS, SPEED_LIMIT)
        self.system = System(components, wires(feeds, components), TICK, scheme)
        self.rows = Simulation(self.system, last_tick).run()

    def __getitem__(self, end: str) -> np.ndarray:
        return self.rows[:, self.system.columns(end)]


def run(*faults: Fault, robot: Robot | None = None, last_tick: int = 120) -> Run:
    """The mock robot with `faults`, to `last_tick`."""
    return Run(robot or Robot(), faults, last_tick)
