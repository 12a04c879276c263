/* An FMU of FMI 2.0 and of FMI 3.0 for tests of what an importer is given. A variable is an input (value reference below
 * 32), the same value as an output (+ 32), or 1024 times it (+ 64, whole numbers of 64 bits). Its GUID says what is odd:
 * "FUNCTION STATUS STEPS FOLDER": after so many steps that function returns the status, having logged something, or goes
 * to that folder if there is one, or with the folder UPWARD has the processor round upwards; a function called "NaN" makes all real outputs NaN, "Inf"
 * infinite, with the sign of STATUS. */
#include <fenv.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define EXPORT __attribute__((visibility("default")))

typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *allocate, *free, *finished, *environment;
} Callbacks;

typedef struct {
    const Callbacks *callbacks;
    void (*log)(void *, int, const char *, const char *);
    void *environment;
    char odd[64], folder[512];
    int status, after, steps, states;
    double time, x;
    unsigned char v[32][8];
} Odd;

static Odd *made(const char *guid)
{
    Odd *o = calloc(1, sizeof *o);
    sscanf(guid, "%63s %d %d %511s", o->odd, &o->status, &o->after, o->folder);
    return o;
}

/* what the function `name` returns */
static int answer(Odd *o, const char *name)
{
    if (strcmp(name, o->odd) != 0 || o->steps < o->after)
        return 0;
    if (strcmp(o->folder, "UPWARD") == 0)
        return fesetround(FE_UPWARD);
    if (o->folder[0])
        return chdir(o->folder);
    if (o->callbacks && o->callbacks->logger)
        o->callbacks->logger(o->callbacks->environment, "odd", 3, "error", "%s of #r0# and #i1#, ##1", name);
    if (o->log)
        o->log(o->environment, 3, "error", name);
    return o->status;
}

static void get(Odd *o, const unsigned vr[], size_t n, void *values, size_t size, int real)
{
    for (size_t k = 0; k < n; k++) {
        char *to = (char *)values + k * size;
        memcpy(to, o->v[vr[k] % 32], size);
        if (vr[k] >= 64)
            *(int64_t *)to *= 1024;
        const int nan = strcmp(o->odd, "NaN") == 0, infinite = strcmp(o->odd, "Inf") == 0;
        if (real && vr[k] >= 32 && (nan || infinite) && o->steps >= o->after) {
            const double value = nan ? NAN : copysign(INFINITY, o->status);
            if (size == 8)
                *(double *)to = value;
            else
                *(float *)to = value;
        }
    }
}

static void set(Odd *o, const unsigned vr[], size_t n, const void *values, size_t size)
{
    for (size_t k = 0; k < n; k++)
        memcpy(o->v[vr[k] % 32], (const char *)values + k * size, size);
}

typedef struct {
    int needed, ended, nominals, states, timed;
    double time;
} EventInfo;

