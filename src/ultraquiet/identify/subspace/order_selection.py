"""How many states a record asks for: singular values propose, a held-out part decides."""

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.subspace import fit, hankel, modal_least_squares, unexcited
from ultraquiet.identify.subspace.settings import SubspaceSettings
from ultraquiet.values import Record

HELD_OUT = 3  # one sample in so many, at the end of the record, judges
HIGHEST = 120
GRID = 1.25  # from one order tried to the next
PATIENCE = 3  # orders tried without a better one before the search ends
WORTH = 0.01  # of the held-out error, summed in logarithms over outputs: what a larger order must gain


def gap(values: FloatArray) -> int:
    """Return the order after which the singular values fall by the largest factor.

    >>> gap(np.array([70.0, 15.0, 3.7, 2.0, 0.30, 0.21, 0.17]))
    4
    """
    return int(np.argmax(values[:-1] / np.maximum(values[1:], np.finfo(float).tiny))) + 1


def chosen(settings: SubspaceSettings, record: Record) -> int:
    """Return the order whose model, drawn from the first two thirds, simulates the last third best.

    The least order within 1 % of the best error wins: in geometric mean over the outputs, each state simulated through
    from the start, so that no initial state is fitted to the part that judges.
    """
    data = fit.Scaled.of(record)
    data = unexcited.topped_up(data, unexcited.silent_bands(data.u))
    split = record.samples - record.samples // HELD_OUT
    u, y = data.centred_u[:, :split], data.y[:, :split]
    rows = max(settings.horizons(record.part(0, split), 1))
    basis, values = hankel.observability(u, y, rows, settings.weight)
    highest = min(HIGHEST, (rows - 1) * len(y), len(values) - 1, record.samples // 20)
    losses: dict[int, float] = {}

    def loss(order: int) -> float:
        if order not in losses:
            losses[order] = _held_out(settings, data, split, basis, values, order)
        return losses[order]

    order, best, waited = 1, 1, 0
    while order <= highest and waited < PATIENCE:
        if loss(order) < losses[best] - WORTH:
            best, waited = order, 0
        else:
            waited += order > 2
        order = max(order + 1, round(order * GRID / 2) * 2)
    near = [n for n in (gap(values), *range(best - 4, best + 5)) if 1 <= n <= highest and (n % 2 == 0 or best < 8)]
    for n in near:
        loss(n)
    floor = min(losses.values()) + WORTH
    return min(n for n, value in losses.items() if value <= floor)


def cost(bank: modal_least_squares.FilterBank, modes: modal_least_squares.Modes) -> float:
    """Return n sum_i log(mean squared error of output i) + log n (states) (inputs + outputs): Schwarz's criterion."""
    states = int(np.sum(np.where(modes.poles.imag == 0.0, 1, 2)))
    misfit = bank.n * float(np.sum(np.log(np.maximum(bank.loss(modes), np.finfo(float).tiny))))
    return misfit + float(np.log(bank.n)) * states * (bank.nu + bank.ny)


def _held_out(
    settings: SubspaceSettings, data: fit.Scaled, split: int, basis: FloatArray, values: FloatArray, order: int
) -> float:
    """Return the mean over outputs of the logarithm of the simulated error's size after `split`."""
    A, C = hankel.transition(basis, values, order, len(data.y))
    poles, directions, _ = fit.modes_of(A, C)
    bank = modal_least_squares.FilterBank(
        poles, data.u[:, :split], data.y[:, :split], settings.feedthrough, settings.offset
    )
    system = fit.system(bank.fit_b(directions))
    error = (data.y - system.simulated(data.u))[:, split:]
    return float(np.mean(np.log(error.std(axis=1))))
