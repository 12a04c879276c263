/* Three velocity servos with droop in one FMI 3.0 FMU, their inputs and outputs arrays of 3; solved exactly.
 * Replaces model.c, access.c and variables.c of torque_motor_fmi3. A value reference is an array's number. */
#include "slave.h"

#include <math.h>

const Variable variables[N_VARIABLES] = {{0}};

bool model_step(Variables *v, double h)
{
    const double T_m = 0.020, droop = 0.6, decay = -expm1(-h / T_m);
    for (int i = 0; i < 3; i++) {
        const double target = v->omega_ref[i] - droop * v->tau_load[i];
        const double error = target - v->omega_m[i];
        v->theta_m[i] += target * h - error * T_m * decay;
        v->omega_m[i] += error * decay;
    }
    return true;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3Float64 values[],
                          size_t n_values)
{
    const Slave *slave = instance;
    if (n_values != 3 * n)
        return fmi3Error;
    for (size_t k = 0; k < n_values; k++)
        values[k] = slave->state.v.at[3 * vr[k / 3] + k % 3];
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, const fmi3Float64 values[],
                          size_t n_values)
{
    Slave *slave = instance;
    if (n_values != 3 * n)
        return fmi3Error;
    for (size_t k = 0; k < n_values; k++)
        slave->state.v.at[3 * vr[k / 3] + k % 3] = values[k];
    return fmi3OK;
}

#define NONE(type)                                                                                                \
    fmi3Status fmi3Get##type(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3##type v[], size_t m)        \
    {                                                                                                                 \
        (void)i, (void)r, (void)n, (void)v, (void)m;                                                                  \
        return fmi3Error;                                                                                             \
    }                                                                                                                 \
    fmi3Status fmi3Set##type(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3##type v[], size_t m)  \
    {                                                                                                                 \
        (void)i, (void)r, (void)n, (void)v, (void)m;                                                                  \
        return fmi3Error;                                                                                             \
    }

NONE(Float32)
NONE(Int32)
NONE(Boolean)
