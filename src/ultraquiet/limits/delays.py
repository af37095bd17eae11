"""Extra delay in front of a plant."""

import numpy as np

from ultraquiet._base.constraints import between
from ultraquiet._base.errors import InputError
from ultraquiet.linalg import discretize
from ultraquiet.values.interconnect import series
from ultraquiet.values.state_space import StateSpace

MOST_SAMPLES = 1000
WHOLE = 1e-9
PADE_ORDER = 4


def delayed(who: str, plant: StateSpace, delay_s: float) -> StateSpace:
    """Return plant times delay.

    Whole samples are exact. What is left is Thiran's all-pass of first order, whose phase is that of the delay at low
    frequency. In continuous time the delay is Pade's all-pass of fourth order.
    """
    between(who, "delay_s", delay_s, 0.0, np.inf if plant.rate_hz is None else MOST_SAMPLES / plant.rate_hz, "s")
    if delay_s == 0:
        return plant
    if plant.D.shape[1] != 1:
        raise InputError(f"{who}: an extra delay is for a plant of one input, got {plant.D.shape[1]}.")
    if plant.rate_hz is None:
        return series(_pade(delay_s), plant)
    samples = delay_s * plant.rate_hz
    whole = round(samples)
    if abs(samples - whole) > WHOLE * max(1.0, samples):
        whole = max(0, whole - 1)
        rest = samples - whole  # between 0.5 and 1.5 where the delay is that long: there the all-pass is at its best
        plant = series(_thiran(rest, plant.rate_hz), plant)
    return series(StateSpace(*discretize.delay(whole, 1), rate_hz=plant.rate_hz), plant) if whole else plant


def _thiran(samples: float, rate_hz: float) -> StateSpace:
    """Return (a + z^-1) / (1 + a z^-1) with a = (1 - d) / (1 + d); stable for every d > 0 (Laakso et al. 1996)."""
    a = (1 - samples) / (1 + samples)
    return StateSpace([[-a]], [[1.0]], [[1 - a * a]], [[a]], rate_hz=rate_hz)


def _pade(delay_s: float) -> StateSpace:
    from scipy.signal import tf2ss

    m = PADE_ORDER
    k = np.cumprod([1.0] + [(m - i) / ((2 * m - i) * (i + 1)) for i in range(m)])
    powers = k * delay_s ** np.arange(m + 1)
    rows = powers[::-1]
    signs = (-1.0) ** np.arange(m + 1)[::-1]
    return StateSpace(*tf2ss(rows * signs, rows))
