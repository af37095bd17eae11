"""Lower bound of the structured singular value: a perturbation that makes the loop singular, and its size.

mu >= |lambda(Q M)| for every Q of the structure with norm one. The power iteration (Packard and Doyle 1993,
doi:10.1016/0005-1098(93)90175-S; Young and Doyle 1990 for real blocks, doi:10.1109/CDC.1990.203852) looks for local
maxima from several starts: the singular vectors that the upper bound ends with, and random ones. The best of them is
then turned by exact eigenvectors until it stands.
"""

import numpy as np

from ultraquiet.analyse.scalings.upper import Upper
from ultraquiet.analyse.structure import BlockStructure
from ultraquiet.linalg.ordered import Array

PAIRS = 4  # starts from the two largest singular values of the scaled matrix
RANDOM = 4  # starts from anywhere
STEPS = 40  # of the power iteration, all starts
POLISH = 60  # turns by exact eigenvectors, best start
SETTLED = 1e-10  # relative gain of a turn below which a frequency is done
TURNS = 8  # of complex blocks until an eigenvalue is real, where other blocks are
REAL = 1e-9  # imaginary share below which an eigenvalue counts as real, where blocks are real
SEED = 0  # of the starts: the bound is the same every time
TINY = np.finfo(float).tiny


def lower_bound(M: Array, blocks: BlockStructure, upper: Upper) -> tuple[Array, Array]:
    """Return the bound `(nf,)` and Q of norm one `(nf, nw, nz)`, which has it as an eigenvalue of Q M."""
    nf = M.shape[0]
    a, b, w = _iterated(M, blocks, _starts(M, upper))
    Q = _perturbations(a, b, w, blocks)
    if blocks.has_real:
        Q = _turned_real(M, blocks, Q)
    size, turn = _spectral(Q @ M[:, None], blocks)
    best = np.argmax(size, axis=1)
    pick = np.arange(nf), best
    size, Q = size[pick], Q[pick] * turn[pick][:, None, None]
    if not blocks.has_real:
        size, Q = _polished(M, blocks, size, Q)
    return size, Q


def _starts(M: Array, upper: Upper) -> tuple[Array, Array]:
    """Return b and w `(nf, starts, nw)`: what leaves the perturbation, and what enters it seen from behind."""
    nf, _, nw = M.shape
    rng = np.random.default_rng(SEED)
    left, right = np.linalg.cholesky(upper.out), np.linalg.cholesky(upper.into)
    back = np.linalg.inv(right).conj().swapaxes(1, 2)
    # G is left out: it turns the matrix of a mixed problem, whose iteration starts well enough from D alone
    N = left.conj().swapaxes(1, 2) @ M @ back
    Vh = np.linalg.svd(N, full_matrices=False)[2]
    top = Vh[:, : min(2, Vh.shape[1])].conj()
    mix = rng.standard_normal((PAIRS, top.shape[1])) + 1j * rng.standard_normal((PAIRS, top.shape[1]))
    mix[0] = np.eye(top.shape[1])[0]
    inside = mix @ top
    b = np.einsum("fij,fsj->fsi", back, inside)
    w = np.einsum("fij,fsj->fsi", right, inside)
    anywhere = rng.standard_normal((2, nf, RANDOM, nw)) + 1j * rng.standard_normal((2, nf, RANDOM, nw))
    return np.concatenate([b, anywhere[0]], axis=1), np.concatenate([w, anywhere[1]], axis=1)


def _iterated(M: Array, blocks: BlockStructure, start: tuple[Array, Array]) -> tuple[Array, Array, Array]:
    """Return a (outputs of M), b (its inputs) and w (its inputs seen from behind) after the power iteration."""
    b, w = start
    forth, back = M.swapaxes(1, 2), M.conj()
    for _ in range(STEPS):
        a = _unit(_unit(b) @ forth)
        z = _outputs(a, b, w, blocks)
        w = _unit(_unit(z) @ back)
        b = _inputs(a, b, w, blocks)
    return _unit(_unit(b) @ forth), b, w


def _unit(x: Array) -> Array:
    return x / np.maximum(np.linalg.norm(x, axis=2, keepdims=True), TINY)


def _outputs(a: Array, b: Array, w: Array, blocks: BlockStructure) -> Array:
    """Return z = Q* w: of a full block along a, of a repeated one along w."""
    z = np.empty_like(a)
    for block, out, into in zip(blocks.blocks, blocks.outputs, blocks.inputs, strict=True):
        ai, bi, wi = a[:, :, out], b[:, :, into], w[:, :, into]
        if block.kind == "full":
            z[:, :, out] = _along(ai) * _length(wi)
        else:
            z[:, :, out] = np.conj(_scalar(block.kind, ai, bi, wi)) * wi
    return z


def _inputs(a: Array, b: Array, w: Array, blocks: BlockStructure) -> Array:
    """Return b = Q a: of a full block along w, of a repeated one along a."""
    out_b = np.empty_like(b)
    for block, out, into in zip(blocks.blocks, blocks.outputs, blocks.inputs, strict=True):
        ai, bi, wi = a[:, :, out], b[:, :, into], w[:, :, into]
        if block.kind == "full":
            out_b[:, :, into] = _along(wi) * _length(ai)
        else:
            out_b[:, :, into] = _scalar(block.kind, ai, bi, wi) * ai
    return out_b


