"""A line heard together with its neighbours: as many of them as noise alone tells apart from a smooth response."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.simulate.sweeps.lines import largest

# Lines to either side, in windows one after the other; a parabola through fewer than five leaves noise as it is.
REACHES = (2, 4, 8, 16)
OFFSETS = np.arange(-REACHES[-1], REACHES[-1] + 1)
# The largest singular value of an n x k matrix of complex noise of size one is sqrt(n) + sqrt(k) in the mean, seldom
# larger by more than this: of a single number once in eight thousand times. One of all lines is a needle when it is so
# much larger yet.
SELDOM, SURELY = 1.0, 1.2
# A needle that is just within the noise of its line is not seen, and lost in a window: so much of what the line leaves
# open by itself is left however wide the window.
UNSEEN = 0.5


@dataclass(frozen=True, eq=False)
class LinesOfS:
    """S at all lines of a band, with what is left open of it.

    Its error is E R^-1: in a response R of the open loop, `k` runs of it, noise E that is independent from line to
    line, from run to run and from sensor to sensor.

    Attributes:
        S: `(ny, ny, lines)`.
        noise: what n independent causes leave open of its largest singular value, `(n, lines)`.
        moving: what runs that had not come to rest leave open of it, `(lines,)`: alike at neighbouring lines.
        noise_rows: size of E at each sensor, `(ny, lines)`.
        responses: R, `(lines, ny, k)`.
        stride: lines from one to the next whose noise is independent.
    """

    S: ComplexArray
    noise: FloatArray
    moving: FloatArray
    noise_rows: FloatArray
    responses: ComplexArray
    stride: int

    def with_neighbours(self, places: np.ndarray) -> tuple[ComplexArray, FloatArray, FloatArray]:
        """Return S at the places, `(ny, ny, places)`, less noisy where it is smooth, its `noise` and its `moving`.

        The value at its middle of the parabola that fits 2 m + 1 lines, m = 2, 4, 8, 16 to either side, is

            S_m(l) = sum_j w_j S(l + j stride),  w_j = (3 (3 m^2 + 3 m - 1) - 15 j^2) / ((2 m - 1) (2 m + 1) (2 m + 3)),

        with noise sqrt(sum_j w_j^2 d(l + j stride)^2); what moves adds up, sum_j |w_j| d(l + j stride). A window counts
        as long as it differs from every narrower one by what noise makes of the difference of their weights, judged in
        the units of the noise: ||diag(rows)^-1 (S_m - S_m') R||. So nothing that a quiet sensor or a strong direction
        shows is lost in the noise of another. Nor does a window with a needle in it count, a line that differs from the
        mean of both beside it by more than noise. Of those that do, the one that leaves least open; half of what a line
        by itself leaves open stays, for a needle within its noise.

        Reference: Savitzky and Golay, Anal. Chem. 36 (1964) 1627-1639, doi:10.1021/ac60214a047, for the weights;
        Katkovnik, IEEE Trans. Signal Process. 47 (1999) 2567-2571, doi:10.1109/78.782208, for windows whose intervals
        meet.
        """
        beside = [(places + self.stride * j).clip(0, self.S.shape[2] - 1) for j in OFFSETS]
        powers = np.stack([self.noise[:, at] ** 2 for at in beside], axis=1)
        moves = np.stack([self.moving[at] for at in beside])
        needles = self._needles()
        has_needle = np.stack([needles[at] for at in beside])
        best, noise, moving = self.S[:, :, places], self.noise[:, places], self.moving[places]
        alone = np.maximum(powers[:, REACHES[-1]].sum(axis=0), np.finfo(float).tiny)
        narrower = [(best, (OFFSETS == 0).astype(float))]
        agrees = np.ones(places.size, dtype=bool)
        for reach in REACHES:
            agrees &= (places >= reach * self.stride) & (places < self.S.shape[2] - reach * self.stride)
            agrees &= ~has_needle[np.abs(OFFSETS) <= reach].any(axis=0)
            if not agrees.any():
                break
            weights = _parabola(reach)
            wider = np.zeros_like(best)
            for j in np.flatnonzero(weights):
                wider += weights[j] * self.S[:, :, beside[j]]
            for other, its_weights in narrower:
                share = np.sqrt(((weights - its_weights) ** 2 @ powers).sum(axis=0) / alone)
                agrees &= self._in_noise(wider - other, places) <= share
            narrower.append((wider, weights))
            its_noise, its_moving = np.sqrt(weights**2 @ powers), np.abs(weights) @ moves
            better = agrees & (together(its_noise, its_moving) < together(noise, moving))
            best, noise = np.where(better, wider, best), np.where(better, its_noise, noise)
            moving = np.where(better, its_moving, moving)
        return best, np.maximum(noise, UNSEEN * self.noise[:, places]), moving

    def _needles(self) -> np.ndarray:
        """Return which lines no noise makes of those beside them, `(lines,)`."""
        found = np.zeros(self.S.shape[2], dtype=bool)
        inner = np.arange(self.stride, self.S.shape[2] - self.stride)
        if inner.size:
            beside = (self.S[:, :, inner - self.stride] + self.S[:, :, inner + self.stride]) / 2
            power = np.sum(self.noise**2, axis=0)
            both = (power[inner - self.stride] + power[inner + self.stride]) / 4
            share = np.sqrt(1 + both / np.maximum(power[inner], np.finfo(float).tiny))
            found[inner] = self._in_noise(self.S[:, :, inner] - beside, inner) > SURELY * share
        return found

    def _in_noise(self, difference: ComplexArray, places: np.ndarray) -> FloatArray:
        """Return how large a difference is, `(places,)`, over the most that the noise of a line makes of it."""
        responses, rows = self.responses[places], self.noise_rows[:, places].T[:, :, None]
        ny, k = responses.shape[1:]
        whitened = np.moveaxis(difference, 2, 0) @ responses / np.maximum(rows, np.finfo(float).tiny)
        return largest(whitened) / (np.sqrt(ny) + np.sqrt(k) + SELDOM)


def together(noise: FloatArray, moving: FloatArray) -> FloatArray:
    """Return what noise of independent causes, `(n, lines)`, and what moves, `(lines,)`, leave open, `(lines,)`."""
    return np.asarray(np.sqrt(np.sum(noise**2, axis=0) + moving**2))


def _parabola(reach: int) -> FloatArray:
    """Return the weights of the offsets in the middle of a parabola through `reach` lines to either side."""
    m, j = reach, OFFSETS
    weights = (3 * (3 * m**2 + 3 * m - 1) - 15 * j**2) / ((2 * m - 1) * (2 * m + 1) * (2 * m + 3))
    return np.where(np.abs(j) <= m, weights, 0.0)
