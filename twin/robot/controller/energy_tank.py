"""An energy tank behind the controller: energy for the environment comes from a store of known size.

The observer integrates the estimated F_ee.dp (Hannaford and Ryu 2002) at every force: below a threshold, a light stroke
would be unlimited. The sum contains the energy given to the body, kinetic energy, which returns when the motion ends,
and losses in the joints' friction. During contact, `bias` times the travel of each joint is charged in addition, an
upper bound for errors of the estimated torques. Energy of the force stored in the springs counts as given, as the body
receives it if it yields. All of this is taken from the store. Equivalently, the store pays for the work of the motors,
tau.omega/N with the joint torques tau of the force, and the body never receives more than that.

A valve then scales the commanded motor speeds by s, so that the store lasts for another `horizon` T even against a
wall, where the force grows by the springs' stiffness:

    s P T + s^2 Q T^2/2 <= remaining energy,   P = tau.omega_ref/N,   Q = k_s eta |omega_ref|^2.

Energy that lagging motors will still deliver is subtracted before. The emptier the store, the slower the robot presses
on (tanks: Ferraguti, Secchi and Fantuzzi 2013).

If the store is overdrawn, and no share of the command refills it in time, stopping is not enough: the weight pulls the
robot down through drives that yield to load. Then each motor yields to its torque, and further if the command asks for
it; always in proportion, as full speed at each change of sign would oscillate. Each motor takes energy back that way,
tau_i omega_i <= 0. The sinking of the head is also reversed. All three motors may always turn up at their commanded
speeds: the body below receives no energy from that. The controller receives the share.

Returned energy refills the store, up to its size. While an encoder message is late, the outgoing energy is unknown, and
the motors stop until the next one.
"""

import math

import numpy as np

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.component import NativeComponent, step_function
from twin.kernel.cosim.port import Port, by_port, memory_of, record, record_of, states, width
from twin.kernel.settings import Settings, Values, optional, setting, setting_fields
from twin.robot.controller.compliance import load_torques
from twin.robot.controller.controller import OMEGA_REF
from twin.robot.mechanism.geometry import Model

TANK_INPUTS = (
    OMEGA_REF,
    Port("p_B", 3, "m", "estimated platform position"),
    Port("J", 9, "rad/m", "Jacobian at the estimated position, row by row"),
    Port("F_ee_B", 3, "N", "estimated force by the robot on the environment"),
    Port("valid", 1, "1", "whether these follow from the newest counts", "bool"),
    Port("sample", 1, "1", "number of the encoders' newest message", "int"),
)
TANK_OUTPUTS = (
    Port("omega_ref", 3, "rad/s", "commanded motor speeds, as far as the tank allows them"),
    Port("share", 1, "1", "of the commanded speeds that is left"),
    Port("level", 1, "J", "energy in the tank"),
    Port("stored", 1, "J", "what the springs hold of the force on the environment, as believed"),
    Port("given", 1, "J", "believed energy given to the body, to motion and to joints, less the energy returned"),
)
COASTING_SHARE = 1.0 / 3.0
"""Time constant of motors that still follow previous commands, as a share of the horizon."""
LARGEST_SAMPLE = 2.0**53
"""Bound of the message counter: beyond it, a double does not represent every integer."""
UNNUMBERED_STATUS = 2
"""Step status for a message without a number."""
RETURN_GAIN = 0.5
"""Gain, times the horizon, of the two loops (1/s) that move the robot when the tank is overdrawn."""
JOINT_PLAY = 1e-3
"""Travel (rad) at each reversal of a joint that is not charged, as rounding causes smaller ones."""


class EnergyTank(Settings):
    """[controller.energy_tank]: a store of the energy that the robot gives to its environment."""

    size: float = setting("J", gt=0, examples=[0.15], help="energy that the touched body may receive")
    horizon: float = setting(
        "ms", default=100.0, gt=0, help="time for which the energy has to suffice; longer than delays and drives' lag"
    )
    touch: float = setting("N", default=0.3, gt=0, help="estimated force that counts as contact")
    release: float | None = optional(
        "s", gt=0, example=0.5, absent=math.inf, help="time without contact until it is refilled; without it, never"
    )
    bias: float = setting(
        "N m", default=4e-3, ge=0, help="bound of a joint's torque error, charged along its travel in contact"
    )


