/* Serial-bus servo: registers on a bus, profile, velocity loop on encoder counts, geared motor. Equations (1) to (11)
 * of README.md. */
#include "model.h"

#include <math.h>

static const double TURN = 6.283185307179586;      /* 2 pi, rad */
static const double DEGREE = 0.017453292519943295; /* pi/180, rad */
static const double RPM = 0.10471975511965977;     /* 2 pi/60, rad/s */
static const double MILLI = 1e-3;
static const double DT_MAX = 50e-6; /* (10), s */

static double clamp(double x, double lo, double hi) { return fmin(fmax(x, lo), hi); }

static double rounded(double x, double unit) { return unit * floor(x / unit + 0.5); }

/* Shaft and load in SI units. */
typedef struct {
    double omega, theta;
} Shaft;

/* (8): torque of the geared motor at its output shaft */
static double motor_torque(const Variables *v, double omega)
{
    return v->stall_torque * (v->pwm - omega / (v->no_load_speed * RPM));
}

/* (3): angle of one encoder count */
static double resolution(const Variables *v) { return TURN / v->counts; }

/* (1), (2): one bus cycle: the goal goes in, the registers come out */
static void exchange_registers(Variables *v, Shaft shaft)
{
    const double current = motor_torque(v, shaft.omega) * v->stall_current / v->stall_torque;
    v->goal = clamp(rounded(v->goal_velocity, v->velocity_unit), -v->velocity_limit, v->velocity_limit);
    v->present_position = v->count * resolution(v) / DEGREE;
    v->present_velocity = rounded(v->omega_f / RPM, v->velocity_unit);
    v->present_current = rounded(current / MILLI, v->current_unit);
}

/* (3), (4): encoder and filtered speed */
static void measure(Variables *v, double theta)
{
    const double before = v->count;
    v->count = floor(theta / resolution(v) + 0.5);
    const double difference = (v->count - before) * resolution(v) / v->T_c;
    v->omega_f += v->T_c / v->T_f * (difference - v->omega_f);
}

/* (5) to (7): profile and velocity loop; what the modulator cannot give is taken back from the integral */
static void control(Variables *v)
{
    const double omega_0 = v->no_load_speed * RPM;
    const double step = v->profile_acceleration * RPM * v->T_c;
    v->omega_p += clamp(v->goal * RPM - v->omega_p, -step, step);
    const double error = v->theta_p - v->count * resolution(v);
    const double band = v->dead_band * resolution(v);
    const double wanted = (v->omega_p + v->k_i * (error - clamp(error, -band, band))) / omega_0;
    v->pwm = clamp(wanted, -1.0, 1.0);
    v->theta_p += v->omega_p * v->T_c + (v->pwm - wanted) * omega_0 / v->k_i;
}

/* (9) */
static Shaft rates(const Variables *v, Shaft x)
{
    const double width = v->friction_width * RPM;
    const double friction = v->friction * x.omega / sqrt(x.omega * x.omega + width * width);
    return (Shaft){
        .omega = (motor_torque(v, x.omega) - v->load_torque - friction) / v->inertia,
        .theta = x.omega,
    };
}

static Shaft moved(Shaft x, Shaft dx, double dt)
{
    return (Shaft){.omega = x.omega + dt * dx.omega, .theta = x.theta + dt * dx.theta};
}

/* (10): classical Runge-Kutta steps of order 4 in equal parts of at most DT_MAX, the modulator held */
static Shaft advanced(const Variables *v, Shaft x, double h)
{
    const double parts = ceil(h / DT_MAX);
    const double dt = h / parts;
    for (double part = 0.0; part < parts; part++) {
        const Shaft k_1 = rates(v, x);
        const Shaft k_2 = rates(v, moved(x, k_1, 0.5 * dt));
        const Shaft k_3 = rates(v, moved(x, k_2, 0.5 * dt));
        const Shaft k_4 = rates(v, moved(x, k_3, dt));
        x = moved(x, k_1, dt / 6.0);
        x = moved(x, k_2, dt / 3.0);
        x = moved(x, k_3, dt / 3.0);
        x = moved(x, k_4, dt / 6.0);
    }
    return x;
}

/* (11): the servo ticks every T_c on its own clock, wherever the communication points fall, and meets the bus every
 * `bus_ticks`. `until_tick` is counted down and never set, so no time is lost. A tick that falls on a communication
 * point, up to rounding, belongs to the step that begins there and sees that step's inputs. */
bool model_step(Variables *v, double h)
{
    const double rounding = 1e-6 * v->T_c;
    Shaft shaft = {v->shaft_speed * RPM, v->shaft_angle * DEGREE};
    for (double left = h; left > 0.0;) {
        if (v->until_tick <= 0.0) {
            measure(v, shaft.theta);
            if (v->until_bus <= 0.0) {
                exchange_registers(v, shaft);
                v->until_bus += v->bus_ticks;
            }
            control(v);
            v->until_bus -= 1.0;
            v->until_tick += v->T_c;
        }
        const double dt = v->until_tick < left - rounding ? v->until_tick : left;
        shaft = advanced(v, shaft, dt);
        v->until_tick -= dt;
        left -= dt;
    }
    v->shaft_speed = shaft.omega / RPM;
    v->shaft_angle = shaft.theta / DEGREE;
    return isfinite(v->shaft_angle) && isfinite(v->shaft_speed);
}
