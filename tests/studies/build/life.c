/* Mistakes in the life of a computer: what it says, and that nothing moves then. */
#include "computer.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static void say(const char *when, const char *wrong) { printf("%s: %s\n", when, wrong ? wrong : "fine"); }

/* Counts of Fig. 4 at its start. */
static const computer_counts START = {{497, -90, -90}, {1020, -141, -141}, 1};

static int complain(const char *what)
{
    fprintf(stderr, "%s\n", what);
    return 1;
}

int main(void)
{
    static computer it, other;
    static const computer_output NOTHING;
    computer_output told, first, again;
    computer_parameters all;
    computer_counts lost = START;
    say("before init", computer_step(&it, &START, &told));
    computer_defaults(&all);
    all.controller.model.k_s_Nm_per_rad = 0.0;
    say("no stiffness", computer_init(&it, &all));
    say("then a step", computer_step(&it, &START, &told));
    computer_defaults(&all);
    all.controller.force.kp_mm_per_N = NAN;
    say("not a number", computer_init(&it, &all));

    if (computer_init(&it, NULL))
        return complain("the defaults are refused");
    lost.count_l[0] = 9000;
    memset(&told, 1, sizeof told);
    say("no pose", computer_step(&it, &lost, &told));
    if (memcmp(&told, &NOTHING, sizeof told) != 0)
        return complain("the drives are told something after a failure");
    say("then a step", computer_step(&it, &START, &told));
    if (computer_reset(&it) || computer_step(&it, &START, &first))
        return complain("a reset does not help");
    if (first.omega_ref[0] == 0.0 || !first.power)
        return complain("the first step is nothing");

    /* a copy goes on by itself, wherever it lies */
    memcpy(&other, &it, sizeof it);
    if (computer_step(&it, &START, &again))
        return complain("the second step fails");
    memset(&it, 0, sizeof it);
    if (computer_step(&other, &START, &told) || memcmp(&told, &again, sizeof told) != 0)
        return complain("a copy does not go on as the original");

    computer_defaults(&all);
    all.controller.model.k_s_Nm_per_rad = 1.5;
    say("stiffness while it runs", computer_tune(&other, &all));
    computer_defaults(&all);
    all.controller.position.kp_per_s = -1.0;
    say("gain of -1 while it runs", computer_tune(&other, &all));
    computer_defaults(&all);
    all.controller.position.kp_per_s *= 2.0;
    if (computer_tune(&other, &all) || computer_step(&other, &START, &again))
        return complain("a tunable gain cannot be tuned");
    if (fabs(again.omega_ref[0] / told.omega_ref[0] - 2.0) > 1e-9)
        return complain("a gain of two has not the effect of two");
    if (computer_reset(&other) || computer_step(&other, &START, &again))
        return complain("it cannot be reset");
    if (fabs(again.omega_ref[0] / first.omega_ref[0] - 2.0) > 1e-9)
        return complain("a reset takes back what was tuned");
    return 0;
}
