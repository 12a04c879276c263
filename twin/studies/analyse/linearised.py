"""Linear loops of an experiment at each operating point, sampled as the co-simulation steps them."""

import copy
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from twin.kernel.errors import InputRefused
from twin.robot.assembly.build import belief, shafts
from twin.robot.assembly.drives import plan_drive
from twin.robot.controller.pid import Gains, force_gains
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.schema import whole_ticks
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.plant.dynamics import series_share, spring_stiffness
from twin.robot.plant.joints import stop_deflection
from twin.studies.analyse.drive_response import identify_drive
from twin.studies.analyse.linear.hand import linear_plant
from twin.studies.analyse.linear.loops import (
    LOOPS,
    DriveModel,
    Estimation,
    Loops,
    LoopSettings,
    LoopStepping,
    estimation,
    linear_law,
    open_loops,
    period_map,
    tick_map,
)
from twin.studies.analyse.operating_point import OperatingPoint

ZERO_GAINS = Gains(0.0)


@dataclass(frozen=True)
class LinearPoint:
    """The open loops at one operating point, see `open_loops`; `gains` is 1 for each loop closed there."""

    point: OperatingPoint
    loops: Loops
    gains: dict[str, float] = field(default_factory=dict)


class Linearisation:
    """The linear models that all operating points of an experiment share: drives, settings, stepping.

    Faults are left out. The drives, called `labels` in reports, are identified under their mean load at the points.
    """

    def __init__(self, experiment: Experiment, points: list[OperatingPoint]):
        self.experiment = experiment
        self.stepping = _stepping(experiment)
        load = float(np.mean([_loads(point) for point in points]))
        models: list[DriveModel] = []
        tables = experiment.drives
        plans = [plan_drive(table) for table in tables]
        for i, table in enumerate(tables):
            same = tables.index(table)
            models.append(models[same] if same < i else identify_drive(plans[i], experiment.cosim.tick, load))
        self.drives, self.labels = tuple(models), tuple(plan.label for plan in plans)

    def linear_point(self, point: OperatingPoint) -> LinearPoint:
        plant = linear_plant(point.parameters, point.x, point.theta_m)
        robot = period_map(tick_map(plant, self.drives, self.stepping), self.stepping)
        settings = self.settings(point.force_on)
        law = linear_law(settings, self.estimation(point))
        return LinearPoint(point, open_loops(robot, law), dict.fromkeys(closed_loop_names(settings), 1.0))

    def with_experiment(self, experiment: Experiment) -> Self:
        """Return a copy of the linearisation for another experiment with the same drives."""
        other = copy.copy(self)
        other.experiment = experiment
        return other

    def settings(self, force_on: bool) -> LoopSettings:
        c = self.experiment.controller
        damping = c.damping if self.experiment.tasks else None
        return LoopSettings(
            N=c.model.N,
            eta=c.model.eta,
            position=Gains.from_tables(c.position),
            force=force_gains(c.force) if force_on else ZERO_GAINS,
            corner=c.force.filter,
            damping=damping,
            period=self.stepping.period * self.stepping.tick,
        )

    def estimation(self, point: OperatingPoint) -> Estimation:
        plant, parameters = self.experiment.plant, point.parameters
        geometry = Geometry(parameters.a, parameters.b, parameters.l_a, parameters.l_b)
        angles = np.concatenate([point.theta_m, joint_angles(geometry, point.p_B)])
        motor, joint = shafts(plant)
        read = angles + np.concatenate([motor.error(angles[:3]), joint.error(angles[3:])])
        # the speed command that holds a drive still under its load
        gains = np.array([drive.steady_gain for drive in self.drives])
        standing = -gains[:, 1] / gains[:, 0] * _loads(point)
        compensation = self.experiment.controller.gravity_compensation
        return estimation(belief(self.experiment), compensation, read, standing)


def closed_loop_names(settings: LoopSettings) -> tuple[str, ...]:
    return LOOPS if any(settings.force[:3]) else LOOPS[:3]


def _loads(point: OperatingPoint) -> np.ndarray:
    """Return the load torques (3,) of the drives (N m) with the robot at rest at an operating point."""
    p = point.parameters
    geometry = Geometry(p.a, p.b, p.l_a, p.l_b)
    d = point.theta_m - p.N * joint_angles(geometry, point.p_B) - np.array(p.slip)
    loaded = np.sign(d) * np.maximum(np.abs(d) - p.backlash - np.array(p.backlash_added), 0.0)
    return np.array(
        [spring_stiffness(p, leg) * series_share(p, leg) * stop_deflection(p, loaded[leg]) for leg in range(3)]
    )


def _stepping(experiment: Experiment) -> LoopStepping:
    c = experiment.controller
    period, delay = experiment.controller_ticks, c.delay_ticks
    if experiment.monitor is not None and (period % experiment.monitor_ticks or delay % experiment.monitor_ticks):
        raise InputRefused(
            f"[monitor] period_ms = {1e3 * experiment.monitor_ticks * experiment.cosim.tick:g} passes the controller's "
            "commands on late; the analysis knows only monitors that divide the controller's period and delay"
        )
    jacobi = experiment.cosim.scheme == "jacobi"
    # no component after the monitor and before the encoders is sampled
    latency = whole_ticks(experiment.plant.encoder_latency, experiment.cosim.tick) or 0
    late = delay + c.bus_delay_ticks + latency
    return LoopStepping(experiment.cosim.tick, experiment.plant.substeps, period, late, jacobi)
