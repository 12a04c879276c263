"""Text of the linear analysis and of the impedance felt by a hand, at most 80 columns wide."""

import math
import re
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.kernel.serialise import to_dict
from twin.studies.analyse import carried_mass, limit_check, passivity, rendering, stability
from twin.studies.analyse.linear.hand import AXES
from twin.studies.analyse.linear.margins import LARGEST_GAIN, DiskMargin, Margins, Pole
from twin.studies.analyse.operating_point import OperatingPoint
from twin.studies.result import NO_BREAK_SPACE, Block, Column, Note, Result, Row, Table, count_text

Numbers = NDArray[np.float64]
DOUBTFUL_RESIDUAL = 0.03
TURNING_NOTE = (
    "measured while it turns: at rest its small signals drown in steps or stiction, "
    "so the numbers are valid for larger swings only"
)
UNTRIED_NOTE = "the gain limits are the linear model's and were not tried in the co-simulation"
SLIDING_NOTE = (
    "dry friction (joint_friction_Nm, spring_hysteresis) is not in the linear model, whose joints slide and whose "
    "springs are ideal: small motions are stiffer"
)
STICTION_NOTE = "- where a loop's gain never reaches 1: sticking friction holds the platform there"
VALUE_PATTERN = re.compile(r"k[pi] = [\d.e+-]+ [^ ,]+(?: s\))?|\([^()]*\) mm|[\d.]+ N\b")
LOOP_COLUMNS = (
    Column("loop", 11, left=True),
    Column("gain margin", 18),
    Column("phase margin", 19),
    Column("M_s", 6, ".2f"),
    Column("M_t", 6, ".2f"),
    Column("-3 dB", 10),
)
AXIS_COLUMNS = (Column("axis", 6, left=True), Column("springs", 14), Column("passive", gap=3, left=True))


def decibels(factor: ArrayLike) -> Numbers:
    """Convert factors to decibels, 20 log10; 0 counts as the smallest positive double."""
    return 20.0 * np.log10(np.maximum(factor, np.finfo(float).tiny))


def margins_text(margins: Margins) -> str:
    """Format gain and phase margin as `: 22 dB, 88 deg`; "" without either."""
    found = [] if margins.gain is None else [f"{decibels(margins.gain):.0f} dB"]
    found += [] if margins.phase is None else [f"{np.degrees(margins.phase):.0f} deg"]
    return f": {', '.join(found)}" if found else ""


def analysis_result(done: stability.Stability, files: Sequence[str] = ()) -> Result:
    first, *verdict = _verdict(done)
    plant = done.experiment.plant
    remarks = [
        *(f"{name}: {m.remark}" for judged in done.points for name, m in judged.margins.items() if m.remark),
        *([SLIDING_NOTE] if plant.joint_friction or plant.spring_hysteresis else []),
        *([UNTRIED_NOTE] if not done.checks else []),
        *(f"left out: {problem}" for problem in done.problems),
    ]
    held = any(m.crossover is None for judged in done.points for m in judged.margins.values())
    doubt: list[Block] = ["", _unbroken_note("", STICTION_NOTE)] if held else []
    parts: list[Block] = [
        *verdict,
        "",
        *(part for judged in done.points for part in _point(judged)),
        *doubt,
        "",
        *_drives(done),
        *(_unbroken_note("note  ", text) for text in dict.fromkeys(remarks)),
        "",
    ]
    facts = done.to_dict() | {"files": [*files]}
    return Result(first, parts, facts, {file: file for file in files}, label=0, exit_code=0 if done.stable else 1)


def point_name(point: OperatingPoint) -> str:
    """Format an operating point as text, such as `pressing with 5 N at (0, 20, -105) mm`."""
    x, y, z = (round(1e3 * value, 2) + 0.0 for value in point.p_B)
    doing = f"pressing with {point.F_z:.3g} N" if point.in_contact else "in air"
    return f"{doing} at ({x:g}, {y:g}, {z:g}) mm"


def loop_name(name: str) -> str:
    return name.replace("_", " ")


def _verdict(done: stability.Stability) -> Iterator[Block]:
    unstable = [judged for judged in done.points if not judged.stable]
    count = len(done.points)
    left_out = f"; {len(done.problems)} left out" if done.problems else ""
    points = "the operating point" if count == 1 else f"all {count} operating points"
    if unstable:
        points = f"{len(unstable)} of {count} operating points"
    elif not done.stable:
        points += " by the linear model, but not in the co-simulation"
    yield _unbroken_note("", f"{done.experiment.name}  {'STABLE' if done.stable else 'UNSTABLE'} at {points}{left_out}")
    for law in ("position", "force"):
        critical = done.critical(law)
        limits = [_checked_limit_text(done, check) for check in done.checks if check.law == law]
        if critical is not None:
            limits = limits or [_predicted_limit_text(done, law, critical)]
        elif any(law in judged.limits for judged in done.points):
            limits = limits or [f"nothing limits its gains up to {LARGEST_GAIN:g} times what is set"]
        yield from (_unbroken_note(f"  {law:8}  ", text) for text in limits)


