"""What sweeps in several directions gave, and what noise and ringing leave open of it."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.simulate.sweeps.lines import inverted, largest
from ultraquiet.simulate.sweeps.rest import NOISE_LINES

# A line is open while what still moves at the end of a run leaves more than this share of it unknown.
OPEN = 0.02


@dataclass(frozen=True, eq=False)
class Runs:
    """Sweeps in `k` directions: what was sent `(nu, k, lines)` and what came back `(ny, k, lines)`, as spectra.

    `levels` `(k, grid)`: how loud each was; `better`: how loud it may be. `clipped`: points at which a limit was met.
    `length`: how long they were, in runs. `open`: what is not known of `heard` as it still moved at the end; `rounded`:
    power that converters add to it, `(ny, k)`.
    """

    sent: ComplexArray
    heard: ComplexArray
    levels: FloatArray
    better: FloatArray
    clipped: int
    length: int
    open: FloatArray
    rounded: FloatArray

    @property
    def is_open(self) -> np.ndarray:
        """Which spectra of a line are left open, `(ny, k, lines)`."""
        return np.asarray(self.open > OPEN * np.abs(self.heard))

    @property
    def lines_open(self) -> int:
        """How many are."""
        return int(np.count_nonzero(self.is_open))


def noise_rows(runs: Runs, noise: FloatArray) -> FloatArray:
    """Return the noise in spectra of runs, `(ny, lines)`: `noise` of a run `(ny, lines)`, and what converters round."""
    return np.sqrt(runs.length * noise**2 + runs.rounded.max(axis=1)[:, None])


def still_moving(runs: Runs) -> FloatArray:
    """Return how far spectra of runs may be off, `(lines,)`, as they still moved when they ended."""
    return np.sqrt(np.sum(runs.open.max(axis=1) ** 2, axis=0))


def deviation_of(runs: Runs, noise: FloatArray) -> FloatArray:
    """Return what the noise `(ny, lines)` of open runs leaves open of an S of size one, `(lines,)`.

    Each is the median of its neighbours.
    """
    inverse = inverted(np.moveaxis(runs.heard, 2, 0))
    left = np.hypot(np.linalg.norm(noise_rows(runs, noise), axis=0), still_moving(runs))
    padded = np.pad(largest(inverse) * left, NOISE_LINES, mode="reflect")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * NOISE_LINES + 1), axis=1)
