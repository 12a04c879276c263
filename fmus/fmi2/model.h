/* What a drive's model.c sees and provides. */
#ifndef MODEL_H
#define MODEL_H

#include <stdbool.h>

/* generated from drive.toml: GUID, N_VARIABLES, and `Variables`, one double per variable */
#include "variables.h"

/* Advance `v` by h seconds with the inputs in `v` held constant over the step.
 * The whole state of a drive is in `v`: nothing else may be remembered between steps.
 * Returns false if the result is not finite. */
bool model_step(Variables *v, double h);

#endif
