/* A direct-current motor behind a proportional speed loop: current limiter and end stop are state events, a supply
 * that falls and rises time events, the first `asks` steps want one. What goes wrong is `fault`, from `fault_at` on. */
#define N_STATES 3
#define N_INDICATORS 2
#define FIRST_STATE 2

enum { OMEGA_REF, TAU_LOAD, THETA, OMEGA, CURRENT, R, L, K, J, B, KP, I_MAX, STOP, BOUNCE, SWITCH_EVERY, FAULT, FAULT_AT, ASKS, UPDATES };
enum { NOT_A_NUMBER = 1, ENDLESS, GROWING, FLICKERING, PAST, BLIND, NOW, ERROR, OVER, TOO_MANY, UNSCALED };
static const double STARTS[] = {0, 0, 0, 0, 0, 2.0, 0.004, 0.1, 1e-4, 1e-3, 2.0, 100.0, 1e6, 0.5, 0, 0, 0};
static const double NOMINALS[] = {1, 1, 1};

static int fault(const Model *m) { return m->time >= m->r[FAULT_AT] ? (int)m->r[FAULT] : 0; }

static bool asks(Model *m) { return m->calls++ < m->r[ASKS]; }

static double free_rate(const Model *m)
{
    const double u = m->supply * m->r[KP] * (m->r[OMEGA_REF] - m->x[1]);
    return (u - m->r[R] * m->x[2] - m->r[K] * m->x[1]) / m->r[L];
}

static void rates(const Model *m, double dx[])
{
    dx[0] = m->x[1];
    dx[1] = (m->r[K] * m->x[2] - m->r[B] * m->x[1] - m->r[TAU_LOAD]) / m->r[J];
    dx[2] = m->limited ? 0.0 : free_rate(m);
}

static void indicate(const Model *m, double z[])
{
    z[0] = m->limited ? copysign(1.0, m->x[2]) * free_rate(m) : m->r[I_MAX] - fabs(m->x[2]);
    z[1] = m->r[STOP] - m->x[0];
}

static int react(Model *m)
{
    int flags = 0;
    m->r[UPDATES]++;
    /* one relation per call, so that the host has to ask again */
    if (!m->limited && fabs(m->x[2]) >= m->r[I_MAX] && m->x[2] * free_rate(m) > 0.0) {
        m->limited = true;
        m->x[2] = copysign(m->r[I_MAX], m->x[2]);
        flags |= NEEDED | STATES_CHANGED;
    } else if (m->limited && m->x[2] * free_rate(m) <= 0.0) {
        m->limited = false;
        flags |= NEEDED;
    }
    if (m->x[0] >= m->r[STOP] && m->x[1] > 0.0) {
        m->x[1] *= -m->r[BOUNCE];
        flags |= STATES_CHANGED;
    }
    if (m->r[SWITCH_EVERY] > 0.0) {
        if (isinf(m->next))
            m->next = m->r[SWITCH_EVERY];
        while (m->time >= m->next) {
            m->supply = m->supply == 1.0 ? 0.5 : 1.0;
            m->next += m->r[SWITCH_EVERY];
            flags |= NOMINALS_CHANGED;
        }
    }
    return flags;
}
