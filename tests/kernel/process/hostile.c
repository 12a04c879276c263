/* A drive that attacks its host one second after its start, or at another time, in the way that its parameter `droop`
 * says (the list `ATTACKS` of hostile.py). The honest functions are those of lifecycle.c, renamed. */
#include "slave.h"

#include <locale.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { NONE, SEGFAULT, ABORT, EXIT, HANG, HANG_IN_INITIALISATION, SEGFAULT_IN_FREE, FLOOD, MOVE, LEAK, FORK };

void honest_FreeInstance(fmi2Component c);
fmi2Status honest_ExitInitializationMode(fmi2Component c);

static volatile int forever = 1;

static int attack(const Variables *v) { return (int)v->droop; }

/* the default action, whatever handler the host has: what a wild pointer does */
static void segfault(void)
{
    signal(SIGSEGV, SIG_DFL);
    *(volatile int *)8 = 1;
}

static void print_megabytes(void)
{
    static char line[1024];
    memset(line, 'x', sizeof line - 2);
    line[sizeof line - 2] = '\n';
    for (int k = 0; k < 4096; k++)
        fputs(line, stdout);
    fflush(stdout);
}

bool model_step(Variables *v, double h)
{
    v->tau_motor += h; /* the time since the start */
    v->theta_m += v->omega_ref * h;
    const bool now = v->tau_motor > 1.0 - 0.5 * h && v->tau_motor < 1.0 + 0.5 * h;
    if (attack(v) == LEAK && v->tau_motor > 1.0 - 0.5 * h) {
        void *lost = malloc(4 << 20);
        memset(lost, 1, 4 << 20);
    }
    if (!now)
        return true;
    switch (attack(v)) {
    case SEGFAULT: segfault(); break;
    case ABORT: abort();
    case EXIT: exit(0);
    case HANG: while (forever) {} break;
    case FLOOD: print_megabytes(); break;
    case FORK: /* what it leaves behind holds every pipe of its host open */
        if (fork() == 0)
            while (forever)
                pause();
        segfault();
        break;
    case MOVE:
        if (chdir("/") != 0)
            abort();
        setlocale(LC_ALL, "");
        break;
    }
    return true;
}

void fmi2FreeInstance(fmi2Component c)
{
    if (attack(&((Slave *)c)->state.v) == SEGFAULT_IN_FREE)
        segfault();
    honest_FreeInstance(c);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    if (attack(&((Slave *)c)->state.v) == HANG_IN_INITIALISATION)
        while (forever) {}
    return honest_ExitInitializationMode(c);
}
