"""Coordinates in which equations are easily solved: real modal blocks, even scaling, Gramians, balancing."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, block_diag, solve_sylvester
from scipy.linalg.lapack import dgesdd, dpstrf  # pyright: ignore[reportAttributeAccessIssue]
from scipy.sparse.csgraph import connected_components

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.discretize import bilinear_to_discrete
from ultraquiet.linalg.equations import lyapunov_both, stein, stein_factor
from ultraquiet.linalg.even import even_scale, even_states
from ultraquiet.linalg.ordered import Array, Matrices, leading_subspace, ordered_schur, real_schur, real_schur_values

# Above this condition of the eigenvectors, a group of modes stays in real Schur form: half of the digits would go.
MODAL_CONDITION = 1e7
BOUNDARY = 1e-12  # of the size of A: as far as rounding may put an integrator off the boundary of stability
# As large a coupling belongs to two halves of a repeated pole, as of a double integrator, which rounding sends apart.
TOGETHER = 1e5
NEAREST = 1e-6  # conjugates are no nearer to the boundary than each other
HIDDEN = 1e-12  # of the largest Hankel value: below it a state is moved or seen by round-off alone
SLOWED = 1.1  # the shortest memory in which states that grow or stay are told apart
PARALLEL = 1e-6  # eigenvectors of unit size whose product is this near one count as parallel
# The same where T is ill-conditioned, and whether poles that are repeated are together even where their eigenvectors
# are not parallel: those of a solver may be anywhere in their space.
COARSER = ((PARALLEL, True), (1e-3, True), (0.1, True))
ALIKE = 1e-7  # of a repeated pole, whatever is as near to it is told from it by rounding alone
PAIR = 2  # states of a block of one mode
ROOT_TWO = np.sqrt(2.0)


class Coordinates(NamedTuple):
    """A system in new coordinates x_old = T x: its A, B, C, T, the inverse of T, and the sizes of A's blocks."""

    A: Array
    B: Array
    C: Array
    T: Array
    inverse: Array
    blocks: tuple[int, ...]


def modal(A: Array, B: Array, C: Array, in_parts: bool = False) -> Coordinates:
    """Return real modal coordinates, |b| = |c| block by block.

    A complex pair becomes [[re, im], [-im, re]], a real eigenvalue a single entry. Modes too close to be told apart
    (delays, repeated poles) are kept together in one real Schur block, so that T stays well conditioned. Where it does
    not, all is one block; with `in_parts` ever more is put together before.
    """
    T, inverse, sizes = _separated(A, COARSER if in_parts else ())
    return _even(inverse @ A @ T, inverse @ B, C @ T, T, inverse, sizes)


def even_blocks(form: Coordinates) -> Coordinates:
    """Return modal coordinates with the states of large blocks scaled by powers of two, as `even_states` does.

    A real Schur block of states that differ by decades is as large as their ratio, and so is what it costs to round it.
    """
    large = np.repeat(np.array(form.blocks, dtype=int), form.blocks) > PAIR
    if not large.any():
        return form
    d = np.where(large, even_scale(form.A, form.B, form.C), 1.0)
    return Coordinates(
        form.A * d / d[:, None], form.B / d[:, None], form.C * d, form.T * d, form.inverse / d[:, None], form.blocks
    )


def gramians(A: Array, B: Array, C: Array, discrete: bool) -> tuple[Array, Array]:
    """Return the controllability and observability Gramians of a stable system."""
    if not discrete:
        return lyapunov_both(A, B @ B.T, C.T @ C)
    return stein(A, B @ B.T), stein(A.T, C.T @ C)


def gramian_factors(A: Array, B: Array, C: Array, discrete: bool) -> tuple[Array, Array]:
    """Return R and L with R R' and L L' the controllability and observability Gramians of a stable system.

    The Gramians are never formed, so that small Hankel values keep the digits that their roots would lose.
    """
    if not discrete and A.shape[0]:
        speed = np.abs(np.linalg.eigvals(A))
        # the map keeps Gramians at any scale of time; in the middle of the poles none comes needlessly near z = 1 or -1
        middle = np.sqrt(speed.min()) * np.sqrt(speed.max())
        A, B, C, _ = bilinear_to_discrete(
            A / middle, B / np.sqrt(middle), C / np.sqrt(middle), np.zeros((len(C), B.shape[1]))
        )
    return stein_factor(A, B), stein_factor(A.T, C.T)


