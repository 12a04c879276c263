/* A first-order velocity servo with droop and limits, solved exactly. Equations (1) to (7) of README.md. */
#include "model.h"

#include <math.h>

static double clamp(double x, double lo, double hi) { return fmin(fmax(x, lo), hi); }

/* Advance by dt at constant acceleration: (4) while a limit is active. */
static void accelerate(Variables *v, double alpha, double dt)
{
    v->theta_m += (v->omega_m + 0.5 * alpha * dt) * dt;
    v->omega_m += alpha * dt;
}

/* Advance by dt without a limit: (4) with alpha = (target - omega_m) / T_m, whose solution is (6). */
static void relax(Variables *v, double target, double dt)
{
    const double decay = -expm1(-dt / v->T_m); /* 1 - exp(-dt/T_m) without cancellation */
    const double error = target - v->omega_m;
    v->theta_m += target * dt - error * v->T_m * decay;
    v->omega_m += error * decay;
}

bool model_step(Variables *v, double h)
{
    const double target = clamp(v->omega_ref, -v->omega_max, v->omega_max) - v->droop * v->tau_load; /* (1) */

    /* (2), (3): where the limits contradict each other, physics (torque) wins over command (acceleration) */
    const double lo_torque = (-v->tau_max - v->tau_load) / v->J_m;
    const double hi_torque = (v->tau_max - v->tau_load) / v->J_m;
    const double lo = clamp(-v->alpha_max, lo_torque, hi_torque);
    const double hi = clamp(v->alpha_max, lo_torque, hi_torque);

    /* (7): at most three phases: a limit, none, and a limit again where the load drags omega_m off */
    double left = h;
    double wanted = (target - v->omega_m) / v->T_m;
    if (wanted > hi || wanted < lo) {
        const double alpha = wanted > hi ? hi : lo;
        const double until_free = v->T_m * (wanted / alpha - 1.0);
        /* not positive: the load drives omega_m away from the target and the limit is never left */
        const double dt = until_free > 0.0 ? fmin(until_free, left) : left;
        accelerate(v, alpha, dt);
        left -= dt;
        wanted = (target - v->omega_m) / v->T_m;
    }
    if (left > 0.0) {
        const bool overloaded = hi < 0.0 || lo > 0.0;
        const double alpha = hi < 0.0 ? hi : lo;
        const double dt = overloaded ? clamp(v->T_m * log(wanted / alpha), 0.0, left) : left;
        relax(v, target, dt);
        accelerate(v, alpha, left - dt);
    }

    const double alpha = clamp((target - v->omega_m) / v->T_m, lo, hi);
    v->tau_motor = v->tau_load + v->J_m * alpha; /* (5) */
    return isfinite(v->theta_m);
}
