/* FMI 3.0 for co-simulation (FMI 3.0.2, chapters 2 and 4) in front of a part. */
#include "fmi3Functions.h"
#include "instance.c"

#include <stdlib.h>

#define STATUS(call) ((call) ? fmi3OK : fmi3Error)

static void log_fmi3(const Instance *it, const char *text)
{
    const fmi3LogMessageCallback logger = (fmi3LogMessageCallback)it->logger;
    if (logger)
        logger(it->environment, fmi3Error, "logStatusError", text);
}

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    /* errors are always logged, and there is nothing else to switch */
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
    const Instance unborn = {.log = log_fmi3, .logger = (void *)logger, .environment = environment};
    if (event_mode_used) {
        refuse(&unborn, "this FMU has no event mode (hasEventMode is false)");
        return NULL;
    }
    return instance_born(&unborn, token);
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start_time, fmi3Boolean stop_time_defined, fmi3Float64 stop_time)
{
    (void)tolerance_defined, (void)tolerance;
    Instance *it = instance;
    if (it->state.mode != INSTANTIATED)
        return STATUS(refuse_in_mode(it, "fmi3EnterInitializationMode"));
    return STATUS(instance_times(it, start_time, stop_time_defined, stop_time)
                  && instance_enter(it, INSTANTIATED, INITIALIZATION, "fmi3EnterInitializationMode"));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) { return STATUS(instance_initialised(instance)); }

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    return STATUS(instance_enter(instance, STEPPING, TERMINATED, "fmi3Terminate"));
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    instance_reset(instance);
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_set_state_prior_to_t,
                      fmi3Boolean *event_handling_needed, fmi3Boolean *terminate_simulation,
                      fmi3Boolean *early_return, fmi3Float64 *last_successful_time)
{
    (void)no_set_state_prior_to_t;
    *event_handling_needed = *terminate_simulation = *early_return = false;
    const bool done = instance_step(instance, t, h);
    *last_successful_time = part_time(&((Instance *)instance)->state);
    return STATUS(done);
}

/* The independent variable, which FMI 3.0 requires, stands behind all others. */
#define TIME_REFERENCE N_VARIABLES

static size_t size_of(fmi3ValueReference vr) { return vr < N_VARIABLES ? variables[vr].size : 1; }

