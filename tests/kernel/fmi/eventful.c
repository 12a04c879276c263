/* A shaft with events, clocks and tricks in one FMI 3.0 FMU, in place of lifecycle.c, access.c, model.c, variables.c
 * and much of not_offered.c of torque_motor_fmi3. What it does is its parameter `kind`, below. It is as strict about
 * modes as the standard allows: what is not allowed in a mode is an error. */
#include "slave.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    FOLLOWS = 0,      /* theta' = omega_ref, taken at intermediate times where it may be set there */
    FLIPS = 1,        /* theta' = +-omega_ref, the sign flips every `period` seconds: time events, over which it won't step */
    BOUNCES = 2,      /* theta' = +-omega_ref, the sign flips where theta is 0 or `stop`: state events */
    SAMPLES = 3,      /* theta' = omega_ref as it was at the last tick of the clock */
    SWITCHES = 4,     /* theta' = omega_ref as it was at the last event */
    DISCARDS = 5,     /* theta' = omega_ref, no step longer than `period` */
    ENDLESS = 10,     /* an event that never ends */
    STUCK = 11,       /* returns early at the start of the step for ever */
    NO_TIME = 12,     /* returns early at a time that is NaN */
    BEFORE = 13,      /* returns early before the step */
    BEYOND = 14,      /* returns early beyond the step */
    PAST = 15,        /* plans its next event for a time that has passed */
    NO_EVENT_TIME = 16,
    CRUMBLES = 17,    /* returns early after a millionth of the step */
    REFUSES = 18,     /* discards every step */
    ENDS = 19,        /* asks in an event to terminate */
    ENDLESS_LATER = 20,
    LOCKED_OUT = 21,  /* cannot enter event mode */
    LOCKED_IN = 22    /* cannot leave it */
};

enum { OMEGA_REF, TAU_LOAD, THETA_M, OMEGA_M, KIND, PERIOD, STOP, STATUS, N_NUMBERS, IN_CLOCK = 20, OUT_CLOCK = 21,
       SIZE = 30, TABLE = 31, TEXT = 32, BLOB = 33, SUM = 34 };
enum { EVENTS = 10, CONFIGURING = 11, UPDATING = 12 };

typedef struct {
    Slave slave; /* first: its state is what fmu_state.c saves */
    bool events, early;
    fmi3IntermediateUpdateCallback update;
    bool ticked, raised;
    unsigned long listed;
    unsigned size;
    double table[8], text, blob;
} Shaft;

/* In Variables: v.at[0 .. 7] as above, [8] the sign, [9] the command in use, [10] time of the next event, [11] the
 * interval of a clock, [12] mode of events, [13] how often an event was handled. */
enum { SIGN = 8, IN_USE, NEXT, INTERVAL, HANDLED };
#define V(name) (shaft->slave.state.v.at[name])

const Variable variables[N_VARIABLES] = {{0}};

fmi3Status refuse(const Slave *slave, const char *format, ...)
{
    if (slave->logger)
        slave->logger(slave->environment, fmi3Error, "logStatusError", format);
    return fmi3Error;
}

static void start(Shaft *shaft)
{
    memset(&shaft->slave.state, 0, sizeof shaft->slave.state);
    V(SIGN) = 1.0, V(NEXT) = INFINITY, V(PERIOD) = 1.0, V(STOP) = INFINITY, V(INTERVAL) = NAN;
    shaft->size = 2, shaft->ticked = shaft->raised = false;
    memset(shaft->table, 0, sizeof shaft->table);
    shaft->text = shaft->blob = 0.0;
    shaft->slave.state.mode = INSTANTIATED;
}

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Status fmi3SetDebugLogging(fmi3Instance i, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)i, (void)on, (void)n, (void)categories;
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging_on, fmi3Boolean event_mode_used,
                                         fmi3Boolean early_return_allowed, const fmi3ValueReference intermediate[],
                                         size_t n, fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                         fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging_on;
    Shaft *shaft = calloc(1, sizeof *shaft);
    shaft->slave.logger = logger, shaft->slave.environment = environment;
    shaft->events = event_mode_used, shaft->early = early_return_allowed;
    for (size_t j = 0; j < n; j++)
        shaft->listed |= 1ul << intermediate[j];
    shaft->update = n ? update : NULL;
    start(shaft);
    return shaft;
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