def _predicted_limit_text(done: stability.Stability, law: str, critical: stability.PointStability) -> str:
    where, factor = point_name(critical.linear.point), critical.limits[law]
    if not factor:
        return f"no gain of it makes the robot stable {where}"
    return f"stable up to {_gains(done, law, factor)}, {factor:.3g} times what is set; beyond, it shakes {where}"


def _checked_limit_text(done: stability.Stability, check: limit_check.LimitCheck) -> str:
    where, predicted = point_name(check.point), check.predicted
    if check.holds and predicted is None:
        return f"nothing limits its gains up to {LARGEST_GAIN:g} times what is set, nor in the co-simulation, {where}"
    if predicted is None:
        linear = f"no limit up to {LARGEST_GAIN:g} times what is set"
    else:
        linear = f"{_gains(done, check.law, predicted)}, {predicted:.3g} times what is set"
    if check.holds:
        within = f"the co-simulation agrees within {100 * limit_check.LIMIT_TOLERANCE:.0f} %"
        return f"stable up to {linear}; beyond, it shakes {where}; {within}"
    if check.high is None:
        tried = check.low or 0.0
        found = f"no nudge lasts up to {_gains(done, check.law, tried)}, {tried:.3g} times what is set"
    elif check.simulated_limit is None:
        found = f"a nudge lasts down to a {limit_check.MAX_SEARCH_FACTOR:g}th of that"
    else:
        factor = check.simulated_limit
        found = f"a nudge lasts from {_gains(done, check.law, factor)} on, {factor:.3g} times what is set"
    return (
        f"not predicted for this drive {where}: in the co-simulation {found}; the linear model predicts {linear}. "
        f"Why: {check.reason}"
    )


def _gains(done: stability.Stability, law: str, factor: float) -> str:
    c = done.experiment.controller
    if law == "position":
        return f"kp = {_digits(factor * c.position.kp)} 1/s"
    terms = [f"kp = {_digits(1e3 * factor * c.force.kp)} mm/N"] if c.force.kp else []
    return ", ".join([*terms, f"ki = {_digits(1e3 * factor * c.force.ki)} mm/(N s)"] if c.force.ki else terms)


def _damping(judged: stability.PointStability) -> str:
    pole = judged.least_damped_pole
    if not judged.stable:
        return f": UNSTABLE, {_growth(judged.poles[0])}"
    if pole.zeta > 0.999:
        return "; nothing swings"
    return f"; swings most at {_hertz(pole.omega)} Hz, zeta {pole.zeta:.2g}"


def _growth(pole: Pole) -> str:
    rate = -pole.zeta * pole.omega
    if pole.zeta < -0.999:
        return f"it runs away, e-fold in {1.0 / rate:.2g} s"
    if rate <= 0.0:
        return "it never settles"
    return f"a swing of {_hertz(pole.omega)} Hz grows e-fold in {1.0 / rate:.2g} s"


def _point(judged: stability.PointStability) -> list[Block]:
    title = _unbroken_note("", point_name(judged.linear.point) + _damping(judged))
    if not judged.stable:
        return [title]
    rows: list[Row] = [_row(loop_name(name), m) for name, m in judged.margins.items()]
    rows.append(("all at once", "gain, each", "phase, each", "disk"))
    return [title, Table(LOOP_COLUMNS, [*rows, *(_disk_row(where, disk) for where, disk in judged.disks.items())])]


def _row(name: str, m: Margins) -> Row:
    gain = f"> {LARGEST_GAIN:g}" if not m.remark else "?"
    if m.gain is not None:
        gain = f"{m.gain:.3g} at {_hertz(m.gain_frequency)} Hz"
    phase = "-" if m.phase is None else f"{math.degrees(m.phase):.0f} deg at {_hertz(m.crossover)} Hz"
    bandwidth = "-" if m.bandwidth is None else f"{_hertz(m.bandwidth)} Hz"
    return name, gain, phase, m.sensitivity, m.complementary, bandwidth


def _disk_row(name: str, disk: DiskMargin) -> Row:
    gain = "any" if disk.gain is None else f"{disk.gain:.3g} at {_hertz(disk.frequency)} Hz"
    return name, gain, f"{math.degrees(disk.phase):.0f} deg", disk.alpha


