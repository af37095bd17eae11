"""A first-order high-pass before a law, so that an offset of a reading moves no command."""

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet.values.interconnect import append, series
from ultraquiet.values.state_space import StateSpace

AT_DC = 1e-2  # of the washout's corner: a pole of the plant nearer to 0 Hz is one that the law must hold there


def washout(corner_hz: float, rate_hz: float | None) -> StateSpace:
    """Return W with one state, zero at 0 Hz and gain one where everything else is faster.

    s / (s + w) in continuous time; g (z - 1) / (z - a) with a = exp(-w / rate) and g = (1 + a) / 2 in discrete time,
    which has gain one at Nyquist.
    """
    w = 2 * np.pi * corner_hz
    if rate_hz is None:
        return StateSpace([[-w]], [[1.0]], [[-w]], [[1.0]])
    a = float(np.exp(-w / rate_hz))
    g = (1 + a) / 2
    return StateSpace([[a]], [[1.0]], [[g * (a - 1)]], [[g]], rate_hz)


def heard_through(plant: StateSpace, corner_hz: float | None) -> StateSpace:
    """Return W G, the plant as a law behind the washout hears it; the plant itself without a corner."""
    return plant if corner_hz is None else series(plant, _on(plant.D.shape[0], corner_hz, plant.rate_hz))


def behind(law: StateSpace, corner_hz: float | None) -> StateSpace:
    """Return K W, the law with its washout; the law itself without a corner."""
    return law if corner_hz is None else series(_on(law.D.shape[1], corner_hz, law.rate_hz), law)


def require_room(who: str, plant: StateSpace, corner_hz: float | None, low_hz: float) -> None:
    """Refuse a washout that makes the law deaf where it is to act.

    Raises:
        InputError: the corner is not below the band; the plant has a pole at 0 Hz, which the law could not hold.
    """
    if corner_hz is None:
        return
    if corner_hz >= low_hz:
        raise InputError(f"{who}: 'washout_hz' = {corner_hz:g} must lie below the band, which begins at {low_hz:g} Hz.")
    poles = plant.poles()
    per_s = poles if plant.rate_hz is None else (poles - 1) * plant.rate_hz
    if np.any(np.abs(per_s) < AT_DC * 2 * np.pi * corner_hz):
        raise InputError(
            f"{who}: the plant has a pole at 0 Hz, where 'washout_hz' = {corner_hz:g} makes the law deaf; leave it out."
        )


def _on(channels: int, corner_hz: float, rate_hz: float | None) -> StateSpace:
    return append(*[washout(corner_hz, rate_hz)] * channels)
