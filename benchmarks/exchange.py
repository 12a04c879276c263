"""What it costs to solve an FMU's equations: model exchange beside a drive that solves them in closed form."""

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.macro_step import TICKS, master_seconds
from benchmarks.measurement import Measurement, Rounds
from tests.kernel.fmi.exchange.fmus import NoCompiler, exchange_fmu
from twin.robot.assembly.drives import DrivePlan, plan_drive
from twin.robot.experiment.drive_files import load_drive
from twin.robot.experiment.schema import Drive
from twin.studies.qualify.bench import response

ROUNDS = 15
BENCH_TICKS = 5_000
ROOT = Path(__file__).parents[1]


def bench_seconds(plan: DrivePlan, moving: bool) -> float:
    """Seconds per tick in the drive's steps on the bench; `moving`: its inputs jump in every tick, else never."""
    t = 1e-3 * np.arange(BENCH_TICKS)
    share = np.sin(40.0 * t) if moving else np.ones(BENCH_TICKS)
    return response(plan, 3.0 * share, 0.02 * share).cost


def measurements() -> list[Measurement]:
    """The lines of the table."""
    with tempfile.TemporaryDirectory() as scratch:
        try:
            servo, motor = (str(exchange_fmu(Path(scratch), name, 2)) for name in ("servo", "motor"))
        except NoCompiler as problem:
            title = "velocity_servo: model exchange, RK4 / closed form"
            return [Measurement(title, None, "x", at_most=8.0, remark=str(problem))]
        closed = plan_drive(load_drive(str(ROOT / "fmus" / "velocity_servo"), ROOT))
        rk4 = plan_drive(Drive.model_validate({"fmu": servo, "solver": "rk4"}))
        cvode = plan_drive(Drive.model_validate({"fmu": motor, "tolerance": 1e-6}))
        ring = Rounds(
            {
                "closed": lambda: master_seconds(closed, TICKS + 1)[0],
                "rk4": lambda: master_seconds(rk4, TICKS + 1)[0],
            },
            ROUNDS,
        )
        bench = Rounds(
            {"moving": lambda: bench_seconds(cvode, True), "still": lambda: bench_seconds(cvode, False)}, ROUNDS
        )
    return [
        Measurement("velocity_servo: model exchange, RK4 / closed form", ring.ratio("rk4", "closed"), "x", at_most=8.0),
        Measurement("CVODE, 3 states, inputs jump: per tick", 1e6 * bench.typical("moving"), "us", at_most=15.0),
        Measurement("CVODE, 3 states, inputs held: per tick", 1e6 * bench.typical("still"), "us"),
    ]
