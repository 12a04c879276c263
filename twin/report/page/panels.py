"""Plots of a report, panel by panel: true and believed signals, then the drives; and the samples of their curves."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from twin.kernel.recording.messages import Field
from twin.report.page.markup import DataBlock, thin_samples, thinning_factor
from twin.robot.mechanism.geometry import AXIS, OUTWARD, Geometry, skeleton
from twin.robot.plant.contact import apex_frame
from twin.robot.run.view import RunView, held_samples
from twin.studies.metrics.response import Curve
from twin.studies.panel import Panel, PanelCurve, Reader, Role, Samples

POSE_RATE = 50.0
"""Poses per second; the player interpolates linearly between them."""
MAX_FRAMES = 20_000
"""Maximum number of poses; a long run has fewer per second."""
MM, DEG = 1e3, math.degrees(1.0)
JOINTS = (0, 1, 2)
MAX_SAMPLES = 4_000_000
"""Maximum number of samples in a page: about 4 MB, and a dozen milliseconds of decoding."""
CONTRACT_SIGNALS = ("theta_m", "omega_m", "tau_motor")
"""Signals of every drive."""
PATCH_HALF_WIDTH, PATCH_FIELDS = 45.0, 10
"""Half the width of the displayed surface (mm), and its number of fields."""


class PanelRun:
    """A run and the checked values of its experiment, keys with units, as input of panels and player.

    `fields` are the fields of signals that have samples, `used` the signals that were read.
    """

    def __init__(self, view: RunView, values: Mapping[str, Any], fields: Mapping[str, Field] | None = None):
        self.view, self.values, self.used = view, values, set[str]()
        self._times: dict[str, Curve] = {}
        self.fields = fields if fields is not None else {
            key: field for key, field in view.fields().items() if len(self.time(_topic(key)))
        }  # fmt: skip

    def time(self, topic: str) -> Curve:
        """Return the sample times of a topic of the run (s), (n,)."""
        if topic not in self._times:
            self._times[topic] = self.view.time(topic)
        return self._times[topic]

    @property
    def end(self) -> float:
        """Time of the run's last sample (s)."""
        return max(float(self.time(_topic(key))[-1]) for key in self.fields)

    def has(self, *keys: str) -> bool:
        """Whether the run has samples of all these signals."""
        return all(key in self.fields for key in keys)

    def column(self, key: str, column: int | None) -> Curve:
        """Return the samples of a signal of the run, or of one column of it."""
        self.used.add(key)
        values = self.view[key]
        return values if column is None else values[:, column]

    def values_at(self, key: str, t: Curve) -> Curve:
        """Return the run's samples of a signal that hold at times `t` (s), (n,); raise as `column`."""
        return self.column(key, None)[held_samples(self.time(_topic(key)), t)]


def _topic(key: str) -> str:
    return key.rpartition(".")[0]


def scene(
    run: PanelRun, block: DataBlock, most: int = MAX_FRAMES, robot: str = "plant", model: str = ""
) -> dict[str, Any] | None:
    """Return the data of a run for the player, which animates the robot, mm and N; None without poses of the robot.

    At most `most` poses, of the topic `robot`, go into `block`. `frames` has their place in the block, each column of
    all n frames together: A (9), p_B (3), displacement of the surface (3), F_ee_B (3), F_ee_B estimated (3; absent
    without an estimator), and A and p_B of a second robot. That robot, of the topic `model` ("" without one), is drawn
    over the first.
    """
    lengths = [run.values.get("plant", {}).get(f"{name}_mm") for name in Geometry._fields]
    poses = [f"{topic}.{name}" for topic in filter(None, (robot, model)) for name in ("theta_l", "p_B")]
    if not run.has(*poses) or None in lengths:
        return None
    geometry = Geometry(*(length / MM for length in lengths))
    times = run.time(robot)
    step = max(1.0 / POSE_RATE, float(times[-1] - times[0]) / most)
    t = times[0] + step * np.arange(int((times[-1] - times[0]) / step + 1e-6) + 1)
    theta_l, p_B, *second = (run.values_at(key, t) for key in poses)
    joints = skeleton(geometry, theta_l, p_B)
    columns = [MM * joints.A.reshape(len(t), 9), MM * p_B, MM * _or_still(run, "body.s_B", t)]
    columns += [_or_still(run, "plant.F_ee_B", t)]
    estimated = run.has("estimator.F_ee_B")
    columns += [run.values_at("estimator.F_ee_B", t)] if estimated else []
    frames: dict[str, Any] = {"count": len(t), "start": float(t[0]), "step": step, "estimated": estimated}
    if second:
        frames["second"] = sum(column.shape[1] for column in columns)
        columns += [MM * skeleton(geometry, *second).A.reshape(len(t), 9), MM * second[1]]
    place, _ = block.add(np.column_stack(columns).T)
    return {
        "frames": frames | {"at": place},
        "B": (MM * joints.B).tolist(),
        "platform": (MM * geometry.b * OUTWARD).tolist(),
        "axis": AXIS.tolist(),
        "surface": surface(run.values["contact"]) if "contact" in run.values else None,
    }


