/* Saving, restoring and serialising the state, one struct of plain numbers (FMI 2.0.4, section 2.1.8). */
#include "slave.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* A state that the importer does not yet own (*saved == NULL) is allocated; otherwise it is overwritten. */
static fmi2Status keep(const Slave *slave, const void *bytes, fmi2FMUstate *saved)
{
    if (!*saved)
        *saved = malloc(sizeof(State));
    if (!*saved)
        return refuse(slave, "out of memory");
    memcpy(*saved, bytes, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *saved)
{
    const Slave *slave = c;
    return keep(slave, &slave->state, saved);
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate saved)
{
    Slave *slave = c;
    if (!saved)
        return refuse(slave, "fmi2SetFMUstate: there is no state to restore");
    memcpy(&slave->state, saved, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *saved)
{
    (void)c;
    free(*saved);
    *saved = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate saved, size_t *size)
{
    (void)c, (void)saved;
    *size = sizeof(State);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate saved, fmi2Byte bytes[], size_t size)
{
    if (size < sizeof(State))
        return refuse(c, "fmi2SerializeFMUstate: %zu bytes given, %zu needed", size, sizeof(State));
    memcpy(bytes, saved, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *saved)
{
    if (size != sizeof(State))
        return refuse(c, "fmi2DeSerializeFMUstate: %zu bytes given, a state has %zu", size, sizeof(State));
    State state;
    memcpy(&state, bytes, sizeof state);
    if ((unsigned)state.mode > TERMINATED || !isfinite(state.time))
        return refuse(c, "fmi2DeSerializeFMUstate: mode %u at %g s is no state of this drive", (unsigned)state.mode, state.time);
    for (int k = 0; k < N_VARIABLES; k++)
        if (!holds(&variables[k], state.v.at[k]))
            return refuse(c, "fmi2DeSerializeFMUstate: %s = %g is no state of this drive", variables[k].name, state.v.at[k]);
    return keep(c, &state, saved);
}
