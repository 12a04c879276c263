"""Text and picture of a robot's capability."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.patches import Circle, Rectangle

from twin.kernel.serialise import to_dict
from twin.robot.assembly.checks.reach import free_poses
from twin.robot.assembly.own_robot import swing_notes
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import geometry_of, skeleton
from twin.robot.mechanism.kinematics import distal_volume, jacobian, joint_angles, transmission_sines
from twin.studies.figure import GREY, INK, JOINT_COLORS, MAP_STYLE, VERMILION, Axes, picture
from twin.studies.result import Block, Column, Note, Result, Table, note
from twin.studies.workspace.capability import Capability

MAP_POINTS = 161
AXIS_COLUMNS = (Column("", 30, left=True), Column("x", 9), Column("y", 9), Column("z", 9), Column("", gap=2, left=True))
RANK_COLUMNS = (Column("value", 36, left=True), Column("rms", 8, ".3f", "N"))


def capability_result(done: Capability, files: Mapping[str, str]) -> Result:
    z, (low, high) = 1e3 * done.pose[2], (1e3 * value for value in done.reach_z)
    rows = [
        ("stiffness of the springs", done.stiffness, 1.0, "N/m"),
        ("deflection under 1 N", 1.0 / done.stiffness, 1e3, "mm"),
        ("natural frequency on springs", done.natural_frequency, 1.0, "Hz"),
        ("smallest force, one joint count", done.smallest_force, 1.0, "N"),
        ("one count on all six encoders", done.count_force, 1.0, "N"),
        ("largest force of the drives", done.largest_force, 1.0, "N"),
        ("largest speed of the drives", done.largest_speed, 1e3, "mm/s"),
    ]
    drives = {one.label: one for one in done.drives}
    body: list[Block] = [
        note("reach", f"z = {low:.1f} to {high:.1f} mm on the axis"),
        note("cylinder", f"radius {1e3 * done.radius:.1f} mm, z = {1e3 * done.bottom:.1f} to {1e3 * done.top:.1f} mm"),
        note(
            "singular", f"serial {done.serial:.2f}, parallel {done.parallel:.2f} (0: singular, 1: farthest); in the "
            f"cylinder at least {done.least_serial:.2f} and {done.least_parallel:.2f}",
        ),
        "",
        Table(AXIS_COLUMNS, [(name, *(f"{f * v:.3g}" for v in values), unit) for name, values, f, unit in rows]),
        "",
        *(note("note", text) for text in swing_notes(done.natural_frequency)),
        note(
            "weight", f"{done.weight:.2f} N at the platform bends the springs by "
            f"{math.degrees(done.weight_deflection):.2f} deg (motor side); "
            f"with the motors held it lowers the platform by {1e3 * done.sag:.2f} mm",
        ),
        *(
            note("drive", f"{one.label}: stalls at {one.remark or f'{one.torque:.3g} N m'}, {one.speed:.3g} rad/s "
                 "without load")
            for one in drives.values()
        ),
        note("values", f"{done.own} of the robot's own; assumed are {len(done.assumed)}: {', '.join(done.assumed)}"),
        "",
        *([Table(RANK_COLUMNS, [(one.label, one.rms) for one in done.ranking])] if done.ranking else []),
        Note(f"values not ranked: {done.unranked}" if done.unranked else
             "what matters most for the force: error of the estimate if the value is off by this, or as it is", "  "),
    ]  # fmt: skip
    headline = f"{done.name}: at z = {z:g} mm it presses with up to {done.largest_force[2]:.3g} N"
    return Result(headline, body, to_dict(done) | {"files": [*files.values()]}, files)


def draw_capability(done: Capability, experiment: Experiment, path: Path) -> None:
    """Draw the robot in its free reach, from the side (x = 0) and from above at the working height, to `path` (PNG)."""
    plant = experiment.plant
    geometry, pose = geometry_of(plant), np.array([done.pose])
    size = max(1.2 * done.radius, geometry.a + geometry.l_a)
    low, high = done.reach_z[0] - 0.02, 0.02
    across, up = np.linspace(-size, size, MAP_POINTS), np.linspace(low, min(high, -1e-3), MAP_POINTS)
    joints = skeleton(geometry, joint_angles(geometry, pose), pose)
    with picture(path, 12, 6, f"{done.name}: free reach and distance from singularities", look=MAP_STYLE) as figure:
        side, above = figure.subplots(1, 2)
        Y, Z = np.meshgrid(across, up)
        shown = _draw_map(side, experiment, Y, Z, np.stack([0.0 * Y, Y, Z], axis=-1))
        X, Y = np.meshgrid(across, across)
        _draw_map(above, experiment, X, Y, np.stack([X, Y, 0.0 * X + done.pose[2]], axis=-1))
        figure.colorbar(shown, ax=[side, above], label="distance from singularities (0: singular)")
        for axes, (h, v) in ((side, (1, 2)), (above, (0, 1))):
            for leg, color in enumerate(JOINT_COLORS):
                line = 1e3 * np.array([joints.B[leg], joints.A[0, leg], joints.P[0, leg]])
                axes.plot(line[:, h], line[:, v], "o-", color=color, lw=2.0, ms=4, label=f"leg {leg + 1}")
            ring = 1e3 * joints.P[0, [0, 1, 2, 0]]
            axes.plot(ring[:, h], ring[:, v], color=INK, lw=2.0)
            axes.set_aspect("equal")
        r, bottom, top = 1e3 * done.radius, 1e3 * done.bottom, 1e3 * done.top
        side.add_patch(Rectangle((-r, bottom), 2.0 * r, top - bottom, fill=False, ec=VERMILION, lw=1.5))
        above.add_patch(Circle((0.0, 0.0), r, fill=False, ec=VERMILION, lw=1.5))
        side.axhline(1e3 * done.pose[2], color=GREY, lw=1.0, ls="--")
        side.set(xlabel="y (mm)", ylabel="z (mm)", title="from the side, x = 0; red: free cylinder, dashed: surface")
        above.set(xlabel="x (mm)", ylabel="y (mm)", title=f"from above, z = {1e3 * done.pose[2]:g} mm")
        above.legend(loc="upper right")


def _draw_map(axes: Axes, experiment: Experiment, h: np.ndarray, v: np.ndarray, p_B: np.ndarray):  # type: ignore[no-untyped-def]
    """Draw the distance from singularities over the free poses, and return the mapped colours."""
    poses = p_B.reshape(-1, 3)
    distance = np.full(len(poses), np.nan)
    free = free_poses(experiment.plant, poses)
    geometry = geometry_of(experiment.plant)
    J = jacobian(geometry, poses[free])
    distance[free] = np.minimum(transmission_sines(geometry, J).min(axis=-1), np.abs(distal_volume(J)))
    return axes.pcolormesh(1e3 * h, 1e3 * v, distance.reshape(h.shape), cmap="cividis", vmin=0.0, vmax=1.0)
