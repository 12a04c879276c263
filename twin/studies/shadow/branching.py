"""A robot's system that is put where an estimate has the robot, and run ahead from there.

What six counts cannot tell comes from the past: the drives have followed the robot's commands and loads from the first
sample on, and hold inside what these leave there; the controller is the twin's own on the robot's counts. Plant and
encoders are put to the estimate. Where the estimate and the equations cannot both be right, this gives way:

    a motor's zero     the drive's shaft stands elsewhere, and zeros of encoders make a force where there is none: both
                       are slip of a belt, so that springs, weight and contact are in balance as the filter has them
    surface            it is where the force of first touch has it; deeper down it is as stiff as the force says
    bristle            the force along the surface is that of a bristle within the cone of friction

Left out are the monitor, faults, noise of the encoders, and what an energy tank has stored.
"""

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.compiled.function import carray
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import Component, NativeComponent
from twin.kernel.cosim.delay import play
from twin.kernel.cosim.port import by_port, memory_of, record, width
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedState, StatePlaces, SystemState, stateless
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.fmi.groups import AT_END
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.build import belief
from twin.robot.experiment.experiment import Experiment
from twin.robot.plant.component import Plant
from twin.robot.plant.contact import HELD, dot, surface_frame
from twin.robot.plant.contact_law import pressing_force
from twin.robot.plant.dynamics import PARAMETERS
from twin.studies.shadow.layout import FORCE, MOTOR, POSITION, TOUCHED, VELOCITY

HORIZON, SPACING = 1.0, 0.05
"""s ahead, and between two of the times that are looked at."""
LEADS = SPACING * np.arange(1, round(HORIZON / SPACING) + 1)
CLEAR = 1e-3
"""m. Higher than that over the believed surface the robot is in free air: heights of healthy robots differ by 0.5 mm,
and zeros of encoders by 0.05 deg are 0.2 mm."""
TELLING = 1.5
"""N. From there on the force says how stiff the surface is, below where it is."""
DEEPEST = 0.1
"""m."""
SOFTEST, HARDEST = 0.5, 2.0
"""A surface is within this of the believed stiffness; what is left of a force moves the surface."""
ENDLESS = 1 << 40
"""Ticks. A session has no end that an FMU could be given."""

_TOUCH = record(
    parameters=PARAMETERS, **dict.fromkeys(("p", "v", "F"), "3f8"), along=("f8", (2,)),
    **dict.fromkeys(("depth", "up", "pressing", "wanted", "law"), "f8"),
)  # fmt: skip
"""Position, velocity and force on the surface (SI, B); the force's parts along it; depth (m), z of the normal, force
into it (N), the depth at which the law has that force, and the law's force at this depth."""


SMOOTH = 0.05
"""s."""


@entry("nothing", _TOUCH)
def _look(m):
    depth, e_1, e_2, n = surface_frame(m.parameters, m.p[0], m.p[1], m.p[2])
    m.depth, m.up = depth, n[2]
    m.along[0], m.along[1] = dot(e_1, m.F[0], m.F[1], m.F[2]), dot(e_2, m.F[0], m.F[1], m.F[2])
    m.pressing = -dot(n, m.F[0], m.F[1], m.F[2])
    rate = -dot(n, m.v[0], m.v[1], m.v[2])
    m.law = pressing_force(m.parameters, depth, rate)
    low, high = 0.0, DEEPEST if m.pressing > 0.0 else 0.0
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        if pressing_force(m.parameters, middle, rate) < m.pressing:
            low = middle
        else:
            high = middle
    m.wanted = high


@entry("nothing", "doubles", "doubles", "int", "doubles", "doubles", "double")
def _drag(theta_l, h, count, smooth, anchors, presliding):
    """Move the `anchors` (3) of dry friction along `count` rows of three joint angles, one after the other (P14).

    Angles are made smooth first: what noise there is in an estimate would shake off what friction carries.
    """
    angles, steps, mean, held = carray(theta_l, 3 * count), carray(h, count), carray(smooth, 3), carray(anchors, 3)
    for k in range(count):
        share = 1.0 - math.exp(-steps[k] / SMOOTH)
        for leg in range(3):
            theta = angles[3 * k + leg]
            if theta == theta:
                mean[leg] = mean[leg] + share * (theta - mean[leg]) if mean[leg] == mean[leg] else theta
                start = held[leg] if held[leg] == held[leg] else mean[leg]
                held[leg] = min(max(start, mean[leg] - presliding), mean[leg] + presliding)


