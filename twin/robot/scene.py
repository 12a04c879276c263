"""Drawing of the robot: pose and shape of every part, and arrows of the force.

Each part has its own frame, relative to the base frame B:

    link_i              origin B_i, x along the proximal link to A_i, y along the joint's axis
    rod_i_minus, _plus  origin at A_i, half the parallelogram's width to either side along the axis; x along the rod
                        to the platform. It turns about y with the link's joint and swings about its own z
    platform            origin O_P, axes parallel to B, as the parallelograms keep it (Sec. II.A)
    surface             origin at the surface's apex, z its normal there

All poses are the truth: joints of `twin.robot.mechanism.geometry`, the surface of `twin.robot.plant.contact`.

Quaternions are unit tuples (x, y, z, w) with Hamilton's product; each turns vectors, not axes. The functions are
compiled; for a single drawing Python calls `py_func`, which avoids compilation.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from numpy.typing import ArrayLike, NDArray

from twin.kernel.compiled.function import carray, njit
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.system import System
from twin.kernel.recording.messages import BLANK_TIME, MessageForm, blank_value
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import AXIS, OUTWARD, Geometry, geometry_of, skeleton
from twin.robot.plant.contact_law import Contact

X, Y, Z = 0, 1, 2
IDENTITY_ROTATION = (0.0, 0.0, 0.0, 1.0)
BASE_FRAME = "base"
LEG_NUMBERS = (1, 2, 3)
LINK_FRAMES = tuple(f"link_{leg}" for leg in LEG_NUMBERS)
ROD_FRAMES = tuple(f"rod_{leg}_{side}" for leg in LEG_NUMBERS for side in ("minus", "plus"))
PLATFORM_FRAME = "platform"
SURFACE_FRAME = "surface"
SCENE_FRAMES = (*LINK_FRAMES, *ROD_FRAMES, PLATFORM_FRAME, SURFACE_FRAME)
"""All moving frames, in the order of `poses`."""
HALF_WIDTH = 0.012
"""Half the width of the parallelograms (m), for drawing only: it does not enter Eq. 3-6."""
POSE_SIZE = 7
"""Number of values of a position and a quaternion."""
# angle phi_i of each leg about z
PHI = np.arctan2(OUTWARD[:, 1], OUTWARD[:, 0])
# distinct by lightness and in every kind of colour vision (Okabe and Ito, https://jfly.uni-koeln.de/color)
GREY = Color(r=0.35, g=0.35, b=0.35, a=1.0)
BLUE = Color(r=0.0, g=114 / 255, b=178 / 255, a=1.0)
SKY_BLUE = Color(r=86 / 255, g=180 / 255, b=233 / 255, a=1.0)
YELLOW = Color(r=240 / 255, g=228 / 255, b=66 / 255, a=1.0)
# translucent, so that force arrows inside the surface are visible
SURFACE_COLORS = {
    "scale": Color(r=0.6, g=0.6, b=0.6, a=0.4),
    "skin": Color(r=204 / 255, g=121 / 255, b=167 / 255, a=0.4),
}
SECOND_ROBOT_COLOR = Color(r=213 / 255, g=94 / 255, b=0.0, a=0.35)
HULL_THICKNESS = 0.003
"""Excess thickness of the second robot (m), so that both are visible where they coincide."""
PLATE_THICKNESS = 0.003
"""Thickness of base, platform and a flat surface (m)."""
SURFACE_EXTENT = 0.2
"""Side length of a flat surface and length of a pressed cylinder (m)."""
MOTOR_DIAMETER, LINK_DIAMETER, AXLE_DIAMETER, ROD_DIAMETER = 0.018, 0.009, 0.006, 0.004
"""Diameters (m)."""
ARROW_LENGTH = 0.01
"""Length of an arrow of 1 N (m)."""
ESTIMATE_OFFSET = 0.008
"""Offset of the estimated from the true force along x (m), so that both are visible where they coincide."""
# shares of an arrow's length: shaft, its diameter, head, its diameter
ARROW_SHARES = (0.75, 0.06, 0.25, 0.13)
ARROW_COLORS = {
    "true": Color(r=213 / 255, g=94 / 255, b=0.0, a=1.0),
    "estimated": Color(r=0.0, g=158 / 255, b=115 / 255, a=1.0),
}
ARROW_SIZE = POSE_SIZE + len(ARROW_SHARES)
"""Number of values of one arrow: pose and sizes."""
ARROWS_WIDTH = ARROW_SIZE * len(ARROW_COLORS)
PICTURE_RATE = 50.0
"""Frame rate of the drawing (Hz)."""


@njit(cache=True)
def axis_rotation(axis, angle):
    """Return the quaternion of the right-handed turn by `angle` (rad) about the axis X, Y or Z."""
    sin, cos = math.sin(0.5 * angle), math.cos(0.5 * angle)
    return (sin if axis == X else 0.0, sin if axis == Y else 0.0, sin if axis == Z else 0.0, cos)


@njit(cache=True)
def product(p, q):
    """Return the quaternion of the turn `q` followed by the turn `p`, both about fixed axes."""
    p_x, p_y, p_z, p_w = p
    q_x, q_y, q_z, q_w = q
    return (
        p_w * q_x + p_x * q_w + p_y * q_z - p_z * q_y,
        p_w * q_y - p_x * q_z + p_y * q_w + p_z * q_x,
        p_w * q_z + p_x * q_y - p_y * q_x + p_z * q_w,
        p_w * q_w - p_x * q_x - p_y * q_y - p_z * q_z,
    )


@njit(cache=True)
def lean_rotation(azimuth, lowered):
    """Return the quaternion of the right-handed turn about y by `lowered`, then about z by `azimuth` (rad)."""
    return product(axis_rotation(Z, azimuth), axis_rotation(Y, lowered))


@njit(cache=True)
def direction_rotation(x, y, z):
    """Return the quaternion that turns e_x to (x, y, z), about y, then about z; identity for a zero vector."""
    # a positive turn about y lowers e_x
    return lean_rotation(math.atan2(y, x), math.atan2(-z, math.hypot(x, y)))


def poses(
    geometry: Geometry, theta_l: NDArray[np.float64], p_B: NDArray[np.float64], surface_B: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute position (m) and unit quaternion (x, y, z, w) of each part of the robot's drawing in frame B.

    Angles of the proximal links `theta_l` (rad) and platform position (m) are (n, 3), poses of the surface
    (n, POSE_SIZE).
    """
    joints = skeleton(geometry, theta_l, p_B)
    found = np.empty((len(p_B), len(SCENE_FRAMES), POSE_SIZE))
    _put_poses(*map(np.ascontiguousarray, (*joints, theta_l, p_B, surface_B)), len(p_B), found)
    return found


