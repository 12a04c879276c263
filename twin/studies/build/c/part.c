/* Life, values and steps of a part; fmi2.c and fmi3.c put the two versions of FMI in front of it. */
#include "part.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const MODE_NAMES[] = {"instantiated", "initialization", "stepping", "terminated", "failed"};

bool refuse(const Part *part, const char *format, ...)
{
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    part->log(part, text);
    return false;
}

bool refuse_in_mode(const Part *part, const char *function)
{
    return refuse(part, "%s is not allowed in mode %s", function, MODE_NAMES[part->state.mode]);
}

/* The generated names of the build: a state of another one is told by it. */
static uint64_t stamp(void)
{
    uint64_t hash = 14695981039346656037u; /* FNV-1a */
    for (const char *c = GUID; *c; c++)
        hash = (hash ^ (unsigned char)*c) * 1099511628211u;
    return hash;
}

static unsigned char *memory_of(Part *part) { return (unsigned char *)part->state.memory; }

static void point(Part *part)
{
    for (int k = 0; k < N_POINTERS; k++) {
        const uint64_t address = (uint64_t)(uintptr_t)(memory_of(part) + pointers[k].target);
        memcpy(memory_of(part) + pointers[k].field, &address, sizeof address);
    }
}

static void publish(State *state)
{
    for (int k = 0; k < N_Y; k++)
        if (outputs[k] >= 0)
            state->values[outputs[k]] = state->y[k];
}

void part_reset(Part *part)
{
    State *state = &part->state;
    memset(state, 0, sizeof *state);
    state->stamp = stamp();
    memcpy(state->values, start_values, sizeof start_values);
    memcpy(state->y, first_y, sizeof first_y);
    memcpy(state->memory, image, sizeof image);
    point(part);
    publish(state);
}

Part *part_born(const Part *from, const char *guid)
{
    if (!guid || strcmp(guid, GUID) != 0) {
        refuse(from, "wrong GUID: the binary has %s, modelDescription.xml belongs to another build", GUID);
        return NULL;
    }
    Part *part = malloc(sizeof *part);
    if (!part) {
        refuse(from, "out of memory");
        return NULL;
    }
    memcpy(part, from, sizeof *part);
    part_reset(part);
    return part;
}

bool part_enter(Part *part, Mode from, Mode to, const char *function)
{
    if (part->state.mode != from)
        return refuse_in_mode(part, function);
    part->state.mode = to;
    return true;
}

bool part_start_time(Part *part, double t)
{
    const double ticks = t / TICK;
    if (!(fabs(ticks) < 1e15 && fabs(ticks - nearbyint(ticks)) < 1e-6))
        return refuse(part, "start time %g s: expected a multiple of %g s", t, TICK);
    part->state.tick = part->state.first = (int64_t)nearbyint(ticks);
    return true;
}

double part_time(const Part *part) { return (double)part->state.tick * TICK; }

/* Evaluates one component; false if it fails. */
static bool evaluate(Part *part, const Component *c, double t)
{
    State *state = &part->state;
    double *u = state->u + c->u, *y = state->y + c->y;
    for (unsigned j = 0; j < c->n_u; j++) {
        const int source = sources[c->u + j];
        u[j] = source >= 0 ? state->y[source] : state->values[-1 - source];
    }
    int32_t result = 0;
    void *exception = NULL;
    const int raised = c->step(&result, &exception, memory_of(part) + c->memory, t, c->period * TICK, u, y);
    if (raised || (result != 0 && result != 1)) {
        if (result == 2 && c->status)
            return refuse(part, "%s: %s, at %g s", c->name, c->status, t);
        return refuse(part, "%s: returned status %d at %g s", c->name, raised ? raised : (int)result, t);
    }
    for (unsigned j = 0; c->finite && j < c->n_y; j++)
        if (!isfinite(y[j]))
            return refuse(part, "%s: an output is not finite at %g s", c->name, t);
    return true;
}

static void put(Part *part, const Place *place)
{
    const double si = part->state.values[place->value] * place->factor / place->divisor * place->times;
    memcpy(memory_of(part) + place->offset, &si, sizeof si);
}

/* All that follows from parameters and from inputs at the start. */
static bool derive(Part *part)
{
    for (int k = 0; k < N_PLACES; k++)
        put(part, &places[k]);
    for (int c = 0; c < N_COMPONENTS; c++)
        if (components[c].period == 0 && !evaluate(part, &components[c], part_time(part)))
            return false;
    publish(&part->state);
    return true;
}

bool part_initialised(Part *part)
{
    if (part->state.mode != INITIALIZATION)
        return refuse_in_mode(part, "ExitInitializationMode");
    if (!derive(part))
        return false;
    part->state.mode = STEPPING;
    return true;
}