class Surroundings:
    """What the past has shown of the robot and what it presses on, beside its state.

    Springs read too much by zeros of encoders, each its own, and by what dry friction carries of the load; in free air
    both are all there is, and a robot that moves up and down tells one from the other. It is a least-squares fit with
    a prior: zeros as those of healthy robots are, friction about the middle of theirs.

    Args:
        spring: N m of a joint by rad of its zero.
        friction: of a joint, as far as it is known (N m); 0: not.

    Attributes:
        height: of the surface over the believed one (m); NaN: it was never touched.
        share: of the believed stiffness; NaN: not known.
        last: time of the newest sample (s); NaN: there was none.
        joints: smooth angles of the joints (3,), rad; NaN: not known.
        anchors: of their dry friction (3,), rad; likewise.
        carried: share of what dry friction can carry that it does (3,), positive against a joint that turns down.
    """

    def __init__(self, spring: float, friction: float):
        self.height = self.share = np.nan
        self.joints, self.anchors, self.carried = np.full(3, np.nan), np.full(3, np.nan), np.zeros(3)
        self.last = np.nan
        spread = np.array([spring * ZERO] * 3 + [FRICTION / 2.0]) / math.sqrt(3.0)
        self._prior, self._A, self._b = np.diag(spread**-2.0), np.zeros((4, 4)), np.zeros(4)
        self._before = self._prior @ [0.0, 0.0, 0.0, friction or FRICTION / 2.0]

    def add(self, torque: NDArray[np.float64]) -> None:
        """Torques (3,), N m, that springs read in free air."""
        rows = np.column_stack([np.eye(3), self.carried]) / UNSURE
        self._A = FORGET * self._A + rows.T @ rows
        self._b = FORGET * self._b + rows.T @ torque / UNSURE

    @property
    def zeros(self) -> NDArray[np.float64]:
        """Torques (3,), N m, that zeros of encoders look like; and of dry friction, one for all joints, last."""
        found: NDArray[np.float64] = np.linalg.solve(self._prior + self._A, self._before + self._b)
        found[3] = min(max(found[3], 0.0), MOST_FRICTION)
        return found

    def unsure(self, J: NDArray[np.float64]) -> float:
        """Deviation of the pressing force (N) by what is not known of zeros and friction; J: see `Present`."""
        reads = np.append(J[:, 2], J[:, 2] @ self.carried)
        return math.sqrt(float(reads @ np.linalg.solve(self._prior + self._A, reads)))

    @property
    def torque(self) -> NDArray[np.float64]:
        """What springs read too much now (3,), N m."""
        zeros = self.zeros
        return zeros[:3] + zeros[3] * self.carried


ZERO, FRICTION, MOST_FRICTION = math.radians(0.05), 0.02, 0.04
"""rad, N m. Zeros of encoders and dry friction of healthy robots lie within the first two."""
UNSURE, FORGET = 1e-2, 0.995
"""N m. Deviation of one look at the springs' torques in free air; and what a look leaves of those before."""


class Present(NamedTuple):
    """Where the robot is.

    Attributes:
        tick: of the branch's system.
        x: of the filter (15,).
        J: d theta_l / d p_B there (3, 3).
        omega_ref: commands that hold (3,), rad/s.
        law: what the controller holds, by the names of its pieces.
        drives: the state of the drives.
        shafts: what their outputs are.
        around: what the past has shown.
    """

    tick: int
    x: NDArray[np.float64]
    J: NDArray[np.float64]
    omega_ref: NDArray[np.float64]
    law: Mapping[str, NDArray]
    drives: SystemState
    shafts: Mapping[str, NDArray[np.float64]]
    around: Surroundings


