"""Orthonormal axes in which several matrices fall into the smallest common blocks, the same on every machine."""

import numpy as np

from ultraquiet.linalg.ordered import Array

ALIKE = 1e-6  # share of the matrices' size below which eigenvalues count as equal and couplings as none


def common_axes(mean: Array, family: Array) -> Array:
    """Return orthonormal columns: eigenvectors of a symmetric `(n, n)` that split a family `(k, n, n)` too.

    Eigenvectors of a multiple eigenvalue are known up to a rotation, which rounding would choose. Here the family
    chooses: it splits such a space where one of its members can; where none can, the copies of a block are told apart
    by the channels, and the axes of every copy are those which the family couples to the first one's. Columns come by
    falling eigenvalue.

    Murota, Kanno, Kojima and Kojima 2010, doi:10.1007/s13160-010-0006-9, where a random sum of the members tells all
    spaces apart; here the members are tried in turn, so that nothing is drawn.
    """
    family = np.concatenate([family, np.swapaxes(family, 1, 2)])
    size = max(float(np.max(np.linalg.norm(family, axis=(1, 2)), initial=0.0)), 1e-300)
    members = family / size
    spaces = _refined(_eigenspaces(mean / max(float(np.linalg.norm(mean)), 1e-300)), members)
    axes: list[list[Array]] = [[] for _ in spaces]
    for k, space in enumerate(spaces):
        while len(axes[k]) < space.shape[1]:
            _follow(spaces, members, axes, k)
    return np.column_stack([v for own in axes for v in own])


def _eigenspaces(S: Array) -> list[Array]:
    """Return orthonormal bases of the eigenspaces of a symmetric matrix, eigenvalues that are alike together."""
    values, vectors = np.linalg.eigh((S + S.T) / 2)
    values, vectors = values[::-1], vectors[:, ::-1]
    return np.split(vectors, np.flatnonzero(-np.diff(values) > ALIKE) + 1, axis=1)


def _refined(spaces: list[Array], members: Array) -> list[Array]:
    """Split spaces until every symmetric matrix that the members give inside one is a multiple of the identity."""
    for k, V in enumerate(spaces):
        if V.shape[1] == 1:
            continue
        inside = V.T @ members @ V
        couplings = [_left_size(V.T @ members @ W) for W in (*spaces[:k], *spaces[k + 1 :])]
        seen = np.concatenate([inside + np.swapaxes(inside, 1, 2), *couplings])
        apart = seen - np.trace(seen, axis1=1, axis2=2)[:, None, None] * np.eye(V.shape[1]) / V.shape[1]
        parts = _eigenspaces(seen[_first_largest(np.linalg.norm(apart, axis=(1, 2)))])
        if len(parts) > 1:
            # smaller spaces see more, so all are looked at again
            return _refined([*spaces[:k], *(V @ part for part in parts), *spaces[k + 1 :]], members)
    return spaces


def _left_size(X: Array) -> Array:
    """Return (X X')^(1/2) of every matrix, which tells sizes apart to all digits where X X' keeps half of them."""
    U, s, _ = np.linalg.svd(X, full_matrices=False)
    return (U * s[:, None, :]) @ np.swapaxes(U, 1, 2)


def _follow(spaces: list[Array], members: Array, axes: list[list[Array]], start: int) -> None:
    """Take a new axis in a space, and in every other space the one to which the members couple it."""
    reached = {start: _by_channels(_left(spaces[start], axes[start]))}
    axes[start].append(reached[start])
    waiting = [start]
    while waiting:
        k = waiting.pop(0)
        for other in range(len(spaces)):
            left = _left(spaces[other], axes[other])
            if other in reached or not left.shape[1]:
                continue
            couplings = spaces[other].T @ members @ spaces[k]
            # the member is chosen for the whole spaces, so that every copy of a block has the same signs
            strongest = _first_largest(np.linalg.norm(couplings, axis=(1, 2)))
            axis = left @ (left.T @ (members[strongest] @ reached[k]))
            norm = float(np.linalg.norm(axis))
            if norm > ALIKE:
                reached[other] = axis / norm
                axes[other].append(reached[other])
                waiting.append(other)


def _left(space: Array, taken: list[Array]) -> Array:
    """Return an orthonormal basis of what the axes taken leave of a space."""
    if not taken:
        return space
    Q = np.linalg.qr(space.T @ np.column_stack(taken), mode="complete")[0]
    return space @ Q[:, len(taken) :]


def _by_channels(space: Array) -> Array:
    """Return the unit vector of a space that comes nearest to a channel's own axis, to the first of those as near."""
    near = np.linalg.norm(space, axis=1)
    first = _first_largest(near)
    return space @ space[first] / near[first]


def _first_largest(sizes: Array) -> int:
    """Return where the largest stands, the first of those as large: which of them is by rounding tells nothing."""
    return int(np.argmax(sizes >= (1 - ALIKE) * np.max(sizes)))
