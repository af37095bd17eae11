"""The model each horizon's subspace gives, of which the best is finished."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.identify.subspace import fit, hankel, modal_least_squares, order_selection
from ultraquiet.identify.subspace.settings import SubspaceSettings

ROUNDS = 60  # of alternating least squares
TRIAL_ROUNDS = 6  # of it by which horizons are compared
GAIN = 1e-5  # share of the error by which a round must lower it for another to follow


@dataclass(frozen=True, eq=False)
class SubspaceStart:
    """What one horizon gave: its loss (see `order_selection.cost`), modes, and where they came from."""

    loss: float
    rows: int
    modes: modal_least_squares.Modes
    factor: hankel.Factor
    basis: FloatArray
    values: FloatArray
    order: int
    bank: modal_least_squares.FilterBank

    @classmethod
    def of(
        cls,
        settings: SubspaceSettings,
        factor: hankel.Factor,
        rows: int,
        order: int,
        bank_at: Callable[[ComplexArray], modal_least_squares.FilterBank],
    ) -> "SubspaceStart":
        """Return the modes of the Hankel matrix of `rows` block rows, fitted to the bank of filters at their poles."""
        basis, values = hankel.directions(factor, settings.weight)
        poles, directions, _ = fit.modes_of(*hankel.transition(basis, values, order, factor.ny))
        bank = bank_at(poles)
        modes = modal_least_squares.alternate(bank, directions, TRIAL_ROUNDS, GAIN)
        if settings.given_order is None:
            bank, modes = modal_least_squares.pruned(bank, modes)
        return cls(order_selection.cost(bank, modes), rows, modes, factor, basis, values, order, bank)

    def settled(self) -> modal_least_squares.Modes:
        """Return the modes after the last rounds of least squares, their poles where they were."""
        return modal_least_squares.alternate(self.bank, self.modes.c, ROUNDS, GAIN)

    def innovations(self, data: fit.Scaled) -> FloatArray:
        """Return the one-step errors of the Kalman filter that the state sequence gives; simulated ones without it."""
        sequence = hankel.realised(self.factor, self.basis, self.values, self.order)
        at_rest = np.zeros(self.order), np.zeros(len(data.y))
        kalman = fit.System(sequence.A, sequence.B, sequence.C, sequence.D, sequence.K, *at_rest)
        if kalman.predicts():
            return kalman.errors(data.centred_u, data.y)
        return data.y - fit.system(self.modes).simulated(data.u)
