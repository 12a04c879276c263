/* A drive that goes wrong one second after its start, in the way that its parameter `droop` says:
 * 1: fmi2DoStep fails; 2: omega_m becomes NaN; 3: theta_m becomes infinite. */
#include "model.h"

#include <math.h>

bool model_step(Variables *v, double h)
{
    v->tau_motor += h; /* the time since the start */
    if (v->tau_motor < 1.0 - 0.5 * h)
        return true;
    if (v->droop == 2.0)
        v->omega_m = NAN;
    if (v->droop == 3.0)
        v->theta_m = INFINITY;
    return v->droop != 1.0;
}
