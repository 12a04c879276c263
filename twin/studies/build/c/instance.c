/* Life, values and saved states of an FMU's instance, with a message for all that is refused. */
#include "part.c"
#include "tables.c"
#include "instance.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Of a tick: by how much a time may be off, which a master adds up. */
#define ROUNDED 0.01

static const char *const MODE_NAMES[] = {"instantiated", "initialization", "stepping", "terminated", "failed"};

static bool refuse(const Instance *instance, const char *format, ...)
{
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    instance->log(instance, text);
    return false;
}

static bool refuse_in_mode(const Instance *instance, const char *function)
{
    return refuse(instance, "%s is not allowed in mode %s", function, MODE_NAMES[instance->state.mode]);
}

static bool refuse_reference(const Instance *instance, unsigned reference)
{
    return refuse(instance, "unknown value reference %u, there are %d variables", reference, N_VARIABLES);
}

static bool refuse_failed(const Instance *instance, const Failure *failure)
{
    const Component *c = failure->component;
    const double t = part_time(&instance->state);
    if (failure->status == 0)
        return refuse(instance, "%s: an output is not finite at %g s", c->name, t);
    if (failure->status == 2 && c->status)
        return refuse(instance, "%s: %s, at %g s", c->name, c->status, t);
    return refuse(instance, "%s: returned status %d at %g s", c->name, failure->status, t);
}

static Instance *instance_born(const Instance *from, const char *guid)
{
    if (!guid || strcmp(guid, GUID) != 0) {
        refuse(from, "wrong GUID: the binary has %s, modelDescription.xml belongs to another build", GUID);
        return NULL;
    }
    Instance *instance = malloc(sizeof *instance);
    if (!instance) {
        refuse(from, "out of memory");
        return NULL;
    }
    memcpy(instance, from, sizeof *instance);
    instance_reset(instance);
    return instance;
}

static void instance_reset(Instance *instance)
{
    part_reset(&instance->state);
    instance->last = INT64_MAX;
}

static bool instance_enter(Instance *instance, Mode from, Mode to, const char *function)
{
    if (instance->state.mode != from)
        return refuse_in_mode(instance, function);
    instance->state.mode = to;
    return true;
}

static bool instance_times(Instance *instance, double start, bool stops, double stop)
{
    const double ticks = start / TICK;
    if (!(fabs(ticks) < 1e15 && fabs(ticks - nearbyint(ticks)) < 1e-6))
        return refuse(instance, "start time %g s: expected a multiple of %g s", start, TICK);
    if (stops && !(stop >= start))
        return refuse(instance, "stop time %g s: expected at least the start time, %g s", stop, start);
    instance->state.tick = instance->state.first = (int64_t)nearbyint(ticks);
    /* what a master adds up is rounded */
    instance->last = stops && stop / TICK < 1e15 ? (int64_t)floor(stop / TICK + ROUNDED) : INT64_MAX;
    return true;
}

static bool derive(Instance *instance)
{
    Failure failure;
    return part_derive(&instance->state, &failure) || refuse_failed(instance, &failure);
}

static bool instance_initialised(Instance *instance)
{
    if (instance->state.mode != INITIALIZATION)
        return refuse_in_mode(instance, "ExitInitializationMode");
    if (!derive(instance))
        return false;
    instance->state.mode = STEPPING;
    return true;
}

static bool instance_step(Instance *instance, double t, double h)
{
    State *state = &instance->state;
    if (state->mode != STEPPING)
        return refuse_in_mode(instance, "DoStep");
    const double ticks = h == TICK ? 1.0 : nearbyint(h / TICK);
    if (h != TICK && !(ticks >= 1.0 && ticks < 1e9 && fabs(h / TICK - ticks) < 1e-6))
        return refuse(instance, "DoStep over %.17g s: expected a multiple of the tick, %g s", h, TICK);
    if (!(fabs(t - part_time(state)) < ROUNDED * TICK))
        return refuse(instance, "DoStep from %.17g s: the time reached is %.17g s", t, part_time(state));
    if (state->tick > instance->last - (int64_t)ticks)
        return refuse(instance, "DoStep from %.17g s over %.17g s: leads beyond the stop time, %g s", t, h,
                      (double)instance->last * TICK);
    Failure failure;
    return part_advance(state, (int64_t)ticks, &failure) || refuse_failed(instance, &failure);
}

/* Masters get every output at every step. Where every variable is one value, as in FMI 2.0, those stand in the order
 * of the references; a look at the table and a call of memcpy would be most of what it costs to get one. */