#define A(name) answer(o, #name)
#define F2(name, ...) EXPORT int fmi2##name(Odd *o, ##__VA_ARGS__)
#define PLAIN2(name, ...) F2(name, ##__VA_ARGS__) { return A(name); }
#define ACCESS2(name, type) \
    F2(Get##name, const unsigned vr[], size_t n, type v[]) { get(o, vr, n, v, sizeof *v, sizeof *v == 8); return A(Get##name); } \
    F2(Set##name, const unsigned vr[], size_t n, const type v[]) { set(o, vr, n, v, sizeof *v); return A(Set##name); }

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT void *fmi2Instantiate(const char *n, int type, const char *guid, const char *r, const Callbacks *c, int v, int l)
{
    Odd *o = made(guid);
    o->callbacks = c;
    return o;
}
EXPORT void fmi2FreeInstance(Odd *o) { free(o); }
ACCESS2(Real, double) ACCESS2(Integer, int) ACCESS2(Boolean, int)
PLAIN2(SetupExperiment, int d, double tolerance, double t, int e, double stop) PLAIN2(EnterInitializationMode)
PLAIN2(ExitInitializationMode) PLAIN2(Terminate) PLAIN2(Reset) PLAIN2(SetDebugLogging)
F2(DoStep, double t, double h, int f) { int s = A(DoStep); o->steps++, o->time = t + h; return s; }
F2(GetRealStatus, int kind, double *v) { *v = o->time; return A(GetRealStatus); }
F2(GetBooleanStatus, int kind, int *v) { *v = 0; return A(GetBooleanStatus); }
#define STATES(P, STATE, DESERIALIZE) \
    EXPORT int P##Get##STATE(Odd *o, Odd **k) { if (!*k) *k = malloc(sizeof *o); **k = *o; return A(GetFMUstate); } \
    EXPORT int P##Set##STATE(Odd *o, const Odd *k) { *o = *k; return A(SetFMUstate); } \
    EXPORT int P##Free##STATE(Odd *o, Odd **k) { free(*k); *k = NULL; return A(FreeFMUstate); } \
    EXPORT int P##Serialized##STATE##Size(Odd *o, Odd *k, size_t *n) { *n = sizeof *o; return A(SerializedFMUstateSize); } \
    EXPORT int P##Serialize##STATE(Odd *o, Odd *k, char b[], size_t n) { memcpy(b, k, n); return A(SerializeFMUstate); } \
    EXPORT int P##DESERIALIZE##STATE(Odd *o, const char b[], size_t n, Odd **k) \
    { *k = malloc(sizeof *o); memcpy(*k, b, sizeof *o); return A(DeSerializeFMUstate); }
STATES(fmi2, FMUstate, DeSerialize)
PLAIN2(SetRealInputDerivatives, const unsigned vr[], size_t n, const int order[], const double v[])
PLAIN2(EnterEventMode) PLAIN2(EnterContinuousTimeMode)
F2(NewDiscreteStates, EventInfo *i) { memset(i, 0, sizeof *i); return A(NewDiscreteStates); }
F2(CompletedIntegratorStep, int f, int *e, int *t) { *e = *t = 0; o->steps++; return A(CompletedIntegratorStep); }
F2(SetTime, double t) { return A(SetTime); }
F2(SetContinuousStates, const double x[], size_t n) { o->x = x[0]; return A(SetContinuousStates); }
F2(GetContinuousStates, double x[], size_t n) { x[0] = o->x; return A(GetContinuousStates); }
F2(GetDerivatives, double x[], size_t n) { x[0] = 1.0; return A(GetDerivatives); }
F2(GetNominalsOfContinuousStates, double x[], size_t n) { x[0] = 1.0; return A(GetNominalsOfContinuousStates); }
F2(GetEventIndicators, double z[], size_t n) { z[0] = 1.0; return A(GetEventIndicators); }
PLAIN2(GetString) PLAIN2(SetString) PLAIN2(GetDirectionalDerivative) PLAIN2(GetRealOutputDerivatives)
PLAIN2(GetStatus) PLAIN2(GetIntegerStatus) PLAIN2(GetStringStatus) PLAIN2(CancelStep)

#define F3(name, ...) EXPORT int fmi3##name(Odd *o, ##__VA_ARGS__)
#define PLAIN3(name, ...) F3(name, ##__VA_ARGS__) { return A(name); }
#define ACCESS3(name, type, real) \
    F3(Get##name, const unsigned vr[], size_t n, type v[], size_t m) { get(o, vr, n, v, sizeof *v, real); return A(Get##name); } \
    F3(Set##name, const unsigned vr[], size_t n, const type v[], size_t m) { set(o, vr, n, v, sizeof *v); return A(Set##name); }

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
EXPORT void *fmi3InstantiateCoSimulation(const char *n, const char *token, const char *r, char v, char l, char e, char a,
                                         const unsigned *vr, size_t nvr, void *environment,
                                         void (*log)(void *, int, const char *, const char *), void *update)
{
    Odd *o = made(token);
    o->environment = environment, o->log = log;
    return o;
}
EXPORT void *fmi3InstantiateModelExchange(void) { return NULL; }
EXPORT void *fmi3InstantiateScheduledExecution(void) { return NULL; }
EXPORT void fmi3FreeInstance(Odd *o) { free(o); }
ACCESS3(Float64, double, 1) ACCESS3(Float32, float, 1) ACCESS3(Int8, int8_t, 0) ACCESS3(UInt8, uint8_t, 0)
ACCESS3(Int16, int16_t, 0) ACCESS3(UInt16, uint16_t, 0) ACCESS3(Int32, int32_t, 0) ACCESS3(UInt32, uint32_t, 0)
ACCESS3(Int64, int64_t, 0) ACCESS3(UInt64, uint64_t, 0) ACCESS3(Boolean, uint8_t, 0)
PLAIN3(EnterInitializationMode, char d, double r, double t, char e, double stop) PLAIN3(ExitInitializationMode)
F3(DoStep, double t, double h, char f, char *event, char *end, char *early, double *last)
{
    int s = A(DoStep);
    o->steps++;
    *event = *end = *early = 0, *last = t + h;
    return s;
}
STATES(fmi3, FMUState, Deserialize)
PLAIN3(EnterEventMode) PLAIN3(EnterStepMode)
F3(UpdateDiscreteStates, char *a, char *b, char *c, char *d, char *e, double *t)
{
    *a = *b = *c = *d = *e = 0;
    return A(UpdateDiscreteStates);
}
PLAIN3(SetDebugLogging) PLAIN3(Terminate) PLAIN3(Reset) PLAIN3(GetString) PLAIN3(SetString) PLAIN3(GetBinary)
PLAIN3(SetBinary) PLAIN3(GetClock) PLAIN3(SetClock) PLAIN3(GetNumberOfVariableDependencies)
PLAIN3(GetVariableDependencies) PLAIN3(GetDirectionalDerivative) PLAIN3(GetAdjointDerivative)
PLAIN3(EnterConfigurationMode) PLAIN3(ExitConfigurationMode) PLAIN3(GetIntervalDecimal) PLAIN3(GetIntervalFraction)
PLAIN3(GetShiftDecimal) PLAIN3(GetShiftFraction) PLAIN3(SetIntervalDecimal) PLAIN3(SetIntervalFraction)
PLAIN3(SetShiftDecimal) PLAIN3(SetShiftFraction) PLAIN3(EvaluateDiscreteStates) PLAIN3(EnterContinuousTimeMode)
PLAIN3(CompletedIntegratorStep) PLAIN3(SetTime) PLAIN3(SetContinuousStates) PLAIN3(GetContinuousStateDerivatives)
PLAIN3(GetEventIndicators) PLAIN3(GetContinuousStates) PLAIN3(GetNominalsOfContinuousStates)
PLAIN3(GetNumberOfEventIndicators) PLAIN3(GetNumberOfContinuousStates) PLAIN3(GetOutputDerivatives)
PLAIN3(ActivateModelPartition)
