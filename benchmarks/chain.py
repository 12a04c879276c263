"""A chain of many small FMUs in `twin cosim`: what set-up and steps cost, and what a recording holds in memory."""

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from benchmarks.masters import FMU, TICK
from benchmarks.measurement import Measurement, Rounds
from benchmarks.start_up import process
from tests.kernel.systems.archives import archive, component, connection, structure, system, values
from twin.kernel.cosim.observers import simulate
from twin.kernel.ssp.package import read_package
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.opening import open_system

FEW, MANY = 10, 1000
STEPS = 400_000
"""Of all components together, so that both take the same time."""
ROUNDS = 5
SHORT, LONG = 300, 1200
"""Ticks of the chain of `MANY` that are recorded."""


@contextmanager
def chain(count: int, ticks: int) -> Iterator[Path]:
    """An archive: the first turns, each gets the speed of the one before."""
    names = [f"c_{i}" for i in range(count)]
    parts = [component(name, FMU.name, bindings=values("omega_ref=1") if name == "c_0" else "") for name in names]
    wires = [connection(f"c_{i}.omega_m", f"c_{i + 1}.omega_ref") for i in range(count - 1)]
    with tempfile.TemporaryDirectory() as folder:
        yield archive(Path(folder) / "chain.ssp", structure(system(parts, wires), ticks * TICK), {FMU.name: FMU})


def seconds(count: int, set_up: list[float]) -> float:
    """Of a step of one component among `count`; what it took before the first goes to `set_up`."""
    with chain(count, STEPS // count) as file:
        began = time.perf_counter()
        with open_system(read_package(file), MasterChoice(tick=TICK)) as (plan, made):
            set_up.append(time.perf_counter() - began)
            return simulate(made, plan.timing.ticks, (), 100).require_success().stepping / STEPS


def peak(ticks: int) -> float:
    """Most memory (MB) of `twin cosim` that records the long chain."""
    with chain(MANY, ticks) as file:
        asked = ("cosim", str(file), "--tick-ms", f"{1e3 * TICK:g}", "--out", str(file.with_name("run")))
        return process(["-m", "twin", *asked])[1]


def measurements() -> list[Measurement]:
    """The lines of the table."""
    set_ups: dict[int, list[float]] = {FEW: [], MANY: []}
    rounds = Rounds({f"{count}": partial(seconds, count, took) for count, took in set_ups.items()}, ROUNDS)
    ratio = rounds.ratio(f"{MANY}", f"{FEW}")
    peak(1)  # what the last edit made stale is compiled here
    short, long = peak(SHORT), peak(LONG)
    return [
        Measurement(f"chain of {MANY} FMUs: set-up", sorted(set_ups[MANY])[ROUNDS // 2], "s", at_most=10.0),
        Measurement(f"chain of {FEW}: a step of a component", 1e9 * rounds.typical(f"{FEW}"), "ns"),
        Measurement(f"chain of {MANY}: the same", 1e9 * rounds.typical(f"{MANY}"), "ns"),
        Measurement(f"chain: the same, {MANY} / {FEW}", ratio, "x", at_most=2.0),
        Measurement(f"chain of {MANY}: peak memory, recorded", short, "MB"),
        Measurement(f"chain: peak memory, {LONG} / {SHORT} ticks", long / short, "x", at_most=1.05),
    ]
