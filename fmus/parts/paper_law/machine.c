/* The machine that walks through the phases and feels its way (Sec. III.B). README.md (10) to (12). */
#include "law.h"

#define LONGEST_TURN 0.1 /* s: five times what the slowest drive takes to reverse */

static double clamp(double x, double lo, double hi) { return fmin(fmax(x, lo), hi); }

static void enter_line(Machine *m, const Phase *phase)
{
    double squared = 0.0;
    for (int i = 0; i < 3; i++) {
        m->start[i] = m->p[i];
        m->end[i] = isnan(phase->target[i]) ? m->p[i] : phase->target[i];
        if (i == 2 && phase->lift > 0.0)
            m->end[2] = m->z_turn + phase->lift;
        squared += (m->end[i] - m->start[i]) * (m->end[i] - m->start[i]);
    }
    m->length = sqrt(squared);
}

/* Where the force loop ends, its correction stays in the reference, so that this does not jump. */
static void enter(Machine *m, const Variables *v, int index, double t, double F_z, double dp_z)
{
    /* before the first phase there is the last */
    const Phase before = phase_at(v, m->index < 0.0 ? 1 << 20 : (int)m->index), phase = phase_at(v, index);
    if (before.force_on && !phase.force_on)
        m->p[2] += dp_z;
    m->index = index, m->entered = t, m->lost = 0.0;
    if (phase.task != before.task)
        m->passes = 0.0;
    enter_line(m, &phase);
    m->F_start = before.force_on ? m->F_ref : fmax(F_z, 0.0);
    m->total = fmax(motion_time(&phase, m->length), phase.duration);
    if (phase.period > 0.0)
        m->total = fmax(0.0, m->tapped + phase.period - t);
    if (phase.kind == TAP)
        m->tapped = t, m->z_lowest = INFINITY;
    if (phase.kind == TAP || phase.kind == DESCEND)
        m->touching = 0.0;
}

static int following(Machine *m, const Variables *v, const Phase *phase, double t, double h, double z, double v_z,
                     double F_z, double F_rate)
{
    const int over = t - m->entered > m->total - 0.5 * h;
    if (phase->until == FELT) {
        if (F_z >= phase->level)
            return phase->next;
        return over ? phase->otherwise : (int)m->index;
    }
    if (phase->until == TURN) {
        const int reached = z + v_z * (m->t_turn + h) <= m->z_turn;
        if ((reached && (m->touching != 0.0 || m->calibrated == 0.0)) || F_z + F_rate * m->t_turn >= phase->level)
            return phase->next;
        return over ? phase->otherwise : (int)m->index;
    }
    if (phase->force_on && phase->kind != RELEASE) {
        m->lost = F_z < 0.5 * v->contact_force ? m->lost + h : 0.0;
        if (m->lost > v->patience)
            return phase->otherwise;
    }
    if (!over)
        return (int)m->index;
    if (phase->times > 1) {
        m->passes += 1.0;
        if (m->passes < phase->times)
            return phase->again;
        m->passes = 0.0;
    }
    return phase->next;
}

/* How long a tap that is to turn round before the next call may still go on; 0: none does. */
static double time_to_turn(const Machine *m, const Phase *phase, double z, double h)
{
    if (phase->until != TURN || m->v[2] >= 0.0)
        return 0.0;
    return clamp((m->z_turn - z) / m->v[2] - m->t_turn, 0.0, h);
}

/* Note where on its way down the platform meets the surface. */
static void feel(Machine *m, const Variables *v, const Phase *phase, double t, double z, double F)
{
    const double contact = v->contact_force;
    if (m->touching == 0.0 && F >= contact && t - m->entered >= phase->ramp_in) {
        m->touching = 1.0;
        if (m->F_before < contact) {
            const double share = (contact - m->F_before) / (F - m->F_before);
            m->z_felt = m->z_before + share * (z - m->z_before);
            if (phase->kind == TAP) {
                if (m->calibrated != 0.0)
                    m->z_turn = m->z_felt - m->depth;
                else
                    m->depth = m->z_felt - m->z_turn, m->calibrated = 1.0;
            }
        }
    }
    m->z_before = z, m->F_before = F;
}

/* Turn round `rest` after t, before the next call: the command is the mean of down and up. */
static void turn_within(Machine *m, const Phase *phase, double t, double h, double rest)
{
    const double down = m->v[2];
    m->p[2] += down * rest;
    enter_line(m, phase);
    m->entered = t + rest;
    m->total = fmax(motion_time(phase, m->length), phase->duration);
    m->p[2] -= down * rest;
    m->v[2] = (down * rest + phase->speed * (h - rest)) / h;
}

void walk(Machine *m, const Variables *v, double t, double h, double z, double F, double F_z, double F_rate,
          double F_delay, double dp_z)
{
    if (m->index < 0.0)
        enter(m, v, 0, t, F_z, dp_z);
    Phase phase = phase_at(v, (int)m->index);
    m->z_lowest = fmin(m->z_lowest, z);
    feel(m, v, &phase, t, z, F);
    const int next = following(m, v, &phase, t, h, z, m->v[2], F_z, F_rate);
    if (next != (int)m->index) {
        if (phase.kind == PROBE)
            m->z_turn = z - m->v[2] * F_delay, m->calibrated = 0.0;
        if (phase.kind == RISE) {
            const double late = (m->z_turn - m->z_lowest) / phase.speed;
            m->t_turn = clamp(m->t_turn + v->learning * late, 0.0, LONGEST_TURN);
        }
        const double rest = time_to_turn(m, &phase, z, h);
        enter(m, v, next, t, F_z, dp_z);
        phase = phase_at(v, (int)m->index);
        if (rest > 0.0) {
            turn_within(m, &phase, t, h, rest);
            return;
        }
    }
    const double elapsed = t - m->entered;
    motion(&phase, m->start, m->end, m->length, elapsed, m->p, m->v);
    const double share = phase.duration > 0.0 ? smooth(elapsed / phase.duration) : 1.0;
    m->F_ref = phase.force_on ? m->F_start + share * (phase.F_end - m->F_start) : 0.0;
}