@njit(cache=True)
def put_pose(to, at, x, y, z, q):
    """Write a position and a quaternion into the array `to` from index `at` on; return the index after them."""
    to[at], to[at + 1], to[at + 2] = x, y, z
    to[at + 3], to[at + 4], to[at + 5], to[at + 6] = q
    return at + POSE_SIZE


@entry("nothing", "doubles", "doubles", "doubles", "doubles", "doubles", "doubles", "int", "doubles")
def _put_poses(base_joints, ends, platform_joints, theta_l, p_B, surface_B, count, found):
    B, to = carray(base_joints, (3, 3)), carray(found, count * len(SCENE_FRAMES) * POSE_SIZE)
    A, P = carray(ends, (count, 3, 3)), carray(platform_joints, (count, 3, 3))
    angle, p, surface = carray(theta_l, (count, 3)), carray(p_B, (count, 3)), carray(surface_B, (count, POSE_SIZE))
    at = 0
    for i in range(count):
        for leg in range(3):
            at = put_pose(to, at, B[leg, 0], B[leg, 1], B[leg, 2], lean_rotation(PHI[leg], angle[i, leg]))
        for leg in range(3):
            x, y, z = A[i, leg]
            q = _rod_rotation(leg, P[i, leg, 0] - x, P[i, leg, 1] - y, P[i, leg, 2] - z)
            for side in (-HALF_WIDTH, HALF_WIDTH):
                at = put_pose(to, at, x + side * AXIS[leg, 0], y + side * AXIS[leg, 1], z + side * AXIS[leg, 2], q)
        at = put_pose(to, at, p[i, 0], p[i, 1], p[i, 2], IDENTITY_ROTATION)
        for k in range(POSE_SIZE):
            to[at + k] = surface[i, k]
        at += POSE_SIZE