class Otherwise(NamedTuple):
    """What is other in one branch than in the present.

    Attributes:
        dx: added to the state (15,).
        height: added to that of the surface (m), where the robot does not touch it.
        share: of its stiffness.
    """

    dx: NDArray[np.float64] = np.zeros(15)
    height: float = 0.0
    share: float = 1.0


class Branching:
    """The system of an experiment that is run ahead from wherever the robot is.

    Args:
        experiment: of the robot.
        where: begins a refusal.

    Attributes:
        tick, period: of the system (s), and of its controller (ticks).

    Raises:
        InputRefused: a part has no state, or is none that twin can put anywhere.
    """

    def __init__(self, experiment: Experiment, where: str = "ahead"):
        others = {role: part for role, part in experiment.stand_ins.items() if role not in ("monitor", "scale")}
        bare = replace(
            experiment, monitor=None, scale=None, faults=(), stand_ins=others, duration_ticks=ENDLESS
        )  # fmt: skip
        if others:
            raise InputRefused(f"{where}: {', '.join(others)} of others cannot be put where the robot's is")
        self._assembly = assemble(bare)
        try:
            system, made = self._assembly.system, self._assembly.made
            if lacking := stateless(system.components, portable=False):
                raise InputRefused(f"{where}: {'; '.join(lacking)}")
            self._drives = made["drive"]
            rest = [one for one in system.components if one not in self._drives]
            none = np.zeros(0)
            self._drive_places, self._places = StatePlaces(self._drives, none, none), StatePlaces(rest, none, none)
            self._plant, self._encoder = self._only("plant"), self._only("encoder")
            self.law = self._only("controller")
            self._as_made = [(one, one.memory.copy()) for one in (self._plant, self._encoder)]
            self._fresh = self._places.take(0)
            self.tick, self.period = system.tick, experiment.controller_ticks
            self._steps = round(SPACING / self.tick)
            self._simulation = Simulation(system, ENDLESS, len(LEADS) * self._steps + 1)
            self._columns = [system.columns("plant.F_ee_B").start + 2, system.columns("plant.p_B").start + 2]
        except BaseException:
            self._assembly.close()
            raise
        self._belief = belief(experiment)
        p = self._plant.memory["parameters"][0]
        self._touch = memory_of(_TOUCH, parameters=p)
        self._spring, self._z_s, self._K = float(p["k_s"] * p["N"] * p["eta"]), float(p["z_s"]), float(p["K"])
        self._slip, self._N, self._presliding = p["slip"].copy(), float(p["N"]), float(p["joint_presliding"])
        self._bristle, self._mu = float(p["sigma_0"]), float(p["mu"])
        self._at = 0
        self._shafts = {one.name: one.initial_outputs.copy() for one in self._drives}
        self._now = np.zeros(6)

    def _only(self, row: str) -> NativeComponent:
        (component,) = self._assembly.made[row]
        assert isinstance(component, NativeComponent)
        return component

    def close(self) -> None:
        """Free the FMUs."""
        self._fresh.close()
        self._assembly.close()

    def follow(self, t: NDArray[np.float64], omega_ref: NDArray[np.float64], tau_load: NDArray[np.float64]) -> int:
        """Step the drives as the robot's are, up to the last sample.

        Args:
            t: of samples (n,), s, later than those before.
            omega_ref: commands (n, 3), rad/s.
            tau_load: of the springs on the shafts (n, 3), N m.

        Returns:
            The tick that they have come to, one of those at which the controller is called.
        """
        end = max(self._at, self.period * round(float(t[-1]) / (self.period * self.tick)))
        values = np.vstack([self._now, np.hstack([omega_ref, tau_load])])
        self._now = values[-1]
        ticks = np.arange(self._at, end)
        if len(ticks):
            # a sample that is a little late is that of its tick
            held = values[np.searchsorted(t, (ticks + 0.25) * self.tick, side="right")]
            for number, drive in enumerate(self._drives):
                rows, status = play(
                    drive, ticks * self.tick, np.full(len(ticks), self.tick), self._inputs(drive, number, held),
                    np.array([len(ticks)]), self._shafts[drive.name],
                )  # fmt: skip
                if status:
                    raise ComponentFailed(f"{drive.label} ({drive.name}) {drive.explain(status)} at t = {t[-1]:.3f} s")
                self._shafts[drive.name] = rows[-1]
        self._at = end
        return end

    def _inputs(self, drive: Component, number: int, held: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of a drive at each tick: those of its joint, or of all three; it has power."""
        columns = []
        for port in drive.inputs:
            first = {"omega_ref": 0, "tau_load": 3}.get(port.name.removesuffix(AT_END))
            if first is None:
                columns.append(np.ones((len(held), port.size)))
            else:
                first += number if port.size == 1 else 0
                columns.append(held[:, first : first + port.size])
        return np.hstack(columns)

    @property
    def command(self) -> NDArray[np.float64]:
        """The newest one (3,), rad/s."""
        return self._now[:3]

    @property
    def call(self) -> float:
        """From one call of the controller to the next, s."""
        return self.period * self.tick

    @property
    def parameters(self) -> NDArray:
        """Of the plant, a record."""
        return self._as_made[0][1]["parameters"][0]

    def present(
        self, x: NDArray[np.float64], J: NDArray[np.float64], law: Component, around: Surroundings
    ) -> Present:
        """What a branch begins from, to be run now or later.

        Args:
            x, J, around: see `Present`.
            law: the controller, where the robot's is.
        """
        pieces = {name: array.copy() for name, array in law.pieces().items()}
        drives = self._drive_places.take(self._at)
        return Present(self._at, x, J, self.command.copy(), pieces, drives, dict(self._shafts), copy(around))

    def beginning(self, now: Present) -> NDArray[np.float64]:
        """Pressing force (N) and height (m) that a branch goes out from (2,)."""
        s_B, _ = self._surface(now.tick)
        seen = self._looked_at(now.x, now.J, now.around, s_B)
        return np.array([float(seen["pressing"]) if touches(seen) else 0.0, now.x[POSITION + 2]])

    def refuse_other_law(self, law: Component, where: str) -> None:
        """Raises InputRefused if this controller cannot go on from what `law` holds."""
        mine, theirs = ({name: a.shape for name, a in one.pieces().items()} for one in (self.law, law))
        if mine != theirs:
            raise InputRefused(f"{where}: the controller cannot be another one in mid-run")

    def run(self, now: Present, other: Otherwise = Otherwise()) -> NDArray[np.float64]:  # noqa: B008, it is a tuple
        """Pressing force (N) and height (m) at each of `LEADS` (leads, 2); NaN from where a component fails."""
        before = self._drive_places.take(now.tick)
        try:
            self._put(now, other)
            return self._ahead()
        finally:
            self._drive_places.put_back(before)
            before.close()

    def run_from(self, saved: SavedState) -> NDArray[np.float64]:
        """As `run`, from a state of the robot itself."""
        before = self._drive_places.take(saved.tick)
        try:
            for component, memory in self._as_made:
                component.memory[...] = memory
            self._simulation.adopt(saved)
            return self._ahead()
        finally:
            self._drive_places.put_back(before)
            before.close()

    def _ahead(self) -> NDArray[np.float64]:
        rows = self._simulation.advance()
        found = np.full((len(LEADS), 2), np.nan)
        there = rows[self._steps :: self._steps, self._columns]
        found[: len(there)] = there * (-1.0, 1.0)
        return found

    def _put(self, now: Present, other: Otherwise) -> None:
        self._places.put_back(self._fresh)
        self._drive_places.put_back(now.drives)
        for name, array in self.law.pieces().items():
            array[...] = now.law[name]
        x, outputs = now.x + other.dx, dict(now.shafts)
        s_B, outputs_of_body = self._surface(now.tick)
        outputs |= outputs_of_body
        p, v = x[POSITION : POSITION + 3], x[VELOCITY : VELOCITY + 3]
        theta_m, shaft = x[MOTOR : MOTOR + 3], self._angles(now.shafts)
        parameters = self._plant.memory["parameters"]
        z_s, K, z_b = self.contact(x, now, other, s_B)
        parameters["z_s"], parameters["K"], parameters["slip"] = z_s, K, self._slip
        state = np.concatenate([p, v, z_b])
        seen = state.copy()
        seen[:6] -= s_B
        F = by_port(self._plant.outputs, self._plant.put(seen, theta_m))["F_ee_B"]
        friction = float(now.around.zeros[3])
        too_much = np.linalg.solve(now.J.T, x[FORCE : FORCE + 3] - F) - friction * now.around.carried
        parameters["slip"] = self._slip + shaft - theta_m + too_much / self._spring
        parameters["joint_friction"] = friction
        outputs["plant"] = self._plant.put(state, shaft)
        theta_l = by_port(self._plant.outputs, outputs["plant"])["theta_l"]
        self._plant.memory["anchors"][0, :, HELD] = theta_l - self._presliding * now.around.carried
        encoder = self._encoder.memory
        for side, zero in (
            ("motor", theta_m - shaft + np.array(self._belief.motor_zero)), ("joint", np.array(self._belief.joint_zero))
        ):  # fmt: skip
            encoder[side]["zero"], encoder[side]["noise"], encoder[side]["eccentricity"] = zero, 0.0, 0.0
        values = {"theta_m": shaft, "theta_l": theta_l, "omega_ref": now.omega_ref}
        for row in ("latency", "delay", "bus"):
            for one in self._assembly.made[row]:
                outputs[one.name] = np.concatenate([values[port.name] for port in one.outputs])
                one.pieces()["ring"].reshape(-1, width(one.outputs))[:] = outputs[one.name]
        for row, port in (("controller", "omega_ref"), ("tank", "omega_ref")):
            for one in self._assembly.made[row]:
                outputs[one.name] = one.initial_outputs.copy()
                by_port(one.outputs, outputs[one.name])[port][:] = now.omega_ref
        self._simulation.place(now.tick, outputs)

    def _surface(self, tick: int) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
        """Displacement and velocity of a surface that moves, by the twin's clock (6,); and outputs of what moves it."""
        for body in self._assembly.made["body"]:
            rows, _ = play(body, np.array([tick * self.tick]), np.array([self.tick]), np.empty((1, 0)))
            return rows[0], {body.name: rows[0]}
        return np.zeros(6), {}

    def _angles(self, shafts: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        return np.concatenate([by_port(one.outputs, shafts[one.name])["theta_m"] for one in self._drives])

    def tare(self, J: NDArray[np.float64], around: Surroundings) -> NDArray[np.float64]:
        """Force (3,), N, that zeros of encoders and dry friction look like."""
        force: NDArray[np.float64] = J.T @ around.torque
        return force

    def _looked_at(
        self, x: NDArray[np.float64], J: NDArray[np.float64], around: Surroundings, s_B: NDArray[np.float64]
    ) -> NDArray:
        """The contact as the estimate has it, zeros of the encoders taken off; height and stiffness as they are known.

        Returns:
            A record of `_TOUCH`.
        """
        touch = self._touch
        touch["p"], touch["v"] = x[POSITION : POSITION + 3] - s_B[:3], x[VELOCITY : VELOCITY + 3] - s_B[3:]
        touch["F"] = x[FORCE : FORCE + 3] - self.tare(J, around)
        touch["parameters"]["z_s"] = self._z_s + (0.0 if np.isnan(around.height) else around.height)
        touch["parameters"]["K"] = self._K * (1.0 if np.isnan(around.share) else around.share)
        _look(touch)
        return touch[0]

    def contact(
        self, x: NDArray[np.float64], now: Present, other: Otherwise, s_B: NDArray[np.float64]
    ) -> tuple[float, float, NDArray[np.float64]]:
        """Height (m) and stiffness (N/m) of a surface that answers as the estimate has it, and its bristle (2,), m."""
        seen, around = self._looked_at(x, now.J, now.around, s_B), now.around
        parameters, nothing = self._touch["parameters"], np.zeros(2)
        if not touches(seen):
            height = float(parameters["z_s"][0]) + other.height
            # it is no higher than where the robot is without touching it
            free = max(0.0, float(seen["depth"]) + other.height * float(seen["up"]))
            return height - free / float(seen["up"]), float(parameters["K"][0]) * other.share, nothing
        if np.isfinite(around.height) and seen["pressing"] > TELLING and seen["law"] > 0.0:
            share = float(parameters["K"][0] * seen["pressing"] / seen["law"]) / self._K
            parameters["K"] = self._K * min(max(share, SOFTEST), HARDEST)
        parameters["K"] *= other.share
        _look(self._touch)
        height = float(parameters["z_s"][0] + (seen["wanted"] - seen["depth"]) / seen["up"])
        limit, along = self._mu * float(seen["pressing"]), np.array(seen["along"])
        size = float(np.hypot(*along))
        return height, float(parameters["K"][0]), along / self._bristle * (min(1.0, limit / size) if size else 1.0)

    def surroundings(self) -> Surroundings:
        """Of a robot that has just come."""
        return Surroundings(self._spring * (1.0 + self._N), float(self.parameters["joint_friction"]))

    def drag(self, t: NDArray[np.float64], theta_l: NDArray[np.float64], around: Surroundings) -> None:
        """Take note of how joints turn, by their angles (n, 3), rad, at `t` (n,), s."""
        h = np.diff(t, prepend=t[0] if np.isnan(around.last) else around.last)
        angles, around.joints, around.anchors = np.ascontiguousarray(theta_l), around.joints.copy(), around.anchors.copy()
        _drag(angles, h, len(angles), around.joints, around.anchors, self._presliding)
        around.last = float(t[-1])
        around.carried = np.nan_to_num((around.joints - around.anchors) / self._presliding)

    def learn(self, x: NDArray[np.float64], J: NDArray[np.float64], around: Surroundings) -> None:
        """Take from an estimate what it says of the surroundings, into `around`; arguments as of `Present`."""
        if not abs(x[VELOCITY + 2]) < SLOW:
            return
        seen = self._looked_at(x, J, around, self._surface(self._at)[0])
        if seen["depth"] < -CLEAR:
            around.add(np.linalg.solve(J.T, x[FORCE : FORCE + 3]))
        elif touches(seen) and seen["pressing"] < TELLING:
            height = float(seen["wanted"] - seen["depth"]) / float(seen["up"]) + np.nan_to_num(around.height)
            around.height = min(max(height, -CLEAR), CLEAR)
        elif touches(seen) and np.isfinite(around.height) and seen["law"] > 0.0:
            share = (1.0 if np.isnan(around.share) else around.share) * float(seen["pressing"] / seen["law"])
            around.share = min(max(share, SOFTEST), HARDEST)

    def settle(
        self, x: NDArray[np.float64], P: NDArray[np.float64], J: NDArray[np.float64], around: Surroundings
    ) -> None:
        """Put right, in place, an estimate of a robot in free air: however the filter explains a fast motion, there is
        no force but what zeros and friction look like. It is one more measurement.

        Args:
            P: of the filter (15, 15), SI.
            x, J, around: see `Present`.
        """
        if self._looked_at(x, J, around, self._surface(self._at)[0])["depth"] < -CLEAR:
            force = slice(FORCE, FORCE + 3)
            gain = np.linalg.solve(P[force, force] + IN_AIR * IN_AIR * np.eye(3), P[force]).T
            x += gain @ (self.tare(J, around) - x[force])
            P -= gain @ P[force]


SLOW = 0.02
"""m/s. Faster motions are explained by forces, too, that are none of the surface's."""
IN_AIR = 0.15
"""N. How much the force of a robot in free air differs from what zeros and friction look like."""


def touches(seen: NDArray) -> bool:
    """Whether the robot presses on the surface, and not on air by the zeros of its encoders."""
    return bool(seen["pressing"] > TOUCHED and seen["depth"] > -CLEAR)
