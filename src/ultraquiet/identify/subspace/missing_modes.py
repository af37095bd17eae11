"""Modes that a subspace of a short horizon has missed: sought in what it leaves, put in the place of the faintest.

A mode whose period is many horizons shows as a drift in the Hankel matrix and may be lost in noise there, while the
whole record tells of it plainly: one filter at its pole explains a part of the simulated error that noise cannot.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.identify.result import NO_NOISE, Result
from ultraquiet.identify.subspace import fit, modal_least_squares
from ultraquiet.identify.subspace.modal_least_squares import FilterBank, Modes
from ultraquiet.linalg import prediction
from ultraquiet.values import Status, StatusWord

DAMPING = 0.02  # of the filters tried, relative
SPACING = 1.06  # from one filter's frequency to the next
SLOWEST = 8.0  # periods that a record must hold of a mode that is sought
FASTEST = 0.9 * np.pi  # radians a sample
FINER = (0.03, 0.015, 0.008)  # steps by which the best filter is then moved, in the logarithm of frequency and damping
ROUNDS = 6  # of alternating least squares
TRIAL_ROUNDS = 4  # of it by which modes that may leave are compared
MEMORY = 8  # samples of the autoregressions that tell how much of the error's power is noise at a frequency
MOST = 3  # modes put in at most


class Sought(NamedTuple):
    """Signals and what a fit to them may hold."""

    data: fit.Scaled
    feedthrough: bool
    offset: bool
    may_grow: bool  # whether more states are allowed, or a mode must leave for each that comes

    def bank(self, poles: ComplexArray) -> FilterBank:
        """Return the products of the filters at some poles."""
        return FilterBank(poles, self.data.u, self.data.y, self.feedthrough, self.offset)

    def error(self, modes: Modes) -> FloatArray:
        """Return what the modes leave of the outputs, simulated, `(ny, n)`."""
        return self.data.y - fit.system(modes).simulated(self.data.u)

    def fitted(self, system: fit.System) -> tuple[FilterBank, Modes]:
        """Return the modes of a system, fitted again to the record."""
        poles, directions, _ = fit.modes_of(system.A, system.C)
        bank = self.bank(poles)
        return bank, bank.fit_b(directions)


def replenished(bank: FilterBank, modes: Modes, sought: Sought) -> tuple[FilterBank, Modes]:
    """Return the modes, faint ones replaced by those that the error shows, as long as that lowers it."""
    for _ in range(MOST):
        error = sought.error(modes)
        plain = plainest(error, sought.data.u)
        if plain is None:
            break
        pole, explained = plain
        kept = _without_the_faintest(bank, modes, explained)
        if kept is None and not sought.may_grow:
            break
        kept = np.arange(modes.poles.size) if kept is None or sought.may_grow else kept
        other, trial = _joined(modes, kept, pole, error, sought)
        if not modal_least_squares.cost(other, trial) < modal_least_squares.cost(bank, modes):
            break
        bank, modes = other, trial
    return modal_least_squares.pruned(bank, modes) if sought.may_grow else (bank, modes)


def widened(modes: Modes, sought: Sought) -> tuple[FilterBank, Modes] | None:
    """Return the modes and the one that the error shows plainest, none left out; None where it shows none."""
    error = sought.error(modes)
    plain = plainest(error, sought.data.u)
    return None if plain is None else _joined(modes, np.arange(modes.poles.size), plain[0], error, sought)


def narrowed(bank: FilterBank, modes: Modes) -> tuple[FilterBank, Modes]:
    """Return the modes without the two states that are missed least, b and c of the others fitted again each time.

    What `carried` says of two modes at one place is that each has inputs of its own, not that one would do for both.
    """
    tried = [(bank, modes)]
    for gone in _leaving(modes, np.argsort(modal_least_squares.carried(bank, modes), kind="stable")):
        kept = np.setdiff1d(np.arange(modes.poles.size), gone)
        other = bank.only(kept)
        tried.append((other, modal_least_squares.alternate(other, modes.c[:, kept], TRIAL_ROUNDS)))
    return min(tried[1:] or tried, key=lambda one: modal_least_squares.cost(*one))


def _leaving(modes: Modes, faintest_first: np.ndarray) -> list[np.ndarray]:
    """Return which modes may leave when two states are freed: any pair, or the two faintest real ones."""
    real = modes.poles.imag == 0.0
    choices = [np.array([k]) for k in np.flatnonzero(~real)]
    alone = faintest_first[real[faintest_first]]
    return [*choices, alone[:2]] if alone.size > 1 else choices


def _joined(
    modes: Modes, kept: np.ndarray, pole: complex, error: FloatArray, sought: Sought
) -> tuple[FilterBank, Modes]:
    """Return the modes that are kept and one at `pole`, all fitted again."""
    poles = np.concatenate([modes.poles[kept], np.array([pole], dtype=np.complex128)])
    c = np.column_stack([modes.c[:, kept], _direction(error, sought.data.u, pole)])
    pairs_first = np.argsort(poles.imag == 0.0, kind="stable")
    bank = sought.bank(poles[pairs_first])
    return bank, modal_least_squares.alternate(bank, c[:, pairs_first], ROUNDS)


def told(result: Result, system: fit.System, data: fit.Scaled, rate_hz: float, predicts: bool = False) -> Result:
    """Return the result, no longer `ok` where its error plainly shows a mode that the model has not.

    The one-step error, where the model `predicts`, is independent of past inputs in a closed loop too.
    """
    if not (result.status.ok and (predicts or system.stable())):
        return result
    error = system.errors(data.u, data.y) if predicts else data.y - system.simulated(data.u)
    plain = plainest(error, data.u)
    if plain is None:
        return result
    pole, explained = plain
    f_hz = abs(np.log(pole)) * rate_hz / (2 * np.pi)
    status = Status(
        StatusWord.NOT_WHITE,
        f"The {'one-step' if predicts else 'simulated'} error holds a response to the inputs near {f_hz:.3g} Hz "
        f"({explained:.0f} times the noise's variance there): a mode is missing or off its place; set refine=True, or "
        f"raise the order or the horizon.",
    )
    return replace(result, status=status, statuses=(status,) * len(result.statuses))


def _asked_for(nu: int, ny: int, n: int) -> float:
    """Return how many noise variances a mode must explain: log n for each of its numbers, by Schwarz's criterion."""
    return float(2 * (nu + ny) * np.log(n))


