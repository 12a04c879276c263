"""A robot as Fig. 2 draws it, solved by search: loops closed by root finding, distances sampled, forces from energy.

It shares no formula with `twin.robot.mechanism`: knees and platform joints are points, and all else follows from the
distance between them.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from twin.robot.plant.dynamics import TrueRobot

Numbers = NDArray[np.float64]
AZIMUTHS = np.radians([-90.0, 30.0, 150.0])
"""Azimuths (rad) of the legs."""
ANGLES = np.radians(np.arange(-180.0, 181.0, 1.0))
"""Joint angles (rad) between which a loop is searched; positive lowers the knee."""
ITERATIONS = 4
"""Number of steps of the descent to an equilibrium."""
POINTS_PER_BAR = 41
"""Number of points by which the distance between two bars is sampled."""
GRAVITY = 9.81
STEP = 1e-5
"""Step of numerical derivatives (m)."""


class BruteRobot:
    """A robot solved by search.

    Args:
        plant: its lengths, masses, stops and sizes.
        home: a pose (3,) in m on its own side of all singularities.
    """

    def __init__(self, plant: TrueRobot, home: Numbers):
        self.plant = plant
        zero = np.zeros(3)
        self.out = np.column_stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS), zero])
        self.aside = np.column_stack([-np.sin(AZIMUTHS), np.cos(AZIMUTHS), zero])
        self.base = plant.a * self.out
        self.side = np.sign(np.linalg.det(self.rods(home, self.pose_angles(home))))

    def knee(self, leg: int, theta: Numbers | float) -> Numbers:
        """Return the knee (..., 3) in m at joint angles (...)."""
        down = np.multiply.outer(np.sin(theta), [0.0, 0.0, -1.0])
        return self.base[leg] + self.plant.l_a * (np.multiply.outer(np.cos(theta), self.out[leg]) + down)

    def platform_joints(self, p_B: Numbers) -> Numbers:
        """Return the three platform joints (3, 3) in m."""
        return p_B + self.plant.b * self.out

    def angles(self, p_B: Numbers) -> Numbers | None:
        """Return the joint angles (3,) with knees outward, by search over all angles; None if a loop stays open."""
        found = []
        for leg, joint in enumerate(self.platform_joints(p_B)):

            def gap(theta: Numbers | float, leg: int = leg, joint: Numbers = joint) -> Numbers:
                return np.linalg.norm(self.knee(leg, theta) - joint, axis=-1) - self.plant.l_b

            signs = np.sign(gap(ANGLES))
            roots = [
                brentq(gap, *ANGLES[[i, i + 1]], xtol=1e-15, rtol=1e-14)
                for i in np.flatnonzero(signs[:-1] * signs[1:] < 0.0)
            ]
            if not roots:
                return None
            # the outward knee is on the far side of the line from base joint to platform joint
            line = joint - self.base[leg]
            normal = np.array([-line[2] * self.out[leg, 0], -line[2] * self.out[leg, 1], line @ self.out[leg]])
            sides = [(self.knee(leg, theta) - self.base[leg]) @ normal for theta in roots]
            found.append(roots[int(np.argmax(sides))])
        return np.array(found)

    def rods(self, p_B: Numbers, theta: Numbers) -> Numbers:
        """Return the vectors (3, 3) from knee to platform joint in m."""
        return self.platform_joints(p_B) - np.array([self.knee(leg, theta[leg]) for leg in range(3)])

    def is_free(self, p_B: Numbers) -> bool:
        """Whether the robot reaches a pose, on the home side of singularities, within stops, and touches nothing."""
        theta, c = self.angles(p_B), self.plant
        if theta is None:
            return False
        assert c.ball_joint_limit is not None
        rods = self.rods(p_B, theta)
        if np.sign(np.linalg.det(rods)) != self.side:
            return False
        lower, upper = (-math.inf if c.joint_lower is None else c.joint_lower), c.joint_upper or math.inf
        if (theta < lower).any() or (theta > upper).any():
            return False
        sideways = np.abs(np.sum(rods * self.aside, axis=1)) / np.linalg.norm(rods, axis=1)
        if np.degrees(np.arcsin(sideways)).max() > math.degrees(c.ball_joint_limit):
            return False
        return self.clearance(p_B, theta) >= 0.0

    def clearance(self, p_B: Numbers, theta: Numbers) -> float:
        """Return the smallest distance (m) between bars of different legs, over points sampled along them."""
        c, joints, share = self.plant, self.platform_joints(p_B), np.linspace(0.0, 1.0, POINTS_PER_BAR)[:, None]
        assert c.rod_spacing is not None and c.link_diameter is not None and c.rod_diameter is not None
        points, radii = [], []
        for leg in range(3):
            knee, off = self.knee(leg, theta[leg]), 0.5 * c.rod_spacing * self.aside[leg]
            ends = [(self.base[leg], knee), (knee - off, joints[leg] - off), (knee + off, joints[leg] + off)]
            points.append([one + share * (other - one) for one, other in ends])
            radii.append([0.5 * c.link_diameter, 0.5 * c.rod_diameter, 0.5 * c.rod_diameter])
        apart = math.inf
        for one, other in ((0, 1), (0, 2), (1, 2)):
            for first, r in zip(points[one], radii[one], strict=True):
                for second, q in zip(points[other], radii[other], strict=True):
                    gaps = np.linalg.norm(first[:, None] - second[None], axis=-1)
                    apart = min(apart, float(gaps.min()) - r - q)
        return apart

    def angle_rates(self, p_B: Numbers) -> Numbers:
        """Return d theta_i / d p_j (3, 3) in rad/m, by differences."""
        columns = [
            (self.pose_angles(p_B + STEP * e) - self.pose_angles(p_B - STEP * e)) / (2.0 * STEP) for e in np.eye(3)
        ]
        return np.column_stack(columns)

    def height_energy(self, p_B: Numbers) -> float:
        """Return the potential energy (J) of links, uniform rods and platform."""
        theta, c = self.pose_angles(p_B), self.plant
        knees = np.array([self.knee(leg, theta[leg]) for leg in range(3)])
        joints = self.platform_joints(p_B)
        heights = c.m_a * 0.5 * knees[:, 2] + c.m_b * 0.5 * (knees[:, 2] + joints[:, 2])
        return GRAVITY * float(heights.sum() + c.m_p * p_B[2])

    def moving_mass(self, p_B: Numbers, way: Numbers) -> float:
        """Return twice the kinetic energy (J) at a platform velocity of 1 m/s along `way`, (3,)."""
        c, ends = self.plant, [self.pose_angles(p_B + s * STEP * way) for s in (1.0, -1.0)]
        mass = c.m_p
        for leg in range(3):
            rate = (ends[0][leg] - ends[1][leg]) / (2.0 * STEP)
            knee = (self.knee(leg, ends[0][leg]) - self.knee(leg, ends[1][leg])) / (2.0 * STEP)
            mass += (c.m_a * c.l_a**2 / 3.0 + c.I_r) * rate**2
            # a uniform rod: the mean of v^2 along it, v linear between its ends
            mass += c.m_b / 3.0 * float(knee @ knee + knee @ way + way @ way)
        return float(mass)

    def spring_energy(self, p_B: Numbers, rest: Numbers) -> float:
        """Return the energy (J) of the springs with the motors held where they are slack at angles `rest`."""
        c = self.plant
        return 0.5 * c.k_s * c.N**2 * c.eta * float(np.sum((self.pose_angles(p_B) - rest) ** 2))

    def deflected(self, p_B: Numbers, force: Numbers) -> Numbers:
        """Return the platform position under a force (N), motors held with slack springs at `p_B`, by descent."""
        rest, place = self.pose_angles(p_B), p_B.copy()
        stiffness = self._curvature(lambda p: self.spring_energy(p, rest), p_B)
        for _ in range(ITERATIONS):
            pull = np.array([self._slope(lambda p: self.spring_energy(p, rest), place, e) for e in np.eye(3)])
            place = place + np.linalg.solve(stiffness, force - pull)
        return place

    def pose_angles(self, p_B: Numbers) -> Numbers:
        theta = self.angles(p_B)
        assert theta is not None
        return theta

    @staticmethod
    def _slope(energy: Callable[[Numbers], float], p_B: Numbers, way: Numbers) -> float:
        return (energy(p_B + STEP * way) - energy(p_B - STEP * way)) / (2.0 * STEP)

    def _curvature(self, energy: Callable[[Numbers], float], p_B: Numbers) -> Numbers:
        columns = []
        for e in 10.0 * STEP * np.eye(3):
            columns.append([self._slope(energy, p_B + e, d) - self._slope(energy, p_B - e, d) for d in np.eye(3)])
        return np.array(columns).T / (20.0 * STEP)
