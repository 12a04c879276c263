"""Where every part of the robot is: a frame each, relative to the base frame B.

    link_i              origin B_i, x along the proximal link to A_i, y along the joint's axis
    rod_i_minus, _plus  origin at A_i, half the parallelogram's width to either side along the axis; x along the rod
                        to the platform. It turns about y with the link's joint and swings about its own z
    platform            origin O_P, axes those of B: the parallelograms keep it so (Sec. II.A)
    surface             origin at the surface's apex, z its normal there

All are the truth: joints of `twin.robot.skeleton`, the surface of `twin.plant.surface`.
"""

import numpy as np
from numpy.typing import NDArray

from twin.robot.geometry import Geometry
from twin.robot.skeleton import AXIS, OUTWARD, skeleton
from twin.runs.scene.rotation import IDENTITY, Z, leaning, product, turn

BASE = "base"
LEGS = (1, 2, 3)
LINKS = tuple(f"link_{leg}" for leg in LEGS)
RODS = tuple(f"rod_{leg}_{side}" for leg in LEGS for side in ("minus", "plus"))
PLATFORM = "platform"
SURFACE = "surface"
FRAMES = (*LINKS, *RODS, PLATFORM, SURFACE)
"""In the order of `poses`."""
HALF_WIDTH = 0.012
"""Of the parallelograms (m), for drawing only: it does not enter Eq. 3-6."""

# angle phi_i of each leg about z, and the two rods of a leg
PHI = np.arctan2(OUTWARD[:, 1], OUTWARD[:, 0])
SIDES = HALF_WIDTH * np.array([-1.0, 1.0])


def poses(
    geometry: Geometry, theta_l: NDArray[np.float64], p_B: NDArray[np.float64], surface_B: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Position (m) and unit quaternion (x, y, z, w) of each of `FRAMES` in B, (n, len(FRAMES), 7).

    Args:
        geometry: lengths of Fig. 2.
        theta_l: angles of the proximal links in rad, (n, 3).
        p_B: platform position in m, (n, 3).
        surface_B: pose of the surface, (n, 7).

    Raises:
        InputRefused: theta_l or p_B is not finite or not of shape (n, 3).
    """
    joints = skeleton(geometry, theta_l, p_B)
    found = np.empty((len(p_B), len(FRAMES), 7))
    # views of it, in the order of FRAMES: an axis is split without a copy
    links, rods = found[:, :3], found[:, 3:9].reshape(-1, 3, 2, 7)
    links[..., :3] = joints.B
    links[..., 3:] = leaning(PHI, theta_l)
    rods[..., :3] = joints.A[:, :, None] + SIDES[:, None] * AXIS[:, None, :]
    rods[..., 3:] = _rod_turns(joints.P - joints.A)[:, :, None]
    found[:, 9, :3], found[:, 9, 3:] = p_B, IDENTITY
    found[:, 10] = surface_B
    return found


def _rod_turns(rod: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions (n, 3, 4) that take e_x to the vectors A_iP_i, (n, 3, 3), and leave e_z in the plane of the link."""
    outward = np.sum(rod * OUTWARD, axis=-1)
    sideways = np.sum(rod * AXIS, axis=-1)
    swing = turn(Z, np.arctan2(sideways, np.hypot(outward, rod[..., 2])))
    return product(leaning(PHI, np.arctan2(-rod[..., 2], outward)), swing)
