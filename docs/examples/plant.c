/* A plant that speaks the line protocol of docs/line-protocol.md on its standard input and output: two sprung masses,
 * pushed by two actuators, their speeds measured. C99 and C++ alike:
 *
 *     cc -O2 -ffp-contract=off -o plant plant.c      or      c++ -O2 -ffp-contract=off -x c++ -o plant plant.c
 *
 * Put your own plant into `rest`, `step` and the lines of the handshake; the rest stays as it is. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { ACTUATORS = 2, SENSORS = 2, LINE = 4096 };

static double position[2], speed[2];

static void rest(void)
{
    for (int i = 0; i < 2; i++) {
        position[i] = 0.0;
        speed[i] = 0.0;
    }
}

/* y is what is read now; u (the command formed one sample before) and d (the disturbance) act until the next sample. */
static void step(const double *u, const double *d, double *y)
{
    const double h = 1.0 / 2000.0, stiffness = 9.0e4, damping = 12.0, coupling = 0.125;
    for (int i = 0; i < 2; i++)
        y[i] = speed[i];
    for (int i = 0; i < 2; i++) {
        double push = u[i] + d[i];
        double other = y[1 - i];
        double force = push - stiffness * position[i] - damping * speed[i] + coupling * other;
        speed[i] = speed[i] + h * force;
        position[i] = position[i] + h * speed[i];
    }
}

static void introduce(void)
{
    printf("ultraquiet-plant 1\n");
    printf("rate 2000\n");
    printf("actuator N -25 25 push 1\nactuator N -25 25 push 2\n");
    printf("sensor m/s -10 10 speed 1\nsensor m/s -10 10 speed 2\n");
    printf("ahead 64\nnumbers hex\nready\n");
}

static int answer(char *at)
{
    double in[2 * ACTUATORS], y[SENSORS];
    for (int i = 0; i < 2 * ACTUATORS; i++) {
        char *end;
        in[i] = strtod(at, &end); /* reads decimal and hexadecimal numbers, rounds correctly */
        if (end == at)
            return 0;
        at = end;
    }
    step(in, in + ACTUATORS, y);
    for (int i = 0; i < SENSORS; i++)
        printf(i == 0 ? "y %a" : " %a", y[i]); /* %.17g would do as well */
    printf("\n");
    return 1;
}

int main(void)
{
    char line[LINE];
    setvbuf(stdout, NULL, _IOLBF, 1 << 16); /* every line leaves at once, and whole */
    while (fgets(line, sizeof line, stdin)) {
        if (strncmp(line, "step ", 5) == 0) {
            if (!answer(line + 5))
                printf("error step takes %d numbers\n", 2 * ACTUATORS);
        } else if (strncmp(line, "hello 1", 7) == 0) {
            introduce();
        } else if (strncmp(line, "reset", 5) == 0 || strncmp(line, "end", 3) == 0) {
            rest();
            printf("ok\n");
        } else {
            printf("error unknown word\n");
        }
    }
    rest(); /* the driver has gone: hardware would be brought to rest here */
    return 0;
}
