"""Which directions of residues of full rank are needed: the faintest leave, the others being fitted again each time."""

from collections.abc import Iterator

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.modes import rank_one

LEAVE = 0.06  # of the modes, in a round
LEAVE_EARLY, EARLY = 0.15, 4  # while there are so many times the modes that the poles alone would make
# Share of the unit diagonal added to normal matrices: beyond the digits that products of samples carry.
RIDGE = 1e-13


def all_directions(poles: ComplexArray, residues: ComplexArray) -> rank_one.RankOneModes:
    """Return modes of rank one for every direction of residues `(ny, nu, poles)`, poles with their conjugates.

    Poles that a bound has made one have one residue, the sum of theirs.
    """
    heads = np.flatnonzero(poles.imag >= 0)
    _, first, where = np.unique(poles[heads], return_index=True, return_inverse=True)
    summed = np.zeros((heads.size, *residues.shape[:2]), dtype=np.complex128)
    np.add.at(summed, first[where], np.moveaxis(residues, 2, 0)[heads])
    first = np.sort(first)
    U, s, Vh = np.linalg.svd(summed[first], full_matrices=False)
    root = np.sqrt(s)
    c, b = U * root[:, None], Vh * root[:, :, None]
    directions = s.shape[1]
    return rank_one.of(
        np.repeat(poles[heads[first]], directions),
        np.moveaxis(c, 1, 0).reshape(c.shape[1], -1),
        b.reshape(-1, b.shape[2]),
    )


def eliminated(modes: rank_one.RankOneModes, samples: rank_one.Samples) -> Iterator[rank_one.RankOneModes]:
    """Give ever fewer modes, the poles held, down to one."""
    alone = len(np.unique(modes.poles[modes.heads()]))
    table = _Products.of(modes.poles, samples)
    while len(modes.heads()) > 1:
        modes, rank = table.faintest(modes)
        heads = modes.heads()
        share = LEAVE_EARLY if heads.size > EARLY * alone else LEAVE
        modes = modes.only(np.sort(np.delete(heads, rank[: max(1, round(share * heads.size))])))
        yield modes


def faintest(modes: rank_one.RankOneModes, samples: rank_one.Samples) -> np.ndarray:
    """Return which of `modes.heads()` would be missed least, second least, and so on."""
    return _Products.of(modes.poles, samples).faintest(modes)[1]


class _Products:
    """Products of the functions of distinct poles with each other, `F`, and with the samples, `M` `(poles, ny, nu)`."""

    def __init__(self, poles: ComplexArray, F: ComplexArray, M: ComplexArray) -> None:
        self.poles, self.F, self.M = poles, F, M

    @classmethod
    def of(cls, poles: ComplexArray, samples: rank_one.Samples) -> "_Products":
        distinct = np.unique(poles)
        phi, _, H = rank_one.weighted(distinct, samples)
        return cls(distinct, phi.conj().T @ phi, np.einsum("fk,ijf->kij", phi.conj(), H, optimize=True))

    def turned(self) -> "_Products":
        """Return the table of the transposed samples."""
        return _Products(self.poles, self.F, self.M.transpose(0, 2, 1))

    def faintest(self, modes: rank_one.RankOneModes) -> tuple[rank_one.RankOneModes, np.ndarray]:
        """Return the modes fitted again, and the places of `heads` in the order in which they may leave.

        A mode counts by how much the squared error would rise without it, all other output directions fitted again, or
        all other input directions, whichever is less; by each of its states.
        """
        modes, by_outputs = self.refitted(_orthogonal(self.refitted(modes)[0]))
        turned, by_inputs = self.turned().refitted(modes.turned())
        states = np.where(np.arange(by_inputs.size) < modes.upper, 2, 1)
        return turned.turned(), np.argsort(np.minimum(by_outputs, by_inputs) / states, kind="stable")

    def refitted(self, modes: rank_one.RankOneModes) -> tuple[rank_one.RankOneModes, FloatArray]:
        """Return the modes with the best output directions, and the rise of the squared error without each of them."""
        from scipy.linalg import cho_factor, cho_solve

        u, m = modes.upper, modes.poles.size
        at = np.searchsorted(self.poles, modes.poles)
        N = self.F[np.ix_(at, at)] * (modes.b.conj() @ modes.b.T)
        N = rank_one.real_rows(rank_one.real_columns(N, u), u)
        r = rank_one.real_rows(np.einsum("kij,kj->ki", self.M[at], modes.b.conj()), u)
        size = np.sqrt(np.maximum(np.diag(N), np.finfo(float).tiny))
        scaled = N / np.outer(size, size)
        scaled[np.diag_indices_from(scaled)] += RIDGE * m
        inverse = cho_solve(cho_factor(scaled, check_finite=False), np.eye(m))
        x = inverse @ (r / size[:, None])
        rise = np.concatenate([_pairs(x[:u], x[u : 2 * u], inverse, u), _singles(x[2 * u :], inverse, u)])
        x = x / size[:, None]
        c = x[:u] + 1j * x[u : 2 * u]
        found = np.vstack([c, c.conj(), x[2 * u :]]).T.astype(np.complex128)
        return rank_one.RankOneModes(modes.poles, found, modes.b), rise


def _pairs(x: FloatArray, y: FloatArray, inverse: FloatArray, u: int) -> FloatArray:
    """Return v' W^-1 v of each pair of unknowns v = (x, y), W their 2 x 2 part of the inverse."""
    k = np.arange(u)
    a, b, d = inverse[k, k], inverse[k, k + u], inverse[k + u, k + u]
    xx, xy, yy = (x * x).sum(axis=1), (x * y).sum(axis=1), (y * y).sum(axis=1)
    return (d * xx - 2 * b * xy + a * yy) / np.maximum(a * d - b * b, np.finfo(float).tiny)


def _singles(x: FloatArray, inverse: FloatArray, u: int) -> FloatArray:
    return (x * x).sum(axis=1) / np.diag(inverse)[2 * u :]


def _orthogonal(modes: rank_one.RankOneModes) -> rank_one.RankOneModes:
    """Return the modes of each pole in orthogonal directions: side by side, each would pass for the other.

    Of more modes than there are directions those beyond are nothing.
    """
    heads = modes.heads()
    _, where = np.unique(modes.poles[heads], return_inverse=True)
    c, b = modes.c[:, heads].copy(), modes.b[heads].copy()
    for pole in range(where.max() + 1):
        of_pole = np.flatnonzero(where == pole)
        U, s, Vh = np.linalg.svd(c[:, of_pole] @ b[of_pole], full_matrices=False)
        root = np.sqrt(s[: of_pole.size])
        kept = of_pole[: root.size]
        c[:, of_pole], b[of_pole] = 0.0, 0.0
        c[:, kept], b[kept] = U[:, : kept.size] * root, root[:, None] * Vh[: kept.size]
    return rank_one.of(modes.poles[heads], c, b)