def square_root(P: Array) -> Array:
    """Return L `(n, n)` with L L' = P for symmetric P >= 0 to round-off; small states keep their digits.

    Cholesky's factor with pivots, of the matrix scaled to a unit diagonal; what is left below n eps is round-off, and
    so is what a P of lower rank has below zero.

    Reference: Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., section 10.3.
    """
    n = len(P)
    if n == 0:
        return np.zeros((0, 0))
    d = np.sqrt(np.maximum(np.diag(P), 0.0))
    d[d == 0] = 1.0
    factor, pivots, rank, _ = dpstrf(((P + P.T) / (2 * d[:, None] * d)).T, lower=1, overwrite_a=1)
    root = np.zeros((n, n))
    root[pivots - 1, :rank] = np.tril(factor)[:, :rank]
    return d[:, None] * root


def balancing(P: Array, Q: Array, order: int) -> tuple[Array, Array, Array]:
    """Return left `(order, n)` and right `(n, order)` projections of balanced truncation and all Hankel values.

    Square-root method (Tombs and Postlethwaite 1987): left @ right = I, `left @ A @ right` is the reduced A.
    """
    return balancing_by(square_root(P), square_root(Q), order)


def balancing_by(R: Array, L: Array, order: int) -> tuple[Array, Array, Array]:
    """Return what `balancing` does, from factors of the Gramians R R' and L L'."""
    product = L.T @ R
    if not product.size:
        return L.T, R, np.zeros(0)
    U, s, Vt, info = dgesdd(np.asfortranarray(product), overwrite_a=1)
    if info:
        raise LinAlgError("the singular values of the Gramians' factors were not found")
    order = min(order, int(np.sum(s > 1e-15 * max(float(s[0]), 1e-300))))
    root = np.sqrt(s[:order])
    return (L @ U[:, :order] / root).T, R @ Vt[:order].T / root, s


def truncate(M: Matrices, left: Array, right: Array) -> Matrices:
    """Return the projected system."""
    A, B, C, D = M
    return left @ A @ right, left @ B, C @ right, D.copy()


def without_faint(M: Matrices, share: float, discrete: bool, least: float = 0.0) -> Matrices:
    """Return a stable system without the states whose Hankel values are below a share of the largest, or the least."""
    P, Q = gramians(*M[:3], discrete=discrete)
    values = balancing(P, Q, 0)[2]
    left, right, _ = balancing(P, Q, int(np.sum(values > max(share * values.max(initial=0.0), least))))
    return truncate(M, left, right)


def without_hidden(M: Matrices, share: float, discrete: bool) -> Matrices:
    """Return a system without stable states at faint Hankel values, and without others that are not moved or not seen.

    States that are unstable, or at the boundary, have no Gramians of their own. Slowed down by a common factor they
    have, and what moves and sees them is the same; below `HIDDEN` of the largest value nothing does.
    """
    A, B, C, D = M
    A, B, C, _ = even_states(A, B, C)
    T, inverse, count = stable_first(A, discrete, BOUNDARY)
    A, B, C = inverse @ A @ T, inverse @ B, C @ T
    slowed = _slowed(A, discrete)
    least = HIDDEN * balancing_by(*gramian_factors(slowed, B, C, discrete), 0)[2].max(initial=0.0)
    stable = without_faint((A[:count, :count], B[:count], C[:, :count], D), share, discrete, least)
    rest = (A[count:, count:], B[count:], C[:, count:], np.zeros(D.shape))
    R, L = gramian_factors(slowed[count:, count:], *rest[1:3], discrete=discrete)
    left, right, _ = balancing_by(R, L, int(np.sum(balancing_by(R, L, 0)[2] > least)))
    a, b, c, _ = truncate(rest, left, right)
    return np.asarray(block_diag(stable[0], a)), np.vstack([stable[1], b]), np.hstack([stable[2], c]), D.copy()


def _slowed(A: Array, discrete: bool) -> Array:
    """Return A / r or A - r I with r a little beyond its spectral radius or abscissa."""
    if not A.size:
        return A
    values = np.linalg.eigvals(A)
    if discrete:
        return A / (SLOWED * (np.abs(values).max() or 1.0))
    size = np.abs(values).max() or np.linalg.norm(A) or 1.0
    return A - (max(values.real.max(), 0.0) + (SLOWED - 1) * size) * np.eye(len(A))


def residualize(M: Matrices, keep: int, discrete: bool) -> Matrices:
    """Keep the first states and replace the others by their steady state (singular perturbation)."""
    A, B, C, D = M
    one = np.eye(A.shape[0] - keep) if discrete else 0.0
    inner = A[keep:, keep:] - one
    X = np.linalg.solve(inner, np.hstack([A[keep:, :keep], B[keep:]]))
    xa, xb = X[:, :keep], X[:, keep:]
    return (
        A[:keep, :keep] - A[:keep, keep:] @ xa,
        B[:keep] - A[:keep, keep:] @ xb,
        C[:, :keep] - C[:, keep:] @ xa,
        D - C[:, keep:] @ xb,
    )


