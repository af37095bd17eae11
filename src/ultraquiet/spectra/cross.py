"""Cross spectra of many channels, summed segment by segment: an hour needs no more memory than a minute."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray, frozen, same_rate, signal_array
from ultraquiet._base.errors import InputError
from ultraquiet.spectra.averaging import Averaging, averaging
from ultraquiet.values import Channel, Record

# So many segments are transformed and multiplied at a time: enough for a matrix product, little to hold.
BATCH = 32
# A channel whose samples lie nearer to each other than this share of their size stands still: they differ by rounding.
ROUNDING = 4 * np.finfo(float).eps


@dataclass(frozen=True, eq=False)
class CrossSpectra:
    """One-sided cross spectral densities S_ab = E[A B*] of all channels, `(channel, channel, frequency)`.

    `inputs` of the channels come first; the rest are outputs. `averaging.averages` counts the segments of all
    records together. `moves` says of each channel whether it moved in any of them; of spectra without a word of it
    those channels did that have power.
    """

    values: ComplexArray
    averaging: Averaging
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]
    hashes: tuple[str, ...] = ()
    moves: tuple[bool, ...] = ()

    def moving(self, rows: Iterable[int]) -> tuple[int, ...]:
        """Return which of some channels moved and have power: what stands still may have some at 0 Hz alone."""
        power = self.power.max(axis=1)
        return tuple(i for i in rows if power[i] > 0 and (not self.moves or self.moves[i]))

    @property
    def f_hz(self) -> FloatArray:
        """The lines in Hz, `(nf,)`."""
        return self.averaging.f_hz

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Actuators and sensors in the order of the rows."""
        return self.actuators + self.sensors

    @property
    def power(self) -> FloatArray:
        """Auto spectra, `(channel, frequency)`."""
        return np.einsum("iif->if", self.values).real

    def block(self, rows: Sequence[int], columns: Sequence[int]) -> ComplexArray:
        """Return S of some channels with the frequency first, `(nf, rows, columns)`, as solvers want it."""
        return np.moveaxis(self.values[np.ix_(list(rows), list(columns))], -1, 0)

    def __add__(self, other: "CrossSpectra") -> "CrossSpectra":
        """Average with the cross spectra of another record, each segment counting once."""
        mine, its = self.averaging, other.averaging
        if replace(mine, averages=its.averages) != its or len(self.channels) != len(other.channels):
            raise InputError(
                f"cross_spectra: {len(self.channels)} channels in {mine.text} do not add to "
                f"{len(other.channels)} channels in {its.text}; average both alike."
            )
        n, m = mine.averages, its.averages
        return replace(
            self,
            values=frozen((n * self.values + m * other.values) / (n + m)),
            averaging=replace(mine, averages=n + m),
            hashes=self.hashes + other.hashes,
            moves=tuple(a or b for a, b in zip(self.moves, other.moves, strict=True))
            if self.moves and other.moves
            else (),
        )


def cross_spectra(
    blocks: Record | Iterable[Record],
    segment_samples: int | None = None,
    overlap: float = 0.5,
    window: str = "hann",
    detrend: str = "constant",
) -> CrossSpectra:
    """Return the cross spectra of a record's inputs and outputs, read whole or as consecutive blocks.

    S_ab(f) = mean over segments of 2 A(f) B*(f) / (rate sum w^2)

    Args:
        blocks: a record, or an iterator of consecutive pieces of one recording (segments run across their seams).
        segment_samples: length of a segment; needed for blocks, by default an eighth of a record.
        overlap: shared part of neighbouring segments, 0 to 0.95.
        window: any window name of scipy.signal.
        detrend: what is removed from every segment: its mean ("constant"), a line ("linear") or nothing ("none").

    Raises:
        InputError: no block, blocks that differ in channels or rate, a recording shorter than one segment.

    >>> u = np.random.default_rng(0).standard_normal((1, 4096))
    >>> record = Record(u, -u, rate_hz=1000.0)
    >>> whole = cross_spectra(record, 512)
    >>> pieces = cross_spectra((record.part(k, k + 1000) for k in range(0, 4096, 1000)), 512)
    >>> bool(np.allclose(whole.values, pieces.values)), pieces.averaging.averages
    (True, 15)

    Reference: P. D. Welch, IEEE Trans. Audio Electroacoust. 15 (1967) 70-73, doi:10.1109/TAU.1967.1161901.
    """
    if isinstance(blocks, Record):
        pieces, samples, hashes = iter([blocks]), blocks.samples, (blocks.hash,)
    elif segment_samples is None:
        raise InputError("cross_spectra: blocks need 'segment_samples', for their total length is not known.")
    else:
        pieces, samples, hashes = iter(blocks), segment_samples, ()
    first = next(pieces, None)
    if first is None:
        raise InputError("cross_spectra: it needs at least one block, got none.")
    plan = averaging("cross_spectra", samples, first.rate_hz, segment_samples, overlap, window, detrend)
    total, span = Accumulator(plan), _span(first)
    total.add(np.concatenate([first.inputs, first.outputs]))
    for piece in pieces:
        same_rate("cross_spectra", "the first block", first.rate_hz, "another", piece.rate_hz)
        if (piece.actuators, piece.sensors) != (first.actuators, first.sensors):
            raise InputError("cross_spectra: all blocks must have the same channels.")
        total.add(np.concatenate([piece.inputs, piece.outputs]))
        span = np.minimum(span, _span(piece))
    moves = tuple(bool(m) for m in _apart(-span[1], span[0]))
    return CrossSpectra(total.mean(), total.plan, first.actuators, first.sensors, hashes, moves)