bool part_step(Part *part, double t, double h)
{
    State *state = &part->state;
    if (state->mode != STEPPING)
        return refuse_in_mode(part, "DoStep");
    const double ticks = nearbyint(h / TICK);
    if (!(ticks >= 1.0 && ticks < 1e9 && fabs(h / TICK - ticks) < 1e-6))
        return refuse(part, "DoStep over %.17g s: expected a multiple of the tick, %g s", h, TICK);
    if (!(fabs(t - part_time(part)) < 0.01 * TICK))
        return refuse(part, "DoStep from %.17g s: the time reached is %.17g s", t, part_time(part));
    for (int64_t end = state->tick + (int64_t)ticks; state->tick < end; state->tick++)
        for (int c = 0; c < N_COMPONENTS; c++) {
            const int period = components[c].period;
            if (period && (period == 1 || state->tick % period == 0)
                && !evaluate(part, &components[c], part_time(part))) {
                state->mode = FAILED;
                return false;
            }
        }
    publish(state);
    return true;
}

bool part_set(Part *part, unsigned reference, const double *values)
{
    if (reference >= N_VARIABLES)
        return refuse(part, "Set: unknown value reference %u, there are %d variables", reference, N_VARIABLES);
    const Variable *variable = &variables[reference];
    if (variable->kind == OUTPUT)
        return refuse(part, "Set: %s is an output", variable->name);
    if (variable->kind == PARAMETER && part->state.mode > INITIALIZATION)
        return refuse(part, "Set: %s can only be set before the end of initialization", variable->name);
    for (unsigned k = 0; k < variable->size; k++) {
        const double value = values[k];
        if (variable->kind != INPUT && !isfinite(value))
            return refuse(part, "Set: %s = %g is not finite", variable->name, value);
        if (value < variable->min || (variable->above_min && value == variable->min))
            return refuse(part, "Set: %s = %.17g; expected %s %g", variable->name, value,
                          variable->above_min ? "more than" : "at least", variable->min);
        if (value > variable->max || (variable->below_max && value == variable->max))
            return refuse(part, "Set: %s = %.17g; expected %s %g", variable->name, value,
                          variable->below_max ? "less than" : "at most", variable->max);
    }
    memcpy(part->state.values + variable->first, values, variable->size * sizeof *values);
    if (variable->kind == TUNABLE && part->state.mode == STEPPING)
        for (int k = 0; k < N_PLACES; k++)
            if (places[k].value - variable->first < variable->size)
                put(part, &places[k]);
    return true;
}

bool part_get(Part *part, unsigned reference, double *values)
{
    if (reference >= N_VARIABLES)
        return refuse(part, "Get: unknown value reference %u, there are %d variables", reference, N_VARIABLES);
    if (variables[reference].kind == OUTPUT && part->state.mode == INITIALIZATION && !derive(part))
        return false;
    memcpy(values, part->state.values + variables[reference].first, variables[reference].size * sizeof *values);
    return true;
}

bool part_save(const Part *part, void **saved)
{
    State *state = *saved ? *saved : malloc(sizeof *state);
    if (!state)
        return refuse(part, "out of memory");
    memcpy(state, &part->state, sizeof *state);
    /* the same state is the same bytes, wherever it lies */
    for (int k = 0; k < N_POINTERS; k++)
        memset((unsigned char *)state->memory + pointers[k].field, 0, sizeof(uint64_t));
    *saved = state;
    return true;
}

bool part_restore(Part *part, const void *saved)
{
    const State *state = saved;
    if (!state || state->stamp != stamp())
        return refuse(part, "SetFMUState: there is no state of this FMU to restore");
    memcpy(&part->state, state, sizeof *state);
    point(part);
    return true;
}

bool part_serialize(const Part *part, const void *saved, unsigned char *bytes, size_t size)
{
    if (!saved || size < sizeof(State))
        return refuse(part, "SerializeFMUState: %zu bytes given, %zu needed", size, sizeof(State));
    memcpy(bytes, saved, sizeof(State));
    return true;
}

bool part_deserialize(const Part *part, const unsigned char *bytes, size_t size, void **saved)
{
    uint64_t found = 0;
    if (size == sizeof(State))
        memcpy(&found, bytes, sizeof found);
    if (found != stamp())
        return refuse(part, "DeSerializeFMUState: not a state of this FMU");
    State *state = *saved ? *saved : malloc(sizeof *state);
    if (!state)
        return refuse(part, "out of memory");
    memcpy(state, bytes, sizeof *state);
    *saved = state;
    return true;
}
