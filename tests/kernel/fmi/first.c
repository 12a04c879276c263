/* A shaft that follows its command, as an FMI 1.0 slave. Its command may rise over a step (fmiSetRealInputDerivatives);
 * a step longer than `longest` it discards, having done as much. Functions carry the model's name, as FMI 1.0 wants. */
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*free)(void *);
    void *finished;
} Callbacks;

enum { OMEGA_REF, TAU_LOAD, THETA_M, OMEGA_M, LONGEST, NUMBERS };
enum { ENABLE = 0 };

typedef struct {
    Callbacks callbacks;
    char name[64];
    double v[NUMBERS], slope, time;
    char enable;
    bool initialised;
} Shaft;

#define EXPORT(type, name) __attribute__((visibility("default"))) type first_##name
#define FMI(name, ...) EXPORT(int, name)(void *c, __VA_ARGS__)

static int refuse(Shaft *shaft, const char *why)
{
    shaft->callbacks.logger(shaft, shaft->name, 3, "error", "%s", why);
    return 3;
}

static void start(Shaft *shaft)
{
    memset(shaft->v, 0, sizeof shaft->v);
    shaft->v[LONGEST] = 1.0, shaft->slope = shaft->time = 0.0, shaft->enable = 1, shaft->initialised = false;
}

EXPORT(const char *, fmiGetTypesPlatform)(void) { return "standard32"; }
EXPORT(const char *, fmiGetVersion)(void) { return "1.0"; }
FMI(fmiSetDebugLogging, char on) { return (void)c, (void)on, 0; }

EXPORT(void *, fmiInstantiateSlave)(const char *name, const char *guid, const char *location, const char *mime,
                                    double timeout, char visible, char interactive, Callbacks callbacks, char logging)
{
    (void)location, (void)mime, (void)timeout, (void)visible, (void)interactive, (void)logging;
    Shaft *shaft = callbacks.allocate(1, sizeof *shaft);
    shaft->callbacks = callbacks;
    strncpy(shaft->name, name, sizeof shaft->name - 1);
    if (strcmp(guid, "{first}") != 0) {
        refuse(shaft, "the GUID is another one");
        callbacks.free(shaft);
        return NULL;
    }
    start(shaft);
    return shaft;
}

FMI(fmiInitializeSlave, double t, char stop_defined, double stop)
{
    Shaft *shaft = c;
    (void)stop;
    if (!stop_defined)
        return refuse(shaft, "no stop time");
    shaft->time = t, shaft->initialised = true;
    return 0;
}

EXPORT(int, fmiTerminateSlave)(void *c) { return ((Shaft *)c)->initialised = false, 0; }
EXPORT(int, fmiResetSlave)(void *c) { return start(c), 0; }
EXPORT(void, fmiFreeSlaveInstance)(void *c) { ((Shaft *)c)->callbacks.free(c); }
EXPORT(int, fmiCancelStep)(void *c) { return refuse(c, "steps are not asynchronous"); }

FMI(fmiSetReal, const unsigned r[], size_t n, const double value[])
{
    Shaft *shaft = c;
    for (size_t k = 0; k < n; k++)
        shaft->v[r[k]] = value[k];
    shaft->slope = 0.0;
    return 0;
}

FMI(fmiGetReal, const unsigned r[], size_t n, double value[])
{
    for (size_t k = 0; k < n; k++)
        value[k] = ((Shaft *)c)->v[r[k]];
    return 0;
}

FMI(fmiSetRealInputDerivatives, const unsigned r[], size_t n, const int order[], const double value[])
{
    for (size_t k = 0; k < n; k++)
        if (r[k] == OMEGA_REF && order[k] == 1)
            ((Shaft *)c)->slope = value[k];
    return 0;
}

FMI(fmiGetRealOutputDerivatives, const unsigned r[], size_t n, const int order[], double value[])
{
    return (void)r, (void)n, (void)order, (void)value, refuse(c, "not offered");
}

FMI(fmiSetBoolean, const unsigned r[], size_t n, const char value[])
{
    return (void)r, (void)n, ((Shaft *)c)->enable = value[0], 0;
}

FMI(fmiGetBoolean, const unsigned r[], size_t n, char value[])
{
    return (void)r, (void)n, value[0] = ((Shaft *)c)->enable, 0;
}

FMI(fmiSetInteger, const unsigned r[], size_t n, const int v[]) { return (void)r, (void)n, (void)v, refuse(c, "none"); }
FMI(fmiGetInteger, const unsigned r[], size_t n, int v[]) { return (void)r, (void)n, (void)v, refuse(c, "none"); }
FMI(fmiSetString, const unsigned r[], size_t n, const char *const v[]) { return (void)r, (void)n, (void)v, refuse(c, "none"); }
FMI(fmiGetString, const unsigned r[], size_t n, const char *v[]) { return (void)r, (void)n, (void)v, refuse(c, "none"); }

FMI(fmiDoStep, double t, double h, char new_step)
{
    Shaft *shaft = c;
    if (!shaft->initialised || !new_step || t - shaft->time > 1e-12 || shaft->time - t > 1e-12)
        return refuse(shaft, "not initialised, no new step, or not where the last one ended");
    const double done = h > shaft->v[LONGEST] ? shaft->v[LONGEST] : h, on = shaft->enable ? 1.0 : 0.0;
    shaft->v[THETA_M] += on * (shaft->v[OMEGA_REF] + 0.5 * shaft->slope * done) * done;
    shaft->v[OMEGA_M] = on * (shaft->v[OMEGA_REF] + shaft->slope * done);
    shaft->time = t + done;
    return done < h ? 2 : 0;
}

FMI(fmiGetRealStatus, int kind, double *value)
{
    return kind == 2 ? (*value = ((Shaft *)c)->time, 0) : 2;
}

FMI(fmiGetStatus, int kind, int *value) { return (void)c, (void)kind, (void)value, 2; }
FMI(fmiGetIntegerStatus, int kind, int *value) { return (void)c, (void)kind, (void)value, 2; }
FMI(fmiGetBooleanStatus, int kind, char *value) { return (void)c, (void)kind, (void)value, 2; }
FMI(fmiGetStringStatus, int kind, const char **value) { return (void)c, (void)kind, (void)value, 2; }
