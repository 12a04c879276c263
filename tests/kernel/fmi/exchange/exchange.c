/* The ceremony of a model-exchange FMU for tests, FMI 2.0 or 3.0 as the macro FMI says, around motor.c or servo.c. */
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    double time, r[32], x[3];
    bool limited; /* relations, frozen between events */
    double supply, next;
    int updates, calls;
} Model;

enum { NEEDED = 1, ENDED = 2, NOMINALS_CHANGED = 4, STATES_CHANGED = 8 };

#include MODEL

#define EXPORT __attribute__((visibility("default")))
#define BAD 3

static double value(const Model *m, unsigned vr) { return vr < FIRST_STATE || vr >= FIRST_STATE + N_STATES ? m->r[vr] : m->x[vr - FIRST_STATE]; }

static void set(Model *m, unsigned vr, double v)
{
    if (vr >= FIRST_STATE && vr < FIRST_STATE + N_STATES)
        m->x[vr - FIRST_STATE] = v;
    else
        m->r[vr] = v;
}

static int set_states(Model *m, const double x[], size_t n)
{
    memcpy(m->x, x, n * sizeof *x);
    return 0;
}

static Model *born(const char *token)
{
    if (strcmp(token, "{exchange}") != 0)
        return NULL;
    Model *m = calloc(1, sizeof *m);
    memcpy(m->r, STARTS, sizeof STARTS);
    m->supply = 1.0;
    m->next = INFINITY;
    return m;
}

static void reborn(Model *m)
{
    Model *fresh = born("{exchange}");
    *m = *fresh;
    free(fresh);
}

static int states_of(const Model *m, double x[])
{
    memcpy(x, m->x, (N_STATES + (fault(m) == TOO_MANY)) * sizeof *x);
    return 0;
}

static int derivatives_of(Model *m, double dx[])
{
    if (fault(m) == ERROR)
        return BAD;
    rates(m, dx);
    if (fault(m) == NOT_A_NUMBER)
        dx[1] = NAN;
    if (fault(m) == GROWING)
        dx[N_STATES] = 1.0;
    return 0;
}

static int indicators_of(Model *m, double z[])
{
    indicate(m, z);
    if (fault(m) == FLICKERING)
        z[0] = m->calls++ % 2 ? 1.0 : -1.0;
    if (fault(m) == BLIND)
        z[0] = NAN;
    return 0;
}

static int nominals_of(const Model *m, double x[])
{
    if (fault(m) == UNSCALED)
        return BAD;
    for (int k = 0; k < N_STATES; k++)
        x[k] = NOMINALS[k];
    return 0;
}

static int updated(Model *m)
{
    int flags = react(m);
    if (fault(m) == ENDLESS)
        flags |= NEEDED;
    if (fault(m) == OVER)
        flags |= ENDED;
    if (fault(m) == PAST)
        m->next = m->time - 0.5;
    if (fault(m) == NOW)
        m->next = m->time;
    return flags;
}