enum { ALL_SCALAR = N_VARIABLES == N_VALUES };

static inline void copy_values(double *to, const double *from, unsigned size)
{
    if (ALL_SCALAR || size == 1)
        *to = *from;
    else
        memcpy(to, from, size * sizeof *to);
}

static bool set_in_bounds(Instance *instance, const Variable *variable, const double *values)
{
    State *state = &instance->state;
    if (variable->kind == OUTPUT)
        return refuse(instance, "Set: %s is an output", variable->name);
    if (variable->kind == PARAMETER && state->mode > INITIALIZATION)
        return refuse(instance, "Set: %s can only be set before the end of initialization", variable->name);
    for (unsigned k = 0; k < variable->size; k++)
        switch (part_fit(variable, values[k])) {
        case NOT_FINITE:
            return refuse(instance, "Set: %s = %g is not finite", variable->name, values[k]);
        case TOO_LOW:
            return refuse(instance, "Set: %s = %.17g; expected %s %g", variable->name, values[k],
                          variable->above_min ? "more than" : "at least", variable->min);
        case TOO_HIGH:
            return refuse(instance, "Set: %s = %.17g; expected %s %g", variable->name, values[k],
                          variable->below_max ? "less than" : "at most", variable->max);
        case FITS:
            break;
        }
    copy_values(state->values + variable->first, values, variable->size);
    if (variable->kind == TUNABLE && state->mode == STEPPING)
        part_tune(state, variable);
    return true;
}

static inline bool instance_set(Instance *instance, unsigned reference, const double *values)
{
    if (reference >= N_VARIABLES)
        return refuse_reference(instance, reference);
    const Variable *variable = &variables[reference];
    /* an input may be anything: its component says what is too much for it */
    if (variable->kind != INPUT)
        return set_in_bounds(instance, variable, values);
    copy_values(instance->state.values + variable->first, values, variable->size);
    return true;
}

/* Whether a variable can be had; outputs follow from parameters and inputs until the first step. */
static bool ready(Instance *instance, unsigned reference)
{
    if (reference >= N_VARIABLES)
        return refuse_reference(instance, reference);
    return variables[reference].kind != OUTPUT || derive(instance);
}

static inline bool instance_get(Instance *instance, unsigned reference, double *values)
{
    if ((reference >= N_VARIABLES || instance->state.mode == INITIALIZATION) && !ready(instance, reference))
        return false;
    const unsigned first = ALL_SCALAR ? reference : variables[reference].first;
    copy_values(values, instance->state.values + first, variables[reference].size);
    return true;
}

/* A state that the master does not own yet (*saved is NULL) is allocated, another one overwritten. */
static State *room(const Instance *instance, void **saved)
{
    if (!*saved)
        *saved = malloc(sizeof(State));
    if (!*saved)
        refuse(instance, "out of memory");
    return *saved;
}

static bool instance_save(const Instance *instance, void **saved)
{
    State *state = room(instance, saved);
    if (!state)
        return false;
    memcpy(state, &instance->state, sizeof *state);
    /* the same state is the same bytes, wherever it lies */
    for (int k = 0; k < N_POINTERS; k++)
        memset((unsigned char *)state->memory + pointers[k].field, 0, sizeof(uint64_t));
    return true;
}

static bool instance_restore(Instance *instance, const void *saved)
{
    const State *state = saved;
    if (!state || state->stamp != part_stamp())
        return refuse(instance, "SetFMUState: there is no state of this FMU to restore");
    memcpy(&instance->state, state, sizeof *state);
    part_point(&instance->state);
    return true;
}

static bool instance_serialize(const Instance *instance, const void *saved, unsigned char *bytes, size_t size)
{
    if (!saved || size < sizeof(State))
        return refuse(instance, "SerializeFMUState: %zu bytes given, %zu needed", size, sizeof(State));
    memcpy(bytes, saved, sizeof(State));
    return true;
}

static bool instance_deserialize(const Instance *instance, const unsigned char *bytes, size_t size, void **saved)
{
    uint64_t found = 0;
    if (size == sizeof(State))
        memcpy(&found, bytes, sizeof found);
    if (found != part_stamp())
        return refuse(instance, "DeSerializeFMUState: not a state of this FMU");
    State *state = room(instance, saved);
    if (!state)
        return false;
    memcpy(state, bytes, sizeof *state);
    return true;
}
