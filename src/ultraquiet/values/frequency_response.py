"""A frequency response: complex gains over frequency, with what is known of their quality."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array, frozen
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.shown import Shown, counted
from ultraquiet.values.channel import Channel, channels
from ultraquiet.values.neighbours.responses import ResponseNeighbours


@dataclass(frozen=True, init=False, eq=False)
class FrequencyResponse(Shown, ResponseNeighbours):
    """Complex response `(ny, nu, nf)` at frequencies `f_hz` `(nf,)`.

    Args:
        f_hz: frequencies in Hz.
        values: complex gains, output unit per input unit.
        coherence: `(ny, nu, nf)` between 0 and 1, or None.
        estimator: how it was estimated (`H1`, `H2`, ...), with windows and averages; empty for a model's response.
        variance: `(ny, nu, nf)` of the complex gains, squared units of `values`, or None.
    """

    f_hz: FloatArray
    values: ComplexArray
    coherence: FloatArray | None
    estimator: str
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]
    provenance: Provenance = field(default_factory=Provenance)
    variance: FloatArray | None = None

    def __init__(
        self,
        f_hz: ArrayLike,
        values: ArrayLike,
        coherence: ArrayLike | None = None,
        estimator: str = "",
        actuators: Sequence[Channel | str] | None = None,
        sensors: Sequence[Channel | str] | None = None,
        provenance: Provenance | None = None,
        variance: ArrayLike | None = None,
    ) -> None:
        f = frequency_array("FrequencyResponse", f_hz)
        g = np.array(values, dtype=np.complex128)
        if g.ndim != 3 or g.shape[2] != f.size:
            raise InputError(f"FrequencyResponse: values must be (ny, nu, {f.size}), got {g.shape}.")
        c = None if coherence is None else np.array(coherence, dtype=np.float64)
        v = None if variance is None else np.array(variance, dtype=np.float64)
        for name, quality in (("coherence", c), ("variance", v)):
            if quality is not None and quality.shape != g.shape:
                raise InputError(f"FrequencyResponse: {name} has shape {quality.shape}, values have {g.shape}.")
        put = object.__setattr__
        put(self, "f_hz", frozen(f))
        put(self, "values", frozen(g))
        put(self, "coherence", None if c is None else frozen(c))
        put(self, "variance", None if v is None else frozen(v))
        put(self, "estimator", estimator)
        put(self, "actuators", channels("FrequencyResponse", actuators, g.shape[1], "input"))
        put(self, "sensors", channels("FrequencyResponse", sensors, g.shape[0], "output"))
        put(self, "provenance", provenance or Provenance())

    def _in_a_line(self) -> str:
        wires = f"{counted(len(self.actuators), 'input')}, {counted(len(self.sensors), 'output')}"
        span = f" from {self.f_hz.min():.4g} to {self.f_hz.max():.4g} Hz" if self.f_hz.size else ""
        told = [wires, f"{counted(self.f_hz.size, 'line')}{span}", self.estimator]
        return ", ".join(each for each in told if each)

    def _as_curve(self) -> tuple[str, FloatArray]:
        return f"gain in dB, {self.actuators[0].name} to {self.sensors[0].name}", self.magnitude_db[0, 0]

    @property
    def magnitude_db(self) -> FloatArray:
        """20 log10 of the gain, `(ny, nu, nf)`; minus infinity where it is zero."""
        with np.errstate(divide="ignore"):
            return 20.0 * np.log10(np.abs(self.values))

    @property
    def phase_deg(self) -> FloatArray:
        """Phase in degrees, unwrapped along frequency, `(ny, nu, nf)`."""
        return np.degrees(np.unwrap(np.angle(self.values), axis=2))
