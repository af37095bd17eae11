"""Random bits at every entrance, in random order, under the address and undefined-behaviour sanitizers."""

import subprocess

import pytest

from ultraquiet.deploy import generate
from ultraquiet.deploy.emit import FLAGS

SANITIZERS = ["-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]

DRIVER = r"""
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "controller.h"

static unsigned long long state;

static unsigned long long draw(void) /* xorshift64*, Vigna 2016 */
{
    state ^= state >> 12; state ^= state << 25; state ^= state >> 27;
    return state * 2685821657736338717ULL;
}

static unsigned long hooked;
static void hook(controller_state *s) { hooked += s->overruns > 0U; }

int main(int argc, char **argv)
{
    controller_state *s = malloc(sizeof *s); /* on the heap: the sanitizer guards its edges */
    controller_real *y = malloc(sizeof(controller_real) * CONTROLLER_INPUTS);
    controller_real *u = malloc(sizeof(controller_real) * CONTROLLER_OUTPUTS);
    unsigned long faults = 0, steps = 0;
    controller_tap tap;
    if (argc < 2 || !s || !y || !u) return 2;
    state = strtoull(argv[1], NULL, 10) * 2ULL + 1ULL;
    controller_init(s, hook);
    for (unsigned long k = 0; k < 200000UL; k++) {
        const unsigned long long kind = draw() >> 56;
        for (unsigned j = 0; j < CONTROLLER_INPUTS; j++) {
            unsigned long long bits = draw();
            const double one = (double)(bits >> 11) / 4503599627370496.0 - 1.0;
            if (kind < 250) y[j] = (controller_real)(one * LEVEL);
            else memcpy(&y[j], &bits, sizeof y[j]);
        }
        if (kind == 7) controller_init(s, (bits_of(k)) ? hook : 0);
        if (kind % 16 == 3) (void)controller_enable(s);
        if (kind == 11) controller_disable(s);
        if (kind % 16 == 5) (void)controller_clear(s);
        (void)controller_frame(s);
        controller_output(s, y, u);
        if (kind == 13) (void)controller_frame(s);
        if (kind != 17) controller_update(s);
        controller_read(s, &tap);
        faults += tap.faults != 0U;
        steps += tap.mode == CONTROLLER_ON;
        for (unsigned i = 0; i < CONTROLLER_OUTPUTS; i++) {
            if (!(u[i] >= -(controller_real)25 && u[i] <= (controller_real)25)) {
                printf("command %u is %g at step %lu\n", i, (double)u[i], k);
                return 1;
            }
        }
    }
    printf("%lu steps in control, %lu with a fault, %lu overruns hooked\n", steps, faults, hooked);
    free(s); free(y); free(u);
    return controller_self_test() == 0U && steps > 1000 && faults > 50 && hooked > 10 ? 0 : 1;
}
""".replace("(bits_of(k))", "(k % 2UL)")


def supported(cc, folder):
    (folder / "empty.c").write_text("int main(void) { return 0; }\n")
    told = subprocess.run([cc, *SANITIZERS, "empty.c", "-o", "empty"], cwd=folder, capture_output=True, check=False)
    return told.returncode == 0 and subprocess.run([folder / "empty"], capture_output=True, check=False).returncode == 0


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("form", ["modal", "schur"])
def test_random_bits_leave_commands_within_limits(law_of, seed, tmp_path, cc, form, precision):
    if not supported(cc, tmp_path):
        pytest.skip(f"{cc} has no address and undefined-behaviour sanitizers")
    folder = tmp_path / "code"
    generate(law_of(12), folder, precision, form=form, anti_windup=form == "modal", ramp_s=0.005)
    (folder / "driver.c").write_text(DRIVER)
    sources = ["driver.c", "controller.c", "controller_selftest.c"]
    plain = [f for f in FLAGS if f not in ("-Wconversion", "-Werror")]
    subprocess.run([cc, *plain, *SANITIZERS, "-DLEVEL=60", *sources, "-o", "driver"], cwd=folder, check=True)
    told = subprocess.run([folder / "driver", str(seed)], capture_output=True, text=True, timeout=120, check=False)
    print(told.stdout)
    assert told.returncode == 0, told.stdout + told.stderr
