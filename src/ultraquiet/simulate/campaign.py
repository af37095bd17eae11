"""One controller on many benches, measured on each by its sensors."""

from collections.abc import Iterable, Iterator, Sequence, Sized
from dataclasses import fields, is_dataclass, replace
from typing import TypeVar

import numpy as np

from ultraquiet._base.constraints import whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet.analyse.monte_carlo import ATTENUATION, PEAK, UNSTABLE, MonteCarlo, checked_band, collected
from ultraquiet.bench import Bench
from ultraquiet.simulate.sensitivity.measure import measure_sensitivity
from ultraquiet.simulate.stability import check_stability
from ultraquiet.values import StateSpace
from ultraquiet.values.controller import Controller

BROADBAND = "broadband_db"
B = TypeVar("B")


def drawn_benches(bench: B, seeds: Sequence[int]) -> Iterator[B]:
    """Yield one bench per seed, each a unit of its own with noise of its own.

    Args:
        bench: a settings object with `seed` and `unit_seed`, a `Hexapod` with a `spread` for instance.
        seeds: of the units.

    Raises:
        InputError: a bench that cannot be drawn, a spread of zero.

    >>> import ultraquiet as uq
    >>> [bench.unit_seed for bench in drawn_benches(uq.bench.Hexapod(spread=1.0), range(3))]
    [0, 1, 2]
    """
    names = {f.name for f in fields(bench)} if is_dataclass(bench) else set()
    if isinstance(bench, type) or not {"seed", "unit_seed"} <= names:
        raise InputError(f"drawn_benches: a {type(bench).__name__} has no 'unit_seed'; give the benches one by one.")
    if not getattr(bench, "spread", 1.0):
        raise InputError("drawn_benches: units of their own need a 'spread' above zero, or all are the same.")
    checked = [whole("drawn_benches", "seeds", seed, 0) for seed in seeds]
    return (replace(bench, seed=seed, unit_seed=seed) for seed in checked)  # pyright: ignore[reportArgumentType]


def campaign(benches: Iterable[Bench], controller: StateSpace | Controller, band_hz: tuple[float, float]) -> MonteCarlo:
    """Close the loop on every bench, see whether it settles, measure its sensitivity, and return the spread.

    Args:
        benches: as many sensors as actuators each; `drawn_benches` makes them.
        controller: acts as u = K y.
        band_hz: where the reduction of the worst direction and of the sensors' power counts, (low, high) in Hz.

    Returns:
        `MonteCarlo` as `analyse.monte_carlo` gives it for models, with the figures `peak_sensitivity_db`,
        `worst_direction_db` and `broadband_db` (worst sensor's power over the band), all as measured.

    Raises:
        InputError: no benches, a band that is none, ends beyond Nyquist or holds no line.

    A model knows its own loop only; this is what the sensors say, with noise, rounding, limits and delay.
    """
    checked_band("campaign", band_hz)
    rows: list[dict[str, float]] = []
    worst, badness, case = 0, -np.inf, None
    with task("benches", len(benches) if isinstance(benches, Sized) else 0) as progress:
        for k, bench in enumerate(benches):
            checked_band("campaign", band_hz, bench.rate_hz)
            rows.append(_measured(bench, controller, band_hz))
            progress.advance(note=f"bench {k + 1}")
            if case is None or rows[-1][PEAK] > badness:
                worst, badness, case = k, rows[-1][PEAK], bench
    return collected("campaign", rows, worst, case, band_hz)


def _measured(bench: Bench, controller: StateSpace | Controller, band_hz: tuple[float, float]) -> dict[str, float]:
    if not check_stability(bench, controller).status.ok:
        return {**UNSTABLE, BROADBAND: -np.inf}
    sensitivity = measure_sensitivity(bench, controller, down_to_hz=band_hz[0] or None)
    return {
        PEAK: sensitivity.peak_amplification_db(),
        ATTENUATION: sensitivity.worst_in_band_db(*band_hz),
        BROADBAND: sensitivity.broadband_db(*band_hz),
    }