def stable_first(A: Array, discrete: bool, border: float = 0.0) -> tuple[Array, Array, int]:
    """Return T, its inverse and the number of stable states, such that A becomes diag(stable, unstable).

    Args:
        A: `(n, n)`, its states of even size.
        discrete: whether the unit circle or the imaginary axis is the boundary of stability.
        border: what is nearer to the boundary than this share of the size of A counts as unstable (see `BOUNDARY`), and
            so do poles, nearest to the boundary first, that cannot be told from an unstable one without loss of digits.

    Raises:
        NumericalError: eigenvalues too near to the boundary to be told apart.
    """
    if A.shape[0] == 0:
        return np.eye(0), np.eye(0), 0
    try:
        return _stable_first(A, discrete, border)
    except LinAlgError as error:
        raise NumericalError(f"stable part of a system ({A.shape[0]} states): {error}.") from None


def inside(A: Array, discrete: bool, border: float = 0.0) -> Callable[[float, float], bool]:
    """Return what tells of an eigenvalue of A whether it is stable, and no nearer to the boundary than a border."""
    width = border * float(np.linalg.norm(A))
    if discrete:
        return lambda real, imaginary: bool(np.hypot(real, imaginary) < 1 - width)
    return lambda real, imaginary: real < -width


def _stable_first(A: Array, discrete: bool, border: float) -> tuple[Array, Array, int]:
    try:
        S, U, count = ordered_schur(A, inside(A, discrete, border))
    except LinAlgError:
        if not border:
            raise
        return _stable_first(A, discrete, _wider(A, discrete, border))
    T = U.copy()
    if count in (0, len(A)):
        return T, T.T.copy(), int(count)
    X = solve_sylvester(S[:count, :count], -S[count:, count:], -S[:count, count:])
    if border and np.linalg.norm(X) > TOGETHER:
        return _stable_first(A, discrete, _wider(A, discrete, border))
    T[:, count:] += U[:, :count] @ X
    return T, np.linalg.inv(T), int(count)


def _wider(A: Array, discrete: bool, border: float) -> float:
    """Return a border that takes in the nearest of the eigenvalues that are stable by another one."""
    stable = inside(A, discrete, border)
    values = [z for z in np.linalg.eigvals(A) if stable(z.real, z.imag)]
    if not values:
        raise LinAlgError("an eigenvalue crossed the border while they were put in order")
    return float(min(1 - abs(z) if discrete else -z.real for z in values)) * (1 + NEAREST) / float(np.linalg.norm(A))


def well_conditioned(T: Array, inverse: Array, limit: float) -> bool:
    """Return whether the condition of T is below a limit, which mostly shows without its singular values."""
    if np.linalg.norm(T) * np.linalg.norm(inverse) < limit:
        return True
    return bool(np.linalg.cond(T) < limit)


def _separated(A: Array, coarser: tuple[tuple[float, bool], ...]) -> tuple[Array, Array, tuple[int, ...]]:
    """Return a well-conditioned T that block-diagonalises A, its inverse, and the block sizes."""
    n = A.shape[0]
    if n == 0:
        return np.eye(0), np.eye(0), ()
    values, vectors = np.linalg.eig(A)
    tried: list[list[list[int]]] = []
    for parallel, repeated in ((PARALLEL, False), *coarser):
        groups = _clusters(values, vectors, parallel, repeated)
        if groups not in tried:
            found = _by_groups(A, values, vectors, groups)
            if found is not None:
                return found
            tried.append(groups)
    return _whole(A)


def _by_groups(
    A: Array, values: Array, vectors: Array, groups: list[list[int]]
) -> tuple[Array, Array, tuple[int, ...]] | None:
    """Return what `_separated` does with these groups of modes; None where T is ill-conditioned or not found."""
    try:
        form, along = (A, A), values
        if any(_tangled(values, g) for g in groups):
            T, Q, along = real_schur_values(A)
            form = T, Q
        bases = [
            _invariant(form, along, values, g) if _tangled(values, g) else _real_basis(values[g], vectors[:, g])
            for g in groups
        ]
        T = np.hstack(bases)
        if T.shape != A.shape:
            return None
        inverse = np.linalg.inv(T)
    except np.linalg.LinAlgError:
        # The reordering moved eigenvalues of a tight cluster across the border between it and its neighbours.
        return None
    return (T, inverse, tuple(len(g) for g in groups)) if well_conditioned(T, inverse, MODAL_CONDITION) else None


