"""The model each horizon's subspace gives, of which the best is finished."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.identify.result import NO_NOISE
from ultraquiet.identify.subspace import fit, hankel, modal_least_squares

ROUNDS = 30  # of alternating least squares
TRIAL_ROUNDS = 6  # of it by which horizons are compared


@dataclass(frozen=True, eq=False)
class Horizon:
    """What the Hankel matrix of `rows` block rows holds, for every order."""

    rows: int
    factor: hankel.Factor
    basis: FloatArray
    values: FloatArray

    @classmethod
    def of(cls, factor: hankel.Factor, weight: str) -> "Horizon":
        """Return the directions of a factor."""
        return cls(factor.rows, factor, *hankel.directions(factor, weight))

    @property
    def most(self) -> int:
        """The highest order that it can tell."""
        return min((self.rows - 1) * self.factor.ny, len(self.values) - 1)


@dataclass(frozen=True, eq=False)
class SubspaceStart:
    """What one horizon gave: its loss (see `modal_least_squares.cost`), modes, and where they came from."""

    loss: float
    horizon: Horizon
    modes: modal_least_squares.Modes
    order: int
    bank: modal_least_squares.FilterBank

    @classmethod
    def of(
        cls, horizon: Horizon, order: int, bank_at: Callable[[ComplexArray], modal_least_squares.FilterBank]
    ) -> "SubspaceStart":
        """Return the modes of the first `order` directions, fitted to the bank of filters at their poles."""
        transition = hankel.transition(horizon.basis, horizon.values, order, horizon.factor.ny)
        poles, directions, _ = fit.modes_of(*transition)
        bank = bank_at(poles)
        modes = modal_least_squares.alternate(bank, directions, TRIAL_ROUNDS)
        return cls(modal_least_squares.cost(bank, modes), horizon, modes, order, bank)

    @property
    def states(self) -> int:
        """Number of states of the modes, which may have become others than the order they came from."""
        return int(np.sum(np.where(self.modes.poles.imag == 0.0, 1, 2)))

    def pruned(self) -> "SubspaceStart":
        """Return the start without the modes that the record cannot tell from noise."""
        bank, modes = modal_least_squares.pruned(self.bank, self.modes)
        return replace(self, loss=modal_least_squares.cost(bank, modes), bank=bank, modes=modes)

    def as_direct_as_needed(self) -> "SubspaceStart":
        """Return the start without D where the record does not tell D from noise.

        D must lower n sum_i log(mean squared error of output i) by log n for each of its numbers, as by Schwarz's
        criterion. A loop takes a reading before it sends a command: a D that is not there costs it a sample of delay.
        """
        bank = self.bank.without_feedthrough()
        modes = modal_least_squares.alternate(bank, self.modes.c, TRIAL_ROUNDS)
        other = replace(self, loss=modal_least_squares.cost(bank, modes), bank=bank, modes=modes)
        floor = NO_NOISE * bank.power / bank.n
        misses = [np.log(np.maximum(b.loss(m), floor)) for b, m in ((bank, modes), (self.bank, self.modes))]
        worth = bank.n * float(np.sum(misses[0] - misses[1]))
        return self if worth > bank.ny * bank.nu * np.log(bank.n) else other

    def settled(self) -> modal_least_squares.Modes:
        """Return the modes after the last rounds of least squares, their poles where they were."""
        return modal_least_squares.alternate(self.bank, self.modes.c, ROUNDS)

    def innovations(self, data: fit.Scaled) -> FloatArray:
        """Return the one-step errors of the Kalman filter that the state sequence gives; simulated ones without it."""
        sequence = hankel.realised(self.horizon.factor, self.horizon.basis, self.horizon.values, self.order)
        at_rest = np.zeros(self.order), np.zeros(len(data.y))
        kalman = fit.System(sequence.A, sequence.B, sequence.C, sequence.D, sequence.K, *at_rest)
        if kalman.predicts():
            return kalman.errors(data.centred_u, data.y)
        return data.y - fit.system(self.modes).simulated(data.u)
