"""A recursion with filters that begins from nothing: batch fits of its first samples, each of twice as many."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.identify.prediction_error.fit import fit_channel
from ultraquiet.identify.prediction_error.initial_models import ChannelData
from ultraquiet.identify.record_checks import SAMPLES_PER_PARAMETER
from ultraquiet.identify.recursive.settings import RecursionSettings
from ultraquiet.linalg import prediction
from ultraquiet.values import PolynomialModel

# Samples of the last of these fits at most. A recursion from a batch fit of 80 samples missed the batch estimate of an
# ARMAX of 7 coefficients with a resonant C in 32 of 40 draws, from 240 in 2, from 500 in none.
LONGEST = 2048


class Beginning:
    """The first samples of a recursion, kept until there are enough of them to begin from.

    Gradients of a model that is still wrong pass through its C and F and point nowhere; information gathered along
    them is never corrected. So the first model is a batch fit of ten samples a parameter, and the fit is repeated
    whenever the samples have doubled, as long as they are no more than `longest` and no older than the memory. Between
    the fits the recursion goes on: its predictions are better than those of a fit that stands still.
    """

    def __init__(
        self, settings: RecursionSettings, rate_hz: float, inputs: int, parameters: int, longest: int = LONGEST
    ) -> None:
        self._settings, self._rate_hz = settings, rate_hz
        self._first = SAMPLES_PER_PARAMETER * parameters
        memory = np.inf if settings.memory_s is None else settings.memory_s * rate_hz
        self._longest = int(max(self._first, min(longest, memory)))
        self._due, self._kept, self._begun = self._first, 0, False
        self._inputs, self._outputs = np.empty((inputs, self._longest)), np.empty(self._longest)

    @property
    def missing(self) -> int:
        """Samples until the next fit; 0 when it is due."""
        return self._due - self._kept

    @property
    def last(self) -> int:
        """Samples of the last fit."""
        return self._first << (self._longest // self._first).bit_length() - 1

    @property
    def over(self) -> bool:
        """Whether the recursion goes on alone."""
        return self._begun and self._due > self._longest

    @property
    def samples(self) -> tuple[FloatArray, FloatArray]:
        """Inputs `(nu, m)` and output `(m,)` that are kept, units of the record."""
        return self._inputs[:, : self._kept], self._outputs[: self._kept]

    def take(self, u: FloatArray, y: FloatArray) -> None:
        """Keep samples, `(nu, m)` and `(m,)`, no more than are missing."""
        new = slice(self._kept, self._kept + y.size)
        self._inputs[:, new], self._outputs[new] = u, y
        self._kept += y.size

    def fit(self) -> tuple[PolynomialModel, float] | None:
        """Return the model of the samples kept and its constant at the output; None when they carry none."""
        found = self._fit()
        self._begun = self._begun or found is not None
        self._due *= 2
        return found

    def forget_silence(self) -> None:
        """Begin with the next sample when those kept are many enough and carried no model."""
        if not self._begun and (self._due > self._longest or not self._moving()):
            self._due, self._kept = self._first, 0

    def _moving(self) -> bool:
        u, y = self.samples
        return bool(np.all(np.ptp(u, axis=1) > 0.0) and np.ptp(y) > 0.0)

    def _fit(self) -> tuple[PolynomialModel, float] | None:
        if not self._moving():
            return None
        u, y = self.samples
        s = self._settings
        try:
            model = fit_channel(ChannelData(u, y), s.structure, s.search, self._rate_hz).model
        except (InputError, np.linalg.LinAlgError):
            return None
        return model, constant_at_output(model, u, y) if s.offset else 0.0


def constant_at_output(model: PolynomialModel, inputs: FloatArray, output: FloatArray) -> float:
    """Return the constant at the output that goes with a model: least squares on the whitened residual of its end."""
    v = prediction.filtered(output, model.a, np.ones(1))
    for x, b, f in zip(inputs, model.b, model.f, strict=True):
        v = v - prediction.filtered(x, b, f)
    settled = output.size // 4
    e, one = (prediction.filtered(x, model.d, model.c)[settled:] for x in (v, np.ones(v.size)))
    return float(e @ one / (one @ one))
