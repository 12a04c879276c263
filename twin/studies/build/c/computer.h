/* The robot's computer: counts of its encoders in, speeds for its drives out.
 *
 *     computer it;
 *     computer_output out;
 *     const char *wrong = computer_init(&it, NULL);
 *     every COMPUTER_STEP_S seconds, from the newest counts:
 *         wrong = computer_step(&it, &counts, &out);
 *
 * What returns text returns NULL if all is well, else why not, one sentence. Nothing allocates or prints; a `computer`
 * is plain memory, may be copied, and there may be several. All values are in SI units, but those of parameters, which
 * have the unit that is in their name. */
#ifndef COMPUTER_H
#define COMPUTER_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* TYPES */

/* The parameters as they were built: those of the experiment. */
void computer_defaults(computer_parameters *parameters);

/* A computer before its first step, its time at 0. NULL: with the defaults. What follows from the parameters is worked
 * out here. If one is refused, computer_step will not start. */
const char *computer_init(computer *it, const computer_parameters *parameters);

/* Other values of parameters that are marked as tunable, between two steps; if any other differs, none is taken. */
const char *computer_tune(computer *it, const computer_parameters *parameters);

/* One step: what follows from these counts, to be sent to the drives at once. If it fails, all of `out` is 0: the
 * drives stand still and have no power, until computer_reset. */
const char *computer_step(computer *it, const computer_counts *counts, computer_output *out);

/* The same as after computer_init, with the parameters that it has. */
const char *computer_reset(computer *it);

#ifdef __cplusplus
}
#endif

#endif
