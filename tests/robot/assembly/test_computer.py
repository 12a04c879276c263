"""The program that tasks become."""

import pytest

from tests.laws.runs import shipped
from tests.robot.monitor.motions import LIMITS
from twin.robot.assembly.build import monitor_limits
from twin.robot.controller import program as programs
from twin.robot.controller.program import PhaseKind as Kind
from twin.robot.monitor.limits import Limits, Monitor


def test_every_limit_of_the_component_is_in_the_table():
    assert set(Monitor.model_fields) == {*Limits._fields, "enabled", "period"}


def test_limits_are_si():
    assert monitor_limits(Monitor(), 8.0) == LIMITS
    assert (LIMITS.penetration_limit, LIMITS.speed_limit, LIMITS.z_min) == (0.025, 0.25, -0.135)
    assert LIMITS.retract == pytest.approx(0.5236, abs=1e-4)


def test_a_command_is_saturated_at_the_controllers_limit_unless_another_is_given():
    assert monitor_limits(Monitor(), 6.0).command_limit == 6.0
    assert monitor_limits(Monitor.model_validate({"command_limit_rad_per_s": 5.0}), 6.0).command_limit == 5.0


def test_the_program_is_that_of_the_tasks_in_the_manner_of_the_approach():
    experiment = shipped("massage")
    assert experiment.approach is not None
    phases = programs.program(experiment.approach, 0.6, experiment.tasks)
    assert [phase.task for phase in phases if phase.kind == Kind.TRAVEL] == [1, 2, 3, 4]
    travel, descend, build_up = phases[:3]
    assert (travel.target, travel.speed, travel.ramp_in) == ((0.0, 0.0, -0.092), 0.04, 0.1)
    assert (descend.target[2], descend.speed, descend.level) == (-0.13, 0.01, 0.6)
    assert (build_up.F_end, build_up.duration) == (8.0, 3.5)
    roll = programs.Roll.model_construct(point=(0.0, 0.0), force=5.0, build_up=2.0, radius=0.005, rate=1.0, turns=6.0)
    found = [phase for phase in phases if phase.task == 3 and phase.kind == Kind.CIRCLE]
    (expected,) = (phase for phase in programs.program(experiment.approach, 0.6, [roll]) if phase.kind == Kind.CIRCLE)
    assert [(phase.radius, phase.rate, phase.turns) for phase in found] == [
        (expected.radius, expected.rate, expected.turns)
    ]
