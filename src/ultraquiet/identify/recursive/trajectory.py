"""How a model moved: its coefficients at points in time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.structure import Structure
from ultraquiet.values import PolynomialModel


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The models of one output that a recursive method passed through.

    Attributes:
        time_s: `(k,)` from the record's first sample to the last one each model knows.
        coefficients: `(k, p)` in the order a, b_1, f_1, b_2, f_2, ..., c, d (without the ones), units of the record.
        deviation: `(k, p)` their standard deviations, for a plant that has not moved within the memory.
        structure: numbers of coefficients.
        inputs: number of inputs.
        rate_hz: of the record.
    """

    time_s: FloatArray
    coefficients: FloatArray
    deviation: FloatArray
    structure: Structure
    inputs: int
    rate_hz: float

    def model(self, k: int = -1) -> PolynomialModel:
        """Return the model at point k, the last one when absent."""
        parts = self._parts(self.coefficients[k : k + 1] if k != -1 else self.coefficients[-1:])
        b = [x[0] for x in parts["b"]]
        return PolynomialModel(
            b, [x[0] for x in parts["f"]], self.rate_hz, parts["a"][0][0], parts["c"][0][0], parts["d"][0][0]
        )

    def frequency_response(self, f_hz: ArrayLike) -> ComplexArray:
        """Return B_j / (A F_j) of every point at `f_hz` (Hz), `(k, nu, nf)`."""
        f = frequency_array("Trajectory", f_hz)
        # Terms of high orders cancel near w = 1, as in `PolynomialModel.frequency_response`.
        w = np.exp(-2j * np.pi * f.astype(np.longdouble) / self.rate_hz).astype(np.clongdouble)
        parts = self._parts(self.coefficients)

        def at(p: FloatArray) -> np.ndarray:
            value = np.zeros((len(p), w.size), dtype=np.clongdouble)
            for column in p.T[::-1]:
                value = value * w + column[:, None]
            return value

        rows = [at(b) / (at(parts["a"][0]) * at(d)) for b, d in zip(parts["b"], parts["f"], strict=True)]
        return np.stack(rows, axis=1).astype(np.complex128)

    def resonance_hz(self, near_hz: float, j: int = 0) -> FloatArray:
        """Return at every point the natural frequency of the pole pair from input j that is nearest to `near_hz`.

        NaN where all poles are real.
        """
        parts = self._parts(self.coefficients)
        out = np.full(len(self.time_s), np.nan)
        for k, (a, f) in enumerate(zip(parts["a"][0], parts["f"][j], strict=True)):
            z = np.roots(np.convolve(a, f))
            z = z[z.imag > 0]
            if z.size:
                hz = np.abs(np.log(z)) * self.rate_hz / (2 * np.pi)
                out[k] = hz[np.argmin(np.abs(np.log(hz / near_hz)))]
        return out

    def _parts(self, table: FloatArray) -> dict[str, list[FloatArray]]:
        """Return the polynomials of every row of coefficients, `(k, order + 1)` each."""
        parameterisation = Parameterisation.alike(self.structure, self.inputs)
        degree, lag = parameterisation.degree(), parameterisation.lag()
        one = np.ones((len(table), 1))
        out: dict[str, list[FloatArray]] = {key: [] for key in "abcdf"}
        at = 0

        def take(row: int, key: str) -> None:
            nonlocal at
            first = np.zeros((len(table), int(lag[row]))) if key == "b" else one
            out[key].append(np.hstack([first, table[:, at : at + degree[row]]]))
            at += int(degree[row])

        take(0, "a")
        for j in range(self.inputs):
            take(3 + 2 * j, "b")
            take(4 + 2 * j, "f")
        take(1, "c")
        take(2, "d")
        return out