def surface(contact: Mapping[str, Any]) -> list[list[list[float]]]:
    """Return points of the untouched body surface in B, (PATCH_FIELDS + 1, PATCH_FIELDS + 1, 3), mm, apex central.

    Shapes and axes of [contact] as in `twin.robot.plant.contact`.
    """
    tilts = SimpleNamespace(**{name: math.radians(contact.get(f"{name}_deg", 0.0)) for name in ("tilt", "tilt_x")})
    e_1, e_2, n = (np.array(axis) for axis in apex_frame(tilts))
    shape, radius = contact.get("shape", "plane"), contact.get("radius_mm", math.inf)
    # draw round bodies up to a slope of at most 45 degrees
    reach = np.linspace(-1.0, 1.0, PATCH_FIELDS + 1) * min(PATCH_HALF_WIDTH, 0.5 * radius)
    w_1, w_2 = np.meshgrid(reach, reach, indexing="ij")
    across = {"sphere": w_1**2 + w_2**2, "cylinder_x": w_2**2, "cylinder_y": w_1**2}.get(shape)
    # equals R - sqrt(R^2 - w^2), without the cancellation at large R
    drop = 0.0 * w_1 if across is None else across / (radius + np.sqrt(radius * radius - across))
    points = w_1[..., None] * e_1 + w_2[..., None] * e_2 - drop[..., None] * n
    points[..., 2] += contact["height_mm"]
    return np.round(points, 4).tolist()


def _or_still(run: PanelRun, key: str, t: Curve) -> Curve:
    return run.values_at(key, t) if run.has(key) else np.zeros((len(t), 3))


def series(key: str, column: int | None = None, scale: float = 1.0) -> Reader:
    """Return a function that reads the samples of the signal `topic.field` from a run, times `scale`."""

    def samples(run: PanelRun) -> Samples | None:
        if not run.has(key):
            return None
        return run.time(key.rpartition(".")[0]), scale * run.column(key, column)

    return samples


def deviation(axis: int) -> Reader:
    """Return a function that reads the platform's true deviation from the reference along `axis` from a run, mm."""

    def samples(run: PanelRun) -> Samples | None:
        if not run.has("plant.p_B", "controller.p_ref_B"):
            return None
        t = run.time("plant")
        return t, MM * (run.column("plant.p_B", axis) - run.values_at("controller.p_ref_B", t)[:, axis])

    return samples


def surface_height(run: PanelRun) -> Samples | None:
    """Return the times (s) and heights (mm) of the apex of a moving surface; None if the surface does not move."""
    if not run.has("body.s_B") or "contact" not in run.values:
        return None
    return run.time("body"), run.values["contact"]["height_mm"] + MM * run.column("body.s_B", 2)


def spring_deflection(joint: int, motor: str, load: str) -> Reader:
    """Return a function that reads a spring's deflection theta_m - N theta_l from a run (Eq. 20), deg, motor side."""

    def samples(run: PanelRun) -> Samples | None:
        if not run.has(motor, load) or "N" not in run.values.get("plant", {}):
            return None
        t = run.time(load.rpartition(".")[0])
        theta_m = run.values_at(motor, t)
        theta_m = theta_m if theta_m.ndim == 1 else theta_m[:, joint]
        return t, DEG * (theta_m - run.values["plant"]["N"] * run.column(load, joint))

    return samples


def commanded_speed(joint: int) -> Reader:
    """Return a function that reads the drive's commanded speed, rad/s, from the last component before the drives."""

    def samples(run: PanelRun) -> Samples | None:
        last = next(
            (name for name in ("bus", "monitor", "delay", "tank") if run.has(f"{name}.omega_ref")), "controller"
        )
        return series(f"{last}.omega_ref", joint)(run)

    return samples


def _of_joints(label: str, role: Role, read: Callable[[int], Reader], shown: bool = True) -> tuple[PanelCurve, ...]:
    return tuple(PanelCurve(f"{label} {joint + 1}", role, read(joint), joint, shown) for joint in JOINTS)


def _x_and_y(role: Role, word: str, key: str, scale: float, shown: bool = True) -> tuple[PanelCurve, ...]:
    return tuple(
        PanelCurve(f"{letter}, {word}", role, series(key, axis, scale), axis, shown) for axis, letter in enumerate("xy")
    )


