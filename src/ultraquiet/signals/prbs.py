"""A pseudo-random binary signal from a shift register."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import formerly, register
from ultraquiet.signals._abstract import Signal, clock, draws, level_above_zero, upper_hz

# Feedback taps of shift registers of maximal length, by number of stages: primitive polynomials over GF(2).
# Reference: W. Stahnke, Math. Comp. 27 (1973) 977-980, doi:10.1090/S0025-5718-1973-0327722-7.
TAPS: dict[int, tuple[int, ...]] = {
    5: (5, 3),
    6: (6, 5),
    7: (7, 6),
    8: (8, 6, 5, 4),
    9: (9, 5),
    10: (10, 7),
    11: (11, 9),
    12: (12, 6, 4, 1),
    13: (13, 4, 3, 1),
    14: (14, 5, 3, 1),
    15: (15, 14),
    16: (16, 15, 13, 4),
    17: (17, 14),
    18: (18, 11),
    19: (19, 6, 2, 1),
    20: (20, 17),
}
# The power of a held binary sequence follows sinc^2(f / clock), which falls by 3 dB at this fraction of the clock.
HALF_POWER = 0.4429


@register("signals", "prbs")
@formerly(level_v="level")
@dataclass(frozen=True)
class Prbs(Signal):
    """Switches between -level and +level by a maximal-length sequence, each bit held for whole samples.

    S(f) ~ sinc^2(f / clock), half power at `stop_hz` with clock = stop_hz / 0.4429, rounded to whole samples a bit.

    Args:
        stop_hz: bandwidth (half power) in Hz, at most 0.4429 times the sampling rate; 0.4 times it when absent.
        level: in the actuator's unit; one when absent, in a list
            a tenth of the actuator's range.

    Raises:
        InputError: a level not above zero, a bandwidth that would need bits shorter than a sample.

    >>> u = Prbs(stop_hz=150, level=25).generate(4096, 3500.0, seed=3)
    >>> sorted(set(u.tolist()))
    [-25.0, 25.0]

    Reference: section 3.3 of the paper (150 Hz).
    """

    stop_hz: float | None = None
    level: float | None = None

    levels = ("level",)

    def __post_init__(self) -> None:
        if self.stop_hz is not None:
            positive("Prbs", "stop_hz", self.stop_hz, "Hz")
        level_above_zero("Prbs", "level", self.level)

    def hold_samples(self, rate_hz: float) -> int:
        """Return for how many samples each bit is held."""
        stop = upper_hz(self.stop_hz, rate_hz)
        if stop > HALF_POWER * rate_hz:
            raise InputError(
                f"Prbs: 'stop_hz' of {stop:g} Hz must not exceed {HALF_POWER * rate_hz:g} Hz at a sampling "
                f"rate of {rate_hz:g} Hz; lower it or sample faster."
            )
        return max(1, round(HALF_POWER * rate_hz / stop))

    def generate(self, samples: int, rate_hz: float, seed: int = 0) -> FloatArray:
        """Return the sequence in the actuator's unit, `(samples,)`; the seed chooses where in its period it begins.

        The register is long enough that nothing repeats within `samples`, up to a million bits.
        """
        n, rate = clock("Prbs", samples, rate_hz)
        hold = self.hold_samples(rate)
        bits = -(-n // hold)
        stages = next((k for k in TAPS if 2**k - 1 >= bits), max(TAPS))
        start = 1 + int(draws("Prbs", seed).integers(2**stages - 1))
        return self.level_of("level") * (2.0 * np.repeat(sequence(stages, bits, start), hold)[:n] - 1.0)


def sequence(stages: int, bits: int, start: int) -> FloatArray:
    """Return `bits` zeros and ones of the register of `stages` stages, begun at the non-zero state `start`."""
    # b(k) = xor of b(k - tap): filled block by block, each as long as the shortest tap allows.
    taps = TAPS[stages]
    out = np.empty(stages + bits, dtype=np.int8)
    out[:stages] = [(start >> i) & 1 for i in range(stages)]
    step, k = min(taps), stages
    while k < out.size:
        stop = min(k + step, out.size)
        out[k:stop] = np.bitwise_xor.reduce([out[k - tap : stop - tap] for tap in taps])
        k = stop
    return out[:bits].astype(np.float64)
