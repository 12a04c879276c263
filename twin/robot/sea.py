"""Series elastic actuator: motor, spring, belt, load (Fig. 3 A), Eq. 18-20.

The spring sits between motor and belt, so d = theta_m - N theta_l is its wind-up on the motor's side.
"""

import math

from twin.compiled.function import njit


@njit(cache=True)
def deflection(theta_m, theta_l, N):
    """Spring wind-up theta_s = theta_m - N theta_l in rad on the motor's side, Eq. 19."""
    return theta_m - N * theta_l


@njit(cache=True, forceinline=True)
def dead_zone(d, half_width):
    """Wind-up in rad left after backlash: 0 for |d| <= half_width, beyond that d reduced by half_width."""
    if d > half_width:
        return d - half_width
    if d < -half_width:
        return d + half_width
    # not 0.0: a wind-up that is not a number has to stay one
    return 0.0 * d


@njit(cache=True)
def motor_load_torque(k_s, d):
    """Torque in N m the spring asks of the motor shaft, tau_r = k_s d = tau_l / (N eta), Eq. 18."""
    return k_s * d


@njit(cache=True)
def load_torque(k_s, N, eta, d):
    """Torque in N m on the proximal link, tau_l = k_s N eta d, Eq. 20: the paper's constant efficiency."""
    return k_s * N * eta * d


@njit(cache=True)
def directed_load_torque(k_s, N, eta, d, thetadot_l, rate):
    """Torque in N m on the proximal link with losses in the direction of the power flow.

    A belt that loses power passes tau_l = N eta tau_r while the spring drives the load
    (tau_r thetadot_l > 0) and tau_l = N tau_r / eta while the load drives the spring; the constant eta of
    Eq. 18 and 20 would give power back in the second case. The factor is eta**s with
    s = sign(tau_r) tanh(thetadot_l / rate): it blends through 1 at rest and never creates power, because s
    has the sign of tau_r thetadot_l.

    Args:
        k_s: spring stiffness in N m/rad.
        N: belt ratio.
        eta: efficiency, 0 < eta <= 1.
        d: spring wind-up after backlash in rad.
        thetadot_l: speed of the proximal link in rad/s.
        rate: speed in rad/s over which the direction blends; 0.76 of the loss is reached at this speed.
    """
    tau_r = motor_load_torque(k_s, d)
    s = math.copysign(1.0, tau_r) * math.tanh(thetadot_l / rate)
    return N * tau_r * eta**s
