/* One FMI 2.0 co-simulation slave: what lifecycle.c, access.c and fmu_state.c share. */
#ifndef SLAVE_H
#define SLAVE_H

#include "fmi2Functions.h"
#include "model.h"

/* The modes of FMI 2.0.4, section 4.2.4 (state machine of calling sequence). */
typedef enum { INSTANTIATED, INITIALIZATION, STEPPING, TERMINATED } Mode;

/* A row of the variable table; the value reference is the row number. */
typedef struct {
    const char *name;
    bool is_input, is_whole;
    double start, min, max;
} Variable;

extern const Variable variables[N_VARIABLES];

/* Whether the variable may have this value: within its bounds, no NaN, no fraction where there are only kinds and counts. */
bool holds(const Variable *variable, double value);

/* Everything that get/setFMUstate must keep; copied as bytes. */
typedef struct {
    Mode mode;
    double time;
    Variables v;
} State;

typedef struct {
    State state;
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    char name[128];
} Slave;

/* Logs the reason and returns fmi2Error. The refused call has changed nothing, so a slave stays usable. */
fmi2Status refuse(const Slave *slave, const char *format, ...) __attribute__((format(printf, 2, 3)));

#endif
