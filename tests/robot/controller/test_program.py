"""Tasks as tables of phases (Sec. III.B): their order, where each leads, and what it presses with."""

import math

from hypothesis import given
from hypothesis import strategies as st

from tests.robot.controller.soft_floor import APPROACH, CONTACT, PRESS, PUSH, ROLL, TAP
from twin.robot.controller.program import PhaseEnd, program
from twin.robot.controller.program import PhaseKind as Kind

WORK = {
    PRESS: [Kind.BUILD_UP, Kind.HOLD, Kind.RELEASE],
    ROLL: [Kind.BUILD_UP, Kind.CIRCLE, Kind.RELEASE],
    PUSH: [Kind.BUILD_UP, Kind.PUSH, Kind.RELEASE],
    TAP: [Kind.PROBE, Kind.RETRACT, Kind.TAP, Kind.RISE, Kind.WAIT],
}
sequences = st.lists(st.sampled_from(list(WORK)), min_size=1, max_size=5)


@given(sequences)
def test_every_task_travels_descends_works_and_retracts(tasks):
    phases = program(APPROACH, CONTACT, tasks)
    expected = [kind for task in tasks for kind in (Kind.TRAVEL, Kind.DESCEND, *WORK[task], Kind.RETRACT)]
    assert [phase.kind for phase in phases] == [*expected, Kind.DONE]


@given(sequences)
def test_phases_lead_from_one_to_the_next_and_the_last_holds_for_ever(tasks):
    phases = program(APPROACH, CONTACT, tasks)
    *walked, done = phases
    assert [phase.next for phase in walked] == list(range(1, len(phases)))
    assert done.next == len(walked)
    assert done.duration == math.inf


@given(sequences)
def test_whatever_goes_wrong_in_a_task_leads_to_its_own_last_retraction(tasks):
    phases = program(APPROACH, CONTACT, tasks)
    for phase in phases[:-1]:
        last = phases[phase.otherwise]
        assert (last.task, last.kind) == (phase.task, Kind.RETRACT)
        assert last.target[2] == APPROACH.height
        assert phases[phase.otherwise + 1].task != phase.task or phase.otherwise == len(phases) - 2


@given(sequences)
def test_taps_are_repeated_from_the_tap_and_nothing_else_is_repeated(tasks):
    phases = program(APPROACH, CONTACT, tasks)
    for phase in phases[:-1]:
        assert (phase.times > 1) == (phase.kind == Kind.WAIT)
        if phase.kind == Kind.WAIT:
            again = phases[phase.again]
            assert (again.kind, again.task, phase.times, phase.period) == (Kind.TAP, phase.task, 5, 0.4)


@given(sequences)
def test_the_force_loop_acts_only_while_the_robot_presses_and_lets_go_at_the_force_of_contact(tasks):
    for phase in program(APPROACH, CONTACT, tasks):
        pressing = phase.kind in (Kind.BUILD_UP, Kind.HOLD, Kind.CIRCLE, Kind.PUSH, Kind.RELEASE)
        assert phase.force_on == pressing
        if phase.kind == Kind.RELEASE:
            assert (phase.F_end, phase.duration) == (CONTACT, APPROACH.release)
        elif pressing:
            assert phase.F_end == tasks[phase.task - 1].force


def test_a_press_builds_its_force_up_and_holds_it():
    phases = {phase.kind: phase for phase in program(APPROACH, CONTACT, [PRESS])}
    assert (phases[Kind.BUILD_UP].F_end, phases[Kind.BUILD_UP].duration) == (5.0, 1.0)
    assert (phases[Kind.HOLD].F_end, phases[Kind.HOLD].duration) == (5.0, 2.0)


def test_a_descent_is_gentle_and_ends_at_the_first_touch_or_at_the_floor():
    descend = program(APPROACH, CONTACT, [PRESS])[1]
    assert (descend.speed, descend.target[2]) == (APPROACH.descent, APPROACH.floor)
    assert (descend.until, descend.level) == (PhaseEnd.FELT, CONTACT)


def test_a_tap_probes_gently_and_then_goes_down_and_up_at_its_speed():
    probe, lift, tap, rise, _ = program(APPROACH, CONTACT, [TAP])[2:7]
    assert (probe.until, probe.level, probe.speed) == (PhaseEnd.FELT, TAP.force, APPROACH.descent)
    assert (tap.until, tap.level, tap.speed, tap.ramp_out) == (PhaseEnd.TURN, TAP.force, TAP.speed, 0.0)
    assert lift.lift == rise.lift == TAP.lift
    # it turns at once
    assert (rise.speed, rise.ramp_in) == (TAP.speed, 0.0)
