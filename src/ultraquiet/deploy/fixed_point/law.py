"""A law in whole numbers: Q31 or Q15 coefficients and states."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.provenance import content_hash
from ultraquiet._base.shown import Shown
from ultraquiet.values.state_space import StateSpace

Whole = NDArray[np.int64]
WORDS = {"q15": 16, "q31": 32}


@dataclass(frozen=True, eq=False)
class FixedLaw(Shown):
    """The law as integers. With w bits, measurements, states and commands are fractions of 2^(w-1) of their range.

    acc = r(A x, a + 2) + r(B y, b + 2);  x+ = r(acc, w - 4), and x + that in delta form;
    u = r(C x + D y, w - 2 + c), saturated at the range; r(v, s) = floor(v / 2^s + 1/2).

    A `(blocks, 4)` and B `(n, ny)` hold w - 2 + a and w - 2 + b fractional bits, `shift_a` per block and `shift_b` per
    state; C `(n, nu)` and D `(nu, ny)` w - 2 + c, `shift_u` per command. Accumulators have 2 w bits. `peak` is the
    largest fraction of full scale any state can reach (L1) with measurements in range, rounding included; with
    `saturates` it may exceed 1 and states are limited. `noise_v` `(nu,)` is the rms of the rounding noise in the
    commands, `noise_bound_v` its proven bound.
    """

    name: str
    word: str
    form: str
    scaling: str
    A: Whole
    B: Whole
    C: Whole
    D: Whole
    shift_a: Whole
    shift_b: Whole
    shift_u: Whole
    input_v: float
    output_v: float
    rate_hz: float
    order: int
    peak: float
    accumulator: float
    noise_v: FloatArray
    noise_bound_v: FloatArray
    ramp_bits: int = 0

    @property
    def bits(self) -> int:
        """Bits of a word."""
        return WORDS[self.word]

    @property
    def top(self) -> int:
        """Largest word; the least that the code holds is its negative."""
        return 2 ** (self.bits - 1) - 1

    @property
    def delta(self) -> bool:
        """True when the blocks hold A - I."""
        return self.form == "delta"

    @property
    def inputs(self) -> int:
        """Number of measurements."""
        return self.D.shape[1]

    @property
    def outputs(self) -> int:
        """Number of commands."""
        return self.D.shape[0]

    @property
    def states(self) -> int:
        """Number of stored states."""
        return self.B.shape[0]

    @property
    def saturates(self) -> bool:
        """Whether states are limited in the code because no bound keeps them within their words."""
        return self.scaling == "l2"

    @property
    def hash(self) -> str:
        """SHA-256 of every integer and setting."""
        integers = (self.A, self.B, self.C, self.D, self.shift_a, self.shift_b, self.shift_u)
        settings = [self.word, self.form, self.scaling, self.ramp_bits, self.rate_hz, self.input_v, self.output_v]
        return content_hash(*integers, settings)

    @property
    def multiply_adds(self) -> int:
        """Multiply-adds of a step."""
        return self.A.size + self.B.size + self.C.size + self.D.size

    @property
    def coefficient_bytes(self) -> int:
        """Bytes of the coefficients."""
        return self.multiply_adds * self.bits // 8

    def state_space(self) -> StateSpace:
        """Return the linear law with its rounded coefficients, volts to volts, for an analysis in float64."""
        A, B, C, D = self.fractions()
        return StateSpace(A, B / self.input_v, self.output_v * C, self.output_v / self.input_v * D, self.rate_hz)

    def fractions(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return A, B, C `(nu, n)`, D in fractions of full scale."""
        unit = 2.0 ** (2 - self.bits)
        blocks = self.A.reshape(-1, 2, 2) * (unit * 2.0**-self.shift_a)[:, None, None]
        A = np.asarray(block_diag(*blocks), dtype=np.float64) + (np.eye(self.states) if self.delta else 0.0)
        B = self.B * (unit * 2.0**-self.shift_b)[:, None]
        row = unit * 2.0**-self.shift_u
        return A, B, self.C.T * row[:, None], self.D * row[:, None]
