"""The first pass over a long record: sizes of its signals, readings at their limits, and where it is excited most."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet.files import LongRecord

SLICE = 4096  # samples whose power is kept as one number


@dataclass(frozen=True, eq=False)
class LongRecordStatistics:
    """What one pass tells of a record.

    Attributes:
        samples: how many there are.
        input_mean, input_size, output_mean, output_size: mean and standard deviation of each channel.
        clipped: readings of each sensor at or beyond its limits.
        power: `(nu, slices)` variance of each input over slices of `SLICE` samples.
    """

    samples: int
    input_mean: FloatArray
    input_size: FloatArray
    output_mean: FloatArray
    output_size: FloatArray
    clipped: np.ndarray
    power: FloatArray

    def most_excited(self, size: int, count: int) -> list[int]:
        """Return the first samples of up to `count` stretches of `size` apart, that of most power first.

        The power of a stretch is that of its weakest input: a model needs all of them.
        """
        window = max(1, size // SLICE)
        level = self.power / np.maximum(self.input_size[:, None] ** 2, np.finfo(float).tiny)
        summed = np.cumsum(np.hstack([np.zeros((len(level), 1)), level]), axis=1)
        if summed.shape[1] <= window:
            return [0]
        score = np.min(summed[:, window:] - summed[:, :-window], axis=0)
        starts: list[int] = []
        while len(starts) < count and np.max(score) > -np.inf:
            best = int(np.argmax(score))
            starts.append(min(best * SLICE, self.samples - size))
            score[max(0, best - window + 1) : best + window] = -np.inf
        return starts


def survey(record: LongRecord) -> LongRecordStatistics:
    """Return the survey of a record.

    Raises:
        InputError: a channel that never moves.
    """
    origin: FloatArray | None = None
    nu = len(record.actuators)
    low = np.array([c.low for c in record.sensors])[:, None]
    high = np.array([c.high for c in record.sensors])[:, None]
    clipped = np.zeros(len(low), dtype=np.int64)
    power: list[FloatArray] = []
    total = squares = np.zeros(nu + len(low))
    with task("survey the record", record.samples) as progress:
        for u, y in record.blocks(16 * SLICE):
            z = np.vstack([u, y])
            # Sums about the first sample: a large offset must not swallow the deviation.
            origin = z[:, :1].copy() if origin is None else origin
            z -= origin
            total, squares = total + z.sum(axis=1), squares + np.einsum("ct,ct->c", z, z)
            clipped += np.count_nonzero((y <= low) | (y >= high), axis=1)
            power += [z[:nu, s : s + SLICE].var(axis=1) for s in range(0, z.shape[1], SLICE)]
            progress.advance(u.shape[1])
    assert origin is not None
    n = record.samples
    mean, size = total / n, np.sqrt(np.maximum(squares / n - (total / n) ** 2, 0.0))
    for value, at, wire in zip(size, origin[:, 0], (*record.actuators, *record.sensors), strict=True):
        if value == 0.0:
            raise InputError(
                f"identify: channel '{wire.name}' of '{record.path}' is constant at {wire.in_unit(at)}, which no model "
                f"can be drawn from; leave it out with record.pick."
            )
    mean = mean + origin[:, 0]
    return LongRecordStatistics(n, mean[:nu], size[:nu], mean[nu:], size[nu:], clipped, np.stack(power, axis=1))
