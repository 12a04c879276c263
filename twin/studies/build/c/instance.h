/* An FMU's instance of a part: its life and its messages; fmi2.c and fmi3.c put the two versions of FMI in front. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include "part.h"

typedef struct Instance Instance;

struct Instance {
    State state;
    int64_t last; /* tick at which the master has said that it stops; no step goes beyond */
    void *environment, *logger;
    void (*log)(const Instance *instance, const char *text);
    char name[128];
};

/* Logs the reason; returns false. */
static bool refuse(const Instance *instance, const char *format, ...) __attribute__((format(printf, 2, 3)));
static bool refuse_in_mode(const Instance *instance, const char *function);

static Instance *instance_born(const Instance *from, const char *guid);
static bool instance_enter(Instance *instance, Mode from, Mode to, const char *function);
static bool instance_times(Instance *instance, double start, bool stops, double stop);
static void instance_reset(Instance *instance);
static bool instance_initialised(Instance *instance);
static bool instance_step(Instance *instance, double t, double h);

/* One variable, all of its values. */
static inline bool instance_set(Instance *instance, unsigned reference, const double *values);
static inline bool instance_get(Instance *instance, unsigned reference, double *values);

static bool instance_save(const Instance *instance, void **saved);
static bool instance_restore(Instance *instance, const void *saved);
static bool instance_serialize(const Instance *instance, const void *saved, unsigned char *bytes, size_t size);
static bool instance_deserialize(const Instance *instance, const unsigned char *bytes, size_t size, void **saved);

#endif
