/* dx/dt = A x + B u, y = C x + D u as an FMI 2.0 FMU of both kinds, for tests: up to 4 states, 2 inputs, 2 outputs.
 * Co-simulation solves it exactly for inputs that are held over a step. It asks to end at `ends_at`. Its numbers stand
 * in its guid. Inputs may have a slope over the next step. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))
#define F(name) EXPORT int fmi2##name
enum { N = 4, M = 2, P = 2, W = N + 2 * M };
/* value references: inputs, outputs, states, start of the states, A, B, C, D, ends_at, calls of doStep */
enum { U = 0, Y = 2, X = 4, X0 = 8, A = 12, B = 28, C = 36, D = 44, ENDS_AT = 48, STEPS = 49, DX = 50, SIZE = 54 };
enum { OK = 0, DISCARD = 2, BAD = 3 };

typedef struct {
    double r[SIZE], time, slope[M];
    int ended;
} Model;

static void outputs(Model *m)
{
    for (int i = 0; i < P; i++) {
        double y = 0.0;
        for (int j = 0; j < N; j++)
            y += m->r[C + i * N + j] * m->r[X + j];
        for (int j = 0; j < M; j++)
            y += m->r[D + i * M + j] * m->r[U + j];
        m->r[Y + i] = y;
    }
}

static void rates(const Model *m, double dx[])
{
    for (int i = 0; i < N; i++) {
        dx[i] = 0.0;
        for (int j = 0; j < N; j++)
            dx[i] += m->r[A + i * N + j] * m->r[X + j];
        for (int j = 0; j < M; j++)
            dx[i] += m->r[B + i * M + j] * m->r[U + j];
    }
}

static void product(const double a[W][W], const double b[W][W], double c[W][W])
{
    double t[W][W] = {{0}};
    for (int i = 0; i < W; i++)
        for (int j = 0; j < W; j++)
            for (int k = 0; k < W; k++)
                t[i][j] += a[i][k] * b[k][j];
    memcpy(c, t, sizeof t);
}

