"""Draws a recording from `/tf`, `/scene` and `/force` as a 3-D viewer does, with nothing of twin's.

    python -m examples.draw_recording run.mcap picture.png 3.0 6.5 17.5

draws the robot at these times (s). Needs the packages mcap, mcap-protobuf-support, scipy and matplotlib.
"""

import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

matplotlib.use("agg")
import matplotlib.pyplot as plt
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

Polygons = list[tuple[NDArray[np.float64], tuple[float, float, float, float]]]
TOPICS = ("/tf", "/scene", "/force")
# a cylinder and the cone of an arrow in so many flat sides
SIDES = 12
RING = np.stack([f(np.linspace(0.0, 2.0 * np.pi, SIDES + 1)) for f in (np.cos, np.sin)], axis=1) / 2.0
LIGHT = np.array([0.4, -0.5, 0.77])


def shown(path: Path, time: float) -> dict[str, Any]:
    """The last message of each of `TOPICS` up to `time` (s): what a viewer shows then."""
    latest = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(TOPICS, ending_at=round(time * 1e9)):
            latest[channel.topic] = message
    return latest


def moved(p: Any, q: Any, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """`points` (n, 3) of a frame at position `p` with quaternion `q`, in the frame around it."""
    return Rotation.from_quat([q.x, q.y, q.z, q.w]).apply(points) + np.array([p.x, p.y, p.z])


def barrel(bottom: float, top: float, low: float, high: float) -> list[NDArray[np.float64]]:
    """Sides and ends of a truncated cone along z between the heights `low` and `high`, of two diameters."""
    below, above = (np.column_stack([d * RING, np.full(len(RING), z)]) for d, z in ((bottom, low), (top, high)))
    sides = [np.array([below[i], below[i + 1], above[i + 1], above[i]]) for i in range(SIDES)]
    return [*sides, below, above]


def ball(diameter: float) -> list[NDArray[np.float64]]:
    """A sphere in flat patches."""
    turns, heights = np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13)
    grid = diameter / 2 * np.stack(
        [np.outer(np.cos(turns), np.sin(heights)), np.outer(np.sin(turns), np.sin(heights)),
         np.outer(np.ones(25), np.cos(heights))], axis=-1,
    )  # fmt: skip
    return [
        np.array([grid[i, j], grid[i + 1, j], grid[i + 1, j + 1], grid[i, j + 1]]) for i in range(24) for j in range(12)
    ]


def box(size: Any) -> list[NDArray[np.float64]]:
    """A cuboid's top and bottom, in tiles so that they sort by depth."""
    spans = list(pairwise(np.linspace(-0.5, 0.5, 9)))
    corners = [np.array([[a, c], [b, c], [b, d], [a, d]]) for a, b in spans for c, d in spans]
    scale = (size.x, size.y)
    return [np.column_stack([tile * scale, np.full(4, z * size.z)]) for tile in corners for z in (-0.5, 0.5)]


def solid(primitive: Any, polygons: list[NDArray[np.float64]]) -> Polygons:
    """`polygons` at the pose and in the colour of `primitive`, shaded."""
    color = primitive.color
    found = []
    for polygon in (moved(primitive.pose.position, primitive.pose.orientation, polygon) for polygon in polygons):
        normal = np.cross(polygon[1] - polygon[0], polygon[2] - polygon[1])
        shade = 0.65 + 0.35 * abs(normal @ LIGHT) / (np.linalg.norm(normal) or 1.0)
        found.append((polygon, (color.r * shade, color.g * shade, color.b * shade, color.a)))
    return found


def solids(entity: Any) -> Polygons:
    """All primitives of a `foxglove.SceneEntity`, in its frame."""
    found: Polygons = []
    for cylinder in entity.cylinders:
        size = cylinder.size
        found += solid(cylinder, barrel(size.x, size.x, -size.z / 2, size.z / 2))
    for sphere in entity.spheres:
        found += solid(sphere, ball(sphere.size.x))
    for cube in entity.cubes:
        found += solid(cube, box(cube.size))
    for arrow in entity.arrows:
        shaft, tip = arrow.shaft_length, arrow.shaft_length + arrow.head_length
        along_z = [
            *barrel(arrow.shaft_diameter, arrow.shaft_diameter, 0.0, shaft),
            *barrel(arrow.head_diameter, 0.0, shaft, tip),
        ]
        found += solid(arrow, [polygon[:, [2, 0, 1]] for polygon in along_z])
    return found


def picture(path: Path, time: float) -> Polygons:
    """Everything to be seen at `time` (s), in the base frame."""
    messages = shown(path, time)
    frames = {transform.child_frame_id: transform for transform in messages["/tf"].transforms}
    found: Polygons = []
    for entity in (*messages["/scene"].entities, *messages["/force"].entities):
        for polygon, color in solids(entity):
            frame = frames.get(entity.frame_id)
            in_base = polygon if frame is None else moved(frame.translation, frame.rotation, polygon)
            found.append((1e3 * in_base, color))
    return found


def main(recording: str, target: str, *times: str) -> None:
    figure = plt.figure(figsize=(4.2 * len(times), 4.6))
    for column, time in enumerate(map(float, times), start=1):
        axes = figure.add_subplot(1, len(times), column, projection="3d", proj_type="ortho")
        polygons, colors = zip(*picture(Path(recording), time), strict=True)
        axes.add_collection3d(Poly3DCollection(polygons, facecolors=colors, edgecolors="none"), autolim=False)
        axes.set(xlim=(-90, 90), ylim=(-90, 90), zlim=(-165, 15), xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)")
        axes.set(xticks=(-80, 0, 80), yticks=(-80, 0, 80), zticks=(-150, -100, -50, 0))
        axes.set_box_aspect((1, 1, 1), zoom=1.15)
        axes.view_init(elev=14, azim=-32)
        axes.set_title(f"{time:g} s")
    figure.tight_layout()
    figure.savefig(target, dpi=110, bbox_inches="tight", pad_inches=0.25)


if __name__ == "__main__":
    main(*sys.argv[1:])
