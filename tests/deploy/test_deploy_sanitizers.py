"""Random bits at every entrance, in random order, under the address and undefined-behaviour sanitizers."""

import subprocess

import pytest

from ultraquiet.deploy import generate
from ultraquiet.deploy.toolchain.compiler import FLAGS

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

static controller_bank pair[2];
static uint32_t words[CONTROLLER_BANK_WORDS];
static unsigned long hooked, loaded, excited;
static void hook(controller_state *s) { hooked += s->overruns > 0U; }

static uint32_t any(uint32_t below) { return (uint32_t)(draw() >> 33) % below; }

static const controller_real *excitation(void)
{
    static controller_real v[CONTROLLER_OUTPUTS];
    for (unsigned i = 0; i < CONTROLLER_OUTPUTS; i++) {
        unsigned long long bits = draw();
        if (any(8)) v[i] = (controller_real)((double)(bits >> 11) / 2251799813685248.0 - 2.0);
        else memcpy(&v[i], &bits, sizeof v[i]);
    }
    return v;
}

static uint32_t sum(void) /* CRC-32, by its definition */
{
    uint32_t crc = 0xFFFFFFFFU;
    for (unsigned k = 0; k < CONTROLLER_BANK_WORDS; k++)
        for (unsigned bit = 0; bit < 32; bit++)
            crc = (crc >> 1) ^ (((crc ^ (words[k] >> bit)) & 1U) ? 0xEDB88320U : 0U);
    return ~crc;
}

/* The bank in use, or any finite bits, or any bits at all; the right CRC or a wrong one. */
static bool bank(controller_state *s)
{
    const uint32_t kind = any(4);
    memcpy(words, s->bank->v, sizeof words);
    for (unsigned k = 0; kind && k < CONTROLLER_BANK_WORDS; k++)
        if (kind > 1 || any(64) == 0) words[k] = (uint32_t)draw();
    if (kind == 2) for (unsigned k = 0; k < CONTROLLER_BANK_WORDS; k++) words[k] &= 0xBFFFFFFFU;
    return controller_load_bank(s, words, any(4) ? sum() : (uint32_t)draw());
}

int main(int argc, char **argv)
{
    controller_state *s = malloc(sizeof *s); /* on the heap: the sanitizer guards its edges */
    controller_real *y = malloc(sizeof(controller_real) * CONTROLLER_INPUTS);
    controller_real *u = malloc(sizeof(controller_real) * CONTROLLER_OUTPUTS);
    unsigned long faults = 0, steps = 0, swaps = 0;
    controller_tap tap;
    controller_real shown[CONTROLLER_TAPS];
    if (argc < 3 || !s || !y || !u) return 2;
    state = strtoull(argv[1], NULL, 10) * 2ULL + 1ULL;
    const unsigned long count = strtoul(argv[2], NULL, 10);
    controller_init(s, hook);
    controller_attach(s, pair);
    for (unsigned long k = 0; k < count; k++) {
        const unsigned long long kind = draw() >> 56;
        for (unsigned j = 0; j < CONTROLLER_INPUTS; j++) {
            unsigned long long bits = draw();
            const double one = (double)(bits >> 11) / 4503599627370496.0 - 1.0;
            if (kind < 250) y[j] = (controller_real)(one * LEVEL);
            else memcpy(&y[j], &bits, sizeof y[j]);
        }
        if (kind == 7) {
            controller_init(s, (bits_of(k)) ? hook : 0);
            if (k % 4UL) controller_attach(s, pair);
        }
        if (kind % 16 == 9) excited += controller_excite(s, excitation());
        if (kind == 19) loaded += bank(s);
        if (kind % 64 == 21) swaps += controller_swap(s, (draw() & 1ULL) != 0ULL);
        if (kind == 23) (void)controller_select(s, any(6), any(9), any(CONTROLLER_STATES + 2U));
        if (kind % 16 == 3) (void)controller_enable(s);
        if (kind == 11) controller_disable(s);
        if (kind % 16 == 5) (void)controller_clear(s);
        (void)controller_frame(s);
        controller_output(s, y, u);
        if (kind == 13) (void)controller_frame(s);
        if (kind != 17) controller_update(s);
        controller_read(s, &tap);
        controller_monitor(s, shown);
        faults += tap.faults != 0U;
        steps += tap.mode == CONTROLLER_ON;
        for (unsigned i = 0; i < CONTROLLER_OUTPUTS; i++) {
            if (!(u[i] >= -(controller_real)25 && u[i] <= (controller_real)25)) {
                printf("command %u is %g at step %lu\n", i, (double)u[i], k);
                return 1;
            }
        }
    }
    printf("%lu steps: %lu in control, %lu with a fault, %lu overruns hooked, %lu excitations, %lu banks, %lu swaps\n",
           count, steps, faults, hooked, excited, loaded, swaps);
    free(s); free(y); free(u);
    return controller_self_test() == 0U
           && steps > 1000 && faults > 50 && hooked > 10 && excited > 100 && loaded > 10 && swaps > 10 ? 0 : 1;
}
""".replace("(bits_of(k))", "(k % 2UL)")


def supported(cc, folder):
    (folder / "empty.c").write_text("int main(void) { return 0; }\n")
    told = subprocess.run([cc, *SANITIZERS, "empty.c", "-o", "empty"], cwd=folder, capture_output=True, check=False)
    return told.returncode == 0 and subprocess.run([folder / "empty"], capture_output=True, check=False).returncode == 0


def fuzz(made, cc, seed, steps):
    """Run the driver over `steps` random steps under the sanitizers and return what it said."""
    folder = made.folder
    (folder / "driver.c").write_text(DRIVER)
    sources = ["driver.c", "controller.c", "controller_selftest.c"]
    plain = [f for f in FLAGS if f not in ("-Wconversion", "-Werror")]
    subprocess.run([cc, *plain, *SANITIZERS, "-DLEVEL=60", *sources, "-o", "driver"], cwd=folder, check=True)
    command = [folder / "driver", str(seed), str(steps)]
    told = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    print(told.stdout)
    assert told.returncode == 0, told.stdout + told.stderr


@pytest.mark.gate("modal-float32")
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("form", ["modal", "schur"])
def test_random_bits_leave_commands_within_limits(law_of, seed, tmp_path, cc, form, precision):
    if not supported(cc, tmp_path):
        pytest.skip(f"{cc} has no address and undefined-behaviour sanitizers")
    made = generate(
        law_of(12), tmp_path / "code", precision, form=form, limits_v=25.0, anti_windup=form == "modal", ramp_s=0.005
    )
    fuzz(made, cc, seed, 100_000)


@pytest.mark.slow
@pytest.mark.parametrize("anti_windup", [False, True])
def test_two_million_steps_of_random_bits(law_of, seed, tmp_path, cc, anti_windup):
    if not supported(cc, tmp_path):
        pytest.skip(f"{cc} has no address and undefined-behaviour sanitizers")
    made = generate(law_of(60), tmp_path / "code", form="modal", limits_v=25.0, anti_windup=anti_windup, ramp_s=0.005)
    fuzz(made, cc, seed, 2_000_000)
