"""Upper bound of the structured singular value: a generalised eigenvalue problem in the scalings, by centres.

The smallest t with t D - M* D M - j (G M - M* G*) >= 0 over scalings D > 0 that commute with the perturbation and
G that belong to its real blocks; mu <= sqrt(t) (Fan, Tits and Doyle 1991, doi:10.1109/9.62265). For a fixed t the
scalings form a convex set. Its analytic centre is found by Newton steps, t lowered towards the eigenvalue at the
centre, and so on (Boyd and El Ghaoui 1993, doi:10.1016/0024-3795(93)90465-Z). All frequencies are treated at once.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ultraquiet.analyse.scalings.levels import balanced_levels
from ultraquiet.analyse.structure import BlockStructure
from ultraquiet.linalg.norms import largest_gains
from ultraquiet.linalg.ordered import Array

LARGEST_STACK = 4e6  # complex numbers held at once for one set of directions: 64 MB
ROUNDS = 80  # of lowering t
NEWTON = 12  # steps a centre
CENTRED = 0.3  # Newton decrement at which a centre is near enough to lower t
LOWERED = 0.03  # share of the distance between t and the eigenvalue that is kept
TOLERANCE = 1e-8  # relative, of t: half of that in mu
STALLED = 4  # rounds without progress after which a frequency is done
LARGEST_G = 1e4  # in units of D times the norm of M: keeps the centre bounded where G has no effect
LEAST_D = 1e-10  # of the mean of D: scalings further apart than this are beyond double precision
RIDGE = 1e-13
LINE = 6  # Newton steps of a line search
LENGTH = 1e-3  # of a step, which it need not know more closely
TINY = np.finfo(float).tiny
START = 1.5  # t at the start, in units of the first eigenvalue


class Upper(NamedTuple):
    """mu <= value `(nf,)`, scalings of outputs and inputs `(nf, nz, nz)`, `(nf, nw, nw)`, G `(nf, nw, nz)`."""

    value: Array
    out: Array
    into: Array
    G: Array


class _Basis(NamedTuple):
    """Directions of D at the outputs, D and G at the inputs, `(p, ., .)`; D at the start `(p,)`.

    `join` `(nw, nz)` leads the outputs of each real block to its inputs. `cones` are directions of what must stay
    positive at every frequency, D and the bounds of G, `(p, nw, nw)`, or `(p, nw)` where all are diagonal; `pull` is
    the linear term of the barrier.
    """

    out: Array
    into: Array
    G: Array
    start: Array
    join: Array
    cones: tuple[Array, ...]
    pull: Array

    @property
    def scalar(self) -> bool:
        """Whether every block is one full channel, as in disk margins: D is then diagonal."""
        p, n = self.start.size, self.into.shape[-1]
        return p == n == self.out.shape[-1] and not np.any(self.G) and not np.any(self.out - self.into)


class _Rows(NamedTuple):
    """The directions of a problem of single channels, m* m for every row m of M `(nf, n, n)`."""

    M: Array


def upper_bound(M: Array, blocks: BlockStructure, enough: float = 0.0) -> Upper:
    """Return the bound for matrices `(nf, nz, nw)`; one that is no longer above `enough` is lowered no further."""
    basis = _basis(blocks)
    chunk = max(1, int(LARGEST_STACK / (basis.start.size * blocks.shape[1] ** 2)))
    parts = [_bounded(M[k : k + chunk], blocks, basis, enough) for k in range(0, max(1, M.shape[0]), chunk)]
    return Upper(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def balanced_norm(M: Array, blocks: BlockStructure) -> Array:
    """Return a quick bound `(nf,)` from above: the norm after balancing."""
    return _balance(M, blocks)[2]


def _bounded(M: Array, blocks: BlockStructure, basis: _Basis, enough: float) -> Upper:
    nf, nz, nw = M.shape
    N, levels, size = _balance(M, blocks)
    moving = np.asarray(size > 0)
    Dz = np.broadcast_to(np.eye(nz, dtype=complex), (nf, nz, nz)).copy()
    Dw = np.broadcast_to(np.eye(nw, dtype=complex), (nf, nw, nw)).copy()
    G = np.zeros((nf, nw, nz), dtype=complex)
    value = size.copy()
    one_full = [b.kind for b in blocks.blocks] == ["full"]
    if np.any(moving) and not one_full:
        goal = (enough / size[moving]) ** 2 if enough > 0 else np.full(np.count_nonzero(moving), -np.inf)
        t, *scalings = _centres(N[moving], basis, goal)
        Dz[moving], Dw[moving], G[moving] = scalings
        value[moving] *= np.sqrt(np.maximum(t, 0.0))
    out, into = (np.exp(levels @ m.T) for m in blocks.members())
    return Upper(
        value,
        out[:, :, None] * Dz * out[:, None, :],
        into[:, :, None] * Dw * into[:, None, :],
        into[:, :, None] * G * out[:, None, :] * size[:, None, None],
    )


def _balance(M: Array, blocks: BlockStructure) -> tuple[Array, Array, Array]:
    """Return M scaled to norm one, the levels log d `(nf, blocks)` that scaled it, and its norm `(nf,)` before."""
    sizes = np.abs(M)
    largest = sizes.max(axis=(1, 2), initial=0.0)
    scale = np.where(largest > 0, largest, 1.0)[:, None, None]
    out, into = blocks.members()
    power = (sizes / scale) ** 2
    if blocks.shape != (len(blocks.blocks), len(blocks.blocks)):
        power = np.einsum("zb,fzw,wc->fbc", out, power, into, optimize=True)
    levels = balanced_levels(power)
    N = M / scale * np.exp(levels @ out.T)[:, :, None] * np.exp(-levels @ into.T)[:, None, :]
    size = largest_gains(N)
    return N / np.where(size > 0, size, 1.0)[:, None, None], levels, size * largest


@lru_cache(maxsize=64)
def _basis(blocks: BlockStructure) -> _Basis:
    """Return the directions in which scalings may move."""
    nz, nw = blocks.shape
    rows: list[tuple[Array, Array, Array, float]] = []
    join = np.zeros((nw, nz))
    for block, z, w in zip(blocks.blocks, blocks.outputs, blocks.inputs, strict=True):
        parts = [np.eye(block.outputs, dtype=complex)] if block.kind == "full" else _hermitian(block.outputs)
        for H in parts:
            Dz, Dw = np.zeros((nz, nz), complex), np.zeros((nw, nw), complex)
            Dz[z, z], Dw[w, w] = H, np.eye(block.inputs) if block.kind == "full" else H
            rows.append((Dz, Dw, np.zeros((nw, nw), complex), float(np.any(np.diag(H)))))
        for H in parts if block.kind == "real" else []:
            G = np.zeros((nw, nw), complex)
            G[w, w] = H
            join[w, z] = np.eye(block.outputs)
            rows.append((np.zeros((nz, nz), complex), np.zeros((nw, nw), complex), G, 0.0))
    out, into, G, start = zip(*rows, strict=True)
    cones, pull = _cones(np.array(into), np.array(G))
    return _Basis(np.array(out), np.array(into), np.array(G), np.array(start), join, cones, pull)


def _hermitian(k: int) -> list[Array]:
    """Return a basis of the Hermitian k x k matrices."""
    basis = []
    for i in range(k):
        for j in range(i, k):
            for unit in (1.0, 1j) if j > i else (1.0,):
                H = np.zeros((k, k), complex)
                H[i, j] = unit
                H[j, i] = np.conj(unit)
                basis.append(H)
    return basis


def _centres(M: Array, basis: _Basis, enough: Array) -> tuple[Array, Array, Array, Array]:
    """Return t, D at outputs and inputs, and G, for matrices of norm one; t need not come below `enough` `(nf,)`."""
    nf, p = M.shape[0], basis.start.size
    if basis.scalar:
        F: Array | _Rows = _Rows(M)
    else:
        moved = np.einsum("fzv,pzy,fyw->fpvw", M.conj(), basis.out, M, optimize=True)
        GM = np.einsum("pvz,fzw->fpvw", basis.G @ basis.join, M, optimize=True)
        F = moved + 1j * (GM - GM.conj().swapaxes(2, 3))
    y = np.broadcast_to(basis.start, (nf, p)).copy()
    value = _eigenvalue(F, basis, y)
    t, best, kept = START * np.abs(value) + TOLERANCE, value.copy(), y.copy()
    left, stalled = np.flatnonzero(best > enough), np.zeros(nf, dtype=int)
    for _ in range(ROUNDS):
        if not left.size:
            break
        y[left], eigenvalue = _next(_chosen(F, left), basis, t[left], y[left])
        finite, better = np.isfinite(eigenvalue), eigenvalue < best[left]
        gained = best[left] - eigenvalue
        stalled[left] = np.where(gained > TOLERANCE * np.abs(best[left]), 0, stalled[left] + 1)
        best[left] = np.where(better, eigenvalue, best[left])
        kept[left] = np.where(better[:, None], y[left], kept[left])
        t[left] = np.where(finite, eigenvalue + LOWERED * np.maximum(t[left] - eigenvalue, 0.0), t[left])
        near = finite & (t[left] - eigenvalue < TOLERANCE * 1e-2 * np.abs(best[left]))
        left = left[(stalled[left] < STALLED) & ~near & finite & (best[left] > enough[left])]
    return best, *(
        np.einsum("fp,pab->fab", kept, D, optimize=True) for D in (basis.out, basis.into, basis.G @ basis.join)
    )


def _next(F: Array | _Rows, basis: _Basis, t: Array, y: Array) -> tuple[Array, Array]:
    """Return the centres and the largest eigenvalues there; infinity where rounding ends the search.

    LAPACK refuses a whole stack for one matrix on the edge of its cone: the stack is halved until that one is alone.
    What it had reached before stands.
    """
    try:
        centre = _centred(F, basis, t, y)
        return centre, _eigenvalue(F, basis, centre)
    except np.linalg.LinAlgError:
        if len(y) == 1:
            return y, np.array([np.inf])
    half = len(y) // 2
    parts = [_next(_chosen(F, k), basis, t[k], y[k]) for k in (slice(None, half), slice(half, None))]
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


def _eigenvalue(F: Array | _Rows, basis: _Basis, y: Array) -> Array:
    """Return the largest eigenvalue of F(y) - t D(y)."""
    D = np.einsum("fp,pab->fab", y, basis.into, optimize=True)
    root = np.linalg.inv(np.linalg.cholesky(D))
    A = root @ _summed(F, y) @ root.conj().swapaxes(1, 2)
    return np.linalg.eigvalsh(A)[:, -1]


def _centred(F: Array | _Rows, basis: _Basis, t: Array, y: Array) -> Array:
    """Return the analytic centre of t D(y) - F(y) > 0, D(y) > 0 by Newton's method with exact line search."""
    y = y.copy()
    left = np.arange(y.shape[0])
    for _ in range(NEWTON):
        step, decrement = _newton(_chosen(F, left), basis, t[left], y[left])
        y[left] += step
        left = left[decrement > CENTRED]
        if not left.size:
            break
    return y


