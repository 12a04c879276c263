/* Birth, modes, steps and death of an instance (FMI 3.0.2, sections 2.3.1 and 4.2). */
#include "slave.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const MODE_NAMES[] = {"instantiated", "initialization", "step", "terminated"};

fmi3Status refuse(const Slave *slave, const char *format, ...)
{
    char text[256];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (slave->logger)
        slave->logger(slave->environment, fmi3Error, "logStatusError", text);
    return fmi3Error;
}

static fmi3Status refuse_in_mode(const Slave *slave, const char *function)
{
    return refuse(slave, "%s is not allowed in mode %s", function, MODE_NAMES[slave->state.mode]);
}

static void restore_start_values(State *state)
{
    memset(state, 0, sizeof *state);
    state->mode = INSTANTIATED;
    for (int k = 0; k < N_VARIABLES; k++)
        state->v.at[k] = variables[k].start;
}

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    /* errors are always logged and there are no debug messages to switch */
    (void)instance, (void)on, (void)n, (void)categories;
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                         fmi3Boolean visible, fmi3Boolean logging_on, fmi3Boolean event_mode_used,
                                         fmi3Boolean early_return_allowed, const fmi3ValueReference intermediate[],
                                         size_t n_intermediate, fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback logger, fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)resources, (void)visible, (void)logging_on, (void)early_return_allowed;
    (void)intermediate, (void)n_intermediate, (void)update;
    Slave born = {.logger = logger, .environment = environment};
    restore_start_values(&born.state);
    if (!token || strcmp(token, GUID) != 0) {
        refuse(&born, "wrong instantiation token: the binary has %s, modelDescription.xml belongs to another build",
               GUID);
        return NULL;
    }
    if (event_mode_used) {
        refuse(&born, "this FMU has no event mode (hasEventMode is false)");
        return NULL;
    }
    Slave *slave = malloc(sizeof *slave);
    if (!slave) {
        refuse(&born, "out of memory");
        return NULL;
    }
    memcpy(slave, &born, sizeof born);
    return slave;
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

static fmi3Status enter(Slave *slave, Mode from, Mode to, const char *function)
{
    if (slave->state.mode != from)
        return refuse_in_mode(slave, function);
    slave->state.mode = to;
    return fmi3OK;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start_time, fmi3Boolean stop_time_defined, fmi3Float64 stop_time)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_time_defined, (void)stop_time;
    Slave *slave = instance;
    const fmi3Status status = enter(slave, INSTANTIATED, INITIALIZATION, "fmi3EnterInitializationMode");
    if (status == fmi3OK)
        slave->state.time = start_time;
    return status;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return enter(instance, INITIALIZATION, STEPPING, "fmi3ExitInitializationMode");
}

fmi3Status fmi3Terminate(fmi3Instance instance) { return enter(instance, STEPPING, TERMINATED, "fmi3Terminate"); }

fmi3Status fmi3Reset(fmi3Instance instance)
{
    restore_start_values(&((Slave *)instance)->state);
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_set_state_prior_to_t,
                      fmi3Boolean *event_handling_needed, fmi3Boolean *terminate_simulation,
                      fmi3Boolean *early_return, fmi3Float64 *last_successful_time)
{
    (void)no_set_state_prior_to_t;
    Slave *slave = instance;
    *event_handling_needed = false;
    *terminate_simulation = false; /* a drive never ends a simulation by itself */
    *early_return = false;
    *last_successful_time = slave->state.time;
    if (slave->state.mode != STEPPING)
        return refuse_in_mode(slave, "fmi3DoStep");
    if (!(h > 0.0 && isfinite(h)))
        return refuse(slave, "fmi3DoStep: communicationStepSize is %g s; it must be positive and finite", h);
    if (!model_step(&slave->state.v, h))
        return refuse(slave, "fmi3DoStep from %g s over %g s: the result is not finite", t, h);
    slave->state.time = t + h;
    *last_successful_time = slave->state.time;
    return fmi3OK;
}
