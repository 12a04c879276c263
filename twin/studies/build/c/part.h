/* A part of the robot: components with compiled steps, in one block of plain numbers. */
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

typedef struct {
    const char *name;
    CompiledStep *step;
    int period; /* ticks; 0: evaluated before the first step only */
    unsigned memory, u, n_u, y, n_y;
    bool finite;        /* whether its outputs have to be */
    const char *status; /* what status 2 means, if anything */
} Component;

extern const Variable variables[N_VARIABLES];
extern const double start_values[N_VALUES];
extern const Place places[N_PLACES + 1];
extern const Pointer pointers[N_POINTERS + 1];
extern const Component components[N_COMPONENTS];
extern const int sources[N_U + 1]; /* of each value of u: >= 0 a value of y, else the value -1 - source */
extern const int outputs[N_Y];     /* where each value of y is published, -1: nowhere */
extern const double first_y[N_Y];
extern const uint64_t image[(MEMORY_BYTES + 7) / 8];

/* All that a saved state holds; copied as bytes. Pointers in it are of the instance and never of a copy. */
typedef struct {
    uint64_t stamp;
    Mode mode;
    int64_t first, tick; /* at which initialisation put it, and now */
    double values[N_VALUES], u[N_U + 1], y[N_Y];
    double memory[(MEMORY_BYTES + 7) / 8];
} State;

typedef struct Part Part;

struct Part {
    State state;
    void *environment, *logger;
    void (*log)(const Part *part, const char *text);
    char name[128];
};

/* Logs the reason; returns false. */
bool refuse(const Part *part, const char *format, ...) __attribute__((format(printf, 2, 3)));
bool refuse_in_mode(const Part *part, const char *function);

Part *part_born(const Part *from, const char *guid);
void part_reset(Part *part);
bool part_enter(Part *part, Mode from, Mode to, const char *function);
bool part_start_time(Part *part, double t);
double part_time(const Part *part);
bool part_initialised(Part *part);
bool part_step(Part *part, double t, double h);

/* One variable, all of its values. */
bool part_set(Part *part, unsigned reference, const double *values);
bool part_get(Part *part, unsigned reference, double *values);

bool part_save(const Part *part, void **saved);
bool part_restore(Part *part, const void *saved);
bool part_serialize(const Part *part, const void *saved, unsigned char *bytes, size_t size);
bool part_deserialize(const Part *part, const unsigned char *bytes, size_t size, void **saved);

#endif
