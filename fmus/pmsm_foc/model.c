/* Surface permanent-magnet machine in rotor coordinates under field-oriented control.
 * Machine: equations (1) to (5) of README.md; controller: (6) to (13); clock: (14). */
#include "model.h"

#include <math.h>

static const double TURN = 6.283185307179586; /* 2 pi, rad */

/* What the parameters of one step imply. */
typedef struct {
    double k_t;        /* torque per current, (4) */
    double g_1, g_2;   /* observer, (7) */
    double kp_v, ki_v; /* velocity loop, (8): gain, and gain per tick of its integral */
    double kp_i, r_i;  /* current loops, (10): gain, and share of it that a tick adds to the integral */
    double v_max;      /* radius of the voltage circle, (12) */
} Design;

static Design design(const Variables *v)
{
    const double k_t = 1.5 * v->p * v->psi;
    const double z_o = exp(-v->omega_o * v->T_c);
    const double kp_v = v->J_m * v->omega_v / k_t;
    const double r_i = -expm1(-v->R / v->L * v->T_c);
    return (Design){
        .k_t = k_t,
        .g_1 = 1.0 - z_o * z_o,
        .g_2 = (1.0 - z_o) * (1.0 - z_o) / v->T_c,
        .kp_v = kp_v,
        .ki_v = 0.25 * kp_v * v->omega_v * v->T_c,
        .kp_i = -expm1(-v->omega_i * v->T_c) * v->R / r_i,
        .r_i = r_i,
        .v_max = v->V_bus / sqrt(3.0),
    };
}

/* (6), (7): the encoder's count, and the observer's angle and speed after it */
static void observe(Variables *v, const Design *k)
{
    const double resolution = TURN / v->counts;
    const double theta = resolution * floor(v->theta_m / resolution + 0.5);
    v->theta_obs += v->T_c * v->omega_obs;
    const double error = theta - v->theta_obs;
    v->theta_obs += k->g_1 * error;
    v->omega_obs += k->g_2 * error;
}

/* (8), (9): velocity loop with the current limit; what the limit cuts off is taken back from the integral */
static void control_velocity(Variables *v, const Design *k)
{
    const double error = v->omega_ref - v->omega_obs;
    const double wanted = k->kp_v * error + v->x_v;
    v->i_q_ref = fmin(fmax(wanted, -v->i_max), v->i_max);
    v->x_v += k->ki_v * (error + (v->i_q_ref - wanted) / k->kp_v);
}

/* (10) to (13): current loops, decoupled, within the voltage circle, integrals held back as in (9) */
static void control_current(Variables *v, const Design *k)
{
    const double omega_e = v->p * v->omega_obs;
    const double error_d = -v->i_d;
    const double error_q = v->i_q_ref - v->current;
    const double wanted_d = k->kp_i * error_d + v->x_d - omega_e * v->L * v->current;
    const double wanted_q = k->kp_i * error_q + v->x_q + omega_e * (v->L * v->i_d + v->psi);
    const double amplitude = sqrt(wanted_d * wanted_d + wanted_q * wanted_q);
    const double scale = amplitude > k->v_max ? k->v_max / amplitude : 1.0;
    v->v_d = scale * wanted_d;
    v->v_q = scale * wanted_q;
    v->x_d += k->r_i * (k->kp_i * error_d + v->v_d - wanted_d);
    v->x_q += k->r_i * (k->kp_i * error_q + v->v_q - wanted_q);
}

typedef struct {
    double i_d, i_q, omega, theta;
} Machine;

/* (1) to (5): rates of change of the machine's state */
static Machine rates(const Variables *v, const Design *k, Machine x)
{
    const double omega_e = v->p * x.omega;
    const double bend = sqrt(x.omega * x.omega + v->omega_c * v->omega_c);
    const double friction = v->b_m * x.omega + v->tau_c * x.omega / bend;
    return (Machine){
        .i_d = (v->v_d - v->R * x.i_d) / v->L + omega_e * x.i_q,
        .i_q = (v->v_q - v->R * x.i_q - omega_e * v->psi) / v->L - omega_e * x.i_d,
        .omega = (k->k_t * x.i_q - v->tau_load - friction) / v->J_m,
        .theta = x.omega,
    };
}

static Machine moved(Machine x, Machine dx, double dt)
{
    return (Machine){
        .i_d = x.i_d + dt * dx.i_d,
        .i_q = x.i_q + dt * dx.i_q,
        .omega = x.omega + dt * dx.omega,
        .theta = x.theta + dt * dx.theta,
    };
}

/* One classical Runge-Kutta step of order 4 over dt <= T_c with the voltages held */
static void run_machine(Variables *v, const Design *k, double dt)
{
    Machine x = {v->i_d, v->current, v->omega_m, v->theta_m};
    const Machine k_1 = rates(v, k, x);
    const Machine k_2 = rates(v, k, moved(x, k_1, 0.5 * dt));
    const Machine k_3 = rates(v, k, moved(x, k_2, 0.5 * dt));
    const Machine k_4 = rates(v, k, moved(x, k_3, dt));
    x = moved(x, k_1, dt / 6.0);
    x = moved(x, k_2, dt / 3.0);
    x = moved(x, k_3, dt / 3.0);
    x = moved(x, k_4, dt / 6.0);
    v->i_d = x.i_d, v->current = x.i_q, v->omega_m = x.omega, v->theta_m = x.theta;
}

/* (14): the controller ticks every T_c on its own clock, wherever the communication points fall. `until_tick`
 * is counted down and never set, so no time is lost. A tick that falls on a communication point, up to
 * rounding, belongs to the step that begins there and sees that step's inputs. */
bool model_step(Variables *v, double h)
{
    const Design k = design(v);
    const double rounding = 1e-6 * v->T_c;
    for (double left = h; left > 0.0;) {
        if (v->until_tick <= 0.0) {
            observe(v, &k);
            control_velocity(v, &k);
            control_current(v, &k);
            v->until_tick += v->T_c;
        }
        const double dt = v->until_tick < left - rounding ? v->until_tick : left;
        run_machine(v, &k, dt);
        v->until_tick -= dt;
        left -= dt;
    }
    v->tau_motor = k.k_t * v->current; /* (4) */
    return isfinite(v->theta_m);
}
