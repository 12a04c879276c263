/* The functions of FMI 3.0 that these drives do not offer. The standard wants those of co-simulation exported; those
 * of model exchange and scheduled execution are here because importers exist that look for all of them. */
#include "slave.h"

/* Each of them refuses without looking at what it is asked. */
#pragma GCC diagnostic ignored "-Wunused-parameter"

#define REFUSE(function, reason, ...)                                                                        \
    fmi3Status function(fmi3Instance instance, __VA_ARGS__) { return refuse(instance, #function ": " reason); }

#define REFUSE_PLAIN(function, reason)                                                                       \
    fmi3Status function(fmi3Instance instance) { return refuse(instance, #function ": " reason); }

#define REFERENCES const fmi3ValueReference vr[], size_t n

#define REFUSE_TYPE(type)                                                                                    \
    REFUSE(fmi3Get##type, "no variable has this type", REFERENCES, fmi3##type values[], size_t n_values)     \
    REFUSE(fmi3Set##type, "no variable has this type", REFERENCES, const fmi3##type values[], size_t n_values)

REFUSE_TYPE(Int8)
REFUSE_TYPE(UInt8)
REFUSE_TYPE(Int16)
REFUSE_TYPE(UInt16)
REFUSE_TYPE(UInt32)
REFUSE_TYPE(Int64)
REFUSE_TYPE(UInt64)
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
    const Slave unborn = {.logger = logger, .environment = environment};
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
