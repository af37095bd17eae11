"""Confidence bands of the 3.5 kHz truth: how often they hold, and the error behind them against the least possible."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "validate"))
campaigns = importlib.import_module("campaigns")

DRAWS = 600
BOUND_FACTOR = 1.3
COVERAGE = (93.0, 97.0)


def measure() -> Iterator[tuple[str, str, str, bool]]:
    found = campaigns.campaign(np.random.default_rng(), DRAWS)
    ratio = found.squared.mean(axis=0) / found.bound.mean(axis=0)
    mean = float(np.mean(found.squared / found.bound))
    yield (
        f"squared error of the response over the Cramer-Rao bound, {DRAWS} records",
        f"{mean:.2f} (worst line {ratio.max():.2f})",
        f"at most {BOUND_FACTOR:g}",
        mean <= BOUND_FACTOR,
    )
    for what, held in (("gain", found.gain_held), ("phase", found.phase_held), ("complex", found.both_held)):
        share, error = campaigns.pooled(held)
        low, high = COVERAGE
        yield (
            f"95 % bands of the {what} hold the truth, 2-1500 Hz",
            f"{share:.1f} +- {error:.1f} %",
            f"{low:g} to {high:g} %",
            # the campaign itself errs: two of its standard errors are allowed for
            low - 2 * error <= share <= high + 2 * error,
        )
    yield "of which the verdict is ok", f"{100 * found.ok.mean():.1f} %", "at least 98 %", found.ok.mean() >= 0.98
