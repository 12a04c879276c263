"""The robot in MuJoCo: poses, and the equations of its bodies. What the engine makes of constraints is not used."""

import math
from typing import Any

import numpy as np

from twin.robot.plant.dynamics import PlantParameters
from validation.engine.bodies import UNIFORM, described
from validation.engine.constrained import Constrained, Numbers

RODS = 6
BOUND = 3 * RODS
FREE = slice(BOUND, BOUND + 3)
STRIDE = 0.01
"""By how much the platform is moved at once (m)."""
CLOSED = 2e-16
"""How far the ends of a rod may be from where they belong (m): the last bits of a position."""
ENOUGH = 1e-14
"""How far they may be after `ROUNDS` of Newton's method (m): where it cannot do better."""
ROUNDS = 12


class Unclosed(RuntimeError):
    """The loops of the robot cannot be closed at a pose."""


class Mechanism:
    """The robot at one pose at a time; to begin with its arms are at `initial_angle`, horizontal if possible.

    Args:
        parameters: of the robot; its springs, and what it presses on, are left out.
        rod: see `described`.

    Attributes:
        arms: which of the engine's speeds are those of the three joints.
        platform: which of them are the velocity of the platform.
    """

    def __init__(self, parameters: PlantParameters, rod: float = UNIFORM):
        import mujoco

        self._engine: Any = mujoco
        self._model: Any = mujoco.MjModel.from_xml_string(described(parameters, rod))
        self._data: Any = mujoco.MjData(self._model)
        model, n = self._model, self._model.nv
        self._rods, self._joints = ([model.site(f"{end}{i}").id for i in range(RODS)] for end in ("rod", "joint"))
        arms = [model.joint(f"arm{leg}") for leg in range(3)]
        self._angles, self.arms = [int(arm.qposadr[0]) for arm in arms], [int(arm.dofadr[0]) for arm in arms]
        place, speed = (int(found[0]) for found in (model.joint("platform").qposadr, model.joint("platform").dofadr))
        self._place, self.platform = slice(place, place + 3), slice(speed, speed + 3)
        self._bodies = model.site_bodyid.tolist()
        # the engine writes into these: velocities of sites per speed, their rates, angular velocities of the rods
        rows = (np.zeros((RODS, 3, n)) for _ in range(5))
        self._rod_rows, self._joint_rows, self._rod_rates, self._joint_rates, self._turns = rows
        self._rows, self._M, self._bias = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
        self._rows[FREE, self.platform] = np.eye(3)
        self._look()
        self._ahead()
        self._first = self._data.qpos.copy()

    @property
    def p_B(self) -> Numbers:
        """Where the platform is (m), (3,)."""
        return self._data.qpos[self._place].copy()

    @property
    def theta_l(self) -> Numbers:
        """The joint angles (rad), (3,)."""
        return self._data.qpos[self._angles]

    def restart(self) -> None:
        """Go back to the initial pose."""
        self._data.qpos[:] = self._first
        self._look()
        self._ahead()

    def move(self, p_B: Numbers) -> None:
        """Bring the platform to `p_B` (m), (3,), with no rod turning about its own axis.

        Raises:
            Unclosed: there are no joint angles.
        """
        start = self.p_B
        strides = math.ceil(float(np.linalg.norm(p_B - start)) / STRIDE)
        for i in range(1, strides + 1):
            self._close(start + (i / strides) * (p_B - start) if i < strides else p_B)

    def equations(self, v_B: Numbers) -> Constrained:
        """Of the robot where it is, while the platform moves at `v_B` (m/s), (3,), and no rod about its own axis."""
        engine, model, data = self._engine, self._model, self._data
        self._ahead()
        data.qvel[:] = self._inverse[:, FREE] @ v_B
        engine.mj_makeM(model, data)
        engine.mj_fullM(model, data, self._M)
        engine.mj_comVel(model, data)
        engine.mj_rne(model, data, 0, self._bias)
        engine.mj_passive(model, data)
        for sites, rates in ((self._joints, self._joint_rates), (self._rods, self._rod_rates)):
            for site, rate in zip(sites, rates, strict=True):
                engine.mj_jacDot(model, data, rate, None, data.site_xpos[site], self._bodies[site])
        drift = ((self._joint_rates - self._rod_rates) @ data.qvel).ravel()
        bias = self._bias - data.qfrc_passive
        return Constrained(self._M.copy(), bias, self._rows[:BOUND].copy(), drift, self._inverse.copy())

    @property
    def omega_l(self) -> Numbers:
        """Speeds of the joints (rad/s), (3,), at the velocity that `equations` was asked for."""
        return self._data.qvel[self.arms]

    def on_arms(self, tau: Numbers) -> Numbers:
        """Torques on the three joints (N m), (3,), as the engine's generalised forces."""
        forces = np.zeros(self._model.nv)
        forces[self.arms] = tau
        return forces

    def _close(self, p_B: Numbers) -> None:
        """Newton's method on what the engine says of where the rods end; with the rows it has while that is enough."""
        engine, model, data = self._engine, self._model, self._data
        wanted = np.zeros(model.nv)
        last = math.inf
        for _ in range(ROUNDS):
            wanted[:BOUND] = (data.site_xpos[self._rods] - data.site_xpos[self._joints]).ravel()
            wanted[FREE] = p_B - data.qpos[self._place]
            off = float(np.max(np.abs(wanted)))
            if off <= CLOSED:
                return
            if off > 1e-3 * last:
                self._ahead()
            last = off
            engine.mj_integratePos(model, data.qpos, self._inverse @ wanted, 1.0)
            self._look()
        if not off <= ENOUGH:
            raise Unclosed(f"off by {off:.1g} m at {1e3 * p_B} mm")

    def _look(self) -> None:
        """Where the bodies are at the coordinates of now."""
        self._engine.mj_kinematics(self._model, self._data)

    def _ahead(self) -> None:
        """How they move there."""
        engine, model, data = self._engine, self._model, self._data
        engine.mj_comPos(model, data)
        for i, (rod, joint) in enumerate(zip(self._rods, self._joints, strict=True)):
            engine.mj_jacSite(model, data, self._rod_rows[i], self._turns[i], rod)
            engine.mj_jacSite(model, data, self._joint_rows[i], None, joint)
        np.subtract(self._joint_rows.reshape(BOUND, -1), self._rod_rows.reshape(BOUND, -1), out=self._rows[:BOUND])
        axes = data.site_xmat[self._rods][:, 2::3]
        self._rows[BOUND + 3 :] = np.einsum("ij,ijk->ik", axes, self._turns)
        self._inverse = np.linalg.inv(self._rows)
