/* A frameless torque motor behind its current loop. Equations (1) to (8) of README.md. */
#include "model.h"

#include <math.h>

static const double DT_MAX = 50e-6; /* longest part of a step, s: (9) */

typedef enum { FOLLOWING, LIMITED, DERATED, OFF } Status;

typedef struct {
    double i, omega, theta, T_w;
} Machine;

static double clamp(double x, double lo, double hi) { return fmin(fmax(x, lo), hi); }

/* (1): what heat leaves of the current limit */
static double share_left(const Variables *v, double T_w)
{
    return clamp((v->T_high - T_w) / (v->T_high - v->T_low), 0.0, 1.0);
}

/* (2) */
static double current_reference(const Variables *v, double T_w)
{
    const double limit = v->i_max * share_left(v, T_w);
    return v->enable != 0.0 ? clamp(v->tau_cmd / v->k_t, -limit, limit) : 0.0;
}

/* (4) */
static double machine_torque(const Variables *v, Machine x)
{
    return v->k_t * x.i * (1.0 + v->ripple * cos(v->n_ripple * x.theta));
}

/* (3), (5) to (7): rates of change of the machine's state */
static Machine rates(const Variables *v, Machine x)
{
    const double bend = sqrt(x.omega * x.omega + v->omega_c * v->omega_c);
    const double friction = v->b_m * x.omega + v->tau_c * x.omega / bend;
    const double cogging = v->tau_cog * sin(v->n_cog * x.theta);
    const double R_w = v->R * (1.0 + v->alpha * (x.T_w - v->T_amb));
    return (Machine){
        .i = (current_reference(v, x.T_w) - x.i) / v->T_i,
        .omega = (machine_torque(v, x) - cogging - friction - v->tau_load) / v->J_m,
        .theta = x.omega,
        .T_w = (R_w * x.i * x.i - (x.T_w - v->T_amb) / v->R_th) / v->C_th,
    };
}

static Machine moved(Machine x, Machine dx, double dt)
{
    return (Machine){
        .i = x.i + dt * dx.i,
        .omega = x.omega + dt * dx.omega,
        .theta = x.theta + dt * dx.theta,
        .T_w = x.T_w + dt * dx.T_w,
    };
}

/* One classical Runge-Kutta step of order 4 */
static Machine advanced(const Variables *v, Machine x, double dt)
{
    const Machine k_1 = rates(v, x);
    const Machine k_2 = rates(v, moved(x, k_1, 0.5 * dt));
    const Machine k_3 = rates(v, moved(x, k_2, 0.5 * dt));
    const Machine k_4 = rates(v, moved(x, k_3, dt));
    x = moved(x, k_1, dt / 6.0);
    x = moved(x, k_2, dt / 3.0);
    x = moved(x, k_3, dt / 3.0);
    return moved(x, k_4, dt / 6.0);
}

/* (8) */
static Status status_of(const Variables *v)
{
    const double asked = fabs(v->tau_cmd / v->k_t);
    if (v->enable == 0.0)
        return OFF;
    if (asked > v->i_max * share_left(v, v->temperature))
        return share_left(v, v->temperature) < 1.0 ? DERATED : LIMITED;
    return FOLLOWING;
}

bool model_step(Variables *v, double h)
{
    Machine x = {v->current, v->omega_m, v->theta_m, v->temperature};
    const double parts = ceil(h / DT_MAX * (1.0 - 1e-9)); /* a whole number of DT_MAX stays one in spite of rounding */
    for (double k = 0.0; k < parts; k++)
        x = advanced(v, x, h / parts);
    v->current = x.i, v->omega_m = x.omega, v->theta_m = x.theta, v->temperature = x.T_w;
    v->tau_motor = machine_torque(v, x);
    v->status = status_of(v);
    return isfinite(v->theta_m) && isfinite(v->temperature);
}
