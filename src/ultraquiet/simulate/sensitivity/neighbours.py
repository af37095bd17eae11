"""A line heard together with its neighbours: as many of them as noise alone tells apart from a smooth response."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.simulate.open_loop import largest

# Lines to either side, in windows one after the other; a parabola through fewer than five leaves noise as it is.
REACHES = (2, 4, 8, 16)
OFFSETS = np.arange(-REACHES[-1], REACHES[-1] + 1)
# Two windows agree when they differ by no more than so many deviations of their difference. The largest singular value
# of a matrix of noise is up to twice the deviation that one of its columns has; a single number is larger than this
# once in two hundred times.
AGREE = 2.3


def with_neighbours(
    S: ComplexArray, deviations: FloatArray, places: np.ndarray, stride: int
) -> tuple[ComplexArray, FloatArray]:
    """Return S at the places, `(ny, ny, places)`, less noisy where it is smooth, and its deviations `(n, places)`.

    The value at its middle of the parabola that fits 2 m + 1 lines, m = 2, 4, 8, 16 to either side, is

        S_m(k) = sum_j w_j S(k + j stride),   w_j = (3 (3 m^2 + 3 m - 1) - 15 j^2) / ((2 m - 1) (2 m + 1) (2 m + 3)),

    with the deviation sqrt(sum_j w_j^2 d(k + j stride)^2). A window counts as long as it differs from every narrower
    one by what noise makes of the difference of their weights; of those that count, the one that noise moves least.
    Where S bends by more than noise, at a needle, it stays as it was read.

    Args:
        S: `(ny, ny, lines)`.
        deviations: what n independent causes leave open of its largest singular value, `(n, lines)`.
        places: of the lines that are wanted.
        stride: lines from one to the next whose noise is independent.

    Reference: Savitzky and Golay, Anal. Chem. 36 (1964) 1627-1639, doi:10.1021/ac60214a047, for the weights; Katkovnik,
    IEEE Trans. Signal Process. 47 (1999) 2567-2571, doi:10.1109/78.782208, for windows whose intervals meet.
    """
    beside = [(places + stride * j).clip(0, S.shape[2] - 1) for j in OFFSETS]
    powers = np.stack([deviations[:, at] ** 2 for at in beside], axis=1)
    best, left = S[:, :, places], deviations[:, places]
    narrower = [(best, _alone())]
    agrees = np.ones(places.size, dtype=bool)
    for reach in REACHES:
        agrees &= (places >= reach * stride) & (places < S.shape[2] - reach * stride)
        if not agrees.any():
            break
        weights = _parabola(reach)
        wider = np.zeros_like(best)
        for j in np.flatnonzero(weights):
            wider += weights[j] * S[:, :, beside[j]]
        for other, its_weights in narrower:
            noise = np.sqrt(((weights - its_weights) ** 2 @ powers).sum(axis=0))
            agrees &= largest(np.moveaxis(wider - other, 2, 0)) <= AGREE * noise
        narrower.append((wider, weights))
        open_ = np.sqrt(weights**2 @ powers)
        better = agrees & (np.linalg.norm(open_, axis=0) < np.linalg.norm(left, axis=0))
        best, left = np.where(better, wider, best), np.where(better, open_, left)
    return best, left


def _alone() -> FloatArray:
    """Return the weights of a line by itself."""
    return (OFFSETS == 0).astype(float)


def _parabola(reach: int) -> FloatArray:
    """Return the weights of the offsets in the middle of a parabola through `reach` lines to either side."""
    m, j = reach, OFFSETS
    weights = (3 * (3 * m**2 + 3 * m - 1) - 15 * j**2) / ((2 * m - 1) * (2 * m + 1) * (2 * m + 3))
    return np.where(np.abs(j) <= m, weights, 0.0)
