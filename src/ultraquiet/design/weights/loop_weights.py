"""Weights that a cost puts on S, T and KS themselves, and what they leave to each of them."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.shown import Shown
from ultraquiet.values.state_space import StateSpace

LoopFunction = Literal["S", "T", "KS"]


@dataclass(frozen=True, eq=False)
class LoopWeights(Shown):
    """Weights W, ||W M|| or ||M W|| <= cost for M = S, T and KS, at the plant's output; None where nothing bounds M.

    S = (I - G K)^-1, T = S - I, KS = K S, each in the plant's own units. Every W is of one channel, which stands for a
    copy on each, takes all outputs of its function, or stands on all its inputs: what it leaves is the same.
    """

    S: StateSpace | None = None
    T: StateSpace | None = None
    KS: StateSpace | None = None

    @property
    def given(self) -> dict[LoopFunction, StateSpace]:
        """The weights that there are, by their function."""
        each: dict[LoopFunction, StateSpace | None] = {"S": self.S, "T": self.T, "KS": self.KS}
        return {function: W for function, W in each.items() if W is not None}

    def left(self, f_hz: FloatArray, cost: float) -> dict[LoopFunction, FloatArray]:
        """Return the largest singular value `(nf,)` that a loop of this cost may have of each weighted function.

        sigma(M) <= cost / sigma_min(W) at every frequency; infinite where the weight sees not every direction.

        Args:
            f_hz: `(nf,)`, Hz.
            cost: of the finished loop.

        >>> from ultraquiet.values.interconnect import gain
        >>> LoopWeights(KS=gain([[0.01]])).left(np.array([5.0]), 2.0)["KS"].tolist()
        [200.0]
        """
        return {name: cost * _inverse(W, f_hz) for name, W in self.given.items()}


def _inverse(W: StateSpace, f_hz: FloatArray) -> FloatArray:
    """Return 1 / sigma_min(W) `(nf,)` over all of its inputs."""
    if W.D.shape[0] < W.D.shape[1]:
        return np.full(f_hz.size, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.moveaxis(W.frequency_response(f_hz), 2, 0)
        values[~np.isfinite(values).all(axis=(1, 2))] = 0.0  # on a pole, as an integrator has one at 0 Hz: left open
        least = np.linalg.svd(values, compute_uv=False)[:, -1]
        return np.asarray(1.0 / least, dtype=np.float64)
