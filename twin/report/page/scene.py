"""What the player moves: the robot's joints, the surface, the force on it, 50 times a second."""

import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from twin.report.page.markup import DataBlock
from twin.report.page.run import ReportRun
from twin.robot.mechanism.geometry import AXIS, OUTWARD, Geometry, skeleton
from twin.robot.plant.contact import apex_frame
from twin.studies.metrics.response import Curve

RATE = 50.0
"""Poses a second; between them the player goes straight."""
MOST_FRAMES = 20_000
"""Of a long run fewer a second are kept."""
MM = 1e3
PATCH, LINES = 45.0, 10
"""Half the width of the surface that is drawn (mm), and into how many fields."""


def scene(run: ReportRun, block: DataBlock) -> dict[str, Any] | None:
    """A run for the player, mm and N; None if it does not say where the robot is. Poses go into `block`.

    `frames` says where they begin, each column of all n frames together: A (9), p_B (3), displacement of the surface
    (3), F_ee_B (3), F_ee_B estimated (3; absent without an estimator).
    """
    lengths = [run.values.get("plant", {}).get(f"{name}_mm") for name in Geometry._fields]
    if not run.has("plant.p_B", "plant.theta_l") or None in lengths:
        return None
    geometry = Geometry(*(length / MM for length in lengths))
    times = run.times["plant"]
    step = max(1.0 / RATE, float(times[-1] - times[0]) / MOST_FRAMES)
    t = times[0] + step * np.arange(int((times[-1] - times[0]) / step + 1e-6) + 1)
    p_B = run.held("plant.p_B", t)
    joints = skeleton(geometry, run.held("plant.theta_l", t), p_B)
    columns = [MM * joints.A.reshape(len(t), 9), MM * p_B, MM * _or_still(run, "body.s_B", t)]
    columns += [_or_still(run, "plant.F_ee_B", t)]
    estimated = run.has("estimator.F_ee_B")
    columns += [run.held("estimator.F_ee_B", t)] if estimated else []
    place, _ = block.add(np.column_stack(columns).T)
    return {
        "frames": {"at": place, "count": len(t), "start": float(t[0]), "step": step, "estimated": estimated},
        "B": (MM * joints.B).tolist(),
        "platform": (MM * geometry.b * OUTWARD).tolist(),
        "axis": AXIS.tolist(),
        "surface": surface(run.values["contact"]) if "contact" in run.values else None,
    }


def surface(contact: Mapping[str, Any]) -> list[list[list[float]]]:
    """Points of the untouched surface in B, (LINES + 1, LINES + 1, 3), mm, apex in the middle.

    Args:
        contact: the experiment's [contact]. Shapes and axes are those of `twin.robot.plant.contact`.
    """
    tilts = SimpleNamespace(**{name: math.radians(contact.get(f"{name}_deg", 0.0)) for name in ("tilt", "tilt_x")})
    e_1, e_2, n = (np.array(axis) for axis in apex_frame(tilts))
    shape, radius = contact.get("shape", "plane"), contact.get("radius_mm", math.inf)
    # round bodies are drawn to where they fall away by 45 degrees at most
    reach = np.linspace(-1.0, 1.0, LINES + 1) * min(PATCH, 0.5 * radius)
    w_1, w_2 = np.meshgrid(reach, reach, indexing="ij")
    across = {"sphere": w_1**2 + w_2**2, "cylinder_x": w_2**2, "cylinder_y": w_1**2}.get(shape)
    # R - sqrt(R^2 - w^2) without the cancellation that a large R would bring
    drop = 0.0 * w_1 if across is None else across / (radius + np.sqrt(radius * radius - across))
    points = w_1[..., None] * e_1 + w_2[..., None] * e_2 - drop[..., None] * n
    points[..., 2] += contact["height_mm"]
    return np.round(points, 4).tolist()


def _or_still(run: ReportRun, key: str, t: Curve) -> Curve:
    return run.held(key, t) if run.has(key) else np.zeros((len(t), 3))