def _drives(done: stability.Stability) -> Iterator[Note]:
    fits = dict(zip(done.shared.labels, done.shared.drives, strict=True))
    for label, model in fits.items():
        doubt = "; take the numbers with that doubt" if model.residual > DOUBTFUL_RESIDUAL else ""
        states = count_text(len(model.A), "state")
        off = "less than 0.1" if model.residual < 0.001 else f"{100 * model.residual:.2g}"
        yield _unbroken_note("drive  ", f"{label}: {states}, {off} % off its measured frequency response{doubt}")
        if model.turning:
            yield _unbroken_note("       ", TURNING_NOTE)


def _digits(value: float) -> str:
    return f"{value:.0f}" if value >= 1000.0 else f"{value:.3g}"


def _hertz(omega: float | None) -> str:
    return f"{(omega or 0.0) / (2.0 * math.pi):.3g}"


def _unbroken_note(head: str, text: str) -> Note:
    """Return a note whose lines break neither a number from its unit nor a bracketed group."""
    tied = VALUE_PATTERN.sub(lambda found: found.group().replace(" ", NO_BREAK_SPACE), text)
    return Note(tied, head, max(2, len(head)), whole=True)


def passivity_result(done: passivity.Passivity, files: Sequence[str] = ()) -> Result:
    passive = sum(point.bands["all"] is None and point.stable for point in done.points)
    parts = [
        *([Note(_rendering_text(done.width), "  renders   ")] if done.width is not None else []),
        *([Note(_carried_mass_text(done.trial), "  carries   ")] if done.tried else []),
        *(part for point in done.points for part in _passive_point(point)),
        *(Note(f"left out: {problem}", "note  ") for problem in dict.fromkeys(done.problems)),
        "",
    ]
    verdict = f"{done.experiment.name}  passive in the hand at {passive} of {len(done.points)} operating points"
    facts, stable = to_dict(done) | {"files": [*files]}, all(point.stable for point in done.points)
    return Result(Note(verdict, later=4), parts, facts, {file: file for file in files}, 0, 0 if stable else 1)


def _rendering_text(width: rendering.ZWidth) -> str:
    rendered, stiffness, damping = width.largest
    spring = f"the springs have {width.spring:.4g} N/m there"
    if not rendered:
        return f"no stiffness passively along z; {spring}"
    return (
        f"passively along z up to {rendered:.4g} N/m, asked for {stiffness:.4g} N/m and {damping:.3g} N s/m; {spring}"
    )


def _carried_mass_text(trial: carried_mass.PassivityTrial | None) -> str:
    if trial is None:
        return f"{passivity.MASS_RANGE[1]:g} kg on the platform in the air, by the linear model"
    inside, outside = (
        f"{factor * trial.mass:.3g} kg" for factor in (carried_mass.STABLE_SHARE, carried_mass.UNSTABLE_SHARE)
    )
    simulated = [f"{growth:+.2g} 1/s" for growth in trial.simulated]
    predicted = [f"{growth:+.2g}" for growth in trial.predicted]
    agrees = "the co-simulation agrees" if trial.agrees else "the co-simulation does NOT agree"
    return (
        f"up to {trial.mass:.3g} kg on the platform {point_name(trial.point)}; beyond, it swings; {agrees}: "
        f"a nudge grows at {simulated[0]} with {inside} ({predicted[0]} predicted), by {simulated[1]} with {outside} "
        f"({predicted[1]})"
    )


def _passive_point(point: passivity.PointPassivity) -> list[Block]:
    springs = {axis: f"{spring:.0f} N/m" for axis, spring in zip(AXES, point.springs, strict=True)}
    rows = [(axis, springs.get(axis), _passive_text(point.bands[axis])) for axis in (*AXES, "all")]
    worst = point.worst
    x, y, z = worst.direction
    environment = f"{worst.mass:.3g} kg on {worst.stiffness:.3g} N/m along ({x:.2f}, {y:.2f}, {z:.2f})"
    swings = f"{environment}, swings at {worst.frequency:.2g} Hz, {worst.growth:+.2g} 1/s"
    return [
        "",
        Note(point_name(point.point) + ("" if point.stable else ": UNSTABLE in an empty hand")),
        Table(AXIS_COLUMNS, rows),
        Note(f"worst environment: {swings if worst.swings else f'no swing; slowest decay {environment}'}", "  "),
    ]


def _passive_text(band: passivity.Band | None) -> str:
    if band is None:
        return "at all frequencies"
    return f"not from {band.low:.2g} to {band.high:.3g} Hz; gives back {-100.0 * band.least:.0f} % at {band.at:.2g} Hz"