RUN_PANELS = (
    Panel(
        "Pressing force F_z", "N",
        (
            PanelCurve("estimated", "belief", series("controller.F_z")),
            PanelCurve("true", "truth", series("plant.F_ee_B", 2, -1.0)),
            PanelCurve("reference", "reference", series("controller.F_z_ref")),
            PanelCurve("scale", "display", series("scale.F_z"), shown=False),
        ),
    ),
    Panel(
        "Height z", "mm",
        (
            PanelCurve("after the force loop", "shifted", series("controller.p_cmd_B", 2, MM)),
            PanelCurve("estimated", "belief", series("estimator.p_B", 2, MM)),
            PanelCurve("true", "truth", series("plant.p_B", 2, MM)),
            PanelCurve("pre-defined", "reference", series("controller.p_ref_B", 2, MM)),
            PanelCurve("surface", "display", surface_height),
        ),
    ),
    Panel(
        "Deviation from the pre-defined path, true", "mm",
        tuple(PanelCurve(letter, "truth", deviation(axis), axis) for axis, letter in enumerate("xyz")),
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
        "Spring deflection, motor side", "deg",
        (*_of_joints("true", "truth", lambda i: spring_deflection(i, f"drive/{i + 1}.theta_m", "plant.theta_l")),
         *_of_joints("measured", "belief",
                     lambda i: spring_deflection(i, "estimator.theta_m", "estimator.theta_l"), False)),
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
        (PanelCurve("largest share of any limit", "truth", series("monitor.utilisation")),),
    ),
)  # fmt: skip


def panels(runs: Iterable[PanelRun], shown: Sequence[Panel] | None = None) -> list[Panel]:
    """Return the plot panels that have data in any of the runs, out of `shown` or all panels."""
    runs = list(runs)
    asked = (*RUN_PANELS, *_own_panels(runs)) if shown is None else shown
    return [panel for panel in asked if _shows_something(panel, runs)]


def _own_panels(runs: Sequence[PanelRun]) -> list[Panel]:
    """Return plot panels of the drives' own signals beyond the contract: a panel per name, a curve per joint."""
    fields = {key: field for run in runs for key, field in run.fields.items() if key.startswith("drive/")}
    names = {
        field.name: field.unit for field in fields.values() if field.name not in CONTRACT_SIGNALS and field.size == 1
    }

    def read(name: str) -> Callable[[int], Reader]:
        return lambda joint: series(f"drive/{joint + 1}.{name}")

    return [Panel(f"Drives: {name}", unit, _of_joints("joint", "truth", read(name))) for name, unit in names.items()]


def _shows_something(panel: Panel, runs: Sequence[PanelRun]) -> bool:
    return any(
        samples is not None and np.any(np.isfinite(samples[1]))
        for quantity in panel.quantities
        for samples in map(quantity.read, runs)
    )


def curves(
    runs: Sequence[PanelRun], blocks: Sequence[DataBlock], shown: Sequence[Panel] | None = None
) -> tuple[list[dict[str, Any]], int]:
    """Return (panels with their curves, JSON-serialisable, thinning factor); the samples go into each run's block.

    A curve is [index of its first sample in the block, count, first time (s), time step (s)], or None if a run lacks
    it.
    """
    found = [
        (panel, [(quantity, [quantity.read(run) for run in runs]) for quantity in panel.quantities])
        for panel in panels(runs, shown)
    ]
    total = sum(len(one[0]) for _, rows in found for _, samples in rows for one in samples if one)
    factor = thinning_factor(total, MAX_SAMPLES)
    facts = [
        panel_facts(
            panel,
            [
                row_facts(quantity)
                | {
                    "shown": quantity.shown and (len(runs) == 1 or quantity.role in ("truth", "reference")),
                    "curves": [_curve(one, block, factor) for one, block in zip(samples, blocks, strict=True)],
                }
                for quantity, samples in rows
                if any(samples)
            ],
        )
        for panel, rows in found
    ]
    return facts, factor


def panel_facts(panel: Panel, rows: list[dict[str, Any]]) -> dict[str, Any]:
    return {"title": panel.title, "unit": "" if panel.unit == "1" else panel.unit, "rows": rows}


def row_facts(quantity: PanelCurve) -> dict[str, Any]:
    """Return a plotted quantity's label, role and visibility for the page, without its curves."""
    return {"label": quantity.label, "role": quantity.role, "member": quantity.member, "shown": quantity.shown}


def _curve(samples: Samples | None, block: DataBlock, factor: int) -> list[float] | None:
    if samples is None:
        return None
    t, values = samples
    step = float(t[-1] - t[0]) / max(1, len(t) - 1)
    return [*block.add(thin_samples(values, factor)), float(t[0]), step * factor]