def _newton(F: Array | _Rows, basis: _Basis, t: Array, y: Array) -> tuple[Array, Array]:
    """Return a step and the Newton decrement of the barrier -log det X - log det D at each frequency.

    Every term is homogeneous, so that a linear term in the trace of D holds the scale without a constraint.
    """
    fixed, pull = basis.cones, basis.pull
    gradient, hessian, root = _of_rows(F, t, y) if isinstance(F, _Rows) else _terms(_pencil(F, basis, t), y)
    gradient += pull
    parts = [_terms(cone, y) if cone.ndim == 3 else _diagonal_terms(cone, y) for cone in fixed]
    for more, bent, _ in parts:
        gradient += more
        hessian += bent
    step = -_solved(hessian, gradient)
    decrement = np.sqrt(np.maximum(-np.einsum("fp,fp->f", step, gradient), 0.0))
    if isinstance(F, _Rows):
        moves = [np.linalg.eigvalsh(root @ (_diagonal(t, step) - _summed(F, step)) @ root.conj().swapaxes(1, 2))]
    else:
        moves = [_moves(_pencil(F, basis, t), root, step)]
    moves += [_moves(cone, part[2], step) for cone, part in zip(fixed, parts, strict=True)]
    length = _line(np.concatenate(moves, axis=1), step @ pull)
    return length[:, None] * step, decrement


