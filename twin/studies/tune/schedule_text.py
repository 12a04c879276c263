"""A schedule as text of at most 80 columns, and as lines of an experiment file."""

import math
from collections.abc import Iterator
from pathlib import Path

from twin.studies.lines import wrapped
from twin.studies.tune.fragment import goals_sentence
from twin.studies.tune.schedule import Point, Scheduled
from twin.studies.tune.trial import Whole


def schedule_text(done: Scheduled) -> str:
    """For people: the verdict, then each point."""
    lines = [*_verdict(done), ""]
    lines.append(f"{'':13} {'kp':>6} {'ki':>9}  {'M_s':>4} {'over':>5} {'5 % in':>7}   run: force off by (rms)")
    lines.append(f"{'on':13} {'mm/N':>6} {'mm/(N s)':>9}  {'':4} {'':5} {'':7}   one set  scheduled")
    for point in done.points:
        lines += _point(point)
    return "\n".join(line.rstrip() for line in lines)


def schedule_lines(done: Scheduled, own_tissue: bool) -> str:
    """TOML that goes below the one set of gains, which is the safe one.

    Args:
        own_tissue: whether the experiment has a [controller.tissue] of its own.
    """
    source = f"twin tune --schedule: {goals_sentence(done.base)}" + ("" if done.met else "; GOALS NOT MET")
    lines = ["", f"# {source}"]
    for point in done.points:
        lines += [
            "[[controller.force.schedule]]",
            f"stiffness_N_per_m = {point.stiffness:.6g}",
            f"kp_mm_per_N = {1e3 * point.gains.force_kp:.6g}",
            f"ki_mm_per_N_s = {1e3 * point.gains.force_ki:.6g}",
            "",
        ]
    return "\n".join(lines if own_tissue else [*lines, "[controller.tissue]", ""])


def _verdict(done: Scheduled) -> Iterator[str]:
    name, points = done.base.experiments[0].name, len(done.points)
    if done.met:
        yield f"{name}  SCHEDULE of {points} points, goals met at each, and the co-simulation agrees"
        return
    yield f"{name}  SCHEDULE of {points} points, GOALS NOT MET; this is the best that was found"
    for point in done.points:
        for miss in point.misses:
            yield from wrapped(f"{miss.goal} for {point.stiffness:.4g} N/m: {miss.at.corner.name}", "  missed    ")
    for sentence in done.contradictions:
        yield from wrapped(sentence, "  missed    ")


def _point(point: Point) -> Iterator[str]:
    gains = f"{1e3 * point.gains.force_kp:6.3g} {1e3 * point.gains.force_ki:9.3g}"
    stable = [prediction for prediction in point.predictions if prediction.stable]
    if not stable:
        yield f"{point.stiffness:8.4g} N/m  {gains}  UNSTABLE"
        return
    M_s = max(prediction.sensitivity for prediction in stable)
    over = max(prediction.answers["force"].overshoot for prediction in stable)
    settling = max(prediction.answers["force"].settling for prediction in stable)
    time = f"{settling:.2f} s" if math.isfinite(settling) else "never"
    for number, (fixed, scheduled) in enumerate(point.wholes):
        own = f"{point.stiffness:8.4g} N/m  {gains}  {M_s:4.2f} {100 * over:3.0f} % {time:>7}" if number == 0 else ""
        errors = [_error(whole) for whole in (fixed, scheduled)]
        label = f"  {Path(fixed.drive).stem}" if len(point.wholes) > 1 else ""
        yield f"{own:51}  {errors[0]:>8} {errors[1]:>8}{label}"


def _error(whole: Whole) -> str:
    found = whole.outcome and whole.outcome.force_error
    return f"{found:.3f} N" if found else "failed"