class Tank(
    Values,
    parts=(
        setting_fields(EnergyTank),
        {"late": setting("s", help="maximum age of the encoders' newest message")},
        setting_fields(Model, "k_s", "N", "eta"),
    ),
):
    """Parameters of the energy tank, and of the series elastic joint as the controller believes it."""


TANK_RECORD = record_of(Tank)
TANK_MEMORY = record(
    tank=TANK_RECORD,
    **states(
        level="f8", given="f8", p="3f8", F="3f8", sample="i8", age="f8", untouched="f8", tau="3f8", omega="3f8",
        turned="3f8", height="f8",
    ),
)  # fmt: skip


@njit(cache=True, error_model="numpy")
def passed_share(left, horizon, P, Q):
    """Return the share (0 .. 1) of a command that uses no more than the remaining energy within the horizon.

    Args:
        left: remaining energy; if negative, the result is the share that returns most of the deficit.
        P: power of the whole command now (W).
        Q: rate of increase of the power if the head is blocked (N m^2/(m s^2)).
    """
    if Q <= 0.0 or horizon * (P + 0.5 * Q * horizon) <= left:
        return 1.0
    root = P * P + 2.0 * Q * left
    most = (math.sqrt(root) - P if root > 0.0 else -P) / (Q * horizon)
    return min(max(most, 0.0), 1.0)


@njit(cache=True, error_model="numpy")
def _yield_to_torque(tank, tau, left, rise, J, omega_ref, passed):
    """Compute motor speeds that return energy when the tank is overdrawn; return the remaining share of the command.

    Every motor yields to its torque, even without a command.

    Args:
        tau: joint torques (3,), N m; motors do not yield to torques within the error `bias`.
        left: remaining energy, < 0 (J). It is returned within the horizon, as far as motor and spring stay stable.
        rise: height that the head has sunk since (m).
        J: Jacobian (9,), rad/m.
        omega_ref: commanded speeds (3,), rad/s.
        passed: speeds to pass on (3,), rad/s, written.
    """
    most = 1.0 / (tank.k_s * tank.N * tank.eta * tank.horizon)
    squares = 0.0
    for i in range(3):
        squares += max(abs(tau[i]) - tank.bias, 0.0) ** 2
    rate = RETURN_GAIN * most
    if -left * tank.N < rate * tank.horizon * squares:
        rate = -left * tank.N / (tank.horizon * squares)
    asked = granted = 0.0
    for i in range(3):
        by = max(abs(tau[i]) - tank.bias, 0.0)
        turned = min(abs(omega_ref[i]), most * by) if tau[i] * omega_ref[i] < 0.0 else 0.0
        asked, granted = asked + abs(omega_ref[i]), granted + turned
        passed[i] = tank.N * J[3 * i + 2] * RETURN_GAIN / tank.horizon * rise - math.copysign(
            max(rate * by, turned), tau[i]
        )
    return granted / asked if asked > 0.0 else 0.0


@njit(cache=True)
def _lift(omega_ref, F, touch):
    """Return a common upward motor speed (rad/s, <= 0) that is allowed with an overdrawn tank; 0 if none is allowed.

    It is allowed only while the environment is not pulled; the body below then receives no energy.
    """
    return min(max(omega_ref[0], omega_ref[1], omega_ref[2]), 0.0) if F[2] < touch else 0.0


@njit(cache=True)
def _joint_travel(turned, J, p, p_before):
    """Return the travel of all joints (rad) during a motion of the platform, less JOINT_PLAY at each reversal.

    The platform moves from `p_before` to `p` (3,), m. `turned` (3,) is the play taken up by each joint, updated in
    place.
    """
    way = 0.0
    for i in range(3):
        here = turned[i]
        for axis in range(3):
            here += J[3 * i + axis] * (p[axis] - p_before[axis])
        inside = min(max(here, -JOINT_PLAY), JOINT_PLAY)
        way += abs(here - inside)
        turned[i] = inside
    return way