static fmi3Status enter(Shaft *shaft, int from, int to)
{
    if ((int)shaft->slave.state.mode != from)
        return refuse(&shaft->slave, "this function is not allowed in this mode");
    shaft->slave.state.mode = to;
    return fmi3OK;
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance i) { return enter(i, INSTANTIATED, CONFIGURING); }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance i) { return enter(i, CONFIGURING, INSTANTIATED); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance i, fmi3Boolean a, fmi3Float64 b, fmi3Float64 t, fmi3Boolean c,
                                       fmi3Float64 d)
{
    (void)a, (void)b, (void)c, (void)d;
    ((Slave *)i)->state.time = t;
    return enter(i, INSTANTIATED, INITIALIZATION);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance i)
{
    return enter(i, INITIALIZATION, ((Shaft *)i)->events ? EVENTS : STEPPING);
}

static fmi3Status change(Shaft *shaft, int from, int to, int refusing)
{
    if ((int)V(KIND) == refusing && shaft->slave.state.time > 0.0095)
        return fmi3Error;
    return enter(shaft, from, to);
}

fmi3Status fmi3EnterEventMode(fmi3Instance i) { return change(i, STEPPING, EVENTS, LOCKED_OUT); }
fmi3Status fmi3EnterStepMode(fmi3Instance i) { return change(i, EVENTS, STEPPING, LOCKED_IN); }
fmi3Status fmi3Terminate(fmi3Instance i) { return enter(i, STEPPING, TERMINATED); }

fmi3Status fmi3Reset(fmi3Instance i)
{
    start(i);
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance i, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *planned, fmi3Float64 *next)
{
    Shaft *shaft = i;
    const double t = shaft->slave.state.time;
    const int kind = (int)V(KIND);
    *again = *terminate = *nominals = *values = *planned = false;
    if ((int)shaft->slave.state.mode != EVENTS)
        return refuse(&shaft->slave, "fmi3UpdateDiscreteStates is not allowed in this mode");
    if (kind == FLIPS) {
        if (V(NEXT) == INFINITY)
            V(NEXT) = V(PERIOD);
        else if (t > V(NEXT) - 1e-12)
            V(SIGN) = -V(SIGN), V(HANDLED) += 1.0, V(NEXT) = V(PERIOD) * (V(HANDLED) + 1.0);
        *planned = true, *next = V(NEXT);
    }
    if (kind == SAMPLES && shaft->ticked)
        V(IN_USE) = V(OMEGA_REF), V(STATUS) += 1.0, V(NEXT) = t;
    if (kind == BOUNCES && shaft->raised)
        V(SIGN) = -V(SIGN);
    if (kind == SWITCHES)
        V(IN_USE) = V(OMEGA_REF), V(HANDLED) += 1.0;
    *again = kind == ENDLESS || (kind == ENDLESS_LATER && t > 0.0095);
    *terminate = kind == ENDS && t > 0.0095;
    if (kind == PAST && t > 0.0095)
        *planned = true, *next = t - 0.001;
    if (kind == NO_EVENT_TIME && t > 0.0095)
        *planned = true, *next = NAN;
    shaft->ticked = shaft->raised = false;
    return fmi3OK;
}

static void call_back(Shaft *shaft, double t, bool finished)
{
    fmi3Boolean ignored = false;
    fmi3Float64 at = 0.0;
    const int mode = (int)shaft->slave.state.mode;
    shaft->slave.state.mode = UPDATING;
    shaft->update(shaft->slave.environment, t, true, true, finished, shaft->early, &ignored, &at);
    shaft->slave.state.mode = mode;
}