def moving(signals: FloatArray) -> NDArray[np.bool_]:
    """Return which channels `(channel, sample)` move: samples that differ by rounding alone stand still."""
    return _apart(signals.max(axis=1), signals.min(axis=1))


def _span(piece: Record) -> FloatArray:
    """Return the least and the negative of the largest sample of each channel, `(2, channel)`."""
    lowest = [side.min(axis=1) for side in (piece.inputs, piece.outputs)]
    highest = [side.max(axis=1) for side in (piece.inputs, piece.outputs)]
    return np.stack([np.concatenate(lowest), -np.concatenate(highest)])


def _apart(high: FloatArray, low: FloatArray) -> NDArray[np.bool_]:
    return np.asarray(high - low > ROUNDING * np.maximum(np.abs(high), np.abs(low)))


class Accumulator:
    """Sums the products of windowed segments; holds the open end of the signals between blocks.

    With `auto=True` only a channel's product with itself is kept, `(channel, frequency)`.
    """

    def __init__(self, plan: Averaging, auto: bool = False) -> None:
        self.plan = replace(plan, averages=0)
        self._auto = auto
        self._tail: FloatArray | None = None
        self._sum: ComplexArray | FloatArray | None = None

    def add(self, signals: ArrayLike) -> None:
        """Take the next samples of all channels, `(channel, sample)`."""
        x = np.asarray(signals, dtype=np.float64)
        self._tail = x if self._tail is None else np.concatenate([self._tail, x], axis=1)
        length, step = self.plan.segment_samples, self.plan.segment_samples - self.plan.shared
        count = 1 + (self._tail.shape[1] - length) // step if self._tail.shape[1] >= length else 0
        views = np.lib.stride_tricks.sliding_window_view(self._tail, length, axis=1)[:, ::step] if count else None
        for start in range(0, count, BATCH):
            assert views is not None
            self._take(views[:, start : min(start + BATCH, count)])
        self._tail = self._tail[:, count * step :].copy()

    def mean(self) -> ComplexArray:
        """Return the one-sided densities of everything added."""
        if self._sum is None:
            samples = 0 if self._tail is None else self._tail.shape[1]
            raise InputError(
                f"cross_spectra: a segment of {self.plan.segment_samples} samples does not fit into {samples} samples; "
                f"shorten it."
            )
        plan = self.plan
        scale = np.full(plan.f_hz.size, 2.0 / (plan.rate_hz * np.sum(plan.taper**2) * plan.averages))
        scale[0] /= 2.0
        if plan.segment_samples % 2 == 0:
            scale[-1] /= 2.0
        if self._auto:
            return frozen(self._sum * scale)
        return frozen(np.moveaxis(self._sum, 0, -1) * scale)

    def _take(self, segments: FloatArray) -> None:
        X = np.fft.rfft(_without_trend(segments, self.plan.detrend) * self.plan.taper, axis=-1)
        if self._auto:
            product = np.sum(X.real**2 + X.imag**2, axis=1)
        else:
            Z = np.ascontiguousarray(np.transpose(X, (2, 0, 1)))
            product = Z @ np.conj(np.swapaxes(Z, 1, 2))
        self._sum = product if self._sum is None else self._sum + product
        self.plan = replace(self.plan, averages=self.plan.averages + segments.shape[1])


def _without_trend(segments: FloatArray, detrend: str) -> FloatArray:
    if detrend == "none":
        return segments
    # The mean of equal samples is rounded: what it leaves would count as a signal at every line.
    still = np.ptp(segments, axis=-1, keepdims=True) == 0
    level = np.where(still, 0.0, segments - segments.mean(axis=-1, keepdims=True))
    if detrend == "constant":
        return level
    t = np.arange(segments.shape[-1]) - (segments.shape[-1] - 1) / 2.0
    return level - (level @ t)[..., np.newaxis] / np.dot(t, t) * t


def refuse_dead(who: str, signals: ArrayLike, names: Sequence[Channel]) -> FloatArray:
    """Return signals `(channel, sample)`, or name the channel that never moves."""
    x = signal_array(who, "signals", signals)
    for row, channel in zip(x, names, strict=True):
        if np.ptp(row) == 0:
            raise InputError(
                f"{who}: channel '{channel.name}' never moves, its samples are all {row[0]:g}; "
                f"leave it out (Record.pick) or mend its wire."
            )
    return x
