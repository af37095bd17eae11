"""A weight from a setting, numbers or a system: made, checked and spread over the channels."""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.constraints import same_rate
from ultraquiet._base.errors import InputError
from ultraquiet.analyse.plant_scale import below_nyquist
from ultraquiet.design.weights.filters import high_pass
from ultraquiet.linalg.ordered import Array
from ultraquiet.values.interconnect import append, gain
from ultraquiet.values.state_space import StateSpace

Weight = StateSpace | Sequence[float] | float
EDGE = 1e-9  # a pole nearer than this to the stability boundary (a share of its modulus) lies on it


def weight(
    who: str, name: str, setting: Weight, size: int, rate_hz: float | None, integrators: bool = False
) -> StateSpace:
    """Return a weight of `size` channels at a rate.

    Args:
        who: the design that asks.
        name: what the weight is called there.
        setting: a system, `(1, 1)` or with `size` inputs; or a number, a gain; or numbers `(low, corner_hz, high)` or
            `(low, corner_hz, high, order)`, a gain `low` that leaves for `high` from the corner on.
        size: number of signals weighted.
        rate_hz: that of the plant.
        integrators: whether poles on the stability boundary may stay, as in loop shaping, where the loop moves them.

    Raises:
        InputError: naming the weight: a wrong shape, a pole on or beyond the stability boundary, numbers that are no
            weight.
        RateError: the weight's time is not the plant's.

    >>> weight("design", "performance", (100.0, 5.0, 0.5), 2, 1000.0).D.shape
    (2, 2)
    """
    system = setting if isinstance(setting, StateSpace) else _from_numbers(who, name, setting, rate_hz)
    same_rate(who, "the plant", rate_hz, f"the weight '{name}'", system.rate_hz)
    if system.D.shape != (1, 1) and system.D.shape[1] != size:
        raise InputError(
            f"{who}: the weight '{name}' is {system.D.shape[0]} x {system.D.shape[1]} (outputs x inputs); it must be "
            f"1 x 1 or take {size} signals."
        )
    _refuse_poles(who, name, system, integrators)
    return system if system.D.shape[1] == size else append(*[system] * size)


def _from_numbers(who: str, name: str, setting: Sequence[float] | float, rate_hz: float | None) -> StateSpace:
    try:
        given = np.atleast_1d(np.asarray(setting))
        numbers = [] if np.iscomplexobj(given) else [float(x) for x in given]
    except (TypeError, ValueError):
        numbers = []
    if not np.all(np.isfinite(numbers)) or not all(x > 0 for x in numbers) or len(numbers) not in (1, 3, 4):
        raise InputError(
            f"{who}: the weight '{name}' must be a StateSpace, a gain above zero, or (low gain, corner in Hz, high gain"
            f"[, order]), all above zero, got {setting!r}."
        )
    if len(numbers) == 1:
        return gain([[numbers[0]]], rate_hz)
    low, corner_hz, high, order = (*numbers, 1.0)[:4]
    if order != int(order):
        raise InputError(f"{who}: the weight '{name}' has order {order:g}; it must be a whole number.")
    return high_pass(below_nyquist(corner_hz, rate_hz), low, high, int(order), rate_hz)


def _refuse_poles(who: str, name: str, system: StateSpace, integrators: bool) -> None:
    poles = system.poles()
    if system.rate_hz is None:
        beyond, boundary = poles.real / np.maximum(np.abs(poles), 1e-300), "the imaginary axis"
        beyond = np.where(np.abs(poles) < np.finfo(float).tiny, 0.0, beyond)
    else:
        beyond, boundary = np.abs(poles) - 1, "the unit circle"
    worst = int(np.argmax(beyond)) if poles.size else 0
    if not poles.size or beyond[worst] < -EDGE or (integrators and beyond[worst] <= EDGE):
        return
    at = _frequency(poles[worst : worst + 1], system.rate_hz)
    if beyond[worst] > EDGE:
        raise InputError(f"{who}: the weight '{name}' is unstable, with a pole outside {boundary} at {at:.4g} Hz.")
    raise InputError(
        f"{who}: the weight '{name}' has a pole on {boundary} at {at:.4g} Hz, which no controller can move; shift it "
        "inside by a small share of the band (an integrator becomes a slow lag)."
    )


def _frequency(pole: Array, rate_hz: float | None) -> float:
    angle = np.abs(pole.imag) if rate_hz is None else np.abs(np.angle(pole)) * rate_hz
    return float(angle[0]) / (2 * np.pi)
