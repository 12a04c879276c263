/* The benchmark's yardstick: drive FMUs in a co-simulation with nothing around them but this loop. */
#include <stddef.h>
#include <stdint.h>

/* `Drive`, the memory of a drive component: c_loop.py writes it from `PLAIN_MEMORY` of twin/kernel/fmi/cosim_step.py. */
#include "drive.h"

typedef int SetReal(void *instance, const unsigned *references, size_t count, const double *values);
typedef int DoStep(void *instance, double t, double h, int no_set_state_prior_to_t);
typedef int GetReal(void *instance, const unsigned *references, size_t count, double *values);

static int step(const Drive *drive, double t, double h, const double *u, double *y)
{
    void *instance = (void *)drive->instance;
    if (((SetReal *)drive->set_real)(instance, (const unsigned *)drive->input_references, drive->inputs, u) > 1)
        return 2;
    if (((DoStep *)drive->do_step)(instance, t, h, (int)drive->final) > 1)
        return 2;
    return ((GetReal *)drive->get_real)(instance, (const unsigned *)drive->output_references, drive->outputs, y);
}

/* Gauss-Seidel: `sources` says which element of `y` feeds each input. */
int macro_steps(const Drive *drives, int count, const int64_t *sources, double *u, double *y, double h,
                int64_t ticks)
{
    for (int64_t k = 0; k < ticks; k++) {
        const int64_t *source = sources;
        double *output = y;
        for (int c = 0; c < count; c++) {
            for (int64_t j = 0; j < drives[c].inputs; j++)
                u[j] = y[*source++];
            if (step(&drives[c], k * h, h, u, output) > 1)
                return c + 1;
            output[drives[c].shifted] += drives[c].shift;
            output += drives[c].outputs;
        }
    }
    return 0;
}

/* The same calls with inputs that never change: what the FMUs themselves take. */
int calls_alone(const Drive *drives, int count, const double *u, double *y, double h, int64_t ticks)
{
    for (int64_t k = 0; k < ticks; k++)
        for (int c = 0; c < count; c++)
            if (step(&drives[c], k * h, h, u, y) > 1)
                return c + 1;
    return 0;
}

/* One component, its inputs held: what its step itself takes. */
int component_steps(int32_t (*step)(void *self, double t, double h, const double *u, double *y), void *self,
                    const double *u, double *y, double h, int64_t ticks)
{
    for (int64_t k = 0; k < ticks; k++)
        if (step(self, k * h, h, u, y) != 0)
            return 1;
    return 0;
}

/* An FMI 2.0 slave by itself, its inputs held. */
int slave_steps(int (*do_step)(void *instance, double t, double h, int no_set_state_prior_to_t), void *instance,
                double h, int64_t first, int64_t ticks)
{
    for (int64_t k = first; k < first + ticks; k++)
        if (do_step(instance, k * h, h, 1) != 0)
            return 1;
    return 0;
}
