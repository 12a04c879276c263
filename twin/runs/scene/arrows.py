"""The force by the robot on what it presses on, as two arrows: `/force`, a `foxglove.SceneUpdate` per picture.

The true force F_ee_B starts at the point that touches, O_P; what the estimator believes of it, beside. An arrow is as
long as its force, to the scale of `LENGTH`, and its thickness grows with it: no force, no arrow. Pressing points down.
"""

import math

import numpy as np
from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from numpy.typing import NDArray

from twin.compiled.function import carray
from twin.compiled.native import entry
from twin.recording.form import BLANK_TIME, blank
from twin.runs.scene.frames import BASE, POSE, put_pose
from twin.runs.scene.parts import pose
from twin.runs.scene.rotation import pointing

LENGTH = 0.01
"""Of an arrow of 1 N (m)."""
BESIDE = 0.008
"""From the true force to the estimate along x (m), so that both are seen where they agree."""
# shares of an arrow's length: shaft, its diameter, head, its diameter
SHARES = (0.75, 0.06, 0.25, 0.13)
ARROWS = {
    "true": Color(r=213 / 255, g=94 / 255, b=0.0, a=1.0),
    "estimated": Color(r=0.0, g=158 / 255, b=115 / 255, a=1.0),
}
NUMBERS = POSE + len(SHARES)
"""Of one arrow: pose and sizes."""
WIDTH = NUMBERS * len(ARROWS)


def force_example() -> SceneUpdate:
    """Both arrows with blanks in the order of `arrows`."""
    entities = []
    for arrow, (name, color) in enumerate(ARROWS.items()):
        x, y, z, *q, shaft, shaft_width, head, head_width = (blank(NUMBERS * arrow + i) for i in range(NUMBERS))
        primitive = ArrowPrimitive(
            pose=pose((x, y, z), q),
            shaft_length=shaft,
            shaft_diameter=shaft_width,
            head_length=head,
            head_diameter=head_width,
            color=color,
        )
        entities.append(SceneEntity(timestamp=BLANK_TIME, frame_id=BASE, id=name, arrows=[primitive]))
    return SceneUpdate(entities=entities)


def arrows(
    p_B: NDArray[np.float64], F_ee_B: NDArray[np.float64], estimate_B: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Numbers for the blanks of `force_example`, (n, WIDTH).

    Args:
        p_B: true platform position in m, (n, 3).
        F_ee_B: true force by the robot on the environment in N, (n, 3).
        estimate_B: what the estimator takes it for, likewise.
    """
    found = np.empty((len(p_B), WIDTH))
    _put_arrows(*map(np.ascontiguousarray, (p_B, F_ee_B, estimate_B)), len(p_B), found)
    return found


@entry("nothing", "doubles", "doubles", "doubles", "int", "doubles")
def _put_arrows(p_B, F_ee_B, estimate_B, count, found):
    p, to = carray(p_B, (count, 3)), carray(found, count * WIDTH)
    true, estimate = carray(F_ee_B, (count, 3)), carray(estimate_B, (count, 3))
    at = 0
    for i in range(count):
        for aside, force in ((0.0, true[i]), (BESIDE, estimate[i])):
            x, y, z = force
            at = put_pose(to, at, p[i, 0] + aside, p[i, 1], p[i, 2], pointing(x, y, z))
            length = LENGTH * math.sqrt(x * x + y * y + z * z)
            for share in SHARES:
                to[at] = share * length
                at += 1
