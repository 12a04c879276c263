/* Hybrid stepper motor on micro-steps of its own step generator. Equations (1) to (9) of README.md. */
#include "model.h"

#include <math.h>

static const double TURN = 6.283185307179586; /* 2 pi, rad */
static const double FULL_STEPS_PER_CYCLE = 4.0;

static double clamp(double x, double lo, double hi) { return fmin(fmax(x, lo), hi); }

/* (1) to (3): speed ramp, its integral, and the micro-step the field stands on */
static void generate_steps(Variables *v)
{
    const double target = clamp(v->omega_ref, -v->omega_max, v->omega_max);
    v->omega_g += clamp(target - v->omega_g, -v->alpha_max * v->T_c, v->alpha_max * v->T_c);
    v->theta_g += v->omega_g * v->T_c;
    const double micro_step = TURN / (FULL_STEPS_PER_CYCLE * v->N_r * v->micro_steps);
    v->theta_f = micro_step * floor(v->theta_g / micro_step + 0.5);
}

/* (4): torque of the field on the rotor */
static double field_torque(const Variables *v, double theta)
{
    return v->tau_hold * sin(v->N_r * (v->theta_f - theta));
}

/* (5), (6) */
static double acceleration(const Variables *v, double theta, double omega)
{
    const double detent = v->tau_detent * sin(FULL_STEPS_PER_CYCLE * v->N_r * theta);
    return (field_torque(v, theta) - detent - v->b_m * omega - v->tau_load) / v->J_m;
}

/* One classical Runge-Kutta step of order 4 over dt <= T_c with the field at rest */
static void run_rotor(Variables *v, double dt)
{
    const double theta = v->theta_m, omega = v->omega_m;
    const double a_1 = acceleration(v, theta, omega);
    const double omega_2 = omega + 0.5 * dt * a_1;
    const double a_2 = acceleration(v, theta + 0.5 * dt * omega, omega_2);
    const double omega_3 = omega + 0.5 * dt * a_2;
    const double a_3 = acceleration(v, theta + 0.5 * dt * omega_2, omega_3);
    const double omega_4 = omega + dt * a_3;
    const double a_4 = acceleration(v, theta + dt * omega_3, omega_4);
    v->theta_m += dt / 6.0 * (omega + 2.0 * omega_2 + 2.0 * omega_3 + omega_4);
    v->omega_m += dt / 6.0 * (a_1 + 2.0 * a_2 + 2.0 * a_3 + a_4);
}

/* (8): the generator ticks every T_c on its own clock, wherever the communication points fall. `until_tick` is
 * counted down and never set, so no time is lost. A tick that falls on a communication point, up to rounding,
 * belongs to the step that begins there and sees that step's inputs. */
bool model_step(Variables *v, double h)
{
    const double rounding = 1e-6 * v->T_c;
    for (double left = h; left > 0.0;) {
        if (v->until_tick <= 0.0) {
            generate_steps(v);
            v->until_tick += v->T_c;
        }
        const double dt = v->until_tick < left - rounding ? v->until_tick : left;
        run_rotor(v, dt);
        v->until_tick -= dt;
        left -= dt;
    }
    v->tau_motor = field_torque(v, v->theta_m); /* (4) */
    v->status = FULL_STEPS_PER_CYCLE * floor((v->theta_f - v->theta_m) * v->N_r / TURN + 0.5); /* (7) */
    return isfinite(v->theta_m);
}
