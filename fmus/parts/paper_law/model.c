/* The robot's controller: force outside, position inside (Fig. 3 B), led by a reference or by tasks. README.md. */
#include "law.h"

#define REST_SPEED 1e-3 /* m/s, below which friction fades out: it has no direction at rest */
#define FIRST(member) ((const double *)&v->member##_1)

_Static_assert(offsetof(Variables, m_t_turn) - offsetof(Variables, m_index) == offsetof(Machine, t_turn),
               "part.toml lists the machine's memory in the order of Machine");

static double clamp(double x, double lo, double hi) { return fmin(fmax(x, lo), hi); }

/* (4) */
static double force_correction(Variables *v, double e, double h)
{
    Loop *loop = (Loop *)&v->force_integral;
    double integral;
    const double u = proposal((const Gains *)&v->force_kp, loop, e, h, &integral);
    if (fabs(u) <= v->dp_z_max)
        loop->integral = integral;
    return -clamp(u, -v->dp_z_max, v->dp_z_max);
}

/* (5), plus what is fed forward */
static void motor_speeds(Variables *v, const double lead[3], double h)
{
    const Gains *gains = (const Gains *)&v->position_kp;
    const double *J = FIRST(J), *p = FIRST(p_B), *to = FIRST(p_cmd_B);
    double u[3], integral[3];
    for (int i = 0; i < 3; i++)
        u[i] = proposal(gains, (Loop *)&v->x_integral + i, to[i] - p[i], h, &integral[i]);
    bool within = true;
    for (int i = 0; i < 3; i++) {
        const double omega = v->N * (J[3 * i] * u[0] + J[3 * i + 1] * u[1] + J[3 * i + 2] * u[2]) + lead[i];
        within = within && fabs(omega) <= v->omega_max;
        (&v->omega_ref_1)[i] = clamp(omega, -v->omega_max, v->omega_max);
    }
    for (int i = 0; i < 3 && within; i++)
        ((Loop *)&v->x_integral)[i].integral = integral[i];
}

static void friction_force(double mu, double F_n, double v_x, double v_y, double F[2])
{
    const double speed = sqrt(v_x * v_x + v_y * v_y + REST_SPEED * REST_SPEED);
    F[0] = mu * F_n * v_x / speed, F[1] = mu * F_n * v_y / speed;
}

/* Joint torques with J^T tau = (f_x, f_y, 0). */
static void load_torques(const double J[9], double f_x, double f_y, double f_z, double tau[3])
{
    const double a = J[0], b = J[1], c = J[2], d = J[3], e = J[4], f = J[5], g = J[6], h = J[7], i = J[8];
    const double x_1 = e * i - f * h, y_1 = f * g - d * i, z_1 = d * h - e * g;
    const double x_2 = h * c - i * b, y_2 = i * a - g * c, z_2 = g * b - h * a;
    const double x_3 = b * f - c * e, y_3 = c * d - a * f, z_3 = a * e - b * d;
    const double det = a * x_1 + b * y_1 + c * z_1;
    tau[0] = (x_1 * f_x + y_1 * f_y + z_1 * f_z) / det;
    tau[1] = (x_2 * f_x + y_2 * f_y + z_2 * f_z) / det;
    tau[2] = (x_3 * f_x + y_3 * f_y + z_3 * f_z) / det;
}

/* (6): the reference's motion and the springs' wind-up, ahead by the believed lag of the drives */
static void feed_forward(const Variables *v, const Machine *m, const Phase *phase, double t, double h, double lead[3])
{
    const double *J = FIRST(J);
    const double elapsed = t - m->entered;
    double p[3], w[3] = {m->v[0], m->v[1], m->v[2]};
    if (elapsed >= 0.0)
        motion(phase, m->start, m->end, m->length, elapsed + v->lag, p, w);
    for (int i = 0; i < 3; i++)
        lead[i] = v->N * (J[3 * i] * w[0] + J[3 * i + 1] * w[1] + J[3 * i + 2] * w[2]);
    if (phase->force_on) {
        double now[2], next[2], tau[3];
        friction_force(v->mu, m->F_ref, w[0], w[1], now);
        motion(phase, m->start, m->end, m->length, elapsed + v->lag + h, p, w);
        friction_force(v->mu, m->F_ref, w[0], w[1], next);
        load_torques(J, next[0] - now[0], next[1] - now[1], 0.0, tau);
        for (int i = 0; i < 3; i++)
            lead[i] += tau[i] / (h * v->k_s * v->N * v->eta);
    }
}