@njit(cache=True)
def _rod_rotation(leg, x, y, z):
    """Return the quaternion that turns e_x to the direction of a rod and leaves e_z in the plane of its link."""
    outward = x * OUTWARD[leg, 0] + y * OUTWARD[leg, 1]
    sideways = x * AXIS[leg, 0] + y * AXIS[leg, 1]
    swing = axis_rotation(Z, math.atan2(sideways, math.hypot(outward, z)))
    return product(lean_rotation(PHI[leg], math.atan2(-z, outward)), swing)


# turns that lay a cylinder, whose axis is z, along x and y
ALONG_X, ALONG_Y = axis_rotation(Y, 0.5 * math.pi), axis_rotation(X, 0.5 * math.pi)


def scene_update(geometry: Geometry, contact: Contact) -> SceneUpdate:
    """Build the 3D shapes of all parts of the robot and of the surface, as a Foxglove message."""
    links = [_link(name, geometry) for name in LINK_FRAMES]
    rods = [_entity(name, cylinders=[_bar(geometry.l_b, ROD_DIAMETER, SKY_BLUE)]) for name in ROD_FRAMES]
    return SceneUpdate(entities=[_base(geometry), *links, *rods, _platform(geometry), _surface(contact)])


def second_robot(beside: str, drawn: SceneUpdate) -> SceneUpdate:
    """Copy the robot's moving parts as a translucent hull, into frames whose names get the prefix `beside`."""
    found = SceneUpdate()
    for one in drawn.entities:
        if one.frame_id not in (BASE_FRAME, SURFACE_FRAME):
            one = found.entities.add(frame_id=f"{beside}{one.frame_id}", id=f"{beside}{one.id}", frame_locked=True,
                                     cylinders=one.cylinders)  # fmt: skip
            for cylinder in one.cylinders:
                size = cylinder.size
                size.x, size.y, size.z = size.x + HULL_THICKNESS, size.y + HULL_THICKNESS, size.z + HULL_THICKNESS
                cylinder.color.CopyFrom(SECOND_ROBOT_COLOR)
    return found


def pose(position: ArrayLike, q: Sequence[float] = IDENTITY_ROTATION) -> Pose:
    """Build a Foxglove pose from a position (m, (3,)) and a quaternion (x, y, z, w)."""
    x, y, z = np.asarray(position)
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=q[0], y=q[1], z=q[2], w=q[3]))


def _entity(frame: str, **primitives: Any) -> SceneEntity:
    """Build a Foxglove entity fixed in a frame, without expiry; its id is the frame's name."""
    return SceneEntity(frame_id=frame, id=frame, frame_locked=True, **primitives)


def _base(geometry: Geometry) -> SceneEntity:
    """Build the drawing of the robot's base: a disc through the base joints, and a motor at each."""
    plate = _disc(geometry.a, 0.5 * PLATE_THICKNESS, GREY)
    return _entity(BASE_FRAME, cylinders=[plate, *_axles(geometry.a, MOTOR_DIAMETER, GREY)])


def _link(name: str, geometry: Geometry) -> SceneEntity:
    """Build the drawing of a proximal link, with the axle at A_i that carries both rods."""
    axle = _cylinder(AXLE_DIAMETER, 2.0 * HALF_WIDTH, BLUE, pose((geometry.l_a, 0.0, 0.0), ALONG_Y))
    return _entity(name, cylinders=[_bar(geometry.l_a, LINK_DIAMETER, BLUE), axle])


