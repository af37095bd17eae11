"""Products of signals at all lags, gathered block by block from records of any length."""

import numpy as np

from ultraquiet._base.constraints import FloatArray

SEGMENT = 8192  # samples of one transform; longer lags take the next power of two above four times as many


class Lagged:
    """Sums over t of x_a(t) x_b(t + k), k = 0 .. lags, of signals that arrive in blocks.

    Overlapping segments are multiplied in the frequency domain and their spectra added up, so that one inverse
    transform at the end gives every lag exactly: cost and memory do not depend on the number of lags or samples.

    >>> x = np.arange(5.0)[None]
    >>> sums = Lagged(1, 2)
    >>> sums.add(x[:, :2])
    >>> sums.add(x[:, 2:])
    >>> sums.products()[:, 0, 0].round(9).tolist()
    [30.0, 20.0, 11.0]
    """

    def __init__(self, channels: int, lags: int) -> None:
        self.lags, self.samples = lags, 0
        self._size = max(SEGMENT, 1 << (4 * lags - 1).bit_length())
        self._spectra = np.zeros((self._size // 2 + 1, channels, channels), dtype=np.complex128)
        self._pending = np.zeros((channels, 0))
        self._total = np.zeros(channels)
        self.head, self.tail = np.zeros((channels, 0)), np.zeros((channels, 0))

    def add(self, block: FloatArray) -> None:
        """Take the next samples `(channels, m)`."""
        self.samples += block.shape[1]
        self._total += block.sum(axis=1)
        if self.head.shape[1] < self.lags:
            self.head = np.hstack([self.head, block[:, : self.lags - self.head.shape[1]]])
        self.tail = np.hstack([self.tail, block[:, -self.lags :]])[:, -self.lags :] if self.lags else self.tail
        self._pending = np.hstack([self._pending, block])
        step = self._size - self.lags
        while self._pending.shape[1] >= self._size:
            self._spectra += self._cross(self._pending[:, : self._size], step)
            self._pending = self._pending[:, step:]

    @property
    def mean(self) -> FloatArray:
        """Means of the signals, `(channels,)`."""
        return self._total / self.samples

    def products(self, centred: bool = False) -> FloatArray:
        """Return the sums `(lags + 1, a, b)`; `centred` takes each signal's mean out first."""
        rest = self._pending
        spectra = self._spectra
        if rest.shape[1]:
            # What is left fits one segment, except for the lags behind its end, which see zeros.
            cut = min(rest.shape[1], self._size - self.lags)
            spectra = spectra + self._cross(rest, cut)
            if cut < rest.shape[1]:
                spectra = spectra + self._cross(rest[:, cut:], rest.shape[1] - cut)
        sums = np.fft.irfft(spectra, self._size, axis=0)[: self.lags + 1]
        return sums - self._means() if centred else sums

    def _means(self) -> FloatArray:
        """Return what the means add: sum_t (m_a x_b(t + k) + x_a(t) m_b - m_a m_b)."""
        mean, lags = self.mean, np.arange(self.lags + 1)
        kept = np.minimum(lags, self.head.shape[1])  # of fewer samples than lags all
        later = (self._total[:, None] - _sums_so_far(self.head)[:, kept]).T
        sooner = (self._total[:, None] - _sums_so_far(self.tail[:, ::-1])[:, kept]).T
        both = (self.samples - lags)[:, None, None] * np.outer(mean, mean)
        return mean[:, None] * later[:, None, :] + sooner[:, :, None] * mean - both

    def _cross(self, x: FloatArray, cut: int) -> np.ndarray:
        """Return the cross spectra of the first `cut` samples with all of them."""
        first = np.fft.rfft(x[:, :cut], self._size)
        every = np.fft.rfft(x, self._size) if cut < x.shape[1] else first
        return first.conj().T[:, :, None] * every.T[:, None, :]


def products_of_shifts(r: FloatArray, last: FloatArray, first: FloatArray | None = None) -> FloatArray:
    """Return the products of a signal's shifts by 0 .. n from its products at these lags, `(n + 1, n + 1)`.

    Those of i and j samples differ from r[|i - j|] by what leaves at the end and, where the first samples only stand in
    the past of others, by what has not yet come at the start.

    Args:
        r: `(n + 1,)` sums of x(t) x(t + k) over the whole signal.
        last: `(n,)` last samples, the newest last.
        first: `(n,)` first samples; None where the signal is zero before it begins.

    >>> x, r = np.array([1.0, 2.0, 3.0]), np.array([14.0, 8.0])
    >>> products_of_shifts(r, x[-1:]).tolist(), products_of_shifts(r, x[-1:], x[:1]).tolist()
    ([[14.0, 8.0], [8.0, 5.0]], [[13.0, 8.0], [8.0, 5.0]])
    """
    i, j = np.indices((r.size, r.size))
    least, apart = np.minimum(i, j), np.abs(i - j)
    G = r[apart]
    if first is not None:
        G = G - _products_so_far(first)[apart, first.size - apart - least]
    return G - _products_so_far(last[::-1])[apart, least]


def _products_so_far(x: FloatArray) -> FloatArray:
    """Return the sums of x_j x_(j + k) over j < m, `(lag k, m)`, k and m from 0 to the size of x, zero beyond it."""
    later = np.lib.stride_tricks.sliding_window_view(np.concatenate([x, np.zeros(x.size + 1)]), max(x.size, 1))
    return _sums_so_far(later[: x.size + 1, : x.size] * x)


def _sums_so_far(rows: FloatArray) -> FloatArray:
    """Return the sums of the first 0, 1, 2, ... of each row."""
    out = np.zeros((rows.shape[0], rows.shape[1] + 1))
    np.cumsum(rows, axis=1, out=out[:, 1:])
    return out
