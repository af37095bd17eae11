"""Test vectors of the emitted frame: what the converters read, and every word that must stand in memory after it."""

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import FloatArray
from ultraquiet.deploy.c31.assembly import COUNTS_PER_VOLT, VOLTS_PER_COUNT, converter_limits, table_sum
from ultraquiet.deploy.c31.float_format import encode
from ultraquiet.deploy.c31.twin import C31Twin
from ultraquiet.deploy.law.law import Law

FULL = 2**15
ALONE = 4  # frames from rest with one measurement alone
AFTER = 12  # silent frames after each of them, in which states alone make the commands
PUSH = 16  # frames that drive one command as far as measurements drive it from rest
RUN = 130  # frames of noise, loud and quiet by turns


def vectors(law: Law) -> str:
    """Return as CSV the word that the check of the tables must find, then frames.

    The first line is `check` and that word: NAME_check leaves it in R0, so no bit of a coefficient, limit or scale is
    another, however little it would change a command. The frames: `rest`, the codes read and written, and in
    hexadecimal the words of u and x after it. One with `rest` begins with all states at the C31's zero, 0x80000000;
    every other one goes on from the frame before. First each measurement alone, several times, so that each coefficient
    that it meets is seen, then each command towards either limit, by measurements at full range with the signs of its
    impulse response, then noise, from half the converter's range down to 2^-13 of it.
    """
    twin = _twin(law)
    heads = [f"{what}{k}" for what, n in (("adc", law.inputs), ("dac", law.outputs)) for k in range(n)]
    heads += [f"{what}{k}" for what, n in (("u", law.outputs), ("x", law.states)) for k in range(n)]
    lines = [f"check,0x{table_sum(law):08X}", ",".join(["rest", *heads])]
    for rest, counts in frames(law):
        if rest:
            twin.reset()
        codes = twin.frame(counts)
        words = [f"0x{word:08X}" for word in encode(np.concatenate([twin.u, twin.x]))]
        lines.append(",".join([str(int(rest)), *map(str, counts.tolist()), *map(str, codes.tolist()), *words]))
    return "\n".join(lines) + "\n"


def frames(law: Law, seed: int = 0) -> list[tuple[bool, NDArray[np.int64]]]:
    """Return (from rest, codes of the reading converters) for every frame of the vectors."""
    rng, silent = np.random.default_rng(seed), np.zeros(law.inputs, np.int64)
    made: list[tuple[bool, NDArray[np.int64]]] = []
    for j in range(law.inputs):
        for k in range(ALONE):
            alone = silent.copy()
            alone[j] = int(rng.integers(FULL // 2, FULL)) * (-1) ** k
            made += [(True, alone), *[(False, silent)] * AFTER]
    for signs in np.where(_answers(law) < 0, -1, 1)[:, :, ::-1]:
        for side in (1, -1):
            made += [(k == 0, row) for k, row in enumerate((side * (FULL - 1) * signs).T)]
    noise = rng.integers(-FULL, FULL, (RUN, law.inputs)) >> (1 + np.arange(RUN) % 13)[:, None]
    return made + [(k == 0, row) for k, row in enumerate(noise)]


def _answers(law: Law) -> FloatArray:
    """Return the commands, before their limits, that follow one count of each measurement, `(nu, ny, PUSH)`.

    In the frame's own arithmetic: the sign of an answer that is nothing but rounding would be another with another
    BLAS.
    """
    twin, answers = _twin(law), np.zeros((law.outputs, law.inputs, PUSH))
    for j, counts in enumerate(np.eye(law.inputs, dtype=np.int64)):
        twin.reset()
        for k in range(PUSH):
            twin.frame(counts if k == 0 else np.zeros_like(counts))
            answers[:, j, k] = twin.u
    return answers


def _twin(law: Law) -> C31Twin:
    return C31Twin(law, converter_limits(law), VOLTS_PER_COUNT, COUNTS_PER_VOLT)
