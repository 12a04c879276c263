/* The robot's computer as its header has it, in front of a part; the only names it adds to a program are `computer_`. */
#include "part.c"
#include "tables.c"
#include "computer.h"
/* generated: STEP_TICKS, N_PARAMETERS, `parameters`, `failures`, take and give */
#include "fields.c"

_Static_assert(sizeof(State) <= sizeof(computer), "a computer holds the state of its part");

static State *state_of(computer *it) { return (State *)it->opaque; }

/* The values of parameter k within `all`. */
static double *values_in(const computer_parameters *all, int k)
{
    return (double *)((char *)all + parameters[k].place);
}

static const char *sentence_of(const Failure *failure)
{
    const int k = (int)(failure->component - components);
    return failure->status ? failures[k].status : failures[k].not_finite;
}

void computer_defaults(computer_parameters *all)
{
    for (int k = 0; k < N_PARAMETERS; k++)
        memcpy(values_in(all, k), start_values + variables[k].first, variables[k].size * sizeof(double));
}

/* Why parameter k cannot have the values it has in `all`. */
static const char *misfit(const computer_parameters *all, int k)
{
    for (unsigned j = 0; j < variables[k].size; j++)
        if (part_fit(&variables[k], values_in(all, k)[j]) != FITS)
            return parameters[k].range;
    return NULL;
}

static void set(State *state, const computer_parameters *all, int k)
{
    memcpy(state->values + variables[k].first, values_in(all, k), variables[k].size * sizeof(double));
}

const char *computer_init(computer *it, const computer_parameters *all)
{
    State *state = state_of(it);
    part_reset(state);
    for (int k = 0; all && k < N_PARAMETERS; k++) {
        const char *wrong = misfit(all, k);
        if (wrong)
            return wrong;
        set(state, all, k);
    }
    Failure failure;
    if (!part_derive(state, &failure))
        return sentence_of(&failure);
    state->mode = STEPPING;
    return NULL;
}

const char *computer_tune(computer *it, const computer_parameters *all)
{
    State *state = state_of(it);
    for (int k = 0; k < N_PARAMETERS; k++) {
        for (unsigned j = 0; j < variables[k].size; j++)
            if (variables[k].kind != TUNABLE && state->values[variables[k].first + j] != values_in(all, k)[j])
                return parameters[k].fixed;
        const char *wrong = misfit(all, k);
        if (wrong)
            return wrong;
    }
    for (int k = 0; k < N_PARAMETERS; k++)
        if (variables[k].kind == TUNABLE) {
            set(state, all, k);
            part_tune(state, &variables[k]);
        }
    return NULL;
}

const char *computer_step(computer *it, const computer_counts *counts, computer_output *out)
{
    static const computer_output NOTHING;
    State *state = state_of(it);
    *out = NOTHING;
    if (state->mode != STEPPING)
        return state->mode == FAILED ? "a step failed before; computer_reset comes first"
                                     : "computer_init comes first, and was not refused";
    part_point(state); /* it may lie elsewhere than before */
    take(state, counts);
    Failure failure;
    if (!part_advance(state, STEP_TICKS, &failure))
        return sentence_of(&failure);
    give(state, out);
    return NULL;
}

const char *computer_reset(computer *it)
{
    computer_parameters all;
    for (int k = 0; k < N_PARAMETERS; k++)
        memcpy(values_in(&all, k), state_of(it)->values + variables[k].first, variables[k].size * sizeof(double));
    return computer_init(it, &all);
}
