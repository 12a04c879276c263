/* FMI 2.0 for co-simulation (FMI 2.0.4, chapters 2 and 4) in front of a part. */
#include "fmi2Functions.h"
#include "instance.c"

#include <stdlib.h>
#include <stdio.h>

#define STATUS(call) ((call) ? fmi2OK : fmi2Error)

static void log_fmi2(const Instance *it, const char *text)
{
    const fmi2CallbackLogger logger = (fmi2CallbackLogger)it->logger;
    if (logger)
        logger(it->environment, it->name, fmi2Error, "logStatusError", "%s", text);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    /* errors are always logged, and there is nothing else to switch */
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging_on)
{
    (void)resources, (void)visible, (void)logging_on;
    static const Instance NO_INSTANCE;
    Instance unborn = NO_INSTANCE;
    unborn.log = log_fmi2;
    unborn.logger = functions ? (void *)functions->logger : NULL;
    unborn.environment = functions ? functions->componentEnvironment : NULL;
    snprintf(unborn.name, sizeof unborn.name, "%s", name ? name : "");
    if (type != fmi2CoSimulation) {
        refuse(&unborn, "this FMU offers co-simulation only");
        return NULL;
    }
    return instance_born(&unborn, guid);
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start_time,
                               fmi2Boolean stop_time_defined, fmi2Real stop_time)
{
    (void)tolerance_defined, (void)tolerance;
    Instance *it = c;
    if (it->state.mode != INSTANTIATED)
        return STATUS(refuse_in_mode(it, "fmi2SetupExperiment"));
    return STATUS(instance_times(it, start_time, stop_time_defined, stop_time));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    return STATUS(instance_enter(c, INSTANTIATED, INITIALIZATION, "fmi2EnterInitializationMode"));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return STATUS(instance_initialised(c)); }

fmi2Status fmi2Terminate(fmi2Component c) { return STATUS(instance_enter(c, STEPPING, TERMINATED, "fmi2Terminate")); }

fmi2Status fmi2Reset(fmi2Component c)
{
    instance_reset(c);
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_set_state_prior_to_t)
{
    (void)no_set_state_prior_to_t;
    return STATUS(instance_step(c, t, h));
}

/* Every value is a variable of its own. */
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    for (size_t k = 0; k < n; k++)
        if (!instance_get(c, vr[k], &value[k]))
            return fmi2Error;
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    for (size_t k = 0; k < n; k++)
        if (!instance_set(c, vr[k], &value[k]))
            return fmi2Error;
    return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *saved) { return STATUS(instance_save(c, saved)); }

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate saved) { return STATUS(instance_restore(c, saved)); }

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
    return STATUS(instance_serialize(c, saved, (unsigned char *)bytes, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *saved)
{
    return STATUS(instance_deserialize(c, (const unsigned char *)bytes, size, saved));
}

#define REFUSE_VARIABLES(function, type)                                                                     \
    fmi2Status function(fmi2Component c, const fmi2ValueReference vr[], size_t n, type value[])              \
    {                                                                                                        \
        (void)vr, (void)value;                                                                               \
        return STATUS(n == 0 || refuse(c, #function ": all variables of this FMU are Real"));                \
    }

REFUSE_VARIABLES(fmi2GetInteger, fmi2Integer)
REFUSE_VARIABLES(fmi2GetBoolean, fmi2Boolean)
REFUSE_VARIABLES(fmi2GetString, fmi2String)
REFUSE_VARIABLES(fmi2SetInteger, const fmi2Integer)
REFUSE_VARIABLES(fmi2SetBoolean, const fmi2Boolean)
REFUSE_VARIABLES(fmi2SetString, const fmi2String)

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr, (void)n, (void)order, (void)value;
    return STATUS(refuse(c, "fmi2SetRealInputDerivatives: inputs are held (canInterpolateInputs is false)"));
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)n, (void)order, (void)value;
    return STATUS(refuse(c, "fmi2GetRealOutputDerivatives: not offered (maxOutputDerivativeOrder is 0)"));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
                                        const fmi2ValueReference known[], size_t n_known, const fmi2Real d_known[],
                                        fmi2Real d_unknown[])
{
    (void)unknown, (void)n_unknown, (void)known, (void)n_known, (void)d_known, (void)d_unknown;
    return STATUS(refuse(c, "fmi2GetDirectionalDerivative: not offered (providesDirectionalDerivative is false)"));
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return STATUS(refuse(c, "fmi2CancelStep: steps are synchronous (canRunAsynchronuously is false)"));
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime)
        return fmi2Discard;
    *value = part_time(&((Instance *)c)->state);
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)c;
    if (kind != fmi2Terminated)
        return fmi2Discard;
    *value = fmi2False; /* it never ends a simulation by itself */
    return fmi2OK;
}

/* No step is ever pending. */
#define DISCARD_STATUS(function, type)                                                                       \
    fmi2Status function(fmi2Component c, const fmi2StatusKind kind, type *value)                             \
    {                                                                                                        \
        (void)c, (void)kind, (void)value;                                                                    \
        return fmi2Discard;                                                                                  \
    }

DISCARD_STATUS(fmi2GetStatus, fmi2Status)
DISCARD_STATUS(fmi2GetIntegerStatus, fmi2Integer)
DISCARD_STATUS(fmi2GetStringStatus, fmi2String)
