"""What the plots of a report show, one panel under the other: truth beside belief, then the drives; with samples."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from twin.report.page.markup import DataBlock, thinned, thinning
from twin.report.page.run import ReportRun
from twin.studies.metrics.response import Curve

Role = Literal["truth", "belief", "reference", "shifted", "display"]
Samples = tuple[Curve, Curve]
"""Times (n,) in s, and values (n,) in the panel's unit."""
Reader = Callable[[ReportRun], Samples | None]
"""A run's samples of a quantity, or None if it holds none."""

DEG = math.degrees(1.0)
MM = 1e3
JOINTS = (0, 1, 2)
MOST_SAMPLES = 4_000_000
"""In a page: about 4 MB, and a dozen milliseconds of decoding."""


class Quantity(NamedTuple):
    """One curve of a panel, in every run that has it.

    Attributes:
        role: what it is to the others; decides colour and line.
        read: its samples.
        member: joint or axis, 0..2, if the panel shows several; decides the colour then. -1: neither.
        shown: at first; one that is not can be switched on.
    """

    label: str
    role: Role
    read: Reader
    member: int = -1
    shown: bool = True


class Panel(NamedTuple):
    """One plot. Values in `unit`."""

    title: str
    unit: str
    quantities: tuple[Quantity, ...]


def series(key: str, column: int | None = None, scale: float = 1.0) -> Reader:
    """Reads `topic.field`, one `column` of it, times `scale`."""

    def samples(run: ReportRun) -> Samples | None:
        if not run.has(key):
            return None
        return run.times[key.rpartition(".")[0]], scale * run.column(key, column)

    return samples


def deviation(axis: int) -> Reader:
    """Reads how far the platform truly is from the pre-defined reference, mm."""

    def samples(run: ReportRun) -> Samples | None:
        if not run.has("plant.p_B", "controller.p_ref_B"):
            return None
        t = run.times["plant"]
        return t, MM * (run.column("plant.p_B", axis) - run.held("controller.p_ref_B", t)[:, axis])

    return samples


def surface_height(run: ReportRun) -> Samples | None:
    """Reads where the apex of a surface that moves is, mm."""
    if not run.has("body.s_B") or "contact" not in run.values:
        return None
    return run.times["body"], run.values["contact"]["height_mm"] + MM * run.column("body.s_B", 2)


def wind_up(joint: int, motor: str, load: str) -> Reader:
    """Reads a spring's deflection theta_m - N theta_l (Eq. 20, before the dead zone), deg, motor side."""

    def samples(run: ReportRun) -> Samples | None:
        if not run.has(motor, load) or "N" not in run.values.get("plant", {}):
            return None
        t = run.times[load.rpartition(".")[0]]
        theta_m = run.held(motor, t)
        theta_m = theta_m if theta_m.ndim == 1 else theta_m[:, joint]
        return t, DEG * (theta_m - run.values["plant"]["N"] * run.column(load, joint))

    return samples


def commanded_speed(joint: int) -> Reader:
    """Reads what the drive is told, rad/s: by the last of the components between controller and drives."""

    def samples(run: ReportRun) -> Samples | None:
        last = next(
            (name for name in ("bus", "monitor", "delay", "tank") if run.has(f"{name}.omega_ref")), "controller"
        )
        return series(f"{last}.omega_ref", joint)(run)

    return samples


def _of_joints(label: str, role: Role, read: Callable[[int], Reader], shown: bool = True) -> tuple[Quantity, ...]:
    return tuple(Quantity(f"{label} {joint + 1}", role, read(joint), joint, shown) for joint in JOINTS)


def _x_and_y(role: Role, word: str, key: str, scale: float, shown: bool = True) -> tuple[Quantity, ...]:
    return tuple(
        Quantity(f"{letter}, {word}", role, series(key, axis, scale), axis, shown) for axis, letter in enumerate("xy")
    )


