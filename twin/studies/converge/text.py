"""Text of a coupling study, at most 80 columns wide: recommendation, reasons, files."""

from collections.abc import Sequence
from itertools import zip_longest
from math import isfinite

from twin.kernel.serialise import to_dict
from twin.studies.converge.convergence import CouplingSeries, CouplingStudy, Order, OrderFinding, TickPoint
from twin.studies.converge.signals import COMPARED_SIGNALS, FORCE_SIGNAL, Signal
from twin.studies.result import Block, Column, Note, Result, Table, note

NAME_WIDTH = 31
COLUMN_WIDTH = 9
ORDER_REMARKS = {
    OrderFinding.NOT_SMOOTH: (
        "~",
        "slopes of neighbouring ticks differ by more than 0.3: an event moves with the tick",
    ),
    OrderFinding.NOT_FALLING: (
        "x",
        "does not fall with the tick: not the coupling's error, but the drive's or an event's",
    ),
    OrderFinding.AT_FLOOR: ("-", "too few errors are above the reference's own to make an order"),
    OrderFinding.UNSTABLE: ("!", "a run failed: the coupling is not stable at that tick"),
}


def convergence_result(study: CouplingStudy, files: dict[str, str]) -> Result:
    headline, *others = _headline(study)
    parts: list[Block] = [
        *others,
        "",
        _errors_by_tick(study),
        "",
        _errors_by_signal(study),
        "",
        *_orders(study),
        "",
        *_power(study),
        "",
        note("reference", study.reference.meaning),
        note("changed", "; ".join(study.changes)),
        *(note("left out", f"{name}: {why}") for name, why in study.left_out.items()),
    ]
    met = study.choice is not None or not study.reference.is_pressing
    return Result(headline, parts, to_dict(study) | files, files, exit_code=0 if met else 1)


def _headline(study: CouplingStudy) -> list[Block]:
    if not study.reference.is_pressing:
        why = "  so a tolerance of the force cannot select a tick and coupling"
        return [f"{study.name}: never presses", why]
    limit = f"{1e3 * study.tolerance:g} mN"
    if study.choice is None:
        return [f"{study.name}: no coupling at any of these ticks keeps F_z within {limit}"]
    coupling, point = study.choice.coupling, study.choice.point
    blocks: list[Block] = [
        f"{study.name}: use {coupling.name} at {1e3 * point.tick:g} ms",
        f"  the longest tick, and the simplest coupling there, that keeps F_z within {limit}:",
        f"  {_number(1e3 * point.errors[FORCE_SIGNAL.name])} mN, for {1e3 * point.cost:.1f} ms of computing per second",
    ]
    own = next((_point_at(one, study.tick) for one in study.series if one.coupling == study.coupling), None)
    if own is not None:
        error, cost = _number(1e3 * own.errors[FORCE_SIGNAL.name]), 1e3 * own.cost
        blocks.append(f"  as it is, {study.coupling.name} at {1e3 * study.tick:g} ms: {error} mN, {cost:.1f} ms")
        blocks += _why_not(study, own)
    return blocks


def _why_not(study: CouplingStudy, own: TickPoint) -> list[Block]:
    """Explain why an experiment may keep a coupling other than the recommended one, and how to change it."""
    if study.choice is None or (study.choice.coupling, study.choice.point.tick) == (study.coupling, study.tick):
        return []
    error = own.errors[FORCE_SIGNAL.name]
    if not isfinite(error):
        return []
    if error <= study.tolerance:
        why = "it keeps the tolerance, too, and only computes more"
    elif study.resolution and error < study.resolution:
        why = f"its error is {error / study.resolution:.0%} of a step of the scale's display, which cannot be read"
    else:
        return [Note(f"its error can be seen: take the other with {_settings(study)}", "  ", whole=True)]
    text = f"it stays the default because {why}, and recordings stay comparable; take the other with {_settings(study)}"
    return [Note(text, "  ", whole=True)]


