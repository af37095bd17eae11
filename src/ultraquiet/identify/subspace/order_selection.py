"""How many states a record asks for: a held-out part judges the models that each order would end in.

Two orders are told apart by the difference of their errors sample by sample, which holds little of the noise that both
share. Where it lies within its own standard error, the smaller order is as good.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.identify.result import NO_NOISE
from ultraquiet.identify.subspace import fit, hankel, unexcited
from ultraquiet.identify.subspace.modal_least_squares import FilterBank
from ultraquiet.identify.subspace.settings import SubspaceSettings
from ultraquiet.identify.subspace.start import Horizon, SubspaceStart
from ultraquiet.identify.subspace.unexcited import tones_in
from ultraquiet.values import Record

HELD_OUT = 3  # one sample in so many, at the end of the record, judges
HIGHEST = 120
GRID = 1.25  # from one order tried to the next
PATIENCE = 3  # orders tried without a better one before the search ends
WORTH = 0.01  # of the held-out error, averaged in logarithms over outputs: less is no reason for a larger order
BATCHES = 20  # of the held-out part: the spread of their means counts the errors' memory


@dataclass(frozen=True, eq=False)
class HeldOutError:
    """Mean squared simulated error of each output over each batch of the held-out part, `(ny, batches)`.

    Of outputs of unit power: what is less than `NO_NOISE` of it is rounding, and tells no order from another.
    """

    squares: FloatArray

    @classmethod
    def of(cls, error: FloatArray) -> "HeldOutError":
        """Return it of an error `(ny, n)`, its mean left out, which no model is asked for."""
        squares = (error - error.mean(axis=1, keepdims=True)) ** 2
        return cls(np.stack([part.mean(axis=1) for part in np.array_split(squares, BATCHES, axis=1)], axis=1))

    @property
    def size(self) -> float:
        """Mean over outputs of log |e_i|."""
        return float(np.mean(np.log(self._power))) / 2

    @property
    def _power(self) -> FloatArray:
        return np.maximum(self.squares.mean(axis=1), NO_NOISE)

    def unsure(self, best: "HeldOutError") -> float:
        """Return the standard error of the difference of two sizes.

        The derivative of log |e_i| by its square gives d(t) = mean_i (e_i^2 / |e_i|^2 - b_i^2 / |b_i|^2) / 2, of which
        means over batches are nearly independent where a batch is longer than the errors' memory.

        Reference: Diebold and Mariano 1995, doi:10.1080/07350015.1995.10524599; Law, Simulation Modeling and Analysis,
        5th ed., section 9.5.3 (batch means).
        """
        d = np.mean(self.squares / self._power[:, None] - best.squares / best._power[:, None], axis=0) / 2
        return float(d.std(ddof=1)) / BATCHES**0.5


@np.errstate(over="ignore")  # over nothing at all
def gap(values: FloatArray) -> int:
    """Return the order after which the singular values fall by the largest factor.

    >>> gap(np.array([70.0, 15.0, 3.7, 2.0, 0.30, 0.21, 0.17]))
    4
    """
    return int(np.argmax(values[:-1] / np.maximum(values[1:], np.finfo(float).tiny))) + 1


def chosen(settings: SubspaceSettings, record: Record) -> int:
    """Return the least order whose model of the first two thirds simulates the last third as well as the best.

    As well is: by no more than one standard error of the difference worse, or 1 %, in geometric mean over the outputs.
    Each state is simulated through from the start, so that no initial state is fitted to the part that judges. A trial
    is a model as the whole record will be given, the best over the horizons that the order allows. No order is tried
    that the inputs do not excite, as so many tones excite half as many modes.

    Raises:
        InputError: inputs of one tone.

    Reference: Breiman et al. 1984, Classification and Regression Trees, section 3.4.3 (one standard error).
    """
    trials = Trials.of(settings, record)
    errors: dict[int, HeldOutError] = {}

    def error(order: int) -> HeldOutError:
        if order not in errors:
            errors[order] = trials.error(order)
        return errors[order]

    tones = tones_in(record.inputs)
    if tones < 2:
        raise InputError(
            "Subspace: the inputs hold hardly more than one tone, which any model of two states can follow; excite "
            "more frequencies, or give 'order' a number."
        )
    highest = min(HIGHEST, tones - 1, max(horizon.most for horizon in trials.horizons), record.samples // 20)
    best = _searched(lambda order: error(order).size, highest)
    gaps = {gap(horizon.values) for horizon in trials.horizons}
    for n in sorted({*gaps, *range(best - 4, best + 5)}):
        if 1 <= n <= highest and (n % 2 == 0 or best < 8):
            error(n)
    found = _least_as_good(errors)
    below = max((n for n in errors if n < found), default=found)
    for n in range(found - 2, below, -2):
        error(n)
    return _least_as_good(errors)


def _searched(size: Callable[[int], float], highest: int) -> int:
    """Return the best order on a coarse grid, left when it no longer gains."""
    order, best, waited = 1, 1, 0
    while order <= highest and waited < PATIENCE:
        if size(order) < size(best) - WORTH:
            best, waited = order, 0
        else:
            waited += order > 2
        order = max(order + 1, round(order * GRID / 2) * 2)
    return best


def _least_as_good(errors: dict[int, HeldOutError]) -> int:
    best = min(errors.values(), key=lambda error: error.size)
    return min(n for n, e in errors.items() if e.size - best.size <= max(WORTH, e.unsure(best)))


@dataclass(frozen=True, eq=False)
class Trials:
    """A record cut into a part that fits and one that judges, and the first one's Hankel matrices."""

    settings: SubspaceSettings
    data: fit.Scaled
    split: int
    horizons: Sequence[Horizon]

    @classmethod
    def of(cls, settings: SubspaceSettings, record: Record) -> "Trials":
        """Cut a record."""
        data = fit.Scaled.of(record)
        data = unexcited.topped_up(data, unexcited.silent_bands(data.u))
        split = record.samples - record.samples // HELD_OUT
        u, y = data.centred_u[:, :split], data.y[:, :split]
        rows = settings.horizons(record.part(0, split), 1)
        return cls(settings, data, split, [Horizon.of(hankel.factor(u, y, r), settings.weight) for r in rows])

    def error(self, order: int) -> HeldOutError:
        """Return the simulated error after the split of the model that fits best before it."""
        starts = [SubspaceStart.of(h, order, self._bank) for h in self.horizons if h.most >= order]
        system = fit.system(min(starts, key=lambda start: start.loss).modes)
        return HeldOutError.of((self.data.y - system.simulated(self.data.u))[:, self.split :])

    def _bank(self, poles: ComplexArray) -> FilterBank:
        u, y = self.data.u[:, : self.split], self.data.y[:, : self.split]
        return FilterBank(poles, u, y, self.settings.feedthrough is not False, self.settings.offset)
