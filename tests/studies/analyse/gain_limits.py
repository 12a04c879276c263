"""Gain limits of every drive of fmus/, predicted and simulated: the table of docs/loops.md.

Run it with `python -m tests.studies.analyse.gain_limits`; it takes some minutes.
"""

from pathlib import Path

from tests.studies.analyse.simulated import fig4
from twin.robot.experiment.experiment import Experiment
from twin.studies.analyse.limit_check import LimitCheck, bisect_limit, lasting_nudges
from twin.studies.analyse.linearised import Linearisation
from twin.studies.analyse.operating_point import operating_points
from twin.studies.analyse.stability import Stability, judge_point, limit_checks
from twin.studies.qualify.drive_list import listed_drives

HEAD = ("drive", "off (%)", "kp in air (1/s)", "verdict", "kp pressing (1/s)", "verdict", "force kp (mm/N)", "verdict")


def tried(experiment: Experiment, points: slice = slice(None)) -> Stability:
    """Its loops at some of its operating points with their limits tried; without maps, which take long."""
    everywhere, problems = operating_points(experiment)
    shared = Linearisation(experiment, everywhere)
    judged = [judge_point(shared.linear_point(point)) for point in everywhere[points]]
    return Stability(experiment, shared, judged, problems, [], limit_checks(shared, judged))


def row(drive: str) -> tuple[str, ...]:
    """The cells of a drive: how far off its model is; limits of Fig. 4's laws, predicted / simulated, and verdicts."""
    done = tried(fig4((), drive))
    model = done.shared.drives[0]
    off = f"{100 * model.residual:.1f}{', turning' if model.turning else ''}"
    return (f"`{drive}`", off, *(cell for check in done.checks for cell in cells(done, check)))


def cells(done: Stability, check: LimitCheck) -> tuple[str, str]:
    """`predicted / simulated` in the units of the file, and the verdict."""
    c = done.experiment.controller
    as_set = c.position.kp if check.law == "position" else 1e3 * c.force.kp
    predicted = "none" if check.predicted is None else digits(check.predicted * as_set)
    low, high = check.low, check.high
    if low is None or high is None:
        simulated = "none" if check.predicted is None else f"> {digits((low or 0.0) * as_set)}"
    else:

        def lasts(factor: float) -> bool:
            return bool(lasting_nudges(done.experiment, check.point, check.law, factor))

        low, high = bisect_limit(lasts, low, high)
        simulated = digits((low * high) ** 0.5 * as_set)
    return f"{predicted} / {simulated}", "holds" if check.holds else "not predicted"


def digits(value: float) -> str:
    return f"{value:.0f}" if value >= 1000.0 else f"{value:.3g}"


def main() -> None:
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    for shelved in listed_drives(Path.cwd()):
        print("| " + " | ".join(row(shelved.name)) + " |", flush=True)


if __name__ == "__main__":
    main()
