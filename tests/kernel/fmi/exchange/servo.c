/* The equations of velocity_servo, not solved: (1) to (4) of its README.md. */
#define N_STATES 2
#define N_INDICATORS 0
#define FIRST_STATE 2

enum { OMEGA_REF, TAU_LOAD, THETA, OMEGA, T_M, DROOP, OMEGA_MAX, ALPHA_MAX, TAU_MAX, J_M };
enum { NOT_A_NUMBER = 1, ENDLESS, GROWING, FLICKERING, PAST, BLIND, NOW, ERROR, OVER, TOO_MANY, UNSCALED };
static const double STARTS[] = {0, 0, 0, 0, 0.020, 0.6, 8.0, 400.0, 0.6, 1e-4};
static const double NOMINALS[] = {1, 1};

static int fault(const Model *m) { return 0; }

static bool asks(Model *m) { return false; }

static double clamp(double x, double lo, double hi) { return fmin(fmax(x, lo), hi); }

static void rates(const Model *m, double dx[])
{
    const double *p = m->r;
    const double target = clamp(p[OMEGA_REF], -p[OMEGA_MAX], p[OMEGA_MAX]) - p[DROOP] * p[TAU_LOAD];
    const double lo_torque = (-p[TAU_MAX] - p[TAU_LOAD]) / p[J_M], hi_torque = (p[TAU_MAX] - p[TAU_LOAD]) / p[J_M];
    const double lo = clamp(-p[ALPHA_MAX], lo_torque, hi_torque), hi = clamp(p[ALPHA_MAX], lo_torque, hi_torque);
    dx[0] = m->x[1];
    dx[1] = clamp((target - m->x[1]) / p[T_M], lo, hi);
}

static void indicate(const Model *m, double z[]) {}
static int react(Model *m) { return 0; }