def _platform(geometry: Geometry) -> SceneEntity:
    """Build the drawing of the platform: a disc on O_P, the contact point, and the three axles at P_i."""
    plate = _disc(geometry.b, 0.5 * PLATE_THICKNESS, YELLOW)
    return _entity(PLATFORM_FRAME, cylinders=[plate, *_axles(geometry.b, AXLE_DIAMETER, YELLOW)])


def _surface(contact: Contact) -> SceneEntity:
    """Build the drawing of the surface: a plate, or a sphere or cylinder below its apex."""
    color = SURFACE_COLORS[contact.kind]
    if contact.radius is None:
        size = Vector3(x=SURFACE_EXTENT, y=SURFACE_EXTENT, z=PLATE_THICKNESS)
        return _entity(
            SURFACE_FRAME, cubes=[CubePrimitive(pose=pose((0.0, 0.0, -0.5 * PLATE_THICKNESS)), size=size, color=color)]
        )
    diameter, middle = 2.0 * contact.radius, (0.0, 0.0, -contact.radius)
    if contact.shape == "sphere":
        size = Vector3(x=diameter, y=diameter, z=diameter)
        return _entity(SURFACE_FRAME, spheres=[SpherePrimitive(pose=pose(middle), size=size, color=color)])
    lying = pose(middle, ALONG_X if contact.shape == "cylinder_x" else ALONG_Y)
    return _entity(SURFACE_FRAME, cylinders=[_cylinder(diameter, SURFACE_EXTENT, color, lying)])


def _axles(radius: float, diameter: float, color: Color) -> list[CylinderPrimitive]:
    """Build three cylinders along the legs' joint axes, `radius` (m) away from the frame's origin."""
    lying = [product(axis_rotation(Z, phi), ALONG_Y) for phi in PHI]
    return [_cylinder(diameter, 2.0 * HALF_WIDTH, color, pose(radius * OUTWARD[leg], lying[leg])) for leg in range(3)]


def _bar(length: float, diameter: float, color: Color) -> CylinderPrimitive:
    """Build a cylinder along x that starts at the frame's origin."""
    return _cylinder(diameter, length, color, pose((0.5 * length, 0.0, 0.0), ALONG_X))


def _disc(radius: float, height: float, color: Color) -> CylinderPrimitive:
    """Build a flat cylinder centred on the z axis at `height`."""
    return _cylinder(2.0 * radius, PLATE_THICKNESS, color, pose((0.0, 0.0, height)))


def _cylinder(diameter: float, length: float, color: Color, where: Pose) -> CylinderPrimitive:
    size = Vector3(x=diameter, y=diameter, z=length)
    return CylinderPrimitive(pose=where, size=size, bottom_scale=1.0, top_scale=1.0, color=color)


def force_example() -> SceneUpdate:
    """Build the message with the force arrows of truth and estimate, whose numbers are filled in row by row."""
    entities = []
    for arrow, (name, color) in enumerate(ARROW_COLORS.items()):
        x, y, z, *q, shaft, shaft_width, head, head_width = (
            blank_value(ARROW_SIZE * arrow + i) for i in range(ARROW_SIZE)
        )
        primitive = ArrowPrimitive(
            pose=pose((x, y, z), q),
            shaft_length=shaft,
            shaft_diameter=shaft_width,
            head_length=head,
            head_diameter=head_width,
            color=color,
        )
        entities.append(SceneEntity(timestamp=BLANK_TIME, frame_id=BASE_FRAME, id=name, arrows=[primitive]))
    return SceneUpdate(entities=entities)


