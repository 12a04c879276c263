/* Values and steps of a part; instance.c makes an FMU's instance of it, computer.c the robot's computer. */
#include "part.h"

#include <string.h>
#ifdef __x86_64__
#include <cpuid.h>
#endif

/* The richest form of a step that this processor and its system can run. */
static int processor_form(void)
{
#ifdef __x86_64__
    /* Intel 64 Software Developer's Manual, vol. 1, sec. 14.3 and 15.2: the system must save what registers hold */
    unsigned a, b, c, d, saved, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_OSXSAVE) || !(c & bit_AVX))
        return ANY;
    __asm__("xgetbv" : "=a"(saved), "=d"(high) : "c"(0));
    if ((saved & 0x6) != 0x6)
        return ANY;
    const bool has_512 = __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & bit_AVX512F) && (b & bit_AVX512VL);
    return has_512 && (saved & 0xe6) == 0xe6 ? AVX512 : AVX;
#else
    return ANY;
#endif
}

/* Of the process: a state may be restored on another machine. */
static int form;

static uint64_t part_stamp(void)
{
    uint64_t hash = 14695981039346656037u; /* FNV-1a */
    for (const char *c = GUID; *c; c++)
        hash = (hash ^ (unsigned char)*c) * 1099511628211u;
    return hash;
}

static unsigned char *memory_of(State *state) { return (unsigned char *)state->memory; }

static void part_point(State *state)
{
    for (int k = 0; k < N_POINTERS; k++) {
        const uint64_t address = (uint64_t)(uintptr_t)(memory_of(state) + pointers[k].target);
        memcpy(memory_of(state) + pointers[k].field, &address, sizeof address);
    }
}

static void part_reset(State *state)
{
    form = processor_form();
    memset(state, 0, sizeof *state);
    state->stamp = part_stamp();
    memcpy(state->values, start_values, sizeof start_values);
    memcpy(state->memory, image, sizeof image);
    part_point(state);
}

static double part_time(const State *state) { return (double)state->tick * TICK; }

static Fit part_fit(const Variable *variable, double value)
{
    if (variable->kind != INPUT && !isfinite(value))
        return NOT_FINITE;
    if (value < variable->min || (variable->above_min && value == variable->min))
        return TOO_LOW;
    if (value > variable->max || (variable->below_max && value == variable->max))
        return TOO_HIGH;
    return FITS;
}

static bool evaluate(State *state, const Component *c, Failure *failure)
{
    double *u = state->u + c->u, *y = state->values + c->y;
    for (unsigned j = 0; j < c->n_u; j++)
        u[j] = state->values[sources[c->u + j]];
    int32_t result = 0;
    void *exception = NULL;
    failure->component = c;
    const int raised = c->step[form](&result, &exception, memory_of(state) + c->memory, part_time(state), c->period * TICK,
                               u, y);
    failure->status = raised ? raised : (int)result;
    if (raised || (result != 0 && result != 1))
        return false;
    failure->status = 0;
    /* without a way out on the way: the compiler then looks at several at once */
    int strange = 0;
    for (unsigned j = 0; c->finite && j < c->n_y; j++)
        strange |= !isfinite(y[j]);
    return !strange;
}

static void put(State *state, const Place *place)
{
    const double si = state->values[place->value] * place->factor / place->divisor * place->times;
    memcpy(memory_of(state) + place->offset, &si, sizeof si);
}

static bool part_derive(State *state, Failure *failure)
{
    for (int k = 0; k < N_PLACES; k++)
        put(state, &places[k]);
    for (int c = 0; c < N_COMPONENTS; c++)
        if (components[c].period == 0 && !evaluate(state, &components[c], failure))
            return false;
    return true;
}

static void part_tune(State *state, const Variable *variable)
{
    for (int k = 0; k < N_PLACES; k++)
        if (places[k].value - variable->first < variable->size)
            put(state, &places[k]);
}

static bool part_advance(State *state, int64_t ticks, Failure *failure)
{
    for (const int64_t end = state->tick + ticks; state->tick < end; state->tick++)
        for (int c = 0; c < N_COMPONENTS; c++) {
            const int period = components[c].period;
            if (period && (period == 1 || state->tick % period == 0) && !evaluate(state, &components[c], failure)) {
                state->mode = FAILED;
                return false;
            }
        }
    return true;
}
