/* Functions that FMI 2.0 wants exported and these drives do not offer. */
#include "slave.h"

#define REFUSE_VARIABLES(function, type)                                                              \
    fmi2Status function(fmi2Component c, const fmi2ValueReference vr[], size_t n, type value[])       \
    {                                                                                                 \
        (void)vr, (void)value;                                                                        \
        return n == 0 ? fmi2OK : refuse(c, #function ": all variables of this FMU are Real");         \
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
    return refuse(c, "fmi2SetRealInputDerivatives: inputs are held constant (canInterpolateInputs is false)");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)n, (void)order, (void)value;
    return refuse(c, "fmi2GetRealOutputDerivatives: not offered (maxOutputDerivativeOrder is 0)");
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
                                        const fmi2ValueReference known[], size_t n_known,
                                        const fmi2Real d_known[], fmi2Real d_unknown[])
{
    (void)unknown, (void)n_unknown, (void)known, (void)n_known, (void)d_known, (void)d_unknown;
    return refuse(c, "fmi2GetDirectionalDerivative: not offered (providesDirectionalDerivative is false)");
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return refuse(c, "fmi2CancelStep: steps are synchronous (canRunAsynchronuously is false)");
}

/* No step is ever pending: nothing to report beyond fmi2GetRealStatus and fmi2GetBooleanStatus. */
#define DISCARD_STATUS(function, type)                                                                \
    fmi2Status function(fmi2Component c, const fmi2StatusKind kind, type *value)                      \
    {                                                                                                 \
        (void)c, (void)kind, (void)value;                                                             \
        return fmi2Discard;                                                                           \
    }

DISCARD_STATUS(fmi2GetStatus, fmi2Status)
DISCARD_STATUS(fmi2GetIntegerStatus, fmi2Integer)
DISCARD_STATUS(fmi2GetStringStatus, fmi2String)
