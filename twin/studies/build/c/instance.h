/* An FMU's instance of a part: its life and its messages; fmi2.c and fmi3.c put the two versions of FMI in front. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include "part.h"

typedef struct Instance Instance;

struct Instance {
    State state;
    void *environment, *logger;
    void (*log)(const Instance *instance, const char *text);
    char name[128];
};

/* Logs the reason; returns false. */
bool refuse(const Instance *instance, const char *format, ...) __attribute__((format(printf, 2, 3)));
bool refuse_in_mode(const Instance *instance, const char *function);

Instance *instance_born(const Instance *from, const char *guid);
bool instance_enter(Instance *instance, Mode from, Mode to, const char *function);
bool instance_start_time(Instance *instance, double t);
bool instance_initialised(Instance *instance);
bool instance_step(Instance *instance, double t, double h);

/* One variable, all of its values. */
bool instance_set(Instance *instance, unsigned reference, const double *values);
bool instance_get(Instance *instance, unsigned reference, double *values);

bool instance_save(const Instance *instance, void **saved);
bool instance_restore(Instance *instance, const void *saved);
bool instance_serialize(const Instance *instance, const void *saved, unsigned char *bytes, size_t size);
bool instance_deserialize(const Instance *instance, const unsigned char *bytes, size_t size, void **saved);

#endif
