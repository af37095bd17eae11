/* Drives an FMI 2.0 unit through its life under sanitizers: argument 1 is its GUID. Exit code 0, or the check that failed. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { CHANNELS = 6, STEPS = 5000 };

typedef void (*Logger)(void *, const char *, int, const char *, const char *, ...);
typedef struct {
    Logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} Callbacks;

void *fmi2Instantiate(const char *, int, const char *, const char *, const Callbacks *, int, int);
int fmi2SetupExperiment(void *, int, double, double, int, double);
int fmi2EnterInitializationMode(void *);
int fmi2ExitInitializationMode(void *);
int fmi2SetReal(void *, const unsigned *, size_t, const double *);
int fmi2GetReal(void *, const unsigned *, size_t, double *);
int fmi2GetString(void *, const unsigned *, size_t, const char **);
int fmi2DoStep(void *, double, double, int);
int fmi2GetFMUstate(void *, void **);
int fmi2SetFMUstate(void *, void *);
int fmi2FreeFMUstate(void *, void **);
int fmi2Reset(void *);
void fmi2FreeInstance(void *);

static int said;

static void listen(void *e, const char *name, int status, const char *category, const char *words, ...)
{
    (void)e, (void)status, (void)category;
    if (strncmp(name, "gone", 4) != 0 || words[0] == '\0')
        abort();
    said++;
}

static double any_bits(void)
{
    uint32_t bits = ((uint32_t)rand() << 16) ^ (uint32_t)rand();
    float value;
    memcpy(&value, &bits, sizeof value); /* of a float, so that no cast overflows */
    return (double)value;
}

static int live(void *m, int wild)
{
    unsigned in[CHANNELS], out[CHANNELS], bad = 99;
    double y[CHANNELS], u[CHANNELS];
    const char *text;
    void *kept = NULL;
    for (unsigned i = 0; i < CHANNELS; i++)
        in[i] = 1 + i, out[i] = 1 + CHANNELS + i;
    if (fmi2SetupExperiment(m, 0, 0, 1.5, 0, 0) || fmi2EnterInitializationMode(m) || fmi2ExitInitializationMode(m))
        return 4;
    for (int k = 0; k < STEPS; k++) {
        for (int j = 0; j < CHANNELS; j++)
            y[j] = wild && k % 3 == 0 ? any_bits() : rand() / 2e9 - 0.5;
        if (fmi2SetReal(m, in, CHANNELS, y) || fmi2DoStep(m, 1.5 + k / 3500.0, 1 / 3500.0, 0) ||
            fmi2GetReal(m, out, CHANNELS, u))
            return 5;
        for (int i = 0; i < CHANNELS; i++)
            if (!(u[i] <= 25.0 && u[i] >= -25.0))
                return 6;
        if (k % 2000 == 500 && fmi2GetFMUstate(m, &kept))
            return 7;
    }
    if (fmi2SetFMUstate(m, kept) || fmi2FreeFMUstate(m, &kept) || fmi2FreeFMUstate(m, &kept))
        return 8;
    if (!fmi2SetFMUstate(m, kept) || !fmi2DoStep(m, 0, 1, 0) || !fmi2GetReal(m, &bad, 1, u))
        return 9;
    if (!fmi2GetString(m, &bad, 1, &text) || fmi2GetString(m, &bad, 0, &text) || fmi2Reset(m))
        return 10;
    return 0;
}

int main(int count, char **words)
{
    Callbacks callbacks = {listen, NULL, NULL, NULL, NULL};
    char *name = calloc(200, 1);
    void *m;
    int failed = 0;
    if (count < 2 || name == NULL)
        return 1;
    memset(name, 'x', 199);
    memcpy(name, "gone", 4);
    m = fmi2Instantiate(name, 1, words[1], "", &callbacks, 0, 0);
    free(name); /* as an importer may */
    if (m == NULL || fmi2Instantiate("gone", 1, "another", "", &callbacks, 0, 0) != NULL)
        return 2;
    if (fmi2Instantiate("gone", 0, words[1], "", &callbacks, 0, 0) != NULL)
        return 3;
    for (int round = 0; round < 3 && !failed; round++)
        failed = live(m, round == 2);
    fmi2FreeInstance(m);
    printf("%d steps, %d sentences in the log\n", 3 * STEPS, said);
    return failed;
}