PANELS = (
    Panel(
        "Pressing force F_z", "N",
        (
            Quantity("estimated", "belief", series("controller.F_z")),
            Quantity("true", "truth", series("plant.F_ee_B", 2, -1.0)),
            Quantity("reference", "reference", series("controller.F_z_ref")),
            Quantity("scale", "display", series("scale.F_z"), shown=False),
        ),
    ),
    Panel(
        "Height z", "mm",
        (
            Quantity("after the force loop", "shifted", series("controller.p_cmd_B", 2, MM)),
            Quantity("estimated", "belief", series("estimator.p_B", 2, MM)),
            Quantity("true", "truth", series("plant.p_B", 2, MM)),
            Quantity("pre-defined", "reference", series("controller.p_ref_B", 2, MM)),
            Quantity("surface", "display", surface_height),
        ),
    ),
    Panel(
        "Deviation from the pre-defined path, true", "mm",
        tuple(Quantity(letter, "truth", deviation(axis), axis) for axis, letter in enumerate("xyz")),
    ),
    Panel(
        "Position x, y", "mm",
        (*_x_and_y("truth", "true", "plant.p_B", MM),
         *_x_and_y("reference", "pre-defined", "controller.p_ref_B", MM),
         *_x_and_y("belief", "estimated", "estimator.p_B", MM, shown=False)),
    ),
    Panel(
        "Force along x, y on the surface", "N",
        (*_x_and_y("belief", "estimated", "estimator.F_ee_B", 1.0),
         *_x_and_y("truth", "true", "plant.F_ee_B", 1.0)),
    ),
    Panel(
        "Joint torque tau_l", "N m",
        (*_of_joints("estimated", "belief", lambda joint: series("estimator.tau_l", joint)),
         *_of_joints("true", "truth", lambda joint: series("plant.tau_l", joint))),
    ),
    Panel(
        "Spring wind-up, motor side", "deg",
        (*_of_joints("true", "truth", lambda i: wind_up(i, f"drive/{i + 1}.theta_m", "plant.theta_l")),
         *_of_joints("measured", "belief", lambda i: wind_up(i, "estimator.theta_m", "estimator.theta_l"), False)),
    ),
    Panel(
        "Motor speed", "rad/s",
        (*_of_joints("commanded", "reference", commanded_speed),
         *_of_joints("true", "truth", lambda joint: series(f"drive/{joint + 1}.omega_m"))),
    ),
    Panel(
        "Motor torque", "N m",
        (*_of_joints("of the machine", "truth", lambda joint: series(f"drive/{joint + 1}.tau_motor")),
         *_of_joints("load of the spring", "reference", lambda joint: series("plant.tau_load", joint))),
    ),
    Panel(
        "Use of the safety monitor's limits", "1",
        (Quantity("largest share of any limit", "truth", series("monitor.utilisation")),),
    ),
)  # fmt: skip
KNOWN = ("theta_m", "omega_m", "tau_motor")
"""What every drive has to say."""


def panels(runs: Iterable[ReportRun]) -> list[Panel]:
    """The panels of which any of `runs` has something to show."""
    runs = list(runs)
    return [panel for panel in (*PANELS, *_own_panels(runs)) if _shows_something(panel, runs)]


def _own_panels(runs: Sequence[ReportRun]) -> list[Panel]:
    """What drives say beyond the contract: a panel per name, a curve per joint."""
    fields = {key: field for run in runs for key, field in run.recording.fields().items() if key.startswith("drive/")}
    names = {field.name: field.unit for field in fields.values() if field.name not in KNOWN and field.size == 1}

    def read(name: str) -> Callable[[int], Reader]:
        return lambda joint: series(f"drive/{joint + 1}.{name}")

    return [Panel(f"Drives: {name}", unit, _of_joints("joint", "truth", read(name))) for name, unit in names.items()]


def _shows_something(panel: Panel, runs: Sequence[ReportRun]) -> bool:
    return any(
        samples is not None and np.any(np.isfinite(samples[1]))
        for quantity in panel.quantities
        for samples in map(quantity.read, runs)
    )


def curves(runs: Sequence[ReportRun], blocks: Sequence[DataBlock]) -> tuple[list[dict[str, Any]], int]:
    """(panels for JSON, factor by which samples are thinned); the samples of each run go into its block.

    A curve is [first sample in the block, number, time of the first (s), time from one to the next (s)]; null where a
    run does not have it.
    """
    found = [
        (panel, [(quantity, [quantity.read(run) for run in runs]) for quantity in panel.quantities])
        for panel in panels(runs)
    ]
    total = sum(len(one[0]) for _, rows in found for _, samples in rows for one in samples if one)
    factor = thinning(total, MOST_SAMPLES)
    facts = [
        {
            "title": panel.title,
            "unit": "" if panel.unit == "1" else panel.unit,
            "rows": [
                {
                    "label": quantity.label,
                    "role": quantity.role,
                    "member": quantity.member,
                    "shown": quantity.shown and (len(runs) == 1 or quantity.role in ("truth", "reference")),
                    "curves": [_curve(one, block, factor) for one, block in zip(samples, blocks, strict=True)],
                }
                for quantity, samples in rows
                if any(samples)
            ],
        }
        for panel, rows in found
    ]
    return facts, factor


def _curve(samples: Samples | None, block: DataBlock, factor: int) -> list[float] | None:
    if samples is None:
        return None
    t, values = samples
    step = float(t[-1] - t[0]) / max(1, len(t) - 1)
    return [*block.add(thinned(values, factor)), float(t[0]), step * factor]