static void integrate(Shaft *shaft, double t, double h)
{
    double speed = V(KIND) == SAMPLES || V(KIND) == SWITCHES ? V(IN_USE) : V(OMEGA_REF);
    if (V(KIND) == FOLLOWS && shaft->update) {
        /* the midpoint rule is exact for what rises evenly */
        call_back(shaft, t + 0.5 * h, false);
        speed = V(OMEGA_REF);
        V(THETA_M) += speed * h;
        call_back(shaft, t + h, true);
        V(OMEGA_M) = V(OMEGA_REF);
    } else {
        V(THETA_M) += V(SIGN) * speed * h;
        V(OMEGA_M) = V(SIGN) * speed;
        if (shaft->update)
            call_back(shaft, t + h, true);
    }
    shaft->slave.state.time = t + h;
}

fmi3Status fmi3DoStep(fmi3Instance i, fmi3Float64 t, fmi3Float64 h, fmi3Boolean final, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    Shaft *shaft = i;
    const int kind = (int)V(KIND);
    const bool later = t > 0.0095;
    (void)final;
    *event = *terminate = *early = false;
    *last = t;
    if (shaft->slave.state.mode != STEPPING)
        return refuse(&shaft->slave, "fmi3DoStep is not allowed in this mode");
    if (fabs(t - shaft->slave.state.time) > 1e-12 || h <= 0.0)
        return refuse(&shaft->slave, "fmi3DoStep does not begin where the last step ended");
    if (kind == FLIPS && t + h > V(NEXT) + 1e-12)
        return refuse(&shaft->slave, "fmi3DoStep goes beyond the time of the next event");
    if ((kind == DISCARDS && h > V(PERIOD) * (1.0 + 1e-9)) || (kind == REFUSES && later))
        return fmi3Discard;
    if (kind == ENDLESS_LATER && later)
        *event = true;
    if (later && (kind == PAST || kind == NO_EVENT_TIME || kind == ENDS || kind >= LOCKED_OUT))
        *event = true;
    if (later && kind >= STUCK && kind <= BEYOND) {
        const double wrong[] = {t, NAN, t - h, t + 2.0 * h};
        *early = true, *event = shaft->events, *last = wrong[kind - STUCK];
        return fmi3OK;
    }
    if (later && kind == CRUMBLES) {
        integrate(shaft, t, 1e-9);
        *early = true, *last = t + 1e-9;
        return fmi3OK;
    }
    if (kind == BOUNCES && V(OMEGA_REF) != 0.0) {
        const double speed = V(SIGN) * V(OMEGA_REF), to_go = ((speed > 0.0 ? V(STOP) : 0.0) - V(THETA_M)) / speed;
        if (to_go <= h) {
            integrate(shaft, t, to_go);
            V(STATUS) += 1.0, shaft->raised = true;
            *early = to_go < h, *event = true, *last = t + to_go;
            shaft->slave.state.time = *early ? *last : t + h;
            return fmi3OK;
        }
    }
    integrate(shaft, t, h);
    *last = t + h;
    return fmi3OK;
}

static bool readable(const Shaft *shaft, fmi3ValueReference vr)
{
    if ((int)shaft->slave.state.mode == UPDATING && !(shaft->listed >> vr & 1))
        return false;
    return vr != STATUS || ((int)shaft->slave.state.mode == EVENTS && (shaft->ticked || shaft->raised));
}

fmi3Status fmi3GetFloat64(fmi3Instance i, const fmi3ValueReference vr[], size_t n, fmi3Float64 values[], size_t m)
{
    Shaft *shaft = i;
    size_t k = 0;
    for (size_t j = 0; j < n; j++) {
        if (vr[j] < N_NUMBERS && readable(shaft, vr[j]))
            values[k++] = V(vr[j]);
        else if (vr[j] == SUM) {
            values[k] = shaft->text + shaft->blob;
            for (unsigned e = 0; e < shaft->size; e++)
                values[k] += shaft->table[e];
            k++;
        } else
            return refuse(&shaft->slave, "fmi3GetFloat64: not now");
    }
    return k == m ? fmi3OK : fmi3Error;
}

