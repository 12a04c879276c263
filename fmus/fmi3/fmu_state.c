/* Saving, restoring and serialising the state, one struct of plain numbers (FMI 3.0.2, section 2.2.6.4). */
#include "slave.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* A state that the importer does not yet own (*saved == NULL) is allocated; otherwise it is overwritten. */
static fmi3Status keep(const Slave *slave, const void *bytes, fmi3FMUState *saved)
{
    if (!*saved)
        *saved = malloc(sizeof(State));
    if (!*saved)
        return refuse(slave, "out of memory");
    memcpy(*saved, bytes, sizeof(State));
    return fmi3OK;
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *saved)
{
    const Slave *slave = instance;
    return keep(slave, &slave->state, saved);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState saved)
{
    Slave *slave = instance;
    if (!saved)
        return refuse(slave, "fmi3SetFMUState: there is no state to restore");
    memcpy(&slave->state, saved, sizeof(State));
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *saved)
{
    (void)instance;
    free(*saved);
    *saved = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState saved, size_t *size)
{
    (void)instance, (void)saved;
    *size = sizeof(State);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState saved, fmi3Byte bytes[], size_t size)
{
    if (size < sizeof(State))
        return refuse(instance, "fmi3SerializeFMUState: %zu bytes given, %zu needed", size, sizeof(State));
    memcpy(bytes, saved, sizeof(State));
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *saved)
{
    if (size != sizeof(State))
        return refuse(instance, "fmi3DeserializeFMUState: %zu bytes given, a state has %zu", size, sizeof(State));
    State state;
    memcpy(&state, bytes, sizeof state);
    if ((unsigned)state.mode > TERMINATED || !isfinite(state.time))
        return refuse(instance, "fmi3DeserializeFMUState: mode %u at %g s is no state of this drive", (unsigned)state.mode, state.time);
    for (int k = 0; k < N_VARIABLES; k++)
        if (!holds(&variables[k], state.v.at[k]))
            return refuse(instance, "fmi3DeserializeFMUState: %s = %g is no state of this drive", variables[k].name, state.v.at[k]);
    return keep(instance, &state, saved);
}