def _settings(study: CouplingStudy) -> str:
    assert study.choice is not None
    new, old = study.choice.coupling, study.coupling
    settings = {"tick_ms": f"{1e3 * study.choice.point.tick:g}"} if study.choice.point.tick != study.tick else {}
    settings |= {name: str(getattr(new, name)) for name in ("scheme", "inputs", "iterations")
             if getattr(new, name) != getattr(old, name)}  # fmt: skip
    return " ".join(f"--set cosim.{key}={value}" for key, value in settings.items())


def _point_at(one: CouplingSeries, tick: float) -> TickPoint | None:
    return next((point for point in one.points if point.tick == tick), None)


def _errors_by_tick(study: CouplingStudy) -> Table:
    ticks = sorted({point.tick for one in study.series for point in one.points}, reverse=True)
    rows = [
        [one.coupling.name, *(_error(_point_at(one, tick), study.judged_signal) for tick in ticks)]
        for one in study.series
    ]
    title = f"largest error of {study.judged_signal.name} in {study.judged_signal.unit} at"
    return _table(title, [f"{1e3 * tick:g} ms" for tick in ticks], rows)


def _errors_by_signal(study: CouplingStudy) -> Table:
    found = [(one, point) for one in study.series if (point := _point_at(one, study.tick)) is not None]
    return _table(
        f"largest error at {1e3 * study.tick:g} ms",
        [signal.name for signal in COMPARED_SIGNALS],
        [[one.coupling.name, *(_error(point, signal) for signal in COMPARED_SIGNALS)] for one, point in found],
        [signal.unit for signal in COMPARED_SIGNALS],
    )


def _orders(study: CouplingStudy) -> list[Block]:
    rows = [
        [
            one.coupling.name,
            *(_order(one.orders[signal.name]) for signal in COMPARED_SIGNALS),
            str(one.coupling.expected_order),
        ]
        for one in study.series
    ]
    found = {order.finding for one in study.series for order in one.orders.values()}
    return [
        _table("observed order", [*(signal.name for signal in COMPARED_SIGNALS), "expected"], rows),
        *(note(mark, meaning) for finding, (mark, meaning) in ORDER_REMARKS.items() if finding in found),
    ]


def _power(study: CouplingStudy) -> list[Block]:
    return [
        _table(
            f"power out of nothing at {1e3 * study.tick:g} ms",
            ["mean", "peak", "energy", "share"],
            [[one.coupling.name, *_balance(one)] for one in study.series if one.residuals],
            ["uW", "uW", "uJ", "ppm"],
        ),
        note("", "mean, energy: of all joints, + created; peak: of one; share: of the energy through"),
    ]


def _table(title: str, names: list[str], rows: list[list[str]], units: Sequence[str] = ()) -> Table:
    columns = [Column(name, COLUMN_WIDTH, unit=unit, gap=0) for name, unit in zip_longest(names, units, fillvalue="")]
    return Table([Column(title, NAME_WIDTH, left=True), *columns], rows)


def _balance(one: CouplingSeries) -> list[str]:
    energy = sum(joint.energy for joint in one.residuals)
    mean, peak = sum(joint.mean for joint in one.residuals), max(joint.peak for joint in one.residuals)
    share = energy / max(sum(joint.throughput for joint in one.residuals), 1e-300)
    return [_number(1e6 * value) for value in (mean, peak, energy, share)]


def _error(point: TickPoint | None, signal: Signal) -> str:
    if point is None:
        return ""
    error = point.errors[signal.name]
    return _number(signal.scale * error) if isfinite(error) else "failed"


def _number(value: float) -> str:
    """Format a number with three digits in at most eight columns."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e3:
        return f"{float(f'{value:.3g}'):g}"
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.1e}"


def _order(order: Order) -> str:
    mark = ORDER_REMARKS[order.finding][0] if order.finding in ORDER_REMARKS else ""
    return mark if order.slope is None else f"{mark}{order.slope:.2f}"
