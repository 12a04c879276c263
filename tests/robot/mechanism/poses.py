"""The robot these tests look at and the poses hypothesis draws for it."""

import math

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from twin.robot.mechanism.geometry import LEG_COS, LEG_SIN, Geometry
from twin.robot.mechanism.kinematics import distal_length_range, distal_volume, jacobian
from twin.robot.mechanism.statics import Masses

# assumed, because the paper prints neither lengths nor masses
GEOMETRY = Geometry(a=0.050, b=0.030, l_a=0.060, l_b=0.1139)
MASSES = Masses(m_a=0.040, m_b=0.030, m_p=0.100, I_r=2e-5)
HOME = (0.0, 0.0, -0.105)

TURN = np.array([[-0.5, -math.sqrt(0.75), 0.0], [math.sqrt(0.75), -0.5, 0.0], [0.0, 0.0, 1.0]])
"""Rotation by +120 degrees about z: it carries leg 1 to leg 2, leg 2 to leg 3, leg 3 to leg 1."""

# in steps of 1e-3: numbers near the smallest float would only test underflow
triple = st.tuples(*[st.integers(-1000, 1000)] * 3).map(lambda whole: np.array(whole) / 1000.0)

working_poses = st.tuples(st.floats(-0.030, 0.030), st.floats(-0.030, 0.030), st.floats(-0.130, -0.085)).map(np.array)


def reach_margins(geometry: Geometry, p_B: ArrayLike) -> NDArray[np.float64]:
    """How much each distal link could change in length (m) before its leg cannot follow `p_B` (..., 3) m, (..., 3).

    Zero where D of Eq. 11 is zero, negative out of reach by the length that is missing.
    """
    shortest, longest = np.stack([distal_length_range(geometry, leg, np.array(p_B)) for leg in range(3)], axis=-1)
    return np.minimum(longest - geometry.l_b, geometry.l_b - shortest)


def height_range(geometry: Geometry, x: float, y: float) -> tuple[float, float]:
    """Lowest and highest height z <= 0 (m) over (x, y) (m) that all legs reach; the lowest above the highest: none.

    Leg i reaches where |sqrt(l_b^2 - w^2) - l_a| <= sqrt(u^2 + z^2) <= sqrt(l_b^2 - w^2) + l_a, which is Eq. 7 with A_i
    anywhere on its circle; the range is what the three legs share.
    """
    u = x * np.array(LEG_COS) + y * np.array(LEG_SIN) - (geometry.a - geometry.b)
    w = -x * np.array(LEG_SIN) + y * np.array(LEG_COS)
    if np.any(np.hypot(np.maximum(np.abs(u) - geometry.l_a, 0.0), w) > geometry.l_b):
        return 0.0, -1.0
    in_plane = np.sqrt(geometry.l_b**2 - w**2)
    lowest = -np.sqrt(np.maximum((in_plane + geometry.l_a) ** 2 - u**2, 0.0))
    highest = -np.sqrt(np.maximum((in_plane - geometry.l_a) ** 2 - u**2, 0.0))
    return float(lowest.max()), float(highest.min())


@st.composite
def reachable_poses(draw: st.DrawFn, smallest_volume: float = 0.05) -> NDArray[np.float64]:
    """Anywhere in the workspace on the home pose's side of the parallel singularity, shape (3,), in m."""
    x, y = draw(st.floats(-0.12, 0.12)), draw(st.floats(-0.12, 0.12))
    share = draw(st.floats(0.01, 0.99))
    lowest, highest = height_range(GEOMETRY, x, y)
    assume(lowest <= highest)
    p_B = np.array([x, y, lowest + share * (highest - lowest)])
    assume(p_B[2] < -1e-3)
    assume(distal_volume(jacobian(GEOMETRY, p_B)) < -smallest_volume)
    return p_B


@st.composite
def geometries(draw: st.DrawFn) -> Geometry:
    """Any robot with a platform no larger than its base and distal links that meet below outward arms."""
    a, l_a = draw(st.floats(0.02, 0.2)), draw(st.floats(0.02, 0.2))
    b = draw(st.floats(0.1, 1.0)) * a
    return Geometry(a, b, l_a, draw(st.floats(2.0, 4.0)) * (a - b + l_a))
