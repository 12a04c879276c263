"""Estimate of encoder zeros, dry friction and the touched surface from the past of a running robot.

Spring torques contain errors by encoder zeros, one for each joint, and dry friction. In free air nothing else loads the
springs, and up and down motion separates the two: a least-squares fit with the spread of healthy robots as prior. In
contact both are subtracted. The force at first touch gives the surface's height, larger forces its stiffness.
"""

import math
from copy import copy

import numpy as np
from numpy.typing import NDArray

from twin.kernel.compiled.function import carray
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.port import memory_of, record
from twin.robot.plant.contact import dot, surface_frame
from twin.robot.plant.contact_law import pressing_force
from twin.robot.plant.dynamics import PARAMETERS_RECORD
from twin.studies.shadow.layout import FORCE, POSITION, TOUCH_FORCE, VELOCITY

Numbers = NDArray[np.float64]
AIR_CLEARANCE = 1e-3
"""Minimum height over the surface for free air (m): surfaces differ by 0.5 mm, zeros of 0.05 deg by 0.2 mm."""
STIFFNESS_FORCE = 1.5
"""Force (N) above which it gives the stiffness of the surface, and below which its height."""
MAX_DEPTH = 0.1
"""m."""
MIN_STIFFNESS_SHARE, MAX_STIFFNESS_SHARE = 0.5, 2.0
"""Limits of the surface's stiffness relative to the believed one; a remaining difference moves the surface."""
SMOOTHING_TIME = 0.05
"""Time constant of the low-pass filter of joint angles (s); estimation noise would release dry friction."""
ENCODER_ZERO, JOINT_FRICTION, MAX_FRICTION = math.radians(0.05), 0.02, 0.04
"""rad, N m. Zeros of encoders and dry friction of healthy robots are within the first two."""
TORQUE_DEVIATION, FORGETTING_FACTOR = 1e-2, 0.995
"""Deviation of a torque measurement in free air (N m), and the weight that it leaves to earlier ones."""
MAX_LEARNING_SPEED = 0.02
"""Maximum vertical speed (m/s): the filter explains faster motions by forces that the surface does not exert."""
AIR_FORCE_DEVIATION = 0.15
"""Standard deviation of the force in free air from the effect of zeros and friction (N)."""

_TOUCH_RECORD = record(
    parameters=PARAMETERS_RECORD, **dict.fromkeys(("p", "v", "F"), "3f8"), along=("f8", (2,)),
    **dict.fromkeys(("depth", "up", "pressing", "wanted", "law"), "f8"),
)  # fmt: skip
"""Position, velocity and force on the surface (SI, B); the force's components along it; depth (m), z component of the
normal, normal force (N), depth required by the law for this force, and force of the law at this depth."""


@entry("nothing", _TOUCH_RECORD, at_once=True)
def _evaluate_contact(m):
    depth, e_1, e_2, n = surface_frame(m.parameters, m.p[0], m.p[1], m.p[2])
    m.depth, m.up = depth, n[2]
    m.along[0], m.along[1] = dot(e_1, m.F[0], m.F[1], m.F[2]), dot(e_2, m.F[0], m.F[1], m.F[2])
    m.pressing = -dot(n, m.F[0], m.F[1], m.F[2])
    rate = -dot(n, m.v[0], m.v[1], m.v[2])
    m.law = pressing_force(m.parameters, depth, rate)
    low, high = 0.0, MAX_DEPTH if m.pressing > 0.0 else 0.0
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        if pressing_force(m.parameters, middle, rate) < m.pressing:
            low = middle
        else:
            high = middle
    m.wanted = high


@entry("nothing", "doubles", "doubles", "int", "doubles", "doubles", "double", at_once=True)
def _drag(theta_l, h, count, smooth, anchors, presliding):
    """Move the `anchors` (3) of dry friction along `count` rows of joint angles (P14), filtered against noise."""
    angles, steps, mean, held = carray(theta_l, 3 * count), carray(h, count), carray(smooth, 3), carray(anchors, 3)
    for k in range(count):
        share = 1.0 - math.exp(-steps[k] / SMOOTHING_TIME)
        for leg in range(3):
            theta = angles[3 * k + leg]
            if theta == theta:
                mean[leg] = mean[leg] + share * (theta - mean[leg]) if mean[leg] == mean[leg] else theta
                start = held[leg] if held[leg] == held[leg] else mean[leg]
                held[leg] = min(max(start, mean[leg] - presliding), mean[leg] + presliding)


