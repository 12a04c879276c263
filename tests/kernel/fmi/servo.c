/* A servo that takes an angle in degrees and closes its own loop: d phi/dt = k (goal - phi) - c load, exactly.
 * It counts its angle over one turn, from -180 to 180 degrees. Replaces model.c of smart_servo; goal_velocity is its goal
 * angle, velocity_limit k in 1/s, and counts whether it wraps. */
#include "model.h"

#include <math.h>

static double wrapped(double angle) { return angle - 360.0 * floor((angle + 180.0) / 360.0); }

bool model_step(Variables *v, double h)
{
    double error = v->goal_velocity - v->omega_p;
    if (v->counts > 1.5) error = wrapped(error);
    const double decay = exp(-v->velocity_limit * h);
    v->omega_p += error * (1.0 - decay);
    v->shaft_speed = error * v->velocity_limit * decay / 6.0;
    v->shaft_angle = v->counts > 1.5 ? wrapped(v->omega_p) : v->omega_p;
    return isfinite(v->omega_p);
}
