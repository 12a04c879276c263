/* A perfect velocity source: the shaft turns as commanded. Equations (1) and (2) of README.md. */
#include "model.h"

#include <math.h>

bool model_step(Variables *v, double h)
{
    v->omega_m = v->omega_ref;       /* (1) */
    v->theta_m += v->omega_ref * h;  /* (2) */
    return isfinite(v->theta_m);
}
