/* Reading and writing variables (FMI 2.0.4, section 2.1.7). */
#include "slave.h"

#include <float.h>
#include <math.h>

/* A bound for people: the largest double stands for none. */
static double shown(double bound) { return fabs(bound) == DBL_MAX ? copysign(INFINITY, bound) : bound; }

bool holds(const Variable *variable, double value)
{
    return value >= variable->min && value <= variable->max && (!variable->is_whole || value == floor(value));
}

static fmi2Status refuse_reference(const Slave *slave, const char *function, fmi2ValueReference vr)
{
    return refuse(slave, "%s: unknown value reference %u, there are %d variables", function, vr, N_VARIABLES);
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    const Slave *slave = c;
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= N_VARIABLES)
            return refuse_reference(slave, "fmi2GetReal", vr[k]);
        value[k] = slave->state.v.at[vr[k]];
    }
    return fmi2OK;
}

static fmi2Status refuse_value(const Slave *slave, const Variable *variable, double value)
{
    if (!variable->is_input && slave->state.mode >= STEPPING)
        return refuse(slave, "fmi2SetReal: %s can only be set before the first step", variable->name);
    if (!isfinite(value))
        return refuse(slave, "fmi2SetReal: %s = %g is not finite", variable->name, value);
    return refuse(slave, "fmi2SetReal: %s = %g is outside %g to %g%s", variable->name, value, shown(variable->min),
                  shown(variable->max), variable->is_whole ? ", or not whole" : "");
}

/* Inputs may be set at any time, all others have a start value that may be changed until the first step. */
static bool accepts(const Slave *slave, const Variable *variable, double value)
{
    return (variable->is_input || slave->state.mode < STEPPING) && isfinite(value) && holds(variable, value);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    Slave *slave = c;
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= N_VARIABLES)
            return refuse_reference(slave, "fmi2SetReal", vr[k]);
        if (!accepts(slave, &variables[vr[k]], value[k]))
            return refuse_value(slave, &variables[vr[k]], value[k]);
    }
    for (size_t k = 0; k < n; k++)
        slave->state.v.at[vr[k]] = value[k];
    return fmi2OK;
}