/* (7) */
static void damp(Variables *v, double h, double lead[3])
{
    const double share = v->damped != 0.0 ? low_pass_share(v->damping_corner, h) : 1.0;
    double *slow = &v->slow_1;
    v->damped = 1.0;
    for (int i = 0; i < 3; i++) {
        const double tau = FIRST(tau_l)[i] / (v->N * v->eta);
        slow[i] += share * (tau - slow[i]);
        lead[i] -= v->damping_gain * (tau - slow[i]);
    }
}

static void set_point(Variables *v, const double p[3], double dp_z)
{
    for (int i = 0; i < 3; i++)
        (&v->p_ref_B_1)[i] = (&v->p_cmd_B_1)[i] = p[i];
    v->p_cmd_B_3 += dp_z;
}

static void follow_way(Variables *v, double t, double h)
{
    const double lead[3] = {0.0, 0.0, 0.0};
    v->F_z += low_pass_share(v->corner, h) * (-v->F_ee_B_3 - v->F_z);
    if (v->F_z > v->trigger_force || t >= v->trigger_time - 0.5 * h)
        v->triggered = 1.0;
    v->dp_z = v->triggered != 0.0 ? force_correction(v, v->F_ref - v->F_z, h) : 0.0;
    set_point(v, FIRST(way), v->dp_z);
    motor_speeds(v, lead, h);
    v->F_z_ref = v->F_ref;
}

static void carry_out_tasks(Variables *v, double t, double h)
{
    Machine *m = (Machine *)&v->m_index;
    if (v->calls == 0.0) {
        m->index = -1.0, m->z_turn = -INFINITY, m->t_turn = v->turn;
        m->p[0] = v->task_x_1, m->p[1] = v->task_y_1, m->p[2] = v->height;
    }
    const double share = low_pass_share(v->corner, h), before = v->F_z;
    v->F_z += share * (-v->F_ee_B_3 - v->F_z);
    v->F_rate += share * ((v->F_z - before) / h - v->F_rate);
    /* a first-order low-pass lags a ramp by its time constant */
    const double lag = h * (1.0 - share) / share;
    walk(m, v, t, h, v->p_B_3, -v->F_ee_B_3, v->F_z, v->F_rate, lag, v->dp_z);
    const Phase phase = phase_at(v, (int)m->index);
    if (phase.force_on) {
        v->dp_z = force_correction(v, m->F_ref - v->F_z, h);
    } else {
        v->dp_z = 0.0;
        *(Loop *)&v->force_integral = (Loop){0};
    }
    double lead[3];
    feed_forward(v, m, &phase, t, h, lead);
    damp(v, h, lead);
    set_point(v, m->p, v->dp_z);
    for (int i = 0; i < 3; i++)
        (&v->v_ref_B_1)[i] = m->v[i];
    motor_speeds(v, lead, h);
    v->triggered = phase.force_on, v->F_z_ref = m->F_ref, v->task = phase.task, v->phase = phase.kind;
}

/* Called at t_k with the period h: what is computed is of t_k. */
bool model_step(Variables *v, double h)
{
    const double t = v->calls * h;
    if (v->tasks > 0.0)
        carry_out_tasks(v, t, h);
    else
        follow_way(v, t, h);
    v->calls += 1.0;
    return isfinite(v->omega_ref_1) && isfinite(v->omega_ref_2) && isfinite(v->omega_ref_3);
}
