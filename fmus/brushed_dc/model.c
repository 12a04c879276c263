/* Brushed permanent-magnet motor behind an averaged H-bridge, with a rigid gearbox. Equations (1) to (11) of
 * README.md. */
#include "model.h"

#include <math.h>

static const double DEGREE = 0.017453292519943295; /* pi/180, rad */
static const double RPM = 0.10471975511965977;     /* 2 pi/60, rad/s */
static const double MILLI = 1e-3;
static const double T_REFERENCE = 25.0; /* at which R is given, degC */
static const double DT_MAX = 25e-6;     /* (11), s */

static double clamp(double x, double lo, double hi) { return fmin(fmax(x, lo), hi); }

/* sign(x) with a bend of this width, for (3), (5) and (7) */
static double soft_sign(double x, double width) { return x / sqrt(x * x + width * width); }

/* The machine's state, the shaft before the gearbox. */
typedef struct {
    double i, omega, phi, T;
} Machine;

/* (1): what the modulator's register holds */
static double duty(const Variables *v)
{
    const double wanted = v->v_bus > 0.0 ? clamp(v->u_cmd / v->v_bus, -1.0, 1.0) : 0.0;
    return floor(wanted * v->levels + 0.5) / v->levels;
}

/* (6) */
static double resistance(const Variables *v, double T) { return v->R * (1.0 + v->alpha * (T - T_REFERENCE)); }

/* (5): the voltage at which the current stays as it is */
static double holding_voltage(const Variables *v, Machine x)
{
    return resistance(v, x.T) * x.i + v->u_brush * soft_sign(x.i, v->i_c) + v->k_t * x.omega;
}

/* (2) to (4): mean voltage of the bridge at the motor's terminals */
static double bridge_voltage(const Variables *v, double d, Machine x)
{
    const double dead = v->T_dead * v->f_pwm * soft_sign(x.i, v->i_c);
    const double open = (d - dead) * v->v_bus;
    if (x.i >= v->i_max)
        return fmin(open, holding_voltage(v, x));
    if (x.i <= -v->i_max)
        return fmax(open, holding_voltage(v, x));
    return open;
}

/* (5), (7) to (9): rates of change; `tau_load` is the load as the motor's shaft feels it */
static Machine rates(const Variables *v, double d, double tau_load, Machine x)
{
    const double friction = v->tau_c + (1.0 / v->eta - 1.0) * fabs(tau_load);
    const double heat = resistance(v, x.T) * x.i * x.i + v->u_brush * soft_sign(x.i, v->i_c) * x.i;
    return (Machine){
        .i = (bridge_voltage(v, d, x) - holding_voltage(v, x)) / v->L,
        .omega = (v->k_t * x.i - tau_load - v->b_m * x.omega - friction * soft_sign(x.omega, v->omega_c)) / v->J_m,
        .phi = x.omega / v->G,
        .T = (heat - (x.T - v->T_amb) / v->R_th) / v->C_th,
    };
}

static Machine moved(Machine x, Machine dx, double dt)
{
    return (Machine){
        .i = x.i + dt * dx.i,
        .omega = x.omega + dt * dx.omega,
        .phi = x.phi + dt * dx.phi,
        .T = x.T + dt * dx.T,
    };
}

/* One classical Runge-Kutta step of order 4; the current that a step carries past the limit is cut off, (4) */
static Machine advanced(const Variables *v, double d, double tau_load, Machine x, double dt)
{
    const Machine k_1 = rates(v, d, tau_load, x);
    const Machine k_2 = rates(v, d, tau_load, moved(x, k_1, 0.5 * dt));
    const Machine k_3 = rates(v, d, tau_load, moved(x, k_2, 0.5 * dt));
    const Machine k_4 = rates(v, d, tau_load, moved(x, k_3, dt));
    x = moved(x, k_1, dt / 6.0);
    x = moved(x, k_2, dt / 3.0);
    x = moved(x, k_3, dt / 3.0);
    x = moved(x, k_4, dt / 6.0);
    x.i = clamp(x.i, -v->i_max, v->i_max);
    return x;
}

/* (11): equal parts of at most DT_MAX */
bool model_step(Variables *v, double h)
{
    const double d = duty(v);
    const double tau_load = v->M_load * MILLI / v->G;
    const double parts = ceil(h / DT_MAX);
    Machine x = {v->i_a, v->n * RPM * v->G, v->phi * DEGREE, v->T_w};
    for (double part = 0.0; part < parts; part++)
        x = advanced(v, d, tau_load, x, h / parts);
    v->i_a = x.i;
    v->n = x.omega / v->G / RPM;
    v->phi = x.phi / DEGREE;
    v->T_w = x.T;
    v->P_el = bridge_voltage(v, d, x) * x.i; /* (10) */
    return isfinite(v->phi) && isfinite(v->n);
}
