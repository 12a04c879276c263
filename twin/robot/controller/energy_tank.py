"""An energy tank behind the controller: the energy given to the environment comes from a store of known size.

The observer adds up F_ee.dp as the estimator feels it (Hannaford and Ryu 2002), at every force: below a threshold a
light stroke would get what it likes. That is the energy given, what moves, and what the joints' own friction takes; the
motion comes back when it ends. As long as something is touched, `bias` along the way of each joint is charged besides,
which is more than an error of the estimated torques can hide. What the springs hold of the force is as good as given,
for the body gets it if it yields. All of it is taken from the store. In other words the store pays for what the motors
put in, tau.omega/N with tau the joint torques of the force, and the body gets no more than that.

A valve then scales the commanded motor speeds so that the store lasts for another `horizon` T even against a wall,
where the force grows by the springs' stiffness:

    s P T + s^2 Q T^2/2 <= what is left,   P = tau.omega_ref/N,   Q = k_s eta |omega_ref|^2.

What the motors still do because they lag is taken off before. So the closer the store is to empty the slower the robot
presses on (tanks: Ferraguti, Secchi and Fantuzzi 2013).

Where more is gone than there was, and no share of the command brings it back in time, standing still is not enough: the
weight pulls the robot down through drives that yield to load. Then each motor gives way to its torque, by itself, and
further if the command asks for it; always in proportion, for full speed at each change of sign would swing. Each takes
energy back by that, tau_i omega_i <= 0. What the head has sunk is taken back, too. All three motors may turn up as fast
as they are commanded to, whatever is left: the body below gets no energy by that. The controller receives the share.
Energy that comes back fills the store, up to its size. While a message is late the energy that leaves is not known: the
motors stand still until the next one.
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
    Port("level", 1, "J", "what is in the tank"),
    Port("stored", 1, "J", "what the springs hold of the force on the environment, as believed"),
    Port("given", 1, "J", "energy given to what was touched, to motion and joints, less what came back, as believed"),
)
COASTING_SHARE = 1.0 / 3.0
"""Of the horizon: how long motors follow the command before."""
LARGEST_SAMPLE = 2.0**53
"""Beyond, a double does not count whole numbers."""
UNNUMBERED_STATUS = 2
"""Status of the step: a message has no number."""
RETURN_GAIN = 0.5
"""Over the horizon: gain (1/s) of each of the two loops by which an overdrawn tank moves the robot."""
JOINT_PLAY = 1e-3
"""Angle (rad) of a joint that counts as no way: rounding goes to and fro by less."""


class EnergyTank(Settings):
    """[controller.energy_tank]: a store of energy, out of which comes what the robot gives to what it touches."""

    size: float = setting("J", gt=0, examples=[0.15], help="energy that may go into what is touched")
    horizon: float = setting(
        "ms",
        default=100.0,
        gt=0,
        help="how long it has to last whatever happens: longer than delays and the drives' lag",
    )
    touch: float = setting("N", default=0.3, gt=0, help="estimated force from which on something is touched")
    release: float | None = optional(
        "s", gt=0, example=0.5, absent=math.inf, help="after so long without touch it is full again; without it never"
    )
    bias: float = setting(
        "N m",
        default=4e-3,
        ge=0,
        help="how far the estimated torque of a joint may be off: charged along its way while touched",
    )


class Tank(
    Values,
    parts=(
        setting_fields(EnergyTank),
        {"late": setting("s", help="how old the newest message of the encoders may be")},
        setting_fields(Model, "k_s", "N", "eta"),
    ),
):
    """The tank's settings and the series elastic joint as the controller believes it."""


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
    """Share of a command that uses no more than `left` (J) within `horizon` (s).

    Args:
        left: may be negative; then what gives most of it back.
        P: power of the whole command now (W).
        Q: what makes more power of it if the head is held (N m^2/(m s^2)).
    """
    if Q <= 0.0 or horizon * (P + 0.5 * Q * horizon) <= left:
        return 1.0
    root = P * P + 2.0 * Q * left
    most = (math.sqrt(root) - P if root > 0.0 else -P) / (Q * horizon)
    return min(max(most, 0.0), 1.0)


@njit(cache=True, error_model="numpy")
def _yield_to_torque(tank, tau, left, rise, J, omega_ref, passed):
    """More is gone than there was: every motor gives way to its torque, and by itself if no command does.

    Args:
        tau: joint torques (3,), N m. No motor gives way to what may be their error.
        left: < 0 (J). It is to come back within the horizon, if the loop of motor and spring is stable with that.
        rise: how far the head is below where it has been since (m).
        J: Jacobian (9,), rad/m.
        omega_ref: commanded (3,), rad/s.
        passed: to be commanded instead (3,), written.

    Returns:
        The share of the command that is left.
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
    """Speed (rad/s, <= 0) at which all motors are commanded to turn up, if none pulls at anything: what lies below gets
    nothing by that."""
    return min(max(omega_ref[0], omega_ref[1], omega_ref[2]), 0.0) if F[2] < touch else 0.0


@njit(cache=True)
def _joint_travel(turned, J, p, p_before):
    """Way of the joints (rad) from `p_before` to `p` (3,), m, less PLAY at each turn; `turned` (3,) keeps account."""
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
    # not >=: that would let NaN pass
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
    """Sampled component: commanded motor speeds in, those that the tank allows out.

    Args:
        tank: settings.
        period: in ticks.
    """

    def __init__(self, tank: Tank, period: int = 1):
        memory = memory_of(TANK_MEMORY, tank=tuple(tank), level=tank.size)
        # the controller knows of the call before, and before the first one nothing is held back
        first = np.zeros(width(TANK_OUTPUTS))
        by_port(TANK_OUTPUTS, first)["share"][:] = 1.0
        super().__init__("tank", TANK_INPUTS, TANK_OUTPUTS, True, tank_step, memory, first, period=period)

    def explain(self, status: int) -> str:
        return "got an encoder message without a number (NaN, infinite or beyond 2^53)"