def plainest(error: FloatArray, u: FloatArray) -> tuple[complex, float] | None:
    """Return what `strongest` does; None where it explains less than a mode must, or where the error is rounding.

    The error is one of outputs of unit power.
    """
    if np.all(np.mean(error**2, axis=1) <= NO_NOISE):
        return None
    pole, explained = strongest(error, u)
    return None if explained < _asked_for(len(u), *error.shape) else (pole, explained)


def strongest(error: FloatArray, u: FloatArray) -> tuple[complex, float]:
    """Return the pole of the filter that explains most of what is left, and how many noise variances that is.

    The variance counted is that of the noise at the filter's frequency, from the smooth spectrum of what the filter
    leaves: coloured noise has more power in one band than in another, and none of it is a mode.
    """
    slowest = 2 * np.pi * SLOWEST / u.shape[1]
    angles = np.exp(np.arange(np.log(slowest), np.log(FASTEST), np.log(SPACING)))
    found = max(((_share(w, DAMPING, error, u), w, DAMPING) for w in angles), key=lambda one: one[0])
    for step in FINER:
        near = [(found[1] * np.exp(a * step), found[2] * np.exp(b * 10 * step)) for a in (-1, 0, 1) for b in (-1, 0, 1)]
        tried = [(_share(w, zeta, error, u), w, zeta) for w, zeta in near if w < FASTEST and zeta < 1.0]
        found = max([found, *tried], key=lambda one: one[0])
    pole = _pole(found[1], found[2])
    bank, x = _alone(pole, error, u)
    left = error - _response(pole, x, u)
    return pole, float(np.sum(np.sum(bank.G[: bank.modes, bank.modes :] * x, axis=0) / _noise_level(left, found[1])))


def _noise_level(left: FloatArray, angle: float) -> FloatArray:
    """Return the spectrum of each channel at `angle` radians a sample, from a short autoregression; white: variance."""
    return np.concatenate([prediction.error_spectrum(one, np.exp([1j * angle]), MEMORY) for one in left])


def _pole(angle: float, zeta: float) -> complex:
    return complex(np.exp(angle * (-zeta + 1j * np.sqrt(1 - zeta**2))))


def _share(angle: float, zeta: float, error: FloatArray, u: FloatArray) -> float:
    """Return the share of each channel's power that the filter explains, summed."""
    bank, x = _alone(_pole(angle, zeta), error, u)
    products = bank.G[: bank.modes, bank.modes :]
    return float(np.sum(np.sum(products * x, axis=0) / np.maximum(bank.power, np.finfo(float).tiny)))


def _response(pole: complex, x: FloatArray, u: FloatArray) -> FloatArray:
    """Return what the filter explains, the free decay from before the first sample too."""
    from scipy.signal import lfilter

    parts = x.reshape(len(u) + 1, 2, -1)
    pulse = np.zeros((1, u.shape[1]))
    pulse[0, 0] = 1.0
    late = np.vstack([np.hstack([np.zeros((len(u), 1)), u[:, :-1]]), pulse])
    states = np.asarray(lfilter([1.0], [1.0, -pole], late, axis=1))
    return np.asarray(((parts[:, 0] - 1j * parts[:, 1]).T @ states).real, dtype=np.float64)


def _direction(error: FloatArray, u: FloatArray, pole: complex) -> ComplexArray:
    """Return the output direction `(ny,)` of the residue of rank one nearest to that which explains most."""
    bank, x = _alone(pole, error, u)
    gains = x.reshape(bank.nu + 1, 2, bank.ny)[:-1]
    U, _, _ = np.linalg.svd((gains[:, 0] - 1j * gains[:, 1]).T, full_matrices=False)
    return np.asarray(U[:, 0], dtype=np.complex128)


def _alone(pole: complex, error: FloatArray, u: FloatArray) -> tuple[FilterBank, FloatArray]:
    """Return the products of one filter with the error, and real parts and negative imaginary ones of its gains."""
    bank = FilterBank(np.array([pole]), u, error, feedthrough=False, offset=False)
    return bank, modal_least_squares.solve(bank.G[: bank.modes, : bank.modes], bank.G[: bank.modes, bank.modes :])


def _without_the_faintest(bank: FilterBank, modes: Modes, explained: float) -> np.ndarray | None:
    """Return which modes stay when two states are freed, or None where none is fainter than what is sought."""
    carried = modal_least_squares.carried(bank, modes)
    choices = _leaving(modes, np.argsort(carried, kind="stable"))
    if not choices:
        return None
    gone = min(choices, key=lambda some: float(carried[some].sum()))
    if carried[gone].sum() >= explained:
        return None
    return np.setdiff1d(np.arange(modes.poles.size), gone)
