"""The largest upper bound of the structured singular value over frequency, closely only where it may stand."""

import numpy as np

from ultraquiet.analyse.scalings.upper import Upper, balanced_norm, upper_bound
from ultraquiet.analyse.structure import BlockStructure
from ultraquiet.linalg.norms import largest_gains
from ultraquiet.linalg.ordered import Array

SAME = 2e-8  # relative: as near as close bounds are to the least ones, a line is not above another
BELOW = 1e-12  # relative: what keeps them apart
MOST_AT_ONCE = 64  # lines that are bounded closely side by side
WORK_AT_ONCE = 60_000  # and their channels, cubed: of many channels each line costs more than what lines share
FIRST = 8  # share of that many while no line is bounded yet
FAINT = 1e-200  # least scaling that is kept
REACH = 0.5  # in the logarithm of frequency: scalings from further away are not asked


class Scalings:
    """Scalings that bound a response closely at some frequencies, and bound it at every other one as well.

    With D and G of any frequency the largest eigenvalue t of D_in^-1 (M* D M + j (G M - M* G*)) bounds mu^2: one
    eigenvalue problem a line, where scalings of its own take some fifty. Least bounds change with frequency as their
    scalings do; those of both neighbours in the right proportion leave what goes with the square of the distance.
    """

    def __init__(self, blocks: BlockStructure) -> None:
        nz, nw = blocks.shape
        # of full blocks every scaling is diagonal
        self._diagonal = all(block.kind == "full" for block in blocks.blocks)
        self._at = np.zeros(0)
        self._out, self._into = (np.zeros((0, n) if self._diagonal else (0, n, n)) for n in (nz, nw))
        self._G = np.zeros((0, nw, nz), dtype=np.complex128)

    def learn(self, f: Array, upper: Upper) -> None:
        """Keep the scalings of lines at `f` `(nf,)`."""
        out, into = upper.out, upper.into
        size = np.einsum("faa->f", out).real / out.shape[-1]
        # where paths never return, scalings may be too far apart for a number to hold; any other bounds as well
        out, into = (D + FAINT * size[:, None, None] * np.eye(D.shape[-1]) for D in (out, into))
        if self._diagonal:
            out, into = (np.einsum("faa->fa", D).real for D in (out, into))
        order = np.argsort(np.concatenate([self._at, _place(f)]), kind="stable")

        def sorted_with(known: Array, more: Array) -> Array:
            return np.concatenate([known, more / size.reshape(-1, *(1,) * (more.ndim - 1))])[order]

        self._at = np.concatenate([self._at, _place(f)])[order]
        self._out, self._into = sorted_with(self._out, out), sorted_with(self._into, into)
        self._G = sorted_with(self._G, upper.G)

    def beside(self, f: Array) -> tuple[Array, Array, Array]:
        """Return the numbers of the scalings below and above each line `(nf,)`, and the share of the upper ones.

        Where there are none on one side, or they are far, those of the other side count alone.
        """
        at, last = _place(f), self._at.size - 1
        above = np.searchsorted(self._at, at)
        low, high = np.maximum(above - 1, 0), np.minimum(above, last)
        near = [np.abs(self._at[k] - at) <= REACH for k in (low, high)]
        low, high = np.where(near[0], low, high), np.where(near[1], high, low)
        width = self._at[high] - self._at[low]
        share = np.where(width > 0, (at - self._at[low]) / np.where(width > 0, width, 1.0), 0.0)
        return low, high, np.clip(share, 0.0, 1.0)

    def bounds(self, M: Array, low: Array, high: Array, share: Array) -> Array:
        """Return bounds `(nf,)` of `(nf, nz, nw)` by scalings between two known ones."""

        def between(known: Array) -> Array:
            part = share.reshape(-1, *(1,) * (known.ndim - 1))
            return (1 - part) * known[low] + part * known[high]

        out, into = between(self._out), between(self._into)
        if self._diagonal:
            return largest_gains(np.sqrt(out)[:, :, None] * M / np.sqrt(into)[:, None, :])
        left = np.linalg.cholesky(out).conj().swapaxes(1, 2)
        back = np.linalg.inv(np.linalg.cholesky(into)).conj().swapaxes(1, 2)
        moved = M @ back
        N = left @ moved
        size = np.abs(N).max(axis=(1, 2), initial=0.0)[:, None, None]
        size[size == 0] = 1.0
        turned = back.conj().swapaxes(1, 2) @ (between(self._G) / size) @ (moved / size)
        square = (N / size).conj().swapaxes(1, 2) @ (N / size) + 1j * (turned - turned.conj().swapaxes(1, 2))
        return size[:, 0, 0] * np.sqrt(np.maximum(np.linalg.eigvalsh(square)[:, -1], 0.0))

    @property
    def known(self) -> bool:
        """Whether there are any."""
        return self._at.size > 0


