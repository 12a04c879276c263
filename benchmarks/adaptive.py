"""What a call of the controller costs that knows the tissue, schedules gains, follows the breath, learns from taps."""

from pathlib import Path

from benchmarks.measurement import Measurement, Rounds
from benchmarks.other_parts import call_seconds
from twin.runs.assembly.load import load_experiment

ROUNDS = 9
BODY = "back"
TISSUE = "controller.tissue.tolerance=0.3"
SCHEDULE = (
    "controller.force.schedule=[{stiffness_N_per_m=800,kp_mm_per_N=1.5,ki_mm_per_N_s=16},"
    "{stiffness_N_per_m=1600,kp_mm_per_N=1.9,ki_mm_per_N_s=13},{stiffness_N_per_m=3200,kp_mm_per_N=1.7,ki_mm_per_N_s=8}]"
)
WITH = {
    "plain": (),
    "estimator": (TISSUE,),
    "estimator, schedule": (TISSUE, SCHEDULE),
    "all of it": (TISSUE, SCHEDULE, "controller.breath.rate_per_min=15", "controller.touch.force_learning=0.5"),
}
MOST = 0.15
"""us that a call may take."""


def measurements(folder: Path) -> list[Measurement]:
    """The lines of the table for pressing.toml in `folder`."""
    loaded = {name: load_experiment(folder / "pressing.toml", how, body=BODY) for name, how in WITH.items()}
    rounds = Rounds({name: lambda one=one: call_seconds(one) for name, one in loaded.items()}, ROUNDS)  # type: ignore[misc]
    lines = [Measurement(f"controller of tasks, {name}: per call", 1e6 * rounds.typical(name), "us") for name in loaded]
    each = zip(rounds.seconds["estimator, schedule"], rounds.seconds["plain"], strict=True)
    beyond = sorted(a - b for a, b in each)[ROUNDS // 2]
    return [*lines, Measurement("controller: estimator and schedule add, per call", 1e6 * beyond, "us", at_most=MOST)]
