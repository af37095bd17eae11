"""What a channel's own samples tell: that it stands still, or piles up at its ends."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import FloatArray
from ultraquiet.values import Channel

# A reading that stands still so many times longer than ever else in the record, having moved over so many levels
# before, has not come to rest by itself: a decaying one stands longer and longer, over fewer and fewer levels.
LONGER, LEVELS = 10, 8
# Share of what the inputs are made of, in bands of equal power, that they must hold while a reading stands still as
# well as otherwise: a sweep that has passed the resonances leaves a coarse reading at rest, and rightly so. One that
# stands off its own middle by more than a level has no such excuse, if the inputs move at all.
ALIKE, BANDS = 0.5, 16
# Values that a channel must take for a pile at its end to be told from few levels; a tone sampled in step with its
# period takes fewer.
DISTINCT = 64
# Samples that stand at an end next to another such one; in how many stretches entered or left from values that lie
# apart, since the one peak of a periodic signal comes back but for noise; or in how many of what mean length (one alone
# is a step response that has settled).
PILED, STRETCHES, FEWER, LONG = 10, 5, 3, 8
# What lies just inside an end, in steps of the converter and as a share of the range: of a pure tone more samples lie
# there than at its very end.
INSIDE_STEPS, INSIDE = 4, 1e-3


@dataclass(frozen=True)
class Stretch:
    """Samples `start` to `stop` (excluded) at one value."""

    start: int
    stop: int
    value: float


def standstill(y: FloatArray, inputs: FloatArray) -> Stretch | None:
    """Return the stretch over which a reading `(n,)` stood still while the inputs `(nu, n)` moved; None without one."""
    edges = np.flatnonzero(np.diff(y)) + 1
    starts, stops = np.concatenate([[0], edges]), np.concatenate([edges, [y.size]])
    lengths = stops - starts
    if lengths.size < 2:
        return None
    k = int(np.argmax(lengths))
    start, stop, longest = int(starts[k]), int(stops[k]), int(lengths[k])
    others = np.delete(lengths, k)
    around = np.concatenate([y[max(0, start - longest) : start], y[stop : stop + longest]])
    if longest <= LONGER * int(others.max()) or np.unique(around).size <= LEVELS:
        return None
    if not _has_reason(y, inputs, slice(start, stop)):
        return None
    return Stretch(start, stop, float(y[start]))


def _has_reason(y: FloatArray, inputs: FloatArray, still: slice) -> bool:
    """Return whether a reading that stood still in a stretch should have moved."""
    rest = np.ones(y.size, dtype=bool)
    rest[still] = False
    shares = [_band_shares(u, rest) for u in inputs if np.ptp(u[still]) > 0]
    alike = max((float(np.minimum(inside, outside).sum()) for inside, outside in shares), default=0.0)
    levels = np.unique(y)
    off = abs(float(y[still][0] - np.median(y[rest]))) > 1.5 * float(np.diff(levels).min())
    return alike > ALIKE or (off and bool(shares))


def _band_shares(u: FloatArray, rest: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Return the shares of an input's power in bands, without and with the samples of a mask."""
    centred = u - u.mean()
    spectra = [np.abs(np.fft.rfft(np.where(mask, centred, 0.0))) ** 2 for mask in (~rest, rest)]
    total = np.cumsum(spectra[0] + spectra[1])
    edges = np.searchsorted(total, np.arange(1, BANDS) * total[-1] / BANDS)
    inside, outside = (np.array([part.sum() for part in np.split(s, edges)]) for s in spectra)
    return inside / max(inside.sum(), 1e-300), outside / max(outside.sum(), 1e-300)


def piled_up(x: FloatArray, wire: Channel, beyond: bool = True) -> tuple[int, float]:
    """Return how many samples `(n,)` stand at an end at which they pile up, and that end; none is (0, nan).

    An end is the channel's limit or, where `beyond`, the largest or least value when more samples stand at it than just
    inside.
    """
    values = np.unique(x)
    worst = (0, np.nan)
    if values.size <= DISTINCT:
        return worst
    width = max(INSIDE_STEPS * float(np.diff(values).min()), INSIDE * float(values[-1] - values[0]))
    for end, declared in ((float(values[-1]), values[-1] >= wire.high), (float(values[0]), values[0] <= wire.low)):
        at = x == end
        if _in_stretches(x, at, width) and (declared or (beyond and _more_than_inside(x, end, width))):
            worst = max(worst, (int(np.count_nonzero(at)), end))
    return worst


def _in_stretches(x: FloatArray, at: NDArray[np.bool_], width: float) -> bool:
    """Return whether enough samples of a mask stand side by side, in stretches that tell, `width` apart around them."""
    ends = np.diff(np.concatenate([[0], at.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(ends == 1), np.flatnonzero(ends == -1)
    several = stops - starts > 1
    starts, stops = starts[several], stops[several]
    if np.sum(stops - starts) < PILED:
        return False
    if starts.size >= FEWER and float(np.mean(stops - starts)) >= LONG:
        return True
    around = np.column_stack([x[np.maximum(starts - 1, 0)], x[np.minimum(stops, x.size - 1)]])
    return _are_apart(around, width, STRETCHES)


def _are_apart(points: FloatArray, width: float, count: int) -> bool:
    """Return whether so many of the points `(n, d)` lie further than `width` from one another, taken in turn."""
    for _ in range(count - 1):
        if not len(points):
            return False
        points = points[np.abs(points - points[0]).max(axis=1) > width]
    return len(points) > 0


def _more_than_inside(x: FloatArray, end: float, width: float) -> bool:
    inside = (x != end) & (np.abs(x - end) <= width)
    return bool(np.count_nonzero(x == end) > np.count_nonzero(inside))
