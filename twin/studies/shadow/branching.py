"""Simulation of a robot's system ahead from an estimated state.

Six counts do not determine every state; the past gives the rest. The drives have followed the robot's commands and
loads since the first sample and keep their internal states; the controller is the twin's own on the robot's counts.
Plant and encoders are set to the estimate, surface and dry friction to the `contact_estimate`. A belt slip compensates
for a drive shaft off the estimate, and for encoder zeros that load a spring: springs, weight and contact are in balance
as in the filter. Not simulated: the monitor, faults, encoder noise, and the energy stored in a tank.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from twin.kernel.compiled.function import carray
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import Component, NativeComponent, Pieces
from twin.kernel.cosim.delay import play
from twin.kernel.cosim.port import port_slices, width
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedState, StatePlaces, SystemState, stateless_reasons
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.fmi.groups import END_SUFFIX
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.build import belief
from twin.robot.experiment.experiment import Experiment
from twin.robot.plant.component import Plant
from twin.robot.plant.contact import JOINT_ANCHOR, surface_depth
from twin.robot.plant.dynamics import PARAMETERS_RECORD, PlantParameters
from twin.studies.shadow.contact_estimate import AIR_CLEARANCE, ContactEstimate
from twin.studies.shadow.layout import FORCE, MOTOR, POSITION, VELOCITY

PREDICTION_HORIZON, LEAD_SPACING = 1.0, 0.05
"""Length of a prediction, and spacing of its times (s)."""
MAX_FOLLOWED_GAP = 1.0
"""Maximum gap (s) over which the drives are stepped; longer gaps are skipped, and need no memory."""
LEAD_TIMES = np.linspace(LEAD_SPACING, PREDICTION_HORIZON, round(PREDICTION_HORIZON / LEAD_SPACING))
Native = TypeVar("Native", bound=NativeComponent)
ENDLESS_TICKS = 1 << 40
"""End of a session for FMUs (ticks); a session has no end."""


class RobotSnapshot(NamedTuple):
    """Snapshot of a robot's state, to run branches from.

    Attributes:
        tick: tick of the branch's system.
        x: state of the filter (15,).
        J: d theta_l / d p_B (3, 3).
        omega_ref: present commands (3,), rad/s.
        shafts: outputs of the drives by component name.
    """

    tick: int
    x: NDArray[np.float64]
    J: NDArray[np.float64]
    omega_ref: NDArray[np.float64]
    law: NDArray[np.uint8]
    drives: SystemState
    shafts: Mapping[str, NDArray[np.float64]]
    contact_estimate: ContactEstimate


class BranchChange(NamedTuple):
    """Change applied to the present state at the start of a branch.

    Attributes:
        dx: added to the state (15,).
        height: added to the height of the surface (m), unless the robot touches it.
        share: factor of the surface's stiffness.
    """

    dx: NDArray[np.float64] = np.zeros(15)
    height: float = 0.0
    share: float = 1.0


@entry("double", PARAMETERS_RECORD, "doubles", "int", at_once=True)
def _deepest(parameters, p, count):
    """Return the largest depth (m) of the head below the surface over `count` platform positions `p` (3 each)."""
    positions, most = carray(p, 3 * count), -math.inf
    for k in range(count):
        most = max(most, surface_depth(parameters, positions[3 * k], positions[3 * k + 1], positions[3 * k + 2]))
    return most


def _inputs(drive: Component, number: int) -> list[int]:
    """List the column of each input of a drive in (3 commands, 3 loads, 1): its joint's, all three, or 1 for power."""
    found: list[int] = []
    for port in drive.inputs:
        first = {"omega_ref": 0, "tau_load": 3}.get(port.name.removesuffix(END_SUFFIX), 6)
        own = number if port.size == 1 else 0
        found += [6] * port.size if first == 6 else range(first + own, first + own + port.size)
    return found


BranchRequest = tuple[list[NDArray[np.float64]], BranchChange]
"""List that receives the branch's rows, and the change of the branch."""


