"""The right-hand side against Lagrange's equations, from energies written down body by body.

Nothing of the package's kinematics is used: the knee comes from the law of cosines, velocities of bodies and
derivatives of energies are central differences in 50 digits.
"""

import numpy as np
import pytest
from hypothesis import Phase, given
from mpmath import mp, mpf

from tests.conftest import examples
from tests.laws.runs import PARAMETERS
from tests.robot.mechanism.poses import HOME
from tests.robot.plant.kinetic import mass_matrix
from tests.robot.plant.states import moving
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.plant.component import NO_MOTION
from twin.robot.plant.contact import contact_force
from twin.robot.plant.dynamics import derivative

STEP = mpf(10) ** -12


def difference(f, step=STEP):
    """df/ds at s = 0; 1e-24 of truncation, three of them nested lose 36 of the 50 digits."""
    return (f(step) - f(-step)) / (2 * step)


def along(q, v, s):
    return [a + b * s for a, b in zip(q, v, strict=True)]


def unit(j):
    return [mpf(i == j) for i in range(3)]


def square(v):
    return sum(x * x for x in v)


def mean_square(v, w):
    """Of the speed along a uniform rod whose ends move at `v` and `w`: Simpson's rule is exact for a square."""
    middle = [(a + b) / 2 for a, b in zip(v, w, strict=True)]
    return (square(v) + 4 * square(middle) + square(w)) / 6


class Bodies:
    """The robot as bodies with masses; q and v are position (m) and velocity (m/s) of the platform."""

    def __init__(self, parameters, theta_m):
        self.c = parameters._replace(**{k: mpf(v) for k, v in parameters._asdict().items() if np.isscalar(v)})
        self.theta_m = [mpf(angle) for angle in theta_m]

    def angle(self, leg, q):
        """theta_l: direction from B_i down to P_i, less the angle at B_i of the triangle B_i A_i P_i in its plane."""
        phi = -mp.pi / 2 + 2 * mp.pi / 3 * leg
        r = q[0] * mp.cos(phi) + q[1] * mp.sin(phi) + self.c.b - self.c.a
        w = -q[0] * mp.sin(phi) + q[1] * mp.cos(phi)
        rho = mp.hypot(r, q[2])
        in_plane2 = self.c.l_b**2 - w**2
        return mp.atan2(-q[2], r) - mp.acos((self.c.l_a**2 + rho**2 - in_plane2) / (2 * self.c.l_a * rho))

    def knee(self, leg, q):
        """A_i in the leg's plane, (outward, up) from B_i."""
        theta = self.angle(leg, q)
        return self.c.l_a * mp.cos(theta), -self.c.l_a * mp.sin(theta)

    def joint_speed(self, leg, q, v):
        return difference(lambda s: self.angle(leg, along(q, v, s)))

    def knee_velocity(self, leg, q, v):
        """Of A_i in base frame B."""
        phi = -mp.pi / 2 + 2 * mp.pi / 3 * leg
        outward, up = (difference(lambda s, i=i: self.knee(leg, along(q, v, s))[i]) for i in (0, 1))
        return [outward * mp.cos(phi), outward * mp.sin(phi), up]

    def kinetic_energy(self, q, v):
        c = self.c
        energy = c.m_p * square(v) / 2
        for leg in range(3):
            knee = self.knee_velocity(leg, q, v)
            pulley = c.I_r * self.joint_speed(leg, q, v) ** 2
            energy += (c.m_b * mean_square(knee, v) + c.m_a * mean_square([0, 0, 0], knee) + pulley) / 2
        return energy

    def potential_energy(self, q):
        c, g = self.c, mpf(9.81)
        energy = c.m_p * g * q[2]
        for leg in range(3):
            height = self.knee(leg, q)[1]
            energy += g * (c.m_b / 2 * q[2] + c.m_b / 2 * height + c.m_a * height / 2)
            d = self.theta_m[leg] - c.N * self.angle(leg, q)
            energy += c.k_s * max(abs(d) - c.backlash, 0) ** 2 / 2
        return energy

    def dissipation(self, q, v):
        """Rayleigh's function of the joints' viscous friction."""
        return self.c.b_j / 2 * sum(self.joint_speed(leg, q, v) ** 2 for leg in range(3))

    def imbalance(self, q, v, acceleration):
        """d/dt dT/dv - dT/dq + dV/dq + dD/dv, (3,) N: the force from outside that this motion needs."""

        def momentum(j, s):
            q_s = [x + v_ * s + a * s * s / 2 for x, v_, a in zip(q, v, acceleration, strict=True)]
            v_s = along(v, acceleration, s)
            return difference(lambda e: self.kinetic_energy(q_s, along(v_s, unit(j), e)))

        return [
            difference(lambda s, j=j: momentum(j, s))
            - difference(lambda s, j=j: self.kinetic_energy(along(q, unit(j), s), v))
            + difference(lambda s, j=j: self.potential_energy(along(q, unit(j), s)))
            + difference(lambda s, j=j: self.dissipation(q, along(v, unit(j), s)))
            for j in range(3)
        ]


