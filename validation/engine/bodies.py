"""The robot as a text that MuJoCo reads: real bodies, two rods to a parallelogram, ball joints, no loop closed yet."""

import math

from twin.robot.mechanism.geometry import LEG_COS, LEG_SIN
from twin.robot.mechanism.statics import G_ACCELERATION
from twin.robot.plant.dynamics import PlantParameters

HALF_WIDTH = 0.015
"""Half the distance of the two rods of a pair (m): assumed, and without effect while the platform does not turn."""
RADIUS = 0.002
"""Of a rod that is a thin tube (m): its inertia about its own axis, without effect because it spins freely."""
UNIFORM, DUMBBELL = 1.0 / 12.0, 1.0 / 4.0
"""Inertia of a rod about its middle per m l^2: uniform, and with half of its mass at either end."""
TURNING = 1e-4
"""Inertia of the platform (kg m2): without effect while it does not turn."""
CLOSING = 0.9
"""Maximum horizontal part of a distal rod in the initial pose, over its length."""


def initial_angle(parameters: PlantParameters) -> float:
    """Return the joint angle (rad) of the initial pose: 0, or lower by steps of 5 deg until the loops close easily.

    Raises:
        ValueError: the rods are too short for every angle.
    """
    c = parameters
    if abs(c.a + c.l_a - c.b) < c.l_b:
        return 0.0
    for degrees in range(5, 95, 5):
        if abs(c.a + c.l_a * math.cos(math.radians(degrees)) - c.b) < CLOSING * c.l_b:
            return math.radians(degrees)
    raise ValueError(f"rods of {1e3 * c.l_b:g} mm close no loop with the knees outward")


def described(parameters: PlantParameters, rod: float = UNIFORM) -> str:
    """Return the model of any robot in MJCF; it begins with its arms at `initial_angle` and all loops closed.

    The joints of the arms are `arm0`..`arm2`. The site `rod4` at the end of the fifth rod, the first one of the third
    leg, belongs where the site `joint4` of the platform is.

    Args:
        parameters: of the robot; what it presses on is left out.
        rod: inertia of a distal rod about its middle, per m l^2.
    """
    c, arms = parameters, initial_angle(parameters)
    reach = c.a + c.l_a * math.cos(arms) - c.b
    height = c.l_a * math.sin(arms) + math.sqrt(c.l_b**2 - reach**2)
    # inclination of the rods in the arm's frame, which is turned by `arms` itself
    tilt = math.asin(reach / c.l_b) - arms
    mass, across, along = c.m_b / 2.0, rod * c.m_b / 2.0 * c.l_b**2, c.m_b / 2.0 * RADIUS**2
    arm = c.m_a / 12.0 * c.l_a**2
    legs = joints = ""
    for leg in range(3):
        turn = math.atan2(LEG_SIN[leg], LEG_COS[leg])
        rods = ""
        for side, number in ((-HALF_WIDTH, 2 * leg), (HALF_WIDTH, 2 * leg + 1)):
            rods += f"""
      <body pos="{c.l_a!r} {side!r} 0" euler="0 {tilt!r} 0">
        <joint type="ball"/>
        <inertial pos="0 0 {-c.l_b / 2.0!r}" mass="{mass!r}" diaginertia="{across!r} {across!r} {along!r}"/>
        <site name="rod{number}" pos="0 0 {-c.l_b!r}"/>
      </body>"""
            x, y = (c.b * e + side * n for e, n in ((LEG_COS[leg], -LEG_SIN[leg]), (LEG_SIN[leg], LEG_COS[leg])))
            joints += f"""
      <site name="joint{number}" pos="{x!r} {y!r} 0"/>"""
        legs += f"""
    <body pos="{c.a * LEG_COS[leg]!r} {c.a * LEG_SIN[leg]!r} 0" euler="{turn!r} {arms!r} 0">
      <joint name="arm{leg}" type="hinge" axis="0 1 0" ref="{arms!r}" armature="{c.I_r!r}" damping="{c.b_j!r}"/>
      <inertial pos="{c.l_a / 2.0!r} 0 0" mass="{c.m_a!r}" diaginertia="{1e-3 * arm!r} {arm!r} {arm!r}"/>{rods}
    </body>"""
    return f"""<mujoco>
  <compiler angle="radian" eulerseq="zyx"/>
  <option gravity="0 0 {-G_ACCELERATION!r}"/>
  <worldbody>{legs}
    <body pos="0 0 {-height!r}">
      <freejoint name="platform"/>
      <inertial pos="0 0 0" mass="{c.m_p!r}" diaginertia="{TURNING!r} {TURNING!r} {TURNING!r}"/>{joints}
    </body>
  </worldbody>
</mujoco>
"""
