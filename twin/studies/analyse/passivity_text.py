"""A robot in the hand as text of at most 80 columns: the verdict, then each operating point."""

from twin.studies.analyse.linear.hand import AXES
from twin.studies.analyse.passivity import MASSES, Band, Passivity, PointPassivity
from twin.studies.analyse.passivity_trial import INSIDE, OUTSIDE, PassivityTrial
from twin.studies.analyse.text import point_name
from twin.studies.analyse.z_width import Width
from twin.studies.lines import wrapped


def passivity_text(done: Passivity) -> str:
    """The verdict first: how many points are passive, what is rendered, what was tried."""
    passive = sum(point.bands["all"] is None and point.stable for point in done.points)
    verdict = f"{done.experiment.name}  passive in the hand at {passive} of {len(done.points)} operating points"
    lines = wrapped(verdict, later=4)
    if done.width is not None:
        lines += wrapped(_rendered(done.width), "  renders   ")
    if done.tried:
        lines += wrapped(_carried(done.trial), "  carries   ")
    for point in done.points:
        lines += ["", *wrapped(point_name(point.point) + ("" if point.stable else ": UNSTABLE in an empty hand"))]
        lines += _table(point)
    for problem in dict.fromkeys(done.problems):
        lines += wrapped(f"left out: {problem}", "note  ")
    return "\n".join(line.rstrip() for line in lines)


def _rendered(width: Width) -> str:
    rendered, stiffness, damping = width.largest
    spring = f"the springs have {width.spring:.4g} N/m there"
    if not rendered:
        return f"no stiffness passively along z; {spring}"
    return (
        f"passively along z up to {rendered:.4g} N/m, asked for {stiffness:.4g} N/m and {damping:.3g} N s/m; {spring}"
    )


def _carried(trial: PassivityTrial | None) -> str:
    if trial is None:
        return f"{MASSES[1]:g} kg on the platform in the air, as far as the linear model says"
    inside, outside = (f"{factor * trial.mass:.3g} kg" for factor in (INSIDE, OUTSIDE))
    simulated = [f"{growth:+.2g} 1/s" for growth in trial.simulated]
    predicted = [f"{growth:+.2g}" for growth in trial.predicted]
    agrees = "the co-simulation agrees" if trial.confirmed else "the co-simulation does NOT agree"
    return (
        f"up to {trial.mass:.3g} kg on the platform {point_name(trial.point)}; beyond, it swings; {agrees}: "
        f"a nudge goes by {simulated[0]} with {inside} ({predicted[0]} predicted), by {simulated[1]} with {outside} "
        f"({predicted[1]})"
    )


def _table(point: PointPassivity) -> list[str]:
    lines = [f"  {'axis':6} {'springs':>10}   passive"]
    for i, axis in enumerate(AXES):
        lines.append(f"  {axis:6} {point.springs[i]:>6.0f} N/m   {_passive(point.bands[axis])}")
    lines.append(f"  {'all':6} {'':>10}   {_passive(point.bands['all'])}")
    worst = point.worst
    x, y, z = worst.direction
    told = f"{worst.mass:.3g} kg on {worst.stiffness:.3g} N/m along ({x:.2f}, {y:.2f}, {z:.2f})"
    if not worst.swings:
        return [*lines, *wrapped(f"worst environment: none swings; slowest to die out {told}", "  ")]
    return [
        *lines,
        *wrapped(f"worst environment: {told}, swings at {worst.frequency:.2g} Hz, {worst.growth:+.2g} 1/s", "  "),
    ]


def _passive(band: Band | None) -> str:
    if band is None:
        return "at all frequencies"
    return f"not from {band.low:.2g} to {band.high:.3g} Hz; gives back {-100.0 * band.least:.0f} % at {band.at:.2g} Hz"
