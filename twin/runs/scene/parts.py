"""What every part of the robot looks like: `/scene`, one `foxglove.SceneUpdate` with an entity in each frame.

Each entity is locked to its frame of `/tf` and stays for ever, so one message at t = 0 is enough: viewers take the last
one before the time they show. Sizes that the paper does not give (diameters, thicknesses) are for the eye only.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from numpy.typing import ArrayLike

from twin.plant.contact_law import Contact
from twin.robot.geometry import Geometry
from twin.robot.skeleton import OUTWARD
from twin.runs.scene.frames import BASE, HALF_WIDTH, LINKS, PHI, PLATFORM, RODS, SURFACE
from twin.runs.scene.rotation import IDENTITY, X, Y, Z, product, turn

# told apart by every kind of colour vision (Okabe and Ito, https://jfly.uni-koeln.de/color), and by lightness
GREY = Color(r=0.35, g=0.35, b=0.35, a=1.0)
BLUE = Color(r=0.0, g=114 / 255, b=178 / 255, a=1.0)
SKY = Color(r=86 / 255, g=180 / 255, b=233 / 255, a=1.0)
YELLOW = Color(r=240 / 255, g=228 / 255, b=66 / 255, a=1.0)
# seen through, so that the arrows of the force that go into it are not hidden
SURFACES = {
    "scale": Color(r=0.6, g=0.6, b=0.6, a=0.4),
    "skin": Color(r=204 / 255, g=121 / 255, b=167 / 255, a=0.4),
}

PLATE = 0.003
"""Thickness of base, platform and a flat surface (m)."""
SURFACE_EXTENT = 0.2
"""Length of a flat surface's sides and of a cylinder that is pressed on (m)."""
MOTOR, LINK, AXLE, ROD = 0.018, 0.009, 0.006, 0.004
"""Diameters (m)."""

# turns that lay a cylinder, whose axis is z, along another axis
ALONG_X, ALONG_Y = turn(Y, 0.5 * math.pi), turn(X, 0.5 * math.pi)


def scene_update(geometry: Geometry, contact: Contact) -> SceneUpdate:
    """All parts of the robot, and what it presses on."""
    links = [_link(name, geometry) for name in LINKS]
    rods = [_entity(name, cylinders=[_bar(geometry.l_b, ROD, SKY)]) for name in RODS]
    return SceneUpdate(entities=[_base(geometry), *links, *rods, _platform(geometry), _surface(contact)])


def pose(position: ArrayLike, q: Sequence[float] = IDENTITY) -> Pose:
    """Pose of a position (m, (3,)) and a quaternion (x, y, z, w)."""
    x, y, z = np.asarray(position)
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=q[0], y=q[1], z=q[2], w=q[3]))


def _entity(frame: str, **primitives: Any) -> SceneEntity:
    """What stands still in `frame`, for ever; its id is the frame's name."""
    return SceneEntity(frame_id=frame, id=frame, frame_locked=True, **primitives)


def _base(geometry: Geometry) -> SceneEntity:
    """A disc through the base joints, and a motor at each."""
    plate = _disc(geometry.a, 0.5 * PLATE, GREY)
    return _entity(BASE, cylinders=[plate, *_axles(geometry.a, MOTOR, GREY)])


def _link(name: str, geometry: Geometry) -> SceneEntity:
    """A proximal link, with the axle at A_i that carries both rods."""
    axle = _cylinder(AXLE, 2.0 * HALF_WIDTH, BLUE, pose((geometry.l_a, 0.0, 0.0), ALONG_Y))
    return _entity(name, cylinders=[_bar(geometry.l_a, LINK, BLUE), axle])


def _platform(geometry: Geometry) -> SceneEntity:
    """A disc that stands on O_P, the point that touches, and the three axles at P_i."""
    plate = _disc(geometry.b, 0.5 * PLATE, YELLOW)
    return _entity(PLATFORM, cylinders=[plate, *_axles(geometry.b, AXLE, YELLOW)])


def _surface(contact: Contact) -> SceneEntity:
    """What the robot presses on: a plate, a sphere or a cylinder below its apex."""
    color = SURFACES[contact.kind]
    if contact.radius is None:
        size = Vector3(x=SURFACE_EXTENT, y=SURFACE_EXTENT, z=PLATE)
        return _entity(SURFACE, cubes=[CubePrimitive(pose=pose((0.0, 0.0, -0.5 * PLATE)), size=size, color=color)])
    diameter, middle = 2.0 * contact.radius, (0.0, 0.0, -contact.radius)
    if contact.shape == "sphere":
        size = Vector3(x=diameter, y=diameter, z=diameter)
        return _entity(SURFACE, spheres=[SpherePrimitive(pose=pose(middle), size=size, color=color)])
    lying = pose(middle, ALONG_X if contact.shape == "cylinder_x" else ALONG_Y)
    return _entity(SURFACE, cylinders=[_cylinder(diameter, SURFACE_EXTENT, color, lying)])


def _axles(radius: float, diameter: float, color: Color) -> list[CylinderPrimitive]:
    """A cylinder along each leg's joint axis, as wide as a parallelogram, `radius` away from the frame's origin."""
    lying = [product(turn(Z, phi), ALONG_Y) for phi in PHI]
    return [_cylinder(diameter, 2.0 * HALF_WIDTH, color, pose(radius * OUTWARD[leg], lying[leg])) for leg in range(3)]


def _bar(length: float, diameter: float, color: Color) -> CylinderPrimitive:
    """A cylinder along x from the frame's origin on."""
    return _cylinder(diameter, length, color, pose((0.5 * length, 0.0, 0.0), ALONG_X))


def _disc(radius: float, height: float, color: Color) -> CylinderPrimitive:
    """A flat cylinder with its middle at `height` on z."""
    return _cylinder(2.0 * radius, PLATE, color, pose((0.0, 0.0, height)))


def _cylinder(diameter: float, length: float, color: Color, where: Pose) -> CylinderPrimitive:
    size = Vector3(x=diameter, y=diameter, z=length)
    return CylinderPrimitive(pose=where, size=size, bottom_scale=1.0, top_scale=1.0, color=color)
