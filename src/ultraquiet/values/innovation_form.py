"""A linear system in state space together with the noise that its outputs carry."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, frozen, real_array
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, content_hash
from ultraquiet.linalg import innovation
from ultraquiet.values.channel import Channel
from ultraquiet.values.record import Record
from ultraquiet.values.state_space import StateSpace


@dataclass(frozen=True, init=False, eq=False)
class InnovationForm(StateSpace):
    """x+ = A x + B u + K e, y = C x + D u + e, e white with covariance `noise_covariance`; discrete time.

    As a `StateSpace` it is the path from inputs to outputs. K is the stationary Kalman gain, so that A - K C with K is
    the observer of an LQG controller.

    Args:
        A, B, C, D: as in `StateSpace`.
        K: `(n, ny)` gain of the innovations; zero when the outputs carry white noise alone.
        noise_covariance: `(ny, ny)` of the innovations, in products of output units.
        rate_hz: sampling rate.
        actuators, sensors: channels or names of inputs and outputs; numbered when absent.
        provenance: how the system was made.

    Raises:
        InputError: shapes that do not fit together, continuous time, NaN or infinite entries.

    >>> lag = InnovationForm([[0.5]], [[0.5]], [[1.0]], [[0.0]], [[0.2]], [[1.0]], rate_hz=1.0)
    >>> lag.predictor().A
    array([[0.3]])

    Reference: Ljung, System Identification, 2nd ed., eq. (4.91).
    """

    K: FloatArray
    noise_covariance: FloatArray

    def __init__(
        self,
        A: ArrayLike,
        B: ArrayLike,
        C: ArrayLike,
        D: ArrayLike,
        K: ArrayLike,
        noise_covariance: ArrayLike,
        rate_hz: float,
        actuators: Sequence[Channel | str] | None = None,
        sensors: Sequence[Channel | str] | None = None,
        provenance: Provenance | None = None,
    ) -> None:
        super().__init__(A, B, C, D, rate_hz, actuators, sensors, provenance)
        if self.rate_hz is None:
            raise InputError("InnovationForm: noise from sample to sample needs discrete time; give a 'rate_hz'.")
        gain = real_array("InnovationForm", "K", K, 2)
        spread = real_array("InnovationForm", "noise_covariance", noise_covariance, 2)
        n, ny = self.C.shape[::-1]
        if gain.shape != (n, ny) or spread.shape != (ny, ny):
            raise InputError(
                f"InnovationForm: {n} states and {ny} outputs take K ({n}, {ny}) and a covariance ({ny}, {ny}), got "
                f"{gain.shape} and {spread.shape}."
            )
        object.__setattr__(self, "K", frozen(gain))
        object.__setattr__(self, "noise_covariance", frozen(spread))

    @property
    def hash(self) -> str:
        """Content hash of matrices, noise and rate."""
        return content_hash(self.A, self.B, self.C, self.D, self.K, self.noise_covariance, self.rate_hz)

    def predictor(self) -> StateSpace:
        """Return the one-step predictor, from inputs and outputs `[u; y]` to the predicted outputs."""
        D = np.hstack([self.D, np.zeros_like(self.noise_covariance)])
        B = np.hstack([self.B - self.K @ self.D, self.K])
        return StateSpace(self.A - self.K @ self.C, B, self.C, D, self.rate_hz)

    def is_invertible(self) -> bool:
        """Return whether the predictor forgets its initial state: every eigenvalue of A - K C inside the circle."""
        return bool(np.all(np.abs(np.linalg.eigvals(self.A - self.K @ self.C)) < 1.0))

    def innovations(self, record: Record, *, estimate: bool = True, offset: bool = True) -> FloatArray:
        """Return the one-step prediction errors `(ny, n)`, the initial state and a constant fitted when asked for."""
        u, y = record.inputs, record.outputs
        return innovation.errors(self.A, self.B, self.C, self.D, self.K, u, y, estimate=estimate, offset=offset)

    def predicted(self, record: Record, steps: int = 1) -> FloatArray:
        """Return the outputs `(ny, n)` predicted `steps` samples ahead, the inputs until then being known."""
        return record.outputs - innovation.ahead(self.A, self.C, self.K, self.innovations(record), steps)