fmi3Status fmi3SetFloat64(fmi3Instance i, const fmi3ValueReference vr[], size_t n, const fmi3Float64 values[], size_t m)
{
    Shaft *shaft = i;
    const int mode = (int)shaft->slave.state.mode, kind = (int)V(KIND);
    if (n == 1 && vr[0] == TABLE) {
        if (m != shaft->size)
            return refuse(&shaft->slave, "the table has another size");
        memcpy(shaft->table, values, m * sizeof *values);
        return fmi3OK;
    }
    for (size_t j = 0; j < n; j++) {
        if (vr[j] == OMEGA_REF && kind == SAMPLES && !(mode == EVENTS && shaft->ticked))
            return refuse(&shaft->slave, "omega_ref is set while its clock does not tick");
        if (vr[j] == OMEGA_REF && kind == SWITCHES && mode == STEPPING)
            return refuse(&shaft->slave, "omega_ref is discrete and set outside of event mode");
        V(vr[j]) = values[j];
    }
    return n == m ? fmi3OK : fmi3Error;
}

fmi3Status fmi3SetUInt64(fmi3Instance i, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 values[], size_t m)
{
    Shaft *shaft = i;
    if ((int)shaft->slave.state.mode != CONFIGURING || n != 1 || m != 1 || vr[0] != SIZE || values[0] > 8)
        return refuse(&shaft->slave, "fmi3SetUInt64: not now");
    shaft->size = (unsigned)values[0];
    return fmi3OK;
}

fmi3Status fmi3SetString(fmi3Instance i, const fmi3ValueReference vr[], size_t n, const fmi3String values[], size_t m)
{
    (void)vr, (void)n, (void)m;
    ((Shaft *)i)->text = 100.0 * (double)strlen(values[0]);
    return fmi3OK;
}

fmi3Status fmi3SetBinary(fmi3Instance i, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                         const fmi3Binary values[], size_t m)
{
    (void)vr, (void)n, (void)m;
    ((Shaft *)i)->blob = 10000.0 * (double)sizes[0] + values[0][0];
    return fmi3OK;
}

fmi3Status fmi3SetClock(fmi3Instance i, const fmi3ValueReference vr[], size_t n, const fmi3Clock values[])
{
    Shaft *shaft = i;
    if ((int)shaft->slave.state.mode != EVENTS || n != 1 || vr[0] != IN_CLOCK || !values[0])
        return refuse(&shaft->slave, "fmi3SetClock: not now");
    shaft->ticked = true;
    return fmi3OK;
}

fmi3Status fmi3GetClock(fmi3Instance i, const fmi3ValueReference vr[], size_t n, fmi3Clock values[])
{
    Shaft *shaft = i;
    if ((int)shaft->slave.state.mode != EVENTS || n != 1 || vr[0] != OUT_CLOCK)
        return refuse(&shaft->slave, "fmi3GetClock: not now");
    values[0] = shaft->raised;
    return fmi3OK;
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance i, const fmi3ValueReference vr[], size_t n, const fmi3Float64 values[])
{
    Shaft *shaft = i;
    (void)vr, (void)n;
    V(INTERVAL) = values[0];
    return fmi3OK;
}

/* A changing clock, and one of a fixed interval that is not stated, ticks every `period`; a countdown that `period`
 * after each tick. */
fmi3Status fmi3GetIntervalDecimal(fmi3Instance i, const fmi3ValueReference vr[], size_t n, fmi3Float64 intervals[],
                                  fmi3IntervalQualifier qualifiers[])
{
    Shaft *shaft = i;
    (void)vr, (void)n;
    intervals[0] = V(PERIOD), qualifiers[0] = fmi3IntervalChanged;
    if (V(STATUS) > 0.0 && V(NEXT) != shaft->slave.state.time)
        qualifiers[0] = fmi3IntervalUnchanged;
    return fmi3OK;
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance i, const fmi3ValueReference vr[], size_t n, fmi3Float64 shifts[])
{
    (void)i, (void)vr, (void)n;
    shifts[0] = 0.002;
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
