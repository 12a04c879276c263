"""What a call of the controller costs that knows the tissue, schedules gains, follows the breath, learns from taps.

The shortest of several runs counts: what else the machine does can only make a call longer.
"""

from pathlib import Path

from benchmarks.measurement import Measurement, Rounds
from benchmarks.other_parts import call_seconds
from twin.robot.assembly.load import load_experiment

ROUNDS = 15
BODY = "back"
TISSUE = "controller.tissue.tolerance=0.3"
SCHEDULE = (
    "controller.force.schedule=[{stiffness_N_per_m=800,kp_mm_per_N=1.5,ki_mm_per_N_s=16},"
    "{stiffness_N_per_m=1600,kp_mm_per_N=1.9,ki_mm_per_N_s=13},{stiffness_N_per_m=3200,kp_mm_per_N=1.7,ki_mm_per_N_s=8}]"
)
BESIDES = ("controller.breath.rate_per_min=15", "controller.touch.force_learning=0.5")
WITH = {
    "plain": (),
    "estimator": (TISSUE,),
    "estimator, schedule": (TISSUE, SCHEDULE),
    "all of it": (TISSUE, SCHEDULE, *BESIDES),
}
MOST = 0.15
"""Maximum time (us) of a call with estimator and schedule."""


def measurements(folder: Path) -> list[Measurement]:
    """The lines of the table for pressing.toml in `folder`."""
    loaded = {name: load_experiment(folder / "pressing.toml", how, body=BODY) for name, how in WITH.items()}
    rounds = Rounds({name: lambda one=one: call_seconds(one) for name, one in loaded.items()}, ROUNDS)  # type: ignore[misc]
    return [
        Measurement(
            f"controller of tasks, {name}: per call, at best", 1e6 * min(rounds.seconds[name]), "us",
            at_most=MOST if name == "estimator, schedule" else None,
        )
        for name in loaded
    ]  # fmt: skip
