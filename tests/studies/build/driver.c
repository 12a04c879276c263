/* Steps an FMI 2.0 co-simulation slave by its library alone: on Linux, and under Windows or what plays it.
 *
 *     driver LIBRARY GUID TICK ROWS OUT
 *
 * The file ROWS is of doubles: how many inputs and outputs, their value references, then the inputs row by row. OUT gets
 * the outputs, first those of initialisation with the inputs of the first row, then those of each step. */
#include "fmi2FunctionTypes.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#include <windows.h>
#define OPEN(name) (void *)LoadLibraryA(name)
#define FIND(library, name) (void *)GetProcAddress((HMODULE)(library), name)
#else
#include <dlfcn.h>
#define OPEN(name) dlopen(name, RTLD_NOW)
#define FIND(library, name) dlsym(library, name)
#endif

static void complain(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category, fmi2String text,
                     ...)
{
    va_list arguments;
    va_start(arguments, text);
    vfprintf(stderr, text, arguments);
    va_end(arguments);
}

#define CALL(name, ...)                                                                                      \
    do {                                                                                                     \
        name##TYPE *f = (name##TYPE *)FIND(library, #name);                                                  \
        if (!f || f(__VA_ARGS__) != fmi2OK) {                                                                \
            fprintf(stderr, " in " #name "\n");                                                              \
            return 1;                                                                                        \
        }                                                                                                    \
    } while (0)

static double number(FILE *file)
{
    double x = 0.0;
    return fread(&x, sizeof x, 1, file) == 1 ? x : 0.0;
}

int main(int n, char *words[])
{
    void *library = n == 6 ? OPEN(words[1]) : NULL;
    FILE *rows = library ? fopen(words[4], "rb") : NULL, *out = rows ? fopen(words[5], "wb") : NULL;
    if (!out) {
        fprintf(stderr, "a library or a file cannot be opened\n");
        return 2;
    }
    const double tick = strtod(words[3], NULL);
    const size_t n_in = (size_t)number(rows), n_out = (size_t)number(rows);
    fmi2ValueReference refs[256];
    double in[256], told[256];
    for (size_t k = 0; k < n_in + n_out; k++)
        refs[k] = (fmi2ValueReference)number(rows);
    const fmi2CallbackFunctions functions = {complain, calloc, free, NULL, NULL};
    fmi2InstantiateTYPE *born = (fmi2InstantiateTYPE *)FIND(library, "fmi2Instantiate");
    fmi2Component it = born ? born("it", fmi2CoSimulation, words[2], "", &functions, fmi2False, fmi2False) : NULL;
    if (!it)
        return 1;
    CALL(fmi2SetupExperiment, it, fmi2False, 0.0, 0.0, fmi2False, 0.0);
    CALL(fmi2EnterInitializationMode, it);
    for (long k = 0; fread(in, sizeof *in, n_in, rows) == n_in; k++) {
        CALL(fmi2SetReal, it, refs, n_in, in);
        if (k == 0)
            CALL(fmi2ExitInitializationMode, it);
        else
            CALL(fmi2DoStep, it, (double)(k - 1) * tick, tick, fmi2True);
        CALL(fmi2GetReal, it, refs + n_in, n_out, told);
        fwrite(told, sizeof *told, n_out, out);
    }
    return fclose(out) != 0;
}
