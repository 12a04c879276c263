/* The law's own records, laid over consecutive variables of part.toml; every number of them is a double. */
#ifndef LAW_H
#define LAW_H

#include "model.h"

#include <math.h>
#include <stddef.h>

#define PI 3.141592653589793

/* A loop's memory: started is 0 or 1. */
typedef struct {
    double integral, derivative, error, started;
} Loop;

typedef struct {
    double kp, ki, kd, corner;
} Gains;

/* README.md (1) to (3) */
double low_pass_share(double corner, double h);
double proposal(const Gains *gains, Loop *loop, double e, double h, double *integral);
double smooth(double x);

enum { TRAVEL = 1, DESCEND, BUILD_UP, HOLD, CIRCLE, PUSH, RELEASE, RETRACT, PROBE, TAP, RISE, WAIT, DONE };
enum { ELAPSED, FELT, TURN };
enum { PRESSING = 1, TAPPING, ROLLING, PUSHING };

/* One phase of a task; a motion starts wherever the reference is. NaN keeps a coordinate. */
typedef struct {
    int kind, task;
    double target[3], lift, speed, ramp_in, ramp_out;
    double radius, rate, turns;
    int force_on;
    double F_end, duration, period;
    int until;
    double level;
    int next, otherwise, again, times;
} Phase;

/* Phase number `index` of the sequence of tasks; the last one holds for ever. */
Phase phase_at(const Variables *v, int index);

double motion_time(const Phase *phase, double length);
void motion(const Phase *phase, const double start[3], const double end[3], double length, double t, double p[3],
            double velocity[3]);

/* What the machine that walks through the phases remembers. */
typedef struct {
    double index, passes, entered, total, length;
    double start[3], end[3], p[3], v[3];
    double F_start, F_ref, lost, tapped, touching, z_before, F_before, z_felt, depth, calibrated, z_turn, z_lowest;
    double t_turn;
} Machine;

/* Advance to t: phase and references. F_delay is by how much F_z lags F. */
void walk(Machine *m, const Variables *v, double t, double h, double z, double F, double F_z, double F_rate,
          double F_delay, double dp_z);

#endif