class LargestBound:
    """Bounds from above over frequency, as low as `upper_bound` has them wherever the largest may be.

    Args:
        blocks: of the perturbation.

    Attributes:
        highest: the largest of all bounds so far, each of them proven; relatively SAME above the best line at most.
    """

    def __init__(self, blocks: BlockStructure) -> None:
        self._blocks = blocks
        self._known = Scalings(blocks)
        self._best, self._best_at = 0.0, np.nan
        self.highest = 0.0
        self._batch = int(np.clip(WORK_AT_ONCE // max(blocks.shape) ** 3, 1, MOST_AT_ONCE))

    def learn(self, f: Array, upper: Upper, values: Array) -> None:
        """Keep close bounds `(nf,)` that were found elsewhere, with what scalings prove them."""
        self._known.learn(f, upper)
        self._raise(f, values)

    def __call__(self, f: Array, M: Array, quick: Array | None = None) -> Array:
        """Return bounds `(nf,)` of `(nf, nz, nw)` at `f` in Hz; `quick` are bounds that are known already."""
        values: Array = np.full(f.size, np.inf) if quick is None else quick.copy()
        fresh, closed = np.isinf(values), np.zeros(f.size, dtype=bool)
        self._borrow(f, M, values)
        some = np.flatnonzero(fresh & self._open(values))
        values[some] = np.minimum(values[some], balanced_norm(M[some], self._blocks))
        while True:
            some = np.flatnonzero(self._open(values) & ~closed)
            if not some.size:
                return self._ranked(f, values)
            few = some[self._chosen(f[some], values[some])]
            upper = upper_bound(M[few], self._blocks, self._best * (1 + SAME))
            values[few] = np.minimum(values[few], upper.value)
            closed[few] = True
            # what stopped short of its least bound is no measure of others
            high = few[self._open(values[few])]
            self._raise(f[high], values[high])
            self._known.learn(f[few], upper)
            self._borrow(f, M, values, ~closed)

    def _raise(self, f: Array, values: Array) -> None:
        if values.max(initial=0.0) > self._best:
            self._best, self._best_at = float(values.max()), float(f[np.argmax(values)])
        self.highest = max(self.highest, self._best)

    def _ranked(self, f: Array, values: Array) -> Array:
        """Return bounds among which none is as high as the best line's for being known less closely."""
        self.highest = max(self.highest, float(values.max(initial=0.0)))
        level = self._best if self._best > 0 else np.inf
        ranked = np.where(self._open(values), values, np.minimum(values, level * (1 - BELOW)))
        return np.where(f == self._best_at, np.minimum(values, level), ranked)

    def _open(self, values: Array) -> Array:
        """Return which lines may be the largest."""
        return values > self._best * (1 + SAME)

    def _borrow(self, f: Array, M: Array, values: Array, which: Array | bool = True) -> None:
        """Lower `values` in place by the scalings nearest to each line, then by those of both sides together."""
        if not self._known.known:
            return
        for nearest in (True, False):
            some = np.flatnonzero(self._open(values) & which)
            low, high, share = self._known.beside(f[some])
            if nearest:
                share = np.round(share)
            else:
                inside = (low < high) & (share > 0) & (share < 1)
                some, low, high, share = some[inside], low[inside], high[inside], share[inside]
            if some.size:
                values[some] = np.minimum(values[some], self._known.bounds(M[some], low, high, share))

    def _chosen(self, f: Array, values: Array) -> Array:
        """Return the lines to be bounded closely next: the highest of those that stand above their neighbours."""
        order = np.argsort(f, kind="stable")
        padded = np.concatenate([[-np.inf], values[order], [-np.inf]])
        top = order[(padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:])]
        # of the first ones every bound is brought all the way down
        most = self._batch if self._best > 0 else max(1, self._batch // FIRST)
        return top[np.argsort(-values[top], kind="stable")][:most]


def _place(f: Array) -> Array:
    """Return where lines stand on an axis of the logarithm of frequency, its ends, zero and infinity, far away."""
    with np.errstate(divide="ignore"):
        return np.clip(np.log(f), -1e3, 1e3)
