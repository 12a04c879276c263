/* The four tasks of Sec. III.B as phases: approach, gentle descent, force, hold, tap, circle or push, release. */
#include "law.h"

#define OF_TASK(name) ((&v->task_##name##_1)[task - 1])

static Phase still(int kind, int task)
{
    return (Phase){.kind = kind, .task = task, .target = {NAN, NAN, NAN}, .until = ELAPSED, .times = 1};
}

static Phase pressing(const Variables *v, int kind, int task)
{
    Phase phase = still(kind, task);
    phase.force_on = 1, phase.F_end = OF_TASK(force);
    return phase;
}

/* Down to the floor until a force is felt. */
static Phase down(const Variables *v, int kind, int task, double speed, double level)
{
    Phase phase = still(kind, task);
    phase.target[2] = v->floor, phase.speed = speed, phase.until = FELT, phase.level = level;
    return phase;
}

static Phase with_ramps(Phase phase, double speed, double ramp_in, double ramp_out)
{
    phase.speed = speed, phase.ramp_in = ramp_in, phase.ramp_out = ramp_out;
    return phase;
}

static Phase travel(const Variables *v, int task)
{
    Phase phase = with_ramps(still(TRAVEL, task), v->speed, v->ramp, v->ramp);
    phase.target[0] = OF_TASK(x), phase.target[1] = OF_TASK(y), phase.target[2] = v->height;
    return phase;
}

static Phase retract(const Variables *v, int task)
{
    Phase phase = with_ramps(still(RETRACT, task), v->speed, v->ramp, v->ramp);
    phase.target[2] = v->height;
    return phase;
}

/* Phases of tapping after the descent: feel the depth gently, up, then taps that aim at it. */
static Phase tapping(const Variables *v, int task, int step)
{
    Phase phase;
    switch (step) {
    case 0:
        return down(v, PROBE, task, v->descent, OF_TASK(force));
    case 1:
        phase = with_ramps(still(RETRACT, task), v->speed, v->ramp, v->ramp);
        phase.lift = OF_TASK(lift);
        return phase;
    case 2:
        phase = down(v, TAP, task, OF_TASK(speed), OF_TASK(force));
        phase.ramp_in = v->ramp, phase.until = TURN;
        return phase;
    case 3:
        phase = with_ramps(still(RISE, task), OF_TASK(speed), 0.0, v->ramp);
        phase.lift = OF_TASK(lift);
        return phase;
    default:
        phase = still(WAIT, task);
        phase.period = OF_TASK(period), phase.times = (int)OF_TASK(times), phase.again = -2;
        return phase;
    }
}

/* Phases of pressing, rolling and pushing after the descent. */
static Phase under_force(const Variables *v, int task, int step)
{
    const int kind = (int)OF_TASK(kind);
    Phase phase;
    if (step == 0) {
        phase = pressing(v, BUILD_UP, task);
        phase.duration = OF_TASK(build_up);
    } else if (step == 2) {
        phase = pressing(v, RELEASE, task);
        phase.F_end = v->contact_force, phase.duration = v->release;
    } else if (kind == PRESSING) {
        phase = pressing(v, HOLD, task);
        phase.duration = OF_TASK(hold);
    } else if (kind == ROLLING) {
        phase = pressing(v, CIRCLE, task);
        phase.radius = OF_TASK(radius), phase.rate = OF_TASK(rate), phase.turns = OF_TASK(turns);
    } else {
        phase = with_ramps(pressing(v, PUSH, task), OF_TASK(speed), v->ramp, v->ramp);
        phase.target[0] = OF_TASK(to_x), phase.target[1] = OF_TASK(to_y);
    }
    return phase;
}

Phase phase_at(const Variables *v, int index)
{
    int first = 0;
    for (int task = 1; task <= (int)v->tasks; task++) {
        const int taps = OF_TASK(kind) == TAPPING;
        const int work = taps ? 5 : 3;
        const int last = first + 2 + work, place = index - first;
        if (index > last) {
            first = last + 1;
            continue;
        }
        Phase phase;
        if (place == 0)
            phase = travel(v, task);
        else if (place == 1)
            phase = with_ramps(down(v, DESCEND, task, v->descent, v->contact_force), v->descent, v->ramp, 0.0);
        else if (index == last)
            phase = retract(v, task);
        else
            phase = taps ? tapping(v, task, place - 2) : under_force(v, task, place - 2);
        phase.next = index + 1, phase.otherwise = last;
        phase.again = phase.again ? index + phase.again : index + 1;
        return phase;
    }
    Phase phase = still(DONE, (int)v->tasks);
    phase.duration = INFINITY, phase.next = index;
    return phase;
}