def lagrangian_acceleration(parameters, x, theta_m, force):
    """dv/dt (3,) under the outside `force` (3,): the imbalance is affine in the acceleration, M a + b."""
    with mp.workdps(50):
        bodies = Bodies(parameters, theta_m)
        q, v = [mpf(value) for value in x[:3]], [mpf(value) for value in x[3:6]]
        b = bodies.imbalance(q, v, [mpf(0)] * 3)
        columns = [bodies.imbalance(q, v, unit(j)) for j in range(3)]
        M = mp.matrix(3, 3)
        for i in range(3):
            for j in range(3):
                M[i, j] = columns[j][i] - b[i]
        rest = mp.matrix([mpf(f) - b_i for f, b_i in zip(force, b, strict=True)])
        return np.array([float(a) for a in mp.lu_solve(M, rest)])


def acceleration(parameters, x, theta_m):
    dx = np.empty(8)
    derivative(parameters, x, theta_m, NO_MOTION, NO_MOTION, dx)
    return dx[3:6]


# a random example finds a wrong term just as well as a hundred, and costs a tenth of a second; shrinking takes minutes
UNSHRUNK = examples(12, phases=[Phase.explicit, Phase.generate])


@pytest.mark.slow
@UNSHRUNK
@given(moving())
def test_acceleration_is_that_of_lagrange(state):
    x, theta_m = state
    on_robot = -np.array(contact_force(PARAMETERS, *x))
    expected = lagrangian_acceleration(PARAMETERS, x, theta_m, on_robot)
    # 1e-9 of the largest component: double precision, and a weight that nearly cancels the springs
    scale = max(np.abs(expected).max(), 1.0)
    assert acceleration(PARAMETERS, x, theta_m) == pytest.approx(expected, rel=0, abs=1e-9 * scale)


@pytest.mark.slow
@UNSHRUNK
@given(moving())
def test_acceleration_is_that_of_lagrange_for_another_robot(state):
    x, theta_m = state
    other = PARAMETERS._replace(
        a=0.055, b=0.028, l_a=0.065, l_b=0.118, m_a=0.3, m_b=0.2, m_p=0.05, I_r=3e-4, b_j=0.05, k_s=2.5, N=3.0, K=0.0
    )
    expected = lagrangian_acceleration(other, x, theta_m, (0.0, 0.0, 0.0))
    # as above; these springs are far from balance
    scale = max(np.abs(expected).max(), 1.0)
    assert acceleration(other, x, theta_m) == pytest.approx(expected, rel=0, abs=1e-9 * scale)


def test_the_masses_felt_at_home_and_what_half_masses_would_make_of_them():
    """Uniform rods; point masses at their ends make the robot 9.7 % too heavy sideways."""
    J = jacobian(Geometry(*PARAMETERS[:4]), HOME)
    M = mass_matrix(PARAMETERS, joint_angles(Geometry(*PARAMETERS[:4]), HOME), J)
    # values of another computation, given to 1e-6 kg
    np.testing.assert_allclose(M, np.diag([0.156424, 0.156424, 0.208148]), rtol=0, atol=1e-6)
    c = PARAMETERS
    half = (c.m_p + 1.5 * c.m_b) * np.eye(3) + ((c.m_a / 3 + c.m_b / 2) * c.l_a**2 + c.I_r) * J.T @ J
    assert half[0, 0] / M[0, 0] == pytest.approx(1.097, abs=5e-4)