class ContactEstimate:
    """Running estimate of encoder zeros, dry friction and touched surface; see the module.

    Args:
        parameters: believed parameters of the plant, a record of `PARAMETERS_RECORD`.

    Attributes:
        height: height of the surface over the believed one (m); NaN before first touch.
        share: stiffness relative to the believed one; NaN if unknown.
        friction_share: dry friction of each joint by its maximum (3,), positive against downward rotation.
        zeros: apparent torques of the encoder zeros (3,), N m, then the dry friction of all joints.

    Methods take the filter's state x (15,), J = d theta_l / d p_B (3, 3), and displacement and velocity s_B of a moving
    surface (6,), SI.
    """

    def __init__(self, parameters: NDArray):
        p = parameters
        self.height = self.share = math.nan
        self.friction_share = np.zeros(3)
        self._joints, self._anchors, self._last = np.full(3, math.nan), np.full(3, math.nan), math.nan
        self._touch, self._z_s, self._K = memory_of(_TOUCH_RECORD, parameters=p), float(p["z_s"]), float(p["K"])
        self._presliding = float(p["joint_presliding"])
        zero = float(p["k_s"] * p["N"] * p["eta"] * (1.0 + p["N"])) * ENCODER_ZERO
        # uniform distributions
        variances = np.array([zero**2, zero**2, zero**2, (JOINT_FRICTION / 2.0) ** 2], dtype=np.float64) / 3.0
        self._prior: Numbers = np.diag(np.asarray(1.0 / variances, dtype=np.float64))
        self._A, self._b = np.zeros((4, 4)), np.zeros(4)
        friction = float(p["joint_friction"]) or JOINT_FRICTION / 2.0
        self._before: Numbers = self._prior @ [0.0, 0.0, 0.0, friction]
        self._solve_zeros()

    def snapshot(self) -> "ContactEstimate":
        found = copy(self)
        found._touch = self._touch.copy()
        return found

    def _solve_zeros(self) -> None:
        found = np.asarray(np.linalg.solve(self._prior + self._A, self._before + self._b), dtype=np.float64)
        found[3] = min(max(found[3], 0.0), MAX_FRICTION)
        self.zeros = found

    def tare(self, J: Numbers) -> Numbers:
        """Compute the apparent force (3,), N, caused by encoder zeros and dry friction."""
        return np.asarray(J.T @ (self.zeros[:3] + self.zeros[3] * self.friction_share))

    def force_deviation(self, J: Numbers) -> float:
        """Compute the standard deviation of the pressing force (N) due to encoder zeros and dry friction."""
        reads = np.append(J[:, 2], J[:, 2] @ self.friction_share)
        return math.sqrt(float(reads @ np.linalg.solve(self._prior + self._A, reads)))

    def drag(self, t: Numbers, theta_l: Numbers) -> None:
        """Update the dry friction of the joints with their angles (n, 3), rad, at `t` (n,), s."""
        h = t - np.concatenate([[t[0] if math.isnan(self._last) else self._last], t[:-1]])
        # new arrays, since copies of this object share the old ones
        joints, anchors, angles = self._joints.copy(), self._anchors.copy(), np.ascontiguousarray(theta_l)
        _drag(angles, h, len(angles), joints, anchors, self._presliding)
        self._joints, self._anchors, self._last = joints, anchors, float(t[-1])
        carried = (joints - anchors) / self._presliding
        self.friction_share = np.where(np.isnan(carried), 0.0, carried)

    def learn(self, x: Numbers, J: Numbers, s_B: Numbers) -> None:
        """Update encoder zeros, surface height or stiffness from an estimate of the robot's state."""
        if not abs(x[VELOCITY + 2]) < MAX_LEARNING_SPEED:
            return
        seen = self._contact_record(x, J, s_B)
        if seen["depth"] < -AIR_CLEARANCE:
            rows = np.column_stack([np.eye(3), self.friction_share]) / TORQUE_DEVIATION
            torques = np.linalg.solve(J.T, x[FORCE : FORCE + 3]) / TORQUE_DEVIATION
            self._A = FORGETTING_FACTOR * self._A + rows.T @ rows
            self._b = FORGETTING_FACTOR * self._b + rows.T @ torques
            self._solve_zeros()
        elif touches(seen) and seen["pressing"] < STIFFNESS_FORCE:
            height = float(seen["wanted"] - seen["depth"]) / float(seen["up"]) + _finite_or(self.height, 0.0)
            self.height = min(max(height, -AIR_CLEARANCE), AIR_CLEARANCE)
        elif touches(seen) and math.isfinite(self.height) and seen["law"] > 0.0:
            share = _finite_or(self.share, 1.0) * float(seen["pressing"] / seen["law"])
            self.share = min(max(share, MIN_STIFFNESS_SHARE), MAX_STIFFNESS_SHARE)

    def correct_in_air(self, x: Numbers, P: Numbers, J: Numbers, s_B: Numbers) -> None:
        """Correct an estimated state in free air in place: zeros and friction cause the only force, even if the filter
        infers another one from a fast motion.

        The correction is one more measurement; P: covariance of the filter (15, 15), SI.
        """
        if self._contact_record(x, J, s_B)["depth"] < -AIR_CLEARANCE:
            force = slice(FORCE, FORCE + 3)
            gain = np.linalg.solve(P[force, force] + AIR_FORCE_DEVIATION * AIR_FORCE_DEVIATION * np.eye(3), P[force]).T
            x += gain @ (self.tare(J) - x[force])
            P -= gain @ P[force]

    def pressing(self, x: Numbers, J: Numbers, s_B: Numbers) -> float:
        """Compute the force into the surface, N, from an estimate of the robot's state."""
        seen = self._contact_record(x, J, s_B)
        return float(seen["pressing"]) if touches(seen) else 0.0

    def contact(
        self, x: Numbers, J: Numbers, s_B: Numbers, higher: float, share: float
    ) -> tuple[float, float, Numbers]:
        """Compute height (m), stiffness (N/m) and bristle (2,), m, of a surface that exerts the estimated force.

        Args:
            higher: added to the height (m) unless the robot touches the surface.
            share: factor of the stiffness.
        """
        seen, p = self._contact_record(x, J, s_B), self._touch["parameters"][0]
        if not touches(seen):
            # a robot in the air is above the surface
            above = max(0.0, float(seen["depth"]) / float(seen["up"]) + higher)
            return float(p["z_s"]) + higher - above, float(p["K"]) * share, np.zeros(2)
        if math.isfinite(self.height) and seen["pressing"] > STIFFNESS_FORCE and seen["law"] > 0.0:
            felt = float(p["K"] * seen["pressing"] / seen["law"]) / self._K
            p["K"] = self._K * min(max(felt, MIN_STIFFNESS_SHARE), MAX_STIFFNESS_SHARE)
        p["K"] *= share
        _evaluate_contact(self._touch)
        height = float(p["z_s"]) + float(seen["wanted"] - seen["depth"]) / float(seen["up"])
        along, limit = np.array(seen["along"]), float(p["mu"] * seen["pressing"])
        size = float(np.hypot(*along))
        return height, float(p["K"]), along / float(p["sigma_0"]) * (min(1.0, limit / size) if size else 1.0)

    def _contact_record(self, x: Numbers, J: Numbers, s_B: Numbers) -> NDArray:
        """Compute the contact at an estimated state, without zeros and friction, as a record of `_TOUCH_RECORD`."""
        seen: NDArray = self._touch[0]
        seen["p"], seen["v"] = x[POSITION : POSITION + 3] - s_B[:3], x[VELOCITY : VELOCITY + 3] - s_B[3:]
        seen["F"] = x[FORCE : FORCE + 3] - self.tare(J)
        p = seen["parameters"]
        p["z_s"], p["K"] = self._z_s + _finite_or(self.height, 0.0), self._K * _finite_or(self.share, 1.0)
        _evaluate_contact(self._touch)
        return seen


def _finite_or(value: float, otherwise: float) -> float:
    return otherwise if math.isnan(value) else value


def touches(seen: NDArray) -> bool:
    """Check whether the robot presses on the surface; apparent forces by encoder zeros in air do not count."""
    return bool(seen["pressing"] > TOUCH_FORCE and seen["depth"] > -AIR_CLEARANCE)