def _scalar(kind: str, a: Array, b: Array, w: Array) -> Array:
    """Return the number q of a repeated block: the phase between w and a, or a real number between -1 and 1."""
    inner = np.sum(a.conj() * w, axis=2, keepdims=True)
    if kind == "repeated":
        size = np.abs(inner)
        return np.where(size > TINY, inner / np.maximum(size, TINY), 1.0)
    size = np.sign(np.sum(a.conj() * b, axis=2, keepdims=True).real) * _length(b) / np.maximum(_length(a), TINY)
    return np.clip(size + inner.real, -1.0, 1.0).astype(complex)


def _length(x: Array) -> Array:
    return np.linalg.norm(x, axis=2, keepdims=True)


def _perturbations(a: Array, b: Array, w: Array, blocks: BlockStructure) -> Array:
    """Return Q `(nf, starts, nw, nz)`: full blocks w a* of norm one, repeated ones q I."""
    nz, nw = blocks.shape
    Q = np.zeros((*a.shape[:2], nw, nz), dtype=np.complex128)
    for block, out, into in zip(blocks.blocks, blocks.outputs, blocks.inputs, strict=True):
        ai, bi, wi = a[:, :, out], b[:, :, into], w[:, :, into]
        if block.kind == "full":
            along = _along(wi)[:, :, :, None] * _along(ai).conj()[:, :, None, :]
            Q[:, :, into, out] = along
        else:
            Q[:, :, into, out] = _scalar(block.kind, ai, bi, wi)[:, :, :, None] * np.eye(block.outputs)
    return Q


def _along(x: Array) -> Array:
    """Return the direction of x, the first axis where x vanishes."""
    length = _length(x)
    first = np.zeros_like(x)
    first[:, :, 0] = 1.0
    return np.where(length > TINY, x / np.maximum(length, TINY), first)


def _spectral(QM: Array, blocks: BlockStructure) -> tuple[Array, Array]:
    """Return the size of the eigenvalue that counts, and what turns Q so that it becomes real and positive.

    Complex blocks may all be turned together; a real block only changes its sign.
    """
    values = np.linalg.eigvals(QM)
    if blocks.has_real:
        values = np.where(np.abs(values.imag) <= REAL * np.abs(values), values, 0.0)
    k = np.argmax(np.abs(values), axis=-1)[..., None]
    top = np.take_along_axis(values, k, axis=-1)[..., 0]
    size = np.abs(top)
    turn = np.where(size > TINY, np.conj(top) / np.maximum(size, TINY), 1.0)
    return size, np.sign(np.real(turn)) + 0j if blocks.has_real else turn


def _turned_real(M: Array, blocks: BlockStructure, Q: Array) -> Array:
    """Turn all complex blocks together until the largest eigenvalue of Q M is real: Newton's method on its angle."""
    nf, starts, nw, nz = Q.shape
    Q, behind = Q.reshape(nf * starts, nw, nz).copy(), np.repeat(M, starts, axis=0)
    free = np.ones((nw, nz))
    for block, out, into in zip(blocks.blocks, blocks.outputs, blocks.inputs, strict=True):
        if block.kind == "real":
            free[into, out] = 0.0
    if not free.any():
        return Q.reshape(nf, starts, nw, nz)
    for _ in range(TURNS):
        values, right = np.linalg.eig(Q @ behind)
        # a real eigenvalue of nearly the same size is worth more than a larger complex one
        k = np.argmax(np.abs(values) - np.abs(np.imag(values)), axis=1)
        top = np.take_along_axis(values, k[:, None], axis=1)[:, 0]
        b = np.take_along_axis(right, k[:, None, None], axis=2)[:, :, 0]
        w = _left_vector(right, k).conj()
        along = np.einsum("fi,fi->f", w, b)
        usable = np.abs(along) > TINY
        slope = np.einsum("fi,fij,fj->f", w, 1j * (free * Q) @ behind, b) / np.where(usable, along, 1.0)
        moving = usable & (np.abs(slope.imag) > REAL * np.abs(top))
        angle = np.where(moving, -np.imag(top) / np.where(moving, slope.imag, 1.0), 0.0)
        Q = np.where(free > 0, Q * np.exp(1j * np.clip(angle, -1.0, 1.0))[:, None, None], Q)
    return Q.reshape(nf, starts, nw, nz)


def _polished(M: Array, blocks: BlockStructure, size: Array, Q: Array) -> tuple[Array, Array]:
    """Turn each block to where the eigenvalue grows, by its right and left eigenvectors, as long as it does."""
    size, Q = size.copy(), Q.copy()
    left = np.flatnonzero(size > TINY)
    for _ in range(POLISH):
        if not left.size:
            break
        values, right = np.linalg.eig(Q[left] @ M[left])
        k = np.argmax(np.abs(values), axis=1)
        b = np.take_along_axis(right, k[:, None, None], axis=2)[:, :, 0]
        w = _left_vector(right, k)
        a = np.einsum("fij,fj->fi", M[left], b)
        trial = _perturbations(a[:, None], b[:, None], w[:, None], blocks)[:, 0]
        radius, turn = _spectral(trial @ M[left], blocks)
        better = radius > size[left]
        gain = radius - size[left]
        rows = left[better]
        Q[rows] = (trial * turn[:, None, None])[better]
        size[rows] = radius[better]
        left = left[better & (gain > SETTLED * size[left])]
    return size, Q


def _left_vector(right: Array, k: Array) -> Array:
    """Return the left eigenvector of column k: row k of the inverse, conjugated; the pseudo-inverse where defective."""
    inverse = np.linalg.pinv(right)
    return np.take_along_axis(inverse, k[:, None, None], axis=1)[:, 0].conj()
