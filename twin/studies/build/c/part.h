/* A part of the robot: components with compiled steps, in one block of plain numbers. It neither prints nor
 * allocates. What is made of a part includes part.c and tables.c: names are its own then, and calls cost nothing. */
#ifndef PART_H
#define PART_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* generated: GUID, TICK, the N_ numbers, MEMORY_BYTES */
#include "sizes.h"

typedef enum { INSTANTIATED, INITIALIZATION, STEPPING, TERMINATED, FAILED } Mode;

typedef enum { PARAMETER, TUNABLE, INPUT, OUTPUT } Kind;

/* A variable as FMI sees it; its value reference is its row. */
typedef struct {
    const char *name;
    Kind kind;
    unsigned first, size; /* of its values */
    double min, max;
    bool above_min, below_max; /* the limit itself is not allowed */
} Variable;

/* Where the value `value`, a parameter, goes: memory[offset] = value * factor / divisor * times. */
typedef struct {
    unsigned value, offset;
    double factor, divisor, times;
} Place;

/* An address within the memory: the pointer at `field` points to `target`. */
typedef struct {
    unsigned field, target;
} Pointer;

/* What numba makes of `int32 step(self, t, h, u, y)`: it returns 0 if `*result` is the step's own status. */
typedef int CompiledStep(int32_t *result, void **exception, void *self, double t, double h, const double *u,
                         double *y);

/* What steps are written for beside any processor of the kind: the suffixes of their names in `platforms.py`. */
#ifdef __x86_64__
enum { ANY, AVX, AVX512, N_FORMS };
#define DECLARE_STEP(name) extern CompiledStep name, name##_avx, name##_avx512
#define STEP(name) {name, name##_avx, name##_avx512}
#else
enum { ANY, N_FORMS };
#define DECLARE_STEP(name) extern CompiledStep name
#define STEP(name) {name}
#endif

typedef struct {
    const char *name;
    CompiledStep *step[N_FORMS];
    int period; /* ticks; 0: evaluated before the first step only */
    unsigned memory, u, n_u, y, n_y; /* bytes, places in u, its outputs among the values */
    bool finite;        /* whether its outputs have to be */
    const char *status; /* what status 2 means, if anything */
} Component;

static const Variable variables[N_VARIABLES];
static const double start_values[N_VALUES];
static const Place places[N_PLACES + 1];
static const Pointer pointers[N_POINTERS + 1];
static const Component components[N_COMPONENTS];
static const unsigned sources[N_U + 1]; /* of each value of u, the value that feeds it */
static const uint64_t image[(MEMORY_BYTES + 7) / 8];

/* All that a part is; copied as bytes. Pointers in it are of the instance and never of a copy. */
typedef struct {
    uint64_t stamp;
    Mode mode;
    int64_t first, tick; /* at which initialisation put it, and now */
    double values[N_VALUES], u[N_U + 1];
    double memory[(MEMORY_BYTES + 7) / 8];
} State;

/* Which component failed, and with what status; 0: an output is not finite. */
typedef struct {
    const Component *component;
    int status;
} Failure;

typedef enum { FITS, NOT_FINITE, TOO_LOW, TOO_HIGH } Fit;

/* Of the build: a state of another one is recognised by it. */
static uint64_t part_stamp(void);
/* Everything as it was built. */
static void part_reset(State *state);
/* Pointers in the memory, after it was moved. */
static void part_point(State *state);
static double part_time(const State *state);
static Fit part_fit(const Variable *variable, double value);
/* All that follows from parameters and from inputs at the start; false if a component fails. */
static bool part_derive(State *state, Failure *failure);
/* A tunable parameter that was set between two steps takes effect. */
static void part_tune(State *state, const Variable *variable);
/* So many ticks, from the inputs in `values`, where the outputs are too; false if a component fails. */
static bool part_advance(State *state, int64_t ticks, Failure *failure);

#endif
