"""Test vectors of the emitted frame: what the converters read, and every word that must stand in memory after it."""

import numpy as np
from numpy.typing import NDArray

from ultraquiet.deploy.c31.assembly import table_sum
from ultraquiet.deploy.c31.edges import edges
from ultraquiet.deploy.c31.float_format import encode
from ultraquiet.deploy.c31.pushes import FULL, Push, pushes, twin_of
from ultraquiet.deploy.law.law import Law

ALONE = 4  # frames from rest with one measurement alone
AFTER = 12  # silent frames after each of them, in which states alone make the commands
RUN = 130  # frames of noise, loud and quiet by turns


def vectors(law: Law, driven: list[Push] | None = None) -> str:
    """Return as CSV the word that the check of the tables must find, then frames.

    The first line is `check` and that word: NAME_check leaves it in R0, so no bit of a coefficient, limit or scale is
    another, however little it would change a command. The frames: `rest`, the codes read and written, and in
    hexadecimal the words of u and x after it. One with `rest` begins with all states at the C31's zero, 0x80000000;
    every other one goes on from the frame before. First each measurement alone, several times, so that each coefficient
    that it meets is seen, then each command beyond either limit (`pushes`, searched here when `driven` is absent)
    and a count from it on both sides, then noise, from half the converter's range down to 2^-13 of it.
    """
    twin = twin_of(law)
    heads = [f"{what}{k}" for what, n in (("adc", law.inputs), ("dac", law.outputs)) for k in range(n)]
    heads += [f"{what}{k}" for what, n in (("u", law.outputs), ("x", law.states)) for k in range(n)]
    lines = [f"check,0x{table_sum(law):08X}", ",".join(["rest", *heads])]
    for rest, counts in frames(law, pushes(law) if driven is None else driven):
        if rest:
            twin.reset()
        codes = twin.frame(counts)
        words = [f"0x{word:08X}" for word in encode(np.concatenate([twin.u, twin.x]))]
        lines.append(",".join([str(int(rest)), *map(str, counts.tolist()), *map(str, codes.tolist()), *words]))
    return "\n".join(lines) + "\n"


def frames(law: Law, driven: list[Push], seed: int = 0) -> list[tuple[bool, NDArray[np.int64]]]:
    """Return (from rest, codes of the reading converters) for every frame of the vectors."""
    rng, silent = np.random.default_rng(seed), np.zeros(law.inputs, np.int64)
    made: list[tuple[bool, NDArray[np.int64]]] = []
    for j in range(law.inputs):
        for k in range(ALONE):
            alone = silent.copy()
            alone[j] = int(rng.integers(FULL // 2, FULL)) * (-1) ** k
            made += [(True, alone), *[(False, silent)] * AFTER]
    twin = twin_of(law)
    for push in driven:
        made += [(k == 0, row) for k, row in enumerate([*push.counts, *edges(twin, push)])]
    noise = rng.integers(-FULL, FULL, (RUN, law.inputs)) >> (1 + np.arange(RUN) % 13)[:, None]
    return made + [(k == 0, row) for k, row in enumerate(noise)]