def _cones(into: Array, G: Array) -> tuple[tuple[Array, ...], Array]:
    n = into.shape[-1]
    mean = np.einsum("paa->p", into).real / n
    cones = [into - LEAST_D * mean[:, None, None] * np.eye(n)]
    if np.any(G):
        cones += [LARGEST_G * into + sign * G for sign in (1.0, -1.0)]
    if not np.any(into * (1 - np.eye(n))):
        cones = [np.einsum("paa->pa", cone).real for cone in cones]
    return tuple(cones), (1 + len(cones)) * n * mean


def _terms(cone: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return gradient and Hessian of -log det X, X = sum of y times directions, and L with L X L* = I."""
    X = np.einsum("fp,fpab->fab", y, np.broadcast_to(cone, (*y.shape, *cone.shape[-2:])), optimize=True)
    L = np.linalg.inv(np.linalg.cholesky(X))
    Z = (L.conj().swapaxes(1, 2) @ L)[:, None] @ cone
    flat, turned = (z.reshape(*y.shape, -1) for z in (Z, Z.swapaxes(2, 3)))
    return -np.einsum("fpaa->fp", Z).real, (flat @ turned.swapaxes(1, 2)).real, L


def _pencil(F: Array, basis: _Basis, t: Array) -> Array:
    return t[:, None, None, None] * basis.into - F


def _diagonal(t: Array, y: Array) -> Array:
    """Return t diag(y) at each frequency."""
    return (t[:, None] * y)[:, :, None] * np.eye(y.shape[1])


def _chosen(F: "Array | _Rows", k: Array | slice) -> "Array | _Rows":
    return _Rows(F.M[k]) if isinstance(F, _Rows) else F[k]


def _summed(F: "Array | _Rows", y: Array) -> Array:
    """Return the sum of y times the directions of F."""
    if isinstance(F, _Rows):
        return F.M.conj().swapaxes(1, 2) @ (y[:, :, None] * F.M)
    return np.einsum("fp,fpab->fab", y, F, optimize=True)


def _of_rows(F: "_Rows", t: Array, y: Array) -> tuple[Array, Array, Array]:
    """Do what `_terms` does where direction i is t e e' - m* m, e a unit vector and m a row of M: n^3 work, not n^5."""
    X = _diagonal(t, y) - _summed(F, y)
    L = np.linalg.inv(np.linalg.cholesky(X))
    W = L.conj().swapaxes(1, 2) @ L
    b = W @ F.M.conj().swapaxes(1, 2)
    c = F.M @ b
    s = t[:, None, None]
    across = np.abs(b) ** 2
    gradient = np.einsum("fii->fi", c).real - t[:, None] * np.einsum("fii->fi", W).real
    return gradient, s**2 * np.abs(W) ** 2 - s * (across + across.swapaxes(1, 2)) + np.abs(c) ** 2, L


def _diagonal_terms(cone: Array, y: Array) -> tuple[Array, Array, Array]:
    """Do the same where X is diagonal; L is the vector 1 / X."""
    inverse = 1.0 / (y @ cone)
    share = cone * inverse[:, None, :]
    return -share.sum(axis=2), share @ share.swapaxes(1, 2), inverse


def _moves(cone: Array, root: Array, step: Array) -> Array:
    """Return the eigenvalues `(nf, nw)` of L dX L*: how far a step of one goes in each direction of the cone."""
    if root.ndim == 2:
        return (step @ cone) * root
    moved = np.einsum("fp,fpab->fab", step, np.broadcast_to(cone, (*step.shape, *cone.shape[-2:])), optimize=True)
    return np.linalg.eigvalsh(root @ moved @ root.conj().swapaxes(1, 2))


def _solved(hessian: Array, gradient: Array) -> Array:
    """Solve with unit diagonal and a ridge at rounding level: near the optimum the barrier is nearly singular."""
    curve = np.einsum("fpp->fp", hessian)
    # a direction without effect has a curvature of differences of large numbers, which rounding can turn negative
    floor = np.finfo(float).eps * curve.max(axis=1, keepdims=True, initial=np.finfo(float).tiny)
    size = np.sqrt(np.maximum(curve, floor))
    one = np.eye(size.shape[1])
    scaled = np.where(one > 0, 1.0 + RIDGE, hessian / (size[:, :, None] * size[:, None, :]))
    return np.linalg.solve(scaled, (gradient / size)[:, :, None])[:, :, 0] / size


def _line(moves: Array, pull: Array) -> Array:
    """Return the length that minimises `pull` a - sum log(1 + a moves), `(nf,)`, inside the cone."""
    longest = 1.0 / np.maximum(-moves.min(axis=1), TINY)
    a = np.minimum(1.0, 0.5 * longest)
    for _ in range(LINE):
        share = moves / (1 + a[:, None] * moves)
        curve = np.maximum(np.einsum("fm,fm->f", share, share), TINY)
        before, a = a, a + (share.sum(axis=1) - pull) / curve
        a = np.minimum(np.maximum(a, 0.1 * before), 0.5 * (before + longest))
        if np.all(np.abs(a - before) <= LENGTH * before):
            break
    return a