static bool fits(const Instance *it, const fmi3ValueReference vr[], size_t n, size_t n_values)
{
    size_t needed = 0;
    for (size_t k = 0; k < n; k++)
        needed += size_of(vr[k]);
    return needed == n_values || refuse(it, "%zu values for variables that have %zu", n_values, needed);
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3Float64 values[],
                          size_t n_values)
{
    if (!fits(instance, vr, n, n_values))
        return fmi3Error;
    for (size_t k = 0; k < n; values += size_of(vr[k]), k++)
        if (vr[k] == TIME_REFERENCE)
            *values = part_time(&((Instance *)instance)->state);
        else if (!instance_get(instance, vr[k], values))
            return fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, const fmi3Float64 values[],
                          size_t n_values)
{
    if (!fits(instance, vr, n, n_values))
        return fmi3Error;
    for (size_t k = 0; k < n; values += size_of(vr[k]), k++)
        if (!instance_set(instance, vr[k], values))
            return fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *saved)
{
    return STATUS(instance_save(instance, saved));
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState saved)
{
    return STATUS(instance_restore(instance, saved));
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
    return STATUS(instance_serialize(instance, saved, bytes, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *saved)
{
    return STATUS(instance_deserialize(instance, bytes, size, saved));
}

/* What is not offered. The standard wants the functions of co-simulation exported; those of model exchange and
 * scheduled execution are here because importers exist that look for all of them. */

/* Each of them refuses without looking at what it is asked. */
#pragma GCC diagnostic ignored "-Wunused-parameter"

#define REFUSE(function, reason, ...)                                                                        \
    fmi3Status function(fmi3Instance instance, __VA_ARGS__) { return STATUS(refuse(instance, #function ": " reason)); }

#define REFUSE_PLAIN(function, reason)                                                                       \
    fmi3Status function(fmi3Instance instance) { return STATUS(refuse(instance, #function ": " reason)); }

#define REFERENCES const fmi3ValueReference vr[], size_t n

#define REFUSE_TYPE(type)                                                                                    \
    REFUSE(fmi3Get##type, "no variable has this type", REFERENCES, fmi3##type values[], size_t n_values)     \
    REFUSE(fmi3Set##type, "no variable has this type", REFERENCES, const fmi3##type values[], size_t n_values)

REFUSE_TYPE(Float32)
REFUSE_TYPE(Int8)
REFUSE_TYPE(UInt8)
REFUSE_TYPE(Int16)
REFUSE_TYPE(UInt16)
REFUSE_TYPE(UInt32)
REFUSE_TYPE(Int32)
REFUSE_TYPE(Int64)
REFUSE_TYPE(UInt64)
REFUSE_TYPE(Boolean)
REFUSE_TYPE(String)

REFUSE(fmi3GetBinary, "no variable has this type", REFERENCES, size_t sizes[], fmi3Binary values[], size_t n_values)
REFUSE(fmi3SetBinary, "no variable has this type", REFERENCES, const size_t sizes[], const fmi3Binary values[],
       size_t n_values)

#define NO_CLOCKS "there are no clocks"

REFUSE(fmi3GetClock, NO_CLOCKS, REFERENCES, fmi3Clock values[])
REFUSE(fmi3SetClock, NO_CLOCKS, REFERENCES, const fmi3Clock values[])
REFUSE(fmi3GetIntervalDecimal, NO_CLOCKS, REFERENCES, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
REFUSE(fmi3GetIntervalFraction, NO_CLOCKS, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
       fmi3IntervalQualifier qualifiers[])
REFUSE(fmi3GetShiftDecimal, NO_CLOCKS, REFERENCES, fmi3Float64 shifts[])
REFUSE(fmi3GetShiftFraction, NO_CLOCKS, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
REFUSE(fmi3SetIntervalDecimal, NO_CLOCKS, REFERENCES, const fmi3Float64 intervals[])
REFUSE(fmi3SetIntervalFraction, NO_CLOCKS, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
REFUSE(fmi3SetShiftDecimal, NO_CLOCKS, REFERENCES, const fmi3Float64 shifts[])
REFUSE(fmi3SetShiftFraction, NO_CLOCKS, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])

#define NO_EVENTS "there is no event mode (hasEventMode is false)"

REFUSE_PLAIN(fmi3EnterEventMode, NO_EVENTS)
REFUSE_PLAIN(fmi3EnterStepMode, NO_EVENTS)
REFUSE_PLAIN(fmi3EvaluateDiscreteStates, NO_EVENTS)
REFUSE(fmi3UpdateDiscreteStates, NO_EVENTS, fmi3Boolean *need_update, fmi3Boolean *terminate,
       fmi3Boolean *nominals_changed, fmi3Boolean *states_changed, fmi3Boolean *next_time_defined,
       fmi3Float64 *next_time)

REFUSE_PLAIN(fmi3EnterConfigurationMode, "there are no structural parameters")
REFUSE_PLAIN(fmi3ExitConfigurationMode, "there are no structural parameters")

#define NO_DEPENDENCIES "sizes are fixed, ModelStructure says it all (providesPerElementDependencies is false)"

REFUSE(fmi3GetNumberOfVariableDependencies, NO_DEPENDENCIES, fmi3ValueReference vr, size_t *n)
REFUSE(fmi3GetVariableDependencies, NO_DEPENDENCIES, fmi3ValueReference dependent, size_t elements[],
       fmi3ValueReference independents[], size_t independent_elements[], fmi3DependencyKind kinds[], size_t n)

#define DERIVATIVES                                                                                          \
    const fmi3ValueReference unknowns[], size_t n_unknowns, const fmi3ValueReference knowns[],               \
        size_t n_knowns, const fmi3Float64 seed[], size_t n_seed, fmi3Float64 sensitivity[], size_t n

REFUSE(fmi3GetDirectionalDerivative, "not offered (providesDirectionalDerivatives is false)", DERIVATIVES)
REFUSE(fmi3GetAdjointDerivative, "not offered (providesAdjointDerivatives is false)", DERIVATIVES)
REFUSE(fmi3GetOutputDerivatives, "not offered (maxOutputDerivativeOrder is 0)", REFERENCES,
       const fmi3Int32 orders[], fmi3Float64 values[], size_t n_values)

#define CO_SIMULATION_ONLY "this FMU offers co-simulation only"

REFUSE_PLAIN(fmi3EnterContinuousTimeMode, CO_SIMULATION_ONLY)
REFUSE(fmi3CompletedIntegratorStep, CO_SIMULATION_ONLY, fmi3Boolean no_set_state_prior, fmi3Boolean *enter_event_mode,
       fmi3Boolean *terminate)
REFUSE(fmi3SetTime, CO_SIMULATION_ONLY, fmi3Float64 time)
REFUSE(fmi3SetContinuousStates, CO_SIMULATION_ONLY, const fmi3Float64 states[], size_t n)
REFUSE(fmi3GetContinuousStates, CO_SIMULATION_ONLY, fmi3Float64 states[], size_t n)
REFUSE(fmi3GetContinuousStateDerivatives, CO_SIMULATION_ONLY, fmi3Float64 derivatives[], size_t n)
REFUSE(fmi3GetNominalsOfContinuousStates, CO_SIMULATION_ONLY, fmi3Float64 nominals[], size_t n)
REFUSE(fmi3GetEventIndicators, CO_SIMULATION_ONLY, fmi3Float64 indicators[], size_t n)
REFUSE(fmi3GetNumberOfEventIndicators, CO_SIMULATION_ONLY, size_t *n)
REFUSE(fmi3GetNumberOfContinuousStates, CO_SIMULATION_ONLY, size_t *n)
REFUSE(fmi3ActivateModelPartition, CO_SIMULATION_ONLY, fmi3ValueReference clock, fmi3Float64 time)

static fmi3Instance refused_birth(fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger)
{
    const Instance unborn = {.log = log_fmi3, .logger = (void *)logger, .environment = environment};
    refuse(&unborn, CO_SIMULATION_ONLY);
    return NULL;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                          fmi3Boolean visible, fmi3Boolean logging_on,
                                          fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger)
{
    return refused_birth(environment, logger);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging_on,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                               fmi3ClockUpdateCallback clock_update,
                                               fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
    return refused_birth(environment, logger);
}