#if FMI == 2
#define F(name) EXPORT int fmi2##name
#define BOOL int
typedef struct {
    int needed, ended, nominals, states, timed;
    double time;
} EventInfo;

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const void *functions, int visible, int logging) { return type == 0 ? born(guid) : NULL; }
EXPORT void fmi2FreeInstance(void *c) { free(c); }
F(SetupExperiment)(void *c, int defined, double tolerance, double start, int stops, double stop) { return 0; }
F(EnterInitializationMode)(void *c) { return 0; }
F(GetReal)(Model *m, const unsigned vr[], size_t n, double v[]) { for (size_t k = 0; k < n; k++) v[k] = value(m, vr[k]); return 0; }
F(SetReal)(Model *m, const unsigned vr[], size_t n, const double v[]) { for (size_t k = 0; k < n; k++) set(m, vr[k], v[k]); return 0; }
F(NewDiscreteStates)(Model *m, EventInfo *info)
{
    const int flags = updated(m);
    *info = (EventInfo){flags & NEEDED, flags & ENDED, flags & NOMINALS_CHANGED, flags & STATES_CHANGED, isfinite(m->next), m->next};
    return 0;
}
F(GetDerivatives)(Model *m, double dx[], size_t n) { return derivatives_of(m, dx); }
F(GetFMUstate)(Model *m, Model **kept) { if (!*kept) *kept = malloc(sizeof *m); **kept = *m; return 0; }
F(SetFMUstate)(Model *m, const Model *kept) { *m = *kept; return 0; }
F(FreeFMUstate)(Model *m, Model **kept) { free(*kept); *kept = NULL; return 0; }
#define NOT_OFFERED(name) F(name)(void) { return BAD; }
NOT_OFFERED(GetInteger) NOT_OFFERED(GetBoolean) NOT_OFFERED(GetString) NOT_OFFERED(SetInteger) NOT_OFFERED(SetBoolean)
NOT_OFFERED(SetString) NOT_OFFERED(SetDebugLogging) NOT_OFFERED(SerializedFMUstateSize) NOT_OFFERED(SerializeFMUstate)
NOT_OFFERED(DeSerializeFMUstate) NOT_OFFERED(GetDirectionalDerivative)
#else
#define F(name) EXPORT int fmi3##name
#define BOOL bool
EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
EXPORT void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources, bool visible, bool logging, void *environment, void *logger) { return born(token); }
EXPORT void fmi3FreeInstance(void *c) { free(c); }
F(EnterInitializationMode)(void *c, bool defined, double tolerance, double start, bool stops, double stop) { return 0; }
F(GetFloat64)(Model *m, const unsigned vr[], size_t n, double v[], size_t nv) { for (size_t k = 0; k < n; k++) v[k] = value(m, vr[k]); return 0; }
F(SetFloat64)(Model *m, const unsigned vr[], size_t n, const double v[], size_t nv) { for (size_t k = 0; k < n; k++) set(m, vr[k], v[k]); return 0; }
F(UpdateDiscreteStates)(Model *m, bool *needed, bool *ended, bool *nominals, bool *states, bool *timed, double *time)
{
    const int flags = updated(m);
    *needed = flags & NEEDED, *ended = flags & ENDED, *nominals = flags & NOMINALS_CHANGED, *states = flags & STATES_CHANGED;
    *timed = isfinite(m->next), *time = m->next;
    return 0;
}
F(GetContinuousStateDerivatives)(Model *m, double dx[], size_t n) { return derivatives_of(m, dx); }
F(GetNumberOfContinuousStates)(Model *m, size_t *n) { *n = N_STATES + (fault(m) == GROWING); return 0; }
F(GetNumberOfEventIndicators)(Model *m, size_t *n) { *n = N_INDICATORS; return 0; }
F(GetFMUState)(Model *m, Model **kept) { if (!*kept) *kept = malloc(sizeof *m); **kept = *m; return 0; }
F(SetFMUState)(Model *m, const Model *kept) { *m = *kept; return 0; }
F(FreeFMUState)(Model *m, Model **kept) { free(*kept); *kept = NULL; return 0; }
#define NOT_OFFERED(name) F(name)(void) { return BAD; }
#define NEITHER(type) NOT_OFFERED(Get##type) NOT_OFFERED(Set##type)
NEITHER(Float32) NEITHER(Int8) NEITHER(UInt8) NEITHER(Int16) NEITHER(UInt16) NEITHER(Int32) NEITHER(UInt32)
NEITHER(Int64) NEITHER(UInt64) NEITHER(Boolean) NEITHER(String) NEITHER(Binary) NEITHER(Clock)
NEITHER(IntervalDecimal) NEITHER(IntervalFraction) NEITHER(ShiftDecimal) NEITHER(ShiftFraction)
NOT_OFFERED(SetDebugLogging) NOT_OFFERED(SerializedFMUStateSize) NOT_OFFERED(SerializeFMUState)
NOT_OFFERED(DeserializeFMUState) NOT_OFFERED(GetDirectionalDerivative) NOT_OFFERED(GetAdjointDerivative)
NOT_OFFERED(EvaluateDiscreteStates) NOT_OFFERED(EnterConfigurationMode) NOT_OFFERED(ExitConfigurationMode)
NOT_OFFERED(GetNumberOfVariableDependencies) NOT_OFFERED(GetVariableDependencies) NOT_OFFERED(GetIntervalFractions)
#endif

F(ExitInitializationMode)(void *c) { return 0; }
F(Terminate)(void *c) { return 0; }
F(Reset)(Model *m) { reborn(m); return 0; }
F(EnterEventMode)(void *c) { return 0; }
F(EnterContinuousTimeMode)(void *c) { return 0; }
F(SetTime)(Model *m, double t) { m->time = t; return 0; }
F(SetContinuousStates)(Model *m, const double x[], size_t n) { return set_states(m, x, n); }
F(GetContinuousStates)(Model *m, double x[], size_t n) { return states_of(m, x); }
F(GetNominalsOfContinuousStates)(Model *m, double x[], size_t n) { return nominals_of(m, x); }
F(GetEventIndicators)(Model *m, double z[], size_t n) { return indicators_of(m, z); }
F(CompletedIntegratorStep)(Model *m, BOOL final, BOOL *event, BOOL *ended)
{
    *event = asks(m);
    *ended = 0;
    return 0;
}