def _spring(p: NDArray) -> NDArray[np.float64]:
    """Compute the stiffness of each joint's spring, torque on the joint per motor angle (3,), N m/rad."""
    return np.asarray(p["k_s"] * p["k_s_share"] * p["N"] * p["eta"], dtype=np.float64)


class Branching:
    """System of an experiment, simulated ahead from any state, with tick (s) and controller period (ticks)."""

    def __init__(self, experiment: Experiment, where: str = ""):
        others = {role: part for role, part in experiment.stand_ins.items() if role not in ("monitor", "scale")}
        if others:
            raise InputRefused(f"{where}{', '.join(others)} of others cannot be put where the robot's is")
        bare = replace(experiment, monitor=None, scale=None, faults=(), stand_ins={}, duration_ticks=ENDLESS_TICKS)
        self._assembly = assemble(bare)
        try:
            system, made = self._assembly.system, self._assembly.components_by_row
            if lacking := stateless_reasons(system.components, portable=False):
                raise InputRefused(f"{where}{'; '.join(lacking)}")
            self._drives = made["drive"]
            rest = [one for one in system.components if one not in self._drives]
            none = np.zeros(0)
            self._drive_places, self._places = StatePlaces(self._drives, none, none), StatePlaces(rest, none, none)
            self._plant, self._encoder = self._only("plant", Plant), self._only("encoder", NativeComponent)
            self.law = self._only("controller", NativeComponent)
            self._law_pieces = Pieces(self.law.pieces().values())
            self._as_made = [(one, one.memory.copy()) for one in (self._plant, self._encoder)]
            self._fresh = self._places.save_state(0)
            self.tick, self.period = system.tick, experiment.controller_ticks
            self._steps = round(LEAD_SPACING / self.tick)
            self._simulation = Simulation(system, ENDLESS_TICKS, len(LEAD_TIMES) * self._steps + 1)
            self._columns = [system.columns(f"plant.{name}").start + 2 for name in ("F_ee_B", "p_B")]
        except BaseException:
            self._assembly.close()
            raise
        zeros, memory = belief(experiment), self._encoder.memory
        self._zeros = [(memory[side]["zero"], np.array(getattr(zeros, f"{side}_zero"))) for side in ("motor", "joint")]
        self._exact = [memory[side][name] for side in ("motor", "joint") for name in ("noise", "eccentricity")]
        self._angle_at = [(one.name, port_slices(one.outputs)["theta_m"]) for one in self._drives]
        self._plant_at = port_slices(self._plant.outputs)
        self._p_at = system.columns("plant.p_B")
        self._s_at = [system.columns(f"{one.name}.s_B") for one in made["body"]]
        p = self._plant.memory["parameters"][0]
        self._spring, self._slip = _spring(p), p["slip"].copy()
        self._presliding = float(p["joint_presliding"])
        self._at = 0
        self._inputs = [_inputs(drive, number) for number, drive in enumerate(self._drives)]
        self._shafts = {one.name: one.initial_outputs.copy() for one in self._drives}
        self._now = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        self._away: SystemState | None = None
        self._held: list[NDArray[np.float64]] = []
        self._skipped, self._last = 0.0, -math.inf

    def _only(self, row: str, kind: type[Native]) -> Native:
        (component,) = self._assembly.components_by_row[row]
        assert isinstance(component, kind)
        return component

    def close(self) -> None:
        for state in filter(None, (self._fresh, self._away)):
            state.close()
        self._assembly.close()

    def follow(self, t: NDArray[np.float64], omega_ref: NDArray[np.float64], tau_load: NDArray[np.float64]) -> None:
        """Buffer commands and loads of the drives up to the newest sample; `catch_up` steps the drives with them.

        Args:
            t: times of the samples (n,), s, ascending from call to call.
            omega_ref: commands (n, 3), rad/s.
            tau_load: loads of the springs on the shafts (n, 3), N m.
        """
        call = self.period * self.tick
        gaps = np.diff(t, prepend=max(self._at * self.tick + self._skipped, self._last))
        # over a long gap drives keep their state; nothing is stepped or stored
        skips = np.where(gaps > MAX_FOLLOWED_GAP, call * np.floor(gaps / call), 0.0)
        t = t - self._skipped - np.cumsum(skips)
        self._last = float(t[-1]) + self._skipped + float(np.sum(skips))
        self._skipped += float(np.sum(skips))
        values = np.ones((len(t) + 1, 7))
        values[0], values[1:, :3], values[1:, 3:6] = self._now, omega_ref, tau_load
        self._now = values[-1]
        end = max(self._at, self.period * round(float(t[-1]) / call))
        # a sample slightly after a tick counts for that tick
        due = (np.arange(self._at, end) + 0.25) * self.tick
        self._held.append(values[t.searchsorted(due, side="right")])
        self._at = end

    def catch_up(self) -> None:
        """Step the drives over the buffered commands and loads; raise `ComponentFailed` if a drive fails."""
        self._restore_drives()
        held = np.concatenate([*self._held, np.empty((0, 7))])
        self._held.clear()
        if not len(held):
            return
        starts = np.asarray(np.arange(self._at - len(held), self._at) * self.tick, dtype=np.float64)
        lengths, count = np.full(len(held), self.tick), np.array([len(held)])
        for drive, inputs in zip(self._drives, self._inputs, strict=True):
            rows, status = play(drive, starts, lengths, held[:, inputs], count, self._shafts[drive.name])
            if status:
                end = f"before t = {self._at * self.tick:.3f} s"
                raise ComponentFailed(f"{drive.label} ({drive.name}) {drive.explain(status)} {end}")
            self._shafts[drive.name] = rows[-1]

    @property
    def command(self) -> NDArray[np.float64]:
        """Newest command to the drives (3,), rad/s."""
        return self._now[:3]

    @property
    def parameters(self) -> NDArray:
        """Parameters of the simulated plant, a record."""
        return self._as_made[0][1]["parameters"][0]

    def accept(self, plant: PlantParameters) -> None:
        """Replace springs, slip and contact stiffness by the values of another plant."""
        for memory in (self._plant.memory, self._as_made[0][1]):
            for name in ("k_s_share", "slip", "K"):
                memory["parameters"][0][name] = getattr(plant, name)
        self._spring, self._slip = _spring(self.parameters), np.array(plant.slip)

    def present(
        self, x: NDArray[np.float64], J: NDArray[np.float64], law: NDArray[np.uint8], around: ContactEstimate
    ) -> RobotSnapshot:
        """Take a snapshot to run branches from; call `catch_up` first."""
        drives = self._drive_places.save_state(self._at)
        return RobotSnapshot(self._at, x, J, self.command.copy(), law, drives, dict(self._shafts), around.snapshot())

    def beginning(self, now: RobotSnapshot) -> NDArray[np.float64]:
        """Compute pressing force (N) and height (m) at the start of a branch (2,)."""
        return np.array([now.contact_estimate.pressing(now.x, now.J, self.surface(now.tick)[0]), now.x[POSITION + 2]])

    def refuse_other_law(self, law: Component, where: str) -> None:
        """Reject a controller whose state does not fit this system's controller; `where` begins the error message."""
        mine, theirs = ({name: a.shape for name, a in one.pieces().items()} for one in (self.law, law))
        if mine != theirs:
            raise InputRefused(f"{where}the controller cannot be another one in mid-run")

    def run(self, now: RobotSnapshot, other: BranchChange = BranchChange()) -> NDArray[np.float64]:  # noqa: B008, it is a tuple
        """Simulate a branch; return force (N) and height (m) at `LEAD_TIMES` (leads, 2), NaN after a failure."""
        self._set_state(now, other)
        return self._run_ahead()

    def run_from(self, saved: SavedState) -> NDArray[np.float64]:
        """Simulate ahead from a saved state of the robot itself; return force and height as `run`."""
        self._save_drives()
        for component, memory in self._as_made:
            component.memory[...] = memory
        self._simulation.adopt(saved)
        return self._run_ahead()

    def _save_drives(self) -> None:
        self._away = self._away or self._drive_places.save_state(self._at)

    def _restore_drives(self) -> None:
        if self._away:
            self._drive_places.restore_state(self._away)
            self._away.close()
            self._away = None

    def differing_branches(self, now: RobotSnapshot, wanted: Sequence[BranchRequest]) -> list[BranchRequest]:
        """Select the requested branches whose result differs from the unchanged branch, which must have been run last.

        While the robot presses, a changed height has no effect; while it stays clear of the surface, no change of the
        surface has.
        """
        presses, clear = self.beginning(now)[0] > 0.0, False
        if not presses:
            p = self._rows[:, self._p_at] - sum(self._rows[:, place] for place in self._s_at)
            # changed heights differ by less
            clear = _deepest(self._plant.memory["parameters"], p, len(p)) < -AIR_CLEARANCE
        return [one for one in wanted if np.any(one[1].dx) or (not clear and (one[1].share != 1.0 or not presses))]

    def _run_ahead(self) -> NDArray[np.float64]:
        """Simulate ahead from the present state of the system; return force and height as `run`."""
        self._rows = rows = self._simulation.advance()
        found = np.full((len(LEAD_TIMES), 2), np.nan)
        there = rows[self._steps :: self._steps, self._columns]
        found[: len(there)] = there * (-1.0, 1.0)
        return found

    def _set_state(self, now: RobotSnapshot, other: BranchChange) -> None:
        self._save_drives()
        self._places.restore_state(self._fresh)
        self._drive_places.restore_state(now.drives)
        self._law_pieces.restore(now.law)
        x, J, around, outputs = now.x + other.dx, now.J, now.contact_estimate, dict(now.shafts)
        s_B, outputs_of_body = self.surface(now.tick)
        outputs |= outputs_of_body
        theta_m = x[MOTOR : MOTOR + 3]
        shaft = np.concatenate([now.shafts[name][place] for name, place in self._angle_at])
        parameters, anchors = self._plant.memory["parameters"], self._plant.memory["anchors"]
        z_s, K, z_b = around.contact(x, J, s_B, other.height, other.share)
        parameters["z_s"], parameters["K"], parameters["slip"] = z_s, K, self._slip
        state = np.concatenate([x[: VELOCITY + 3], z_b])
        seen = state.copy()
        seen[:6] -= s_B
        F = self._plant.set_state(seen, theta_m)[self._plant_at["F_ee_B"]]
        friction = float(around.zeros[3])
        too_much = np.linalg.solve(J.T, x[FORCE : FORCE + 3] - F) - friction * around.friction_share
        parameters["slip"] = self._slip + shaft - theta_m + too_much / self._spring
        parameters["joint_friction"] = friction
        outputs["plant"] = self._plant.set_state(state, shaft)
        theta_l = outputs["plant"][self._plant_at["theta_l"]]
        anchors[0, :, JOINT_ANCHOR] = theta_l - self._presliding * around.friction_share
        for (zero, believed), away in zip(self._zeros, (theta_m - shaft, 0.0), strict=True):
            zero[:] = away + believed
        for array in self._exact:
            array[...] = 0.0
        values = {"theta_m": shaft, "theta_l": theta_l, "omega_ref": now.omega_ref}
        for row in ("latency", "delay", "bus"):
            for one in self._assembly.components_by_row[row]:
                outputs[one.name] = np.concatenate([values[port.name] for port in one.outputs])
                one.pieces()["ring"].reshape(-1, width(one.outputs))[:] = outputs[one.name]
        for row in ("controller", "tank"):
            for one in self._assembly.components_by_row[row]:
                outputs[one.name] = one.initial_outputs.copy()
                outputs[one.name][port_slices(one.outputs)["omega_ref"]] = now.omega_ref
        self._simulation.jump_to(now.tick, outputs)

    def surface(self, tick: int | None = None) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
        """Return displacement and velocity of a moving surface at `tick` (None: now) (6,), SI, and the outputs."""
        t = self.tick * (self._at if tick is None else tick)
        for body in self._assembly.components_by_row["body"]:
            rows, _ = play(body, np.array([t]), np.array([self.tick]), np.empty((1, 0)))
            return rows[0], {body.name: rows[0]}
        return np.zeros(6), {}