def _whole(A: Array) -> tuple[Array, Array, tuple[int, ...]]:
    """Return what `_separated` does where A cannot be separated: its Schur form is one block."""
    T = real_schur(A)[1]
    return T, T.T.copy(), (len(A),)


def _clusters(values: Array, vectors: Array, parallel: float, repeated: bool) -> list[list[int]]:
    """Group eigenvalues whose eigenvectors are nearly parallel, or all that are repeated; conjugates stay together.

    So does all that shares the value of such a group, as other chains of a repeated pole do: its invariant subspace is
    told by values alone.
    """
    n = values.size
    near = np.abs(vectors.conj().T @ vectors) > 1 - parallel
    own = np.arange(n)
    mirror = np.argmin(np.abs(values[:, None] - values.conj()[None, :]), axis=1)
    near[own, own] = near[own, mirror] = True
    if repeated:
        near |= np.abs(values[:, None] - values[None, :]) <= ALIKE * np.abs(values)
    if np.array_equal(mirror[mirror], own) and near.sum() == n + np.sum(mirror != own):
        label = np.minimum(own, mirror)  # as almost always: nothing is tied but conjugates
    else:
        label = _with_their_like(values, near)
    order = np.lexsort((values.imag < 0, np.abs(values.imag), values.real))
    groups: dict[int, list[int]] = {}
    for i in order:
        groups.setdefault(int(label[i]), []).append(int(i))
    return list(groups.values())


def _with_their_like(values: Array, near: Array) -> Array:
    """Return the group of each eigenvalue: those that are tied, and with several whatever lies among them."""
    count, label = connected_components(near, directed=False)
    while True:
        for k in range(count):
            group = np.flatnonzero(label == k)
            if _tangled(values, [int(i) for i in group]):
                apart = np.abs(values[:, None] - values[None, group])
                radius = _spread(values[group]) + ALIKE * np.abs(values[group]).max()
                near[np.any(apart <= radius, axis=1), group[0]] = True
        before, (count, label) = count, connected_components(near, directed=False)
        if count == before:
            return label


def _spread(values: Array) -> float:
    """Return how far the eigenvalues of a group lie from the middle of those on their side of the real axis."""
    upper = values.real + 1j * np.abs(values.imag)
    return float(np.abs(upper - upper.mean()).max())


def _tangled(values: Array, group: list[int]) -> bool:
    return not (len(group) == 1 or (len(group) == 2 and values[group[0]].imag != 0))


def _real_basis(values: Array, vectors: Array) -> Array:
    """Return one real column (real eigenvalue) or two (complex pair), of unit size and evenly conditioned."""
    if values.size == 1:
        return vectors.real / np.linalg.norm(vectors.real)
    v = vectors[:, 0] if values[0].imag > 0 else vectors[:, 1]
    # rotating v by the phase of v'v makes its real and imaginary parts orthogonal
    v = v * np.exp(-0.5j * np.angle(v @ v))
    return np.column_stack([v.real, v.imag]) * ROOT_TWO


def _invariant(form: tuple[Array, Array], along: Array, values: Array, group: list[int]) -> Array:
    """Return an orthonormal basis of the invariant subspace of a group of eigenvalues; `along` are the form's."""
    T, Q = form
    wanted, others = values[group], np.delete(values, group)
    if not others.size:
        return Q
    near, far = (np.min(np.abs(z[:, None] - along[None, :]), axis=0) for z in (wanted, others))
    return leading_subspace(T, Q, near < far)[:, : len(group)]


def _even(A: Array, B: Array, C: Array, T: Array, inverse: Array, sizes: tuple[int, ...]) -> Coordinates:
    edges = np.concatenate([[0], np.cumsum(sizes, dtype=int)]) if sizes else np.zeros(1, dtype=int)
    A = A.copy()
    d = np.ones(A.shape[0])
    for low, high in pairwise(edges):
        A[low:high, :low] = 0.0
        A[low:high, high:] = 0.0
        d[low:high] = _ratio(np.linalg.norm(C[:, low:high]), np.linalg.norm(B[low:high]))
    # one factor a block: a similarity that leaves every block of A as it is
    return Coordinates(A, B * d[:, None], C / d, T / d, inverse * d[:, None], sizes)


def _ratio(c: Any, b: Any) -> Array:
    """Return sqrt(c / b) rounded to a power of two, one where either vanishes."""
    c, b = np.atleast_1d(c).astype(float), np.atleast_1d(b).astype(float)
    safe = (c > 0) & (b > 0)
    power = np.zeros(c.shape)
    power[safe] = np.round(np.log2(c[safe] / b[safe]) / 2)
    return np.exp2(np.clip(power, -500, 500))
