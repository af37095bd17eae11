"""What chance left open of a state-space response: directions in which it may lie off, each of unit variance."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.modes.modal_spread import ModalSensitivities, moved, spread_root
from ultraquiet.linalg.response import points
from ultraquiet.values.innovation_form import InnovationForm
from ultraquiet.values.record import Record
from ultraquiet.values.state_space import StateSpace


class ResponseSpread(Protocol):
    """What a model without coefficients states of its response's confidence."""

    def directions(self, f_hz: FloatArray) -> ComplexArray:
        """Return X `(ny, nu, nf, k)`: the response is off by X g, g of k independent numbers of unit variance."""
        ...


@dataclass(frozen=True, eq=False)
class SimulatedSpread:
    """Of a model whose simulated error is the least: all of theta from the record's spectra when it is first asked.

    Attributes:
        model: stable, discrete.
        record: that it was identified from.
        weight: `(ny, ny)` of the errors in the sum of squares; None for the inverse of their covariance.

    Raises:
        NumericalError: when asked, where poles lie so near to each other that they have no modes of their own.
    """

    model: StateSpace
    record: Record
    weight: FloatArray | None = None

    def directions(self, f_hz: FloatArray) -> ComplexArray:
        """Return what `ResponseSpread` says."""
        at, root = self._found
        return moved(at, points(f_hz, self.record.rate_hz), root, None)

    @cached_property
    def _found(self) -> tuple[ModalSensitivities, FloatArray]:
        m, u = self.model, _moving(self.record.inputs)
        at = ModalSensitivities(m.A, m.B, m.C, m.D, u.shape[0] if np.any(m.D) else 0)
        return at, spread_root(at, u, _moving(self.record.outputs) - m.simulate(u), self.weight, colored=True)


@dataclass(frozen=True, eq=False)
class PredictedSpread:
    """Of a model whose one-step error is the least and white: plant and noise together, in open or closed loop.

    Attributes:
        model: with an invertible noise model.
        record: that it was identified from.
        weight: as in `SimulatedSpread`, of the one-step errors.

    Raises:
        NumericalError: when asked, where poles of the predictor have no modes of their own.
    """

    model: InnovationForm
    record: Record
    weight: FloatArray | None = None

    def directions(self, f_hz: FloatArray) -> ComplexArray:
        """Return what `ResponseSpread` says."""
        at, root = self._found
        return moved(at, points(f_hz, self.record.rate_hz), root, self.model.frequency_response(f_hz))

    @cached_property
    def _found(self) -> tuple[ModalSensitivities, FloatArray]:
        w, m = self.model.predictor(), self.model
        at = ModalSensitivities(w.A, w.B, w.C, w.D, m.B.shape[1] if np.any(m.D) else 0)
        heard = _moving(self.record.outputs)
        drive = np.vstack([_moving(self.record.inputs), heard])
        return at, spread_root(at, drive, heard - w.simulate(drive), self.weight, colored=False)


def _moving(signals: FloatArray) -> FloatArray:
    """Return signals without their means: a constant and the states at the record's beginning make up for these."""
    return signals - signals.mean(axis=1, keepdims=True)
