"""Gain limits of every drive of fmus/, predicted and simulated: the table of docs/analysis.md.

Run it with `python -m tests.loop_analysis.gain_limits`; it takes a minute.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.loop_analysis.simulated import AIR, fig4, pressing_with_force_loop, simulated_limit
from twin.analysis.margins import gain_limit
from twin.loop_analysis.linear_point import Linearised
from twin.loop_analysis.operating_point import operating_points
from twin.loop_analysis.stability import FORCE, POSITION
from twin.qualification.shelf import shelved_drives

POSITION_GAIN = {"controller.position.kp_per_s": 1.5}
FORCE_GAINS = {"controller.force.kp_mm_per_N": 2.0, "controller.force.ki_mm_per_N_s": 0.5}
SPREAD = 4.0


def limits(base: Sequence[str], drive: str, gains: dict[str, float], names: tuple[str, ...]) -> tuple[str, str, str]:
    """(how far off the drive's model is, the first gain of `gains` at the limit as predicted, as simulated)."""
    experiment = fig4(base, drive)
    points, _ = operating_points(experiment)
    shared = Linearised(experiment, points)
    point = shared.at(points[-1] if names == FORCE else points[0])
    predicted = gain_limit(point.loops, point.gains, names)
    model, gain = shared.drives[0], next(iter(gains.values()))
    residual = f"{100 * model.residual:.1f}{', turning' if model.turning else ''}"
    if predicted is None:
        return residual, "none", "-"
    simulated = simulated_limit(base, gains, predicted, drive, SPREAD)
    told = f"{simulated * gain:.1f}"
    if simulated == 0.0:
        told = f"< {predicted / SPREAD * gain:.1f}"
    elif np.isinf(simulated):
        told = f"> {predicted * SPREAD * gain:.0f}"
    return residual, f"{predicted * gain:.1f}", told


def main() -> None:
    print("| drive | off (%) | kp in air, predicted (1/s) | simulated | force kp, predicted (mm/N) | simulated |")
    print("|---|---|---|---|---|---|")
    for shelved in shelved_drives(Path.cwd()):
        residual, *air = limits(AIR, shelved.name, POSITION_GAIN, POSITION)
        _, *force = limits(pressing_with_force_loop((), shelved.name), shelved.name, FORCE_GAINS, FORCE)
        print("| " + " | ".join([f"`{shelved.name}`", residual, *air, *force]) + " |", flush=True)


if __name__ == "__main__":
    main()