@step_function(TANK_MEMORY, TANK_INPUTS, TANK_OUTPUTS)
def tank_step(m, t, h, u, y):
    tank = m.tank
    # not >=, which would accept NaN
    if not abs(u.sample) < LARGEST_SAMPLE:
        return UNNUMBERED_STATUS
    fresh = u.valid != 0.0 and u.sample != m.sample
    m.age = 0.0 if fresh else m.age + h
    if fresh:
        gone = unsure = 0.0
        if m.sample != 0:
            unsure = tank.bias * _joint_travel(m.turned, u.J, u.p_B, m.p)
            for i in range(3):
                gone += 0.5 * (m.F[i] + u.F_ee_B[i]) * (u.p_B[i] - m.p[i])
        m.sample = int(u.sample)
        for i in range(3):
            m.p[i], m.F[i] = u.p_B[i], u.F_ee_B[i]
        touched = m.F[0] * m.F[0] + m.F[1] * m.F[1] + m.F[2] * m.F[2] >= tank.touch * tank.touch
        m.untouched = 0.0 if touched else m.untouched + h
        m.given += gone
        m.level = min(m.level - gone, tank.size)
        if touched:
            m.level -= unsure
        elif m.untouched >= tank.release:
            m.level = tank.size
        m.tau[0], m.tau[1], m.tau[2] = load_torques(u.J, m.F[0], m.F[1], m.F[2])
    stored = power = force = power_on = force_on = 0.0
    for i in range(3):
        stored += 0.5 * m.tau[i] * m.tau[i] / (tank.k_s * tank.N * tank.N * tank.eta)
        power += m.tau[i] * u.omega_ref[i]
        force += tank.k_s * tank.eta * u.omega_ref[i] * u.omega_ref[i]
        power_on += m.tau[i] * m.omega[i]
        force_on += tank.k_s * tank.eta * m.omega[i] * m.omega[i]
    power, power_on = power / tank.N, power_on / tank.N
    on = COASTING_SHARE * tank.horizon
    coasting = max(0.0, power_on * on + 0.5 * force_on * on * on)
    left, fresh = m.level - stored - coasting, m.age <= tank.late
    m.height = max(m.height, m.p[2]) if left < 0.0 else m.p[2]
    lift, share = _lift(u.omega_ref, m.F, tank.touch), 0.0
    if fresh:
        share = passed_share(left, tank.horizon, power, force)
    for i in range(3):
        y.omega_ref[i] = share * u.omega_ref[i]
    if fresh and left < 0.0 and (power >= 0.0 or power * power + 2.0 * force * left <= 0.0):
        share = _yield_to_torque(tank, m.tau, left, m.height - m.p[2], u.J, u.omega_ref, y.omega_ref)
    if fresh and lift < 0.0:
        asked = granted = 0.0
        for i in range(3):
            y.omega_ref[i] = min(y.omega_ref[i], lift)
            asked, granted = asked - u.omega_ref[i], granted - max(y.omega_ref[i], u.omega_ref[i])
        share = max(share, granted / asked)
    for i in range(3):
        m.omega[i] += h / (on + h) * (y.omega_ref[i] - m.omega[i])
    y.share, y.level, y.stored, y.given = share, m.level, stored, m.given
    return 0


class TankValve(NativeComponent):
    """Sampled component of the energy tank: commanded motor speeds in, permitted speeds out; `period` in ticks."""

    def __init__(self, tank: Tank, period: int = 1):
        memory = memory_of(TANK_MEMORY, tank=tuple(tank), level=tank.size)
        # the controller reads the share of the previous call; before the first one it is 1
        first = np.zeros(width(TANK_OUTPUTS))
        by_port(TANK_OUTPUTS, first)["share"][:] = 1.0
        super().__init__("tank", TANK_INPUTS, TANK_OUTPUTS, True, tank_step, memory, first, period=period)

    def explain(self, status: int) -> str:
        return "got an encoder message without a number (NaN, infinite or beyond 2^53)"
