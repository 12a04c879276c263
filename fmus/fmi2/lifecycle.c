/* Birth, modes, steps and death of a slave (FMI 2.0.4, sections 2.1.5, 2.1.6, 4.2.2, 4.2.3). */
#include "slave.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const MODE_NAMES[] = {"instantiated", "initialization", "stepping", "terminated"};

fmi2Status refuse(const Slave *slave, const char *format, ...)
{
    char text[256];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (slave->logger)
        slave->logger(slave->environment, slave->name, fmi2Error, "logStatusError", text);
    return fmi2Error;
}

static fmi2Status refuse_in_mode(const Slave *slave, const char *function)
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

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    /* errors are always logged and there are no debug messages to switch */
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean logging_on)
{
    (void)resources, (void)visible, (void)logging_on;
    Slave born = {.logger = functions ? functions->logger : NULL,
                  .environment = functions ? functions->componentEnvironment : NULL};
    snprintf(born.name, sizeof born.name, "%s", name ? name : "");
    restore_start_values(&born.state);
    if (type != fmi2CoSimulation) {
        refuse(&born, "this FMU offers co-simulation only");
        return NULL;
    }
    if (!guid || strcmp(guid, GUID) != 0) {
        refuse(&born, "wrong GUID: the binary has %s, modelDescription.xml belongs to another build", GUID);
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

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                               fmi2Real start_time, fmi2Boolean stop_time_defined, fmi2Real stop_time)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_time_defined, (void)stop_time;
    Slave *slave = c;
    if (slave->state.mode != INSTANTIATED)
        return refuse_in_mode(slave, "fmi2SetupExperiment");
    slave->state.time = start_time;
    return fmi2OK;
}

static fmi2Status enter(Slave *slave, Mode from, Mode to, const char *function)
{
    if (slave->state.mode != from)
        return refuse_in_mode(slave, function);
    slave->state.mode = to;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    return enter(c, INSTANTIATED, INITIALIZATION, "fmi2EnterInitializationMode");
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    return enter(c, INITIALIZATION, STEPPING, "fmi2ExitInitializationMode");
}

fmi2Status fmi2Terminate(fmi2Component c) { return enter(c, STEPPING, TERMINATED, "fmi2Terminate"); }

fmi2Status fmi2Reset(fmi2Component c)
{
    restore_start_values(&((Slave *)c)->state);
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_set_state_prior_to_t)
{
    (void)no_set_state_prior_to_t;
    Slave *slave = c;
    if (slave->state.mode != STEPPING)
        return refuse_in_mode(slave, "fmi2DoStep");
    if (!(h > 0.0 && isfinite(h)))
        return refuse(slave, "fmi2DoStep: communicationStepSize is %g s; it must be positive and finite", h);
    if (!model_step(&slave->state.v, h))
        return refuse(slave, "fmi2DoStep from %g s over %g s: the result is not finite", t, h);
    slave->state.time = t + h;
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime)
        return fmi2Discard;
    *value = ((Slave *)c)->state.time;
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)c;
    if (kind != fmi2Terminated)
        return fmi2Discard;
    *value = fmi2False; /* a drive never ends a simulation by itself */
    return fmi2OK;
}
