/* Reading and writing variables (FMI 3.0.2, section 2.2.6.2). */
#include "slave.h"

#include <float.h>
#include <math.h>

/* A bound for people: the largest double stands for none. */
static double shown(double bound) { return fabs(bound) == DBL_MAX ? copysign(INFINITY, bound) : bound; }

bool holds(const Variable *variable, double value)
{
    return value >= variable->min && value <= variable->max && (!variable->is_whole || value == floor(value));
}

static const char *const TYPE_NAMES[] = {"Float64", "Float32", "Int32", "Boolean"};

/* Whether `n` references of scalars of `type` go with `n_values` values; logs the first reason why not. */
static bool fits(const Slave *slave, const char *verb, Type type, const fmi3ValueReference vr[], size_t n,
                 size_t n_values)
{
    if (n != n_values) {
        refuse(slave, "fmi3%s%s: %zu values for %zu scalars", verb, TYPE_NAMES[type], n_values, n);
        return false;
    }
    for (size_t k = 0; k < n; k++) {
        if (vr[k] > TIME_REFERENCE) {
            refuse(slave, "fmi3%s%s: unknown value reference %u, the last is %d", verb, TYPE_NAMES[type], vr[k],
                   TIME_REFERENCE);
            return false;
        }
        const Type its_type = vr[k] == TIME_REFERENCE ? Float64 : variables[vr[k]].type;
        if (its_type != type) {
            refuse(slave, "fmi3%s%s: variable %u is a %s", verb, TYPE_NAMES[type], vr[k], TYPE_NAMES[its_type]);
            return false;
        }
    }
    return true;
}

static double value_of(const Slave *slave, fmi3ValueReference vr)
{
    return vr == TIME_REFERENCE ? slave->state.time : slave->state.v.at[vr];
}

/* Inputs may be set at any time, all others have a start value that may be changed until the first step. */
static bool accepts(const Slave *slave, Type type, fmi3ValueReference vr, double value)
{
    const char *name = TYPE_NAMES[type];
    if (vr == TIME_REFERENCE) {
        refuse(slave, "fmi3Set%s: time moves only with a step", name);
        return false;
    }
    const Variable *variable = &variables[vr];
    if (!variable->is_input && slave->state.mode >= STEPPING) {
        refuse(slave, "fmi3Set%s: %s can only be set before the first step", name, variable->name);
        return false;
    }
    if (!isfinite(value)) {
        refuse(slave, "fmi3Set%s: %s = %g is not finite", name, variable->name, value);
        return false;
    }
    if (!holds(variable, value)) {
        refuse(slave, "fmi3Set%s: %s = %g is outside %g to %g%s", name, variable->name, value, shown(variable->min),
               shown(variable->max), variable->is_whole ? ", or not whole" : "");
        return false;
    }
    return true;
}

#define ACCESS(type)                                                                                         \
    fmi3Status fmi3Get##type(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,                 \
                             fmi3##type values[], size_t n_values)                                           \
    {                                                                                                        \
        const Slave *slave = instance;                                                                       \
        if (!fits(slave, "Get", type, vr, n, n_values))                                                      \
            return fmi3Error;                                                                                \
        for (size_t k = 0; k < n; k++)                                                                       \
            values[k] = (fmi3##type)value_of(slave, vr[k]);                                                  \
        return fmi3OK;                                                                                       \
    }                                                                                                        \
                                                                                                             \
    fmi3Status fmi3Set##type(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,                 \
                             const fmi3##type values[], size_t n_values)                                     \
    {                                                                                                        \
        Slave *slave = instance;                                                                             \
        if (!fits(slave, "Set", type, vr, n, n_values))                                                      \
            return fmi3Error;                                                                                \
        for (size_t k = 0; k < n; k++)                                                                       \
            if (!accepts(slave, type, vr[k], (double)values[k]))                                             \
                return fmi3Error;                                                                            \
        for (size_t k = 0; k < n; k++)                                                                       \
            slave->state.v.at[vr[k]] = (double)values[k];                                                    \
        return fmi3OK;                                                                                       \
    }

ACCESS(Float64)
ACCESS(Float32)
ACCESS(Int32)
ACCESS(Boolean)