/* x(t + h): the exponential of [A B 0; 0 0 1; 0 0 0] h, by its series for a small part of h, squared again and again */
static void advance(Model *m, double h)
{
    double g[W][W] = {{0}}, e[W][W] = {{0}}, term[W][W] = {{0}}, norm = 0.0;
    for (int i = 0; i < N; i++)
        for (int j = 0; j < W; j++) {
            g[i][j] = j < N + M ? h * (j < N ? m->r[A + i * N + j] : m->r[B + i * M + j - N]) : 0.0;
            norm = fmax(norm, fabs(g[i][j]));
        }
    for (int j = 0; j < M; j++)
        g[N + j][N + M + j] = h;
    norm = fmax(norm, h);
    int halvings = norm > 0.0 ? (int)fmax(0.0, ceil(log2(norm)) + 6) : 0;
    for (int i = 0; i < W; i++)
        for (int j = 0; j < W; j++) {
            g[i][j] = ldexp(g[i][j], -halvings);
            e[i][j] = term[i][j] = i == j;
        }
    for (int n = 1; n < 12; n++) {
        product(term, g, term);
        for (int i = 0; i < W; i++)
            for (int j = 0; j < W; j++) {
                term[i][j] /= n;
                e[i][j] += term[i][j];
            }
    }
    for (int n = 0; n < halvings; n++)
        product(e, e, e);
    double x[N];
    for (int i = 0; i < N; i++) {
        x[i] = 0.0;
        for (int j = 0; j < W; j++)
            x[i] += e[i][j] * (j < N ? m->r[X + j] : j < N + M ? m->r[U + j - N] : m->slope[j - N - M]);
    }
    memcpy(m->r + X, x, sizeof x);
    for (int j = 0; j < M; j++) {
        m->r[U + j] += h * m->slope[j];
        m->slope[j] = 0.0;
    }
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const void *functions, int visible, int logging)
{
    Model *m = calloc(1, sizeof *m);
    char *next = (char *)guid;
    for (int k = X0; k <= ENDS_AT; k++)
        m->r[k] = strtod(next, &next);
    return m;
}
EXPORT void fmi2FreeInstance(void *c) { free(c); }
F(SetupExperiment)(Model *m, int defined, double tolerance, double start, int stops, double stop) { m->time = start; return OK; }
F(EnterInitializationMode)(Model *m) { memcpy(m->r + X, m->r + X0, N * sizeof(double)); return OK; }
F(ExitInitializationMode)(Model *m) { outputs(m); return OK; }
F(GetReal)(Model *m, const unsigned vr[], size_t n, double v[])
{
    outputs(m);
    rates(m, m->r + DX);
    for (size_t k = 0; k < n; k++)
        v[k] = m->r[vr[k]];
    return OK;
}
F(SetReal)(Model *m, const unsigned vr[], size_t n, const double v[]) { for (size_t k = 0; k < n; k++) m->r[vr[k]] = v[k]; return OK; }
F(SetRealInputDerivatives)(Model *m, const unsigned vr[], size_t n, const int order[], const double v[])
{
    for (size_t k = 0; k < n; k++)
        m->slope[vr[k] - U] = v[k];
    return OK;
}
F(DoStep)(Model *m, double t, double h, int final)
{
    m->r[STEPS] += 1.0;
    if (fabs(t - m->time) > 1e-9)
        return BAD;
    if (t + h > m->r[ENDS_AT] + 1e-12) {
        m->ended = 1;
        return DISCARD;
    }
    advance(m, h);
    m->time = t + h;
    return OK;
}
F(GetRealStatus)(Model *m, int kind, double *value) { *value = m->time; return OK; }
F(GetBooleanStatus)(Model *m, int kind, int *value) { *value = kind == 3 && m->ended; return OK; }
F(GetFMUstate)(Model *m, Model **kept) { if (!*kept) *kept = malloc(sizeof *m); **kept = *m; return OK; }
F(SetFMUstate)(Model *m, const Model *kept) { *m = *kept; return OK; }
F(FreeFMUstate)(Model *m, Model **kept) { free(*kept); *kept = NULL; return OK; }
F(SerializedFMUstateSize)(Model *m, const Model *kept, size_t *size) { *size = sizeof *m; return OK; }
F(SerializeFMUstate)(Model *m, const Model *kept, char bytes[], size_t size) { memcpy(bytes, kept, size); return OK; }
F(DeSerializeFMUstate)(Model *m, const char bytes[], size_t size, Model **kept) { *kept = malloc(sizeof *m); memcpy(*kept, bytes, size); return OK; }
F(Terminate)(void *c) { return OK; }
F(Reset)(Model *m) { memset(m->r + X, 0, N * sizeof(double)); return OK; }
/* model exchange */
typedef struct {
    int needed, ended, nominals, states, timed;
    double time;
} EventInfo;
F(EnterEventMode)(void *c) { return OK; }
F(NewDiscreteStates)(Model *m, EventInfo *info) { *info = (EventInfo){0, m->time >= m->r[ENDS_AT], 0, 0, isfinite(m->r[ENDS_AT]), m->r[ENDS_AT]}; return OK; }
F(EnterContinuousTimeMode)(void *c) { return OK; }
F(CompletedIntegratorStep)(void *c, int final, int *event, int *ended) { *event = *ended = 0; return OK; }
F(SetTime)(Model *m, double t) { m->time = t; return OK; }
F(SetContinuousStates)(Model *m, const double x[], size_t n) { memcpy(m->r + X, x, n * sizeof *x); return OK; }
F(GetContinuousStates)(Model *m, double x[], size_t n) { memcpy(x, m->r + X, n * sizeof *x); return OK; }
F(GetDerivatives)(Model *m, double dx[], size_t n) { double all[N]; rates(m, all); memcpy(dx, all, n * sizeof *dx); return OK; }
F(GetNominalsOfContinuousStates)(Model *m, double x[], size_t n) { for (size_t k = 0; k < n; k++) x[k] = 1.0; return OK; }
F(GetEventIndicators)(void *c, double z[], size_t n) { return OK; }
#define NOT_OFFERED(name) F(name)(void) { return BAD; }
NOT_OFFERED(GetInteger) NOT_OFFERED(GetBoolean) NOT_OFFERED(GetString) NOT_OFFERED(SetBoolean)
F(SetInteger)(void *c, const unsigned vr[], size_t n, const int v[]) { return v[0] == 2 ? OK : BAD; }
NOT_OFFERED(SetString) NOT_OFFERED(SetDebugLogging) NOT_OFFERED(GetDirectionalDerivative)
NOT_OFFERED(GetRealOutputDerivatives) NOT_OFFERED(GetStatus)
NOT_OFFERED(GetIntegerStatus) NOT_OFFERED(GetStringStatus)
#ifndef LACKING
NOT_OFFERED(CancelStep)
#endif