def arrows(
    p_B: NDArray[np.float64], F_ee_B: NDArray[np.float64], estimate_B: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the numbers of the force arrows' message for each row, (n, ARROWS_WIDTH).

    True platform position (m), true force by the robot on the environment and estimated force (N) are (n, 3).
    """
    found = np.empty((len(p_B), ARROWS_WIDTH))
    _put_arrows(*map(np.ascontiguousarray, (p_B, F_ee_B, estimate_B)), len(p_B), found)
    return found


@entry("nothing", "doubles", "doubles", "doubles", "int", "doubles")
def _put_arrows(p_B, F_ee_B, estimate_B, count, found):
    p, to = carray(p_B, (count, 3)), carray(found, count * ARROWS_WIDTH)
    true, estimate = carray(F_ee_B, (count, 3)), carray(estimate_B, (count, 3))
    at = 0
    for i in range(count):
        for aside, force in ((0.0, true[i]), (ESTIMATE_OFFSET, estimate[i])):
            x, y, z = force
            at = put_pose(to, at, p[i, 0] + aside, p[i, 1], p[i, 2], direction_rotation(x, y, z))
            length = ARROW_LENGTH * math.sqrt(x * x + y * y + z * z)
            for share in ARROW_SHARES:
                to[at] = share * length
                at += 1


class Drawing(NamedTuple):
    """Rows of one of the scene's drawings: form name, tick of the first row, values (n, width)."""

    name: str
    first_tick: int
    rows: NDArray[np.float64]


class Scene:
    """Converts the rows of a run to 3D drawings of the robot, with the message `forms` scene, tf and force."""

    def __init__(self, experiment: Experiment, system: System):
        """Prepare to draw the run of an experiment by a system with a plant and an estimator."""
        self._period, self._begins_at = max(1, round(1.0 / (PICTURE_RATE * system.tick))), 0
        self._geometry = geometry_of(experiment.plant)
        self._surface = surface_pose(experiment.contact)
        moves = any(component.name == "body" for component in system.components)
        self._s_B = system.columns("body.s_B") if moves else None
        self._theta_l, self._p_B = system.columns("plant.theta_l"), system.columns("plant.p_B")
        self._F_ee_B, self._estimate_B = system.columns("plant.F_ee_B"), system.columns("estimator.F_ee_B")
        self.forms = (
            MessageForm("scene", scene_update(self._geometry, experiment.contact), 0, experiment.duration_ticks + 1),
            MessageForm("tf", transforms_example(), POSE_SIZE * len(SCENE_FRAMES), self._period),
            MessageForm("force", force_example(), ARROWS_WIDTH, self._period),
        )

    def begin_at(self, tick: int) -> None:
        """Set the first tick of the drawings, at which static parts are drawn: 0, or the tick of a restored state."""
        self._begins_at = tick

    def drawings(self, first: int, rows: NDArray[np.float64]) -> Iterator[Drawing]:
        """Yield the 3D drawings due within `rows`, (n, outputs of the system), whose first row is tick `first`."""
        if first == self._begins_at:
            yield Drawing("scene", first, np.empty((1, 0)))
        start = -first % self._period
        shown = rows[start :: self._period]
        if len(shown):
            p_B = shown[:, self._p_B]
            surface = np.repeat(self._surface[None], len(shown), axis=0)
            if self._s_B is not None:
                surface[:, :3] += shown[:, self._s_B]
            frames = poses(self._geometry, shown[:, self._theta_l], p_B, surface)
            yield Drawing("tf", first + start, frames.reshape(len(shown), -1))
            yield Drawing("force", first + start, arrows(p_B, shown[:, self._F_ee_B], shown[:, self._estimate_B]))


def surface_pose(contact: Contact) -> NDArray[np.float64]:
    """Return position and quaternion of the surface at rest in B, (7,): its apex, R_y(tilt) R_x(tilt_x)."""
    q = product(axis_rotation(Y, contact.tilt), axis_rotation(X, contact.tilt_x))
    return np.concatenate([[0.0, 0.0, contact.height], q])


def transforms_example(beside: str = "") -> FrameTransforms:
    """Build the message of all parts' frames, with names prefixed by `beside`; numbers are filled in by row."""
    transforms = []
    for number, frame in enumerate(SCENE_FRAMES):
        x, y, z, *q = (blank_value(POSE_SIZE * number + i) for i in range(POSE_SIZE))
        where = pose((x, y, z), q)
        transforms.append(
            FrameTransform(
                timestamp=BLANK_TIME,
                parent_frame_id=BASE_FRAME,
                child_frame_id=f"{beside}{frame}",
                translation=where.position,
                rotation=where.orientation,
            )
        )
    return FrameTransforms(transforms=transforms)
