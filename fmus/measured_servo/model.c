/* Servo with identified friction: P loop on the voltage, DC motor, load-dependent Stribeck friction. Equations (1) to
 * (9) of README.md. */
#include "model.h"

#include <math.h>

static const double DT_MAX = 50e-6; /* (8), s */
static const int MOST_HALVINGS = 60; /* (9): below the spacing of doubles */

static double clamp(double x, double lo, double hi) { return fmin(fmax(x, lo), hi); }

typedef struct {
    double theta, omega;
} Shaft;

/* (1), (2): the firmware's tick. A goal that is further ahead than the whole voltage asks for would only wind up. */
static void control(Variables *v, double theta)
{
    const double most = v->pwm_max / (v->k_p * v->error_gain);
    if (v->mode > 0.5)
        v->goal = theta + clamp((v->ticks > 0.0 ? v->goal : theta) - theta, -most, most);
    else
        v->goal = v->goal_position;
    v->voltage = v->v_in * clamp(v->k_p * v->error_gain * (v->goal - theta), -v->pwm_max, v->pwm_max);
    v->goal += v->mode > 0.5 ? v->goal_velocity * v->T_c : 0.0;
    v->ticks += 1.0;
}

/* (3) */
static double motor_torque(const Variables *v, double omega)
{
    return v->k_t * (v->voltage - v->k_t * omega) / v->R;
}

/* (4), (5): the most that the gears can resist with at rest, and without its viscous part in motion */
static double friction(const Variables *v, double omega)
{
    const double motor = motor_torque(v, omega);
    const double external = -v->tau_load;
    const double stribeck = exp(-pow(fabs(omega / v->omega_s), v->alpha));
    double most = v->friction_base + fabs(external * v->load_external - motor * v->load_motor);
    most += stribeck * (v->friction_stribeck
        + fabs(external * v->load_external_stribeck - motor * v->load_motor_stribeck));
    if (external * motor <= 0.0) {
        if (fabs(external) < fabs(motor)) most += stribeck * v->load_external_quad * external * external;
        if (fabs(external) > fabs(motor)) most += stribeck * v->load_motor_quad * motor * motor;
    }
    return most;
}

/* (6): `way` is the sign of the speed, which friction resists */
static Shaft rates(const Variables *v, Shaft x, double way)
{
    const double resisting = friction(v, x.omega) + v->friction_viscous * way * x.omega;
    return (Shaft){x.omega, (motor_torque(v, x.omega) - v->tau_load - way * resisting) / v->J};
}

static Shaft moved(Shaft x, Shaft dx, double dt) { return (Shaft){x.theta + dt * dx.theta, x.omega + dt * dx.omega}; }

/* (8): one classical Runge-Kutta step of order 4, the direction kept */
static Shaft advanced(const Variables *v, Shaft x, double way, double dt)
{
    const Shaft k_1 = rates(v, x, way);
    const Shaft k_2 = rates(v, moved(x, k_1, 0.5 * dt), way);
    const Shaft k_3 = rates(v, moved(x, k_2, 0.5 * dt), way);
    const Shaft k_4 = rates(v, moved(x, k_3, dt), way);
    x = moved(x, k_1, dt / 6.0);
    x = moved(x, k_2, dt / 3.0);
    x = moved(x, k_3, dt / 3.0);
    return moved(x, k_4, dt / 6.0);
}

/* (7): the sign of the speed, or at rest of what overcomes friction; 0 sticks */
static double direction(const Variables *v, double omega)
{
    if (omega != 0.0) return omega > 0.0 ? 1.0 : -1.0;
    const double net = motor_torque(v, 0.0) - v->tau_load;
    return fabs(net) <= friction(v, 0.0) ? 0.0 : (net > 0.0 ? 1.0 : -1.0);
}

/* (9): to where the shaft comes to rest, at most for `dt`; what is left of `dt` goes to `left` */
static Shaft until_rest(const Variables *v, Shaft x, double way, double dt, double *left)
{
    *left = 0.0;
    Shaft end = advanced(v, x, way, dt);
    if (way * end.omega > 0.0) return end;
    double before = 0.0, after = dt;
    for (int i = 0; i < MOST_HALVINGS; i++) {
        const double middle = 0.5 * (before + after);
        if (way * advanced(v, x, way, middle).omega > 0.0) before = middle;
        else after = middle;
    }
    end = advanced(v, x, way, after);
    end.omega = 0.0;
    *left = dt - after;
    return end;
}

static Shaft flown(const Variables *v, Shaft x, double h)
{
    const double parts = ceil(h / DT_MAX);
    for (double part = 0.0; part < parts; part++) {
        double left = h / parts;
        while (left > 0.0) {
            const double way = direction(v, x.omega);
            if (way == 0.0) break;
            const double before = left, omega = x.omega;
            x = until_rest(v, x, way, before, &left);
            /* what overcomes friction by less than rounding does not overcome it */
            if (omega == 0.0 && left >= before) break;
        }
    }
    return x;
}

/* The firmware ticks every T_c on its own clock, wherever the communication points fall; a tick that falls on one, up to
 * rounding, belongs to the step that begins there and sees that step's inputs. */
bool model_step(Variables *v, double h)
{
    const double rounding = 1e-6 * v->T_c;
    Shaft x = {v->theta_m, v->omega_m};
    for (double left = h; left > 0.0;) {
        if (v->until_tick <= 0.0) {
            control(v, x.theta);
            v->until_tick += v->T_c;
        }
        const double dt = v->until_tick < left - rounding ? v->until_tick : left;
        x = flown(v, x, dt);
        v->until_tick -= dt;
        left -= dt;
    }
    v->theta_m = x.theta;
    v->omega_m = x.omega;
    v->tau_motor = motor_torque(v, x.omega);
    v->current = v->tau_motor / v->k_t;
    return isfinite(x.theta) && isfinite(x.omega);
}
