"""In which directions a bench is swept: one of its sensors' after the other, weak ones as loud as strong ones."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

# Directions this much weaker than the strongest are driven no more strongly.
WEAKEST = 1e-3
# The next vector of a basis is the first channel with this share of the largest rest: which of two alike channels comes
# first is not left to rounding.
ALIKE = 0.9


@dataclass(frozen=True, eq=False)
class Directions:
    """Directions of the disturbance at rising frequencies, `(points,)`: columns of `vectors`, `(nu, k, points)`."""

    f_hz: FloatArray
    vectors: ComplexArray

    @classmethod
    def of(cls, f_hz: FloatArray, G: ComplexArray) -> "Directions":
        """Return those of responses `(ny, nu, points)`, every channel in its range: see `directions`."""
        return cls(f_hz, np.moveaxis(directions(np.moveaxis(G, 2, 0)), 0, 2))

    def __len__(self) -> int:
        return self.vectors.shape[1]

    def at(self, k: int, f_hz: FloatArray) -> ComplexArray:
        """Return one of them at frequencies between its own, `(nu, frequencies)`."""
        at, own = np.log(np.maximum(f_hz, np.finfo(float).tiny)), np.log(self.f_hz)
        return np.array([between(at, own, row) for row in self.vectors[:, k]], complex)

    def loudest(self, G: ComplexArray, heard: float, driven: float) -> FloatArray:
        """Return how loud each may be, `(k, points)`, where so much is heard and driven, in shares of ranges.

        G: responses at these frequencies, as for `of`. Where nothing else is moved and nothing rings on, that is.
        """
        moved = np.abs(np.einsum("ijl,jkl->ikl", G, self.vectors)).max(axis=0)
        return np.minimum(heard / np.maximum(moved, np.finfo(float).tiny), driven / np.abs(self.vectors).max(axis=0))


def between(at: FloatArray, known: FloatArray, values: ComplexArray) -> ComplexArray:
    """Return complex values between those at known places, the first and the last beyond them."""
    return np.interp(at, known, values.real) + 1j * np.interp(at, known, values.imag)


def directions(G: ComplexArray) -> ComplexArray:
    """Return `nu` directions of the actuators at each of some frequencies, `(frequencies, nu, nu)`, each of size one.

    Args:
        G: responses at rising frequencies, `(frequencies, ny, nu)`, every channel in its range.

    The first min(ny, nu) are columns of V diag(1 / s) U^H W, where G = U diag(s) V^H and W is a basis of what the
    actuators reach: each moves one direction of the sensors alone. The others, with more actuators than sensors, move
    none. Neighbours in frequency are in phase, so that a sweep turns slowly.
    """
    ny, nu = G.shape[1:]
    heard = min(ny, nu)
    u, s, vh = np.linalg.svd(G)
    u, s, v = u[:, :, :heard], s[:, None, :heard], np.conj(np.swapaxes(vh, 1, 2))
    turned = np.conj(np.swapaxes(u, 1, 2))
    common = np.eye(ny) if heard == ny else _reached((u @ turned).mean(axis=0), heard)
    s = s / np.maximum(s[:, :, :1], np.finfo(float).tiny)
    w = (v[:, :, :heard] / np.maximum(s, WEAKEST)) @ (turned @ common)
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    still = v[:, :, heard:].copy()
    still[0] = _basis(still[0])
    for k in range(1, len(w)):
        turn = np.sum(np.conj(w[k]) * w[k - 1], axis=0)
        w[k] *= turn / np.maximum(np.abs(turn), np.finfo(float).tiny)
        # the unitary that brings one basis nearest to the other
        left, _, right = np.linalg.svd(np.conj(still[k].T) @ still[k - 1])
        still[k] = still[k] @ (left @ right)
    return np.concatenate([w, still], axis=2)


def _reached(mean: ComplexArray, rank: int) -> ComplexArray:
    """Return a basis `(ny, rank)` of the directions that the mean of projections `(ny, ny)` keeps most of."""
    return _basis(np.linalg.svd(mean)[0][:, :rank])


def _basis(columns: ComplexArray) -> ComplexArray:
    """Return the orthonormal basis of a subspace that lies nearest to single channels, whatever basis it is given by.

    Singular vectors of equal values are any of their span's, by rounding.
    """
    rest = columns @ np.conj(columns.T)
    found = np.empty_like(columns)
    for k in range(columns.shape[1]):
        size = np.linalg.norm(rest, axis=0)
        first = np.flatnonzero(size >= ALIKE * size.max())[0]
        found[:, k] = rest[:, first] / size[first]
        rest = rest - np.outer(found[:, k], np.conj(found[:, k]) @ rest)
    return found
