/* A tiny FMU for the tests: the two sprung masses of docs/examples, as FMI 2.0 and FMI 3.0 co-simulation at once.
 * Variables: 0, 1 inputs; 2, 3 outputs; 4 stiffness (parameter); 5 the step of doStep that fails (parameter). */
#include <stdlib.h>
#include <string.h>

typedef struct {
    double u[2], position[2], speed[2], stiffness, fails_at;
    int steps;
    void (*log2)(void *, const char *, int, const char *, const char *, ...);
} Model;

static Model *made(void)
{
    Model *m = calloc(1, sizeof(Model));
    m->stiffness = 9.0e4;
    m->fails_at = -1.0;
    return m;
}

static double *variable(Model *m, unsigned r)
{
    double *all[] = {&m->u[0], &m->u[1], &m->speed[0], &m->speed[1], &m->stiffness, &m->fails_at};
    return r < 6 ? all[r] : NULL;
}

static int set(Model *m, const unsigned *r, size_t n, const double *v)
{
    for (size_t i = 0; i < n; i++) {
        if (!variable(m, r[i]))
            return 3;
        *variable(m, r[i]) = v[i];
    }
    return 0;
}

static int get(Model *m, const unsigned *r, size_t n, double *v)
{
    for (size_t i = 0; i < n; i++) {
        if (!variable(m, r[i]))
            return 3;
        v[i] = *variable(m, r[i]);
    }
    return 0;
}

static int step(Model *m, double h)
{
    const double damping = 12.0, coupling = 0.125;
    double y[2] = {m->speed[0], m->speed[1]};
    if (m->steps++ == (int)m->fails_at) {
        if (m->log2)
            m->log2(NULL, "bench", 3, "error", "the table is not level");
        return 3;
    }
    for (int i = 0; i < 2; i++) {
        double force = m->u[i] - m->stiffness * m->position[i] - damping * m->speed[i] + coupling * y[1 - i];
        m->speed[i] = m->speed[i] + h * force;
        m->position[i] = m->position[i] + h * m->speed[i];
    }
    return 0;
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void *fmi2Instantiate(const char *name, int kind, const char *guid, const char *where, const void *callbacks, int visible, int logging)
{
    Model *m = made();
    (void)name, (void)kind, (void)where, (void)visible, (void)logging;
    memcpy(&m->log2, callbacks, sizeof m->log2);
    return strcmp(guid, "{two-masses}") == 0 ? m : NULL;
}
void fmi2FreeInstance(void *m) { free(m); }
int fmi2SetupExperiment(void *m, int t, double tol, double start, int s, double stop)
{
    (void)m, (void)t, (void)tol, (void)start, (void)s, (void)stop;
    return 0;
}
int fmi2EnterInitializationMode(void *m) { return m == NULL; }
int fmi2ExitInitializationMode(void *m) { return m == NULL; }
int fmi2Terminate(void *m) { return m == NULL; }
int fmi2SetReal(void *m, const unsigned *r, size_t n, const double *v) { return set(m, r, n, v); }
int fmi2GetReal(void *m, const unsigned *r, size_t n, double *v) { return get(m, r, n, v); }
int fmi2DoStep(void *m, double t, double h, int keep) { (void)t, (void)keep; return step(m, h); }

const char *fmi3GetVersion(void) { return "3.0"; }
void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *where, _Bool visible, _Bool logging, _Bool events,
                                  _Bool early, const unsigned *needed, size_t n, void *environment, void *log, void *update)
{
    (void)name, (void)where, (void)visible, (void)logging, (void)events, (void)early, (void)needed, (void)n;
    (void)environment, (void)log, (void)update;
    return strcmp(token, "{two-masses}") == 0 ? made() : NULL;
}
void fmi3FreeInstance(void *m) { free(m); }
int fmi3EnterInitializationMode(void *m, _Bool t, double tol, double start, _Bool s, double stop)
{
    (void)t, (void)tol, (void)start, (void)s, (void)stop;
    return m == NULL;
}
int fmi3ExitInitializationMode(void *m) { return m == NULL; }
int fmi3Terminate(void *m) { return m == NULL; }
int fmi3SetFloat64(void *m, const unsigned *r, size_t n, const double *v, size_t k) { (void)k; return set(m, r, n, v); }
int fmi3GetFloat64(void *m, const unsigned *r, size_t n, double *v, size_t k) { (void)k; return get(m, r, n, v); }
int fmi3DoStep(void *m, double t, double h, _Bool keep, _Bool *event, _Bool *end, _Bool *early, double *last)
{
    (void)keep;
    *event = *end = *early = 0;
    *last = t + h;
    return step(m, h);
}
