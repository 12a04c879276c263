/* One FMI 3.0 co-simulation instance: what lifecycle.c, access.c and fmu_state.c share. */
#ifndef SLAVE_H
#define SLAVE_H

#include "fmi3Functions.h"
#include "model.h"

/* The modes of FMI 3.0.2, section 4.2 (state machine for co-simulation). */
typedef enum { INSTANTIATED, INITIALIZATION, STEPPING, TERMINATED } Mode;

/* The types these drives use, of the twelve of FMI 3.0. */
typedef enum { Float64, Float32, Int32, Boolean } Type;

/* A row of the variable table; the value reference is the row number. Whatever its type outside, inside a variable
 * is a double, which holds every value of the four types exactly. */
typedef struct {
    const char *name;
    Type type;
    bool is_input, is_whole;
    double start, min, max;
} Variable;

extern const Variable variables[N_VARIABLES];

/* Whether the variable may have this value: within its bounds, no NaN, no fraction where there are only kinds and counts. */
bool holds(const Variable *variable, double value);

/* Value reference of the independent variable `time`, which FMI 3.0 requires: the one after the table. */
#define TIME_REFERENCE N_VARIABLES

/* Everything that fmi3Get/SetFMUState must keep; copied as bytes. */
typedef struct {
    Mode mode;
    double time;
    Variables v;
} State;

typedef struct {
    State state;
    fmi3LogMessageCallback logger;
    fmi3InstanceEnvironment environment;
} Slave;

/* Logs the reason and returns fmi3Error. The refused call has changed nothing, so an instance stays usable. */
fmi3Status refuse(const Slave *slave, const char *format, ...) __attribute__((format(printf, 2, 3)));

#endif
