"""A record cut into overlapping frames, in which every mode stays one exponential."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

# Frames a record is cut into; each reaches over so many steps of the next. A Kaiser window of this shape lets 220 dB
# less through beyond its main lobe, so a band holds the modes of its own frequencies and no other.
FRAMES, OVERLAP, KAISER = 160, 16, 30.0
# Every fourth line of a frame's transform suffices for a main lobe this wide: the frame is folded before it.
FOLD = 4


@dataclass(frozen=True, eq=False)
class Frames:
    """How a record of `samples` is cut: `count` frames of `length`, `hop` samples apart."""

    samples: int
    rate_hz: float

    @property
    def hop(self) -> int:
        """Samples from frame to frame."""
        return max(1, self.samples // FRAMES)

    @property
    def length(self) -> int:
        """Samples of a frame, a multiple of `FOLD`."""
        return OVERLAP * self.hop

    @property
    def count(self) -> int:
        """Frames that the record holds."""
        return (self.samples - self.length) // self.hop + 1

    @cached_property
    def window(self) -> FloatArray:
        """Kaiser's window, its sum of squares one: white noise keeps its size."""
        window = np.kaiser(self.length, KAISER)
        return window / np.sqrt(np.sum(window**2))

    def power(self, signal: FloatArray, first: int) -> FloatArray:
        """Return the mean power over channels and frames from `first` on, at every line in use, `(lines,)`."""
        chosen = range(first, self.count, OVERLAP // 4)
        total = np.zeros(self.length // FOLD // 2 + 1)
        for k in chosen:
            frame = signal[:, k * self.hop : k * self.hop + self.length] * self.window
            folded = frame.reshape(len(signal), FOLD, -1).sum(axis=1)
            total += np.mean(np.abs(np.fft.rfft(folded, axis=1)) ** 2, axis=0)
        return total / len(chosen)

    def band(self, signal: FloatArray, line: int) -> ComplexArray:
        """Return the amplitude about one line in every frame, `(channels, count)`.

        A mode z^t of the signal is z^(hop k) there, times a constant: exactly, whatever the window.
        """
        turning = self.window * np.exp(-2j * np.pi * line * FOLD / self.length * np.arange(self.length))
        # a frame is `OVERLAP` steps in a row: each step's product with each part of the window is made once
        parts = turning.reshape(OVERLAP, self.hop).T
        steps = signal[:, : (self.count + OVERLAP - 1) * self.hop].reshape(len(signal), -1, self.hop)
        products = steps @ np.hstack([parts.real, parts.imag])
        total = np.sum([products[:, k : k + self.count, k::OVERLAP] for k in range(OVERLAP)], axis=0)
        return np.asarray(total[..., 0] + 1j * total[..., 1], dtype=np.complex128)

    def line_hz(self, line: int) -> float:
        """Return the frequency of a line in Hz."""
        return line * FOLD / self.length * self.rate_hz
