"""Descriptor systems made explicit: E is inverted where it can be, algebraic equations are solved where it cannot."""

import numpy as np

from ultraquiet._base.errors import NumericalError
from ultraquiet.linalg.ordered import Array, Matrices

RANK = 1e-13  # of E at unit rows and columns: a singular value below it stands for an algebraic equation
SOLVABLE = 1e-12  # of the algebraic equations' own matrix, likewise


def explicit(E: Array, A: Array, B: Array, C: Array, D: Array) -> Matrices:
    """Return A, B, C, D of E x' = A x + B u, y = C x + D u.

    Raises:
        NumericalError: the algebraic equations do not fix their variables (index above one).
    """
    if not E.size:
        return A, B, C, D
    rows = _inverse(np.linalg.norm(np.hstack([E, A]), axis=1))
    columns = _inverse(np.linalg.norm(E * rows[:, None], axis=0))
    U, s, Vt = np.linalg.svd(E * rows[:, None] * columns)
    rank = int(np.sum(s > RANK * max(float(s[0]), np.finfo(float).tiny)))
    a = U.T @ (A * rows[:, None] * columns) @ Vt.T
    b, c = U.T @ (B * rows[:, None]), (C * columns) @ Vt.T
    a, b = np.vstack([a[:rank] / s[:rank, None], a[rank:]]), np.vstack([b[:rank] / s[:rank, None], b[rank:]])
    if rank == len(s):
        # back in the states as they were given
        return (Vt.T @ a @ Vt) * columns[:, None] / columns, (Vt.T @ b) * columns[:, None], C, D
    inner = a[rank:, rank:]
    size = np.linalg.svd(inner, compute_uv=False)
    if not size[-1] > SOLVABLE * max(float(np.linalg.norm(a[rank:])), np.finfo(float).tiny):
        raise NumericalError(
            f"{len(s) - rank} equations without derivative do not fix the variables without one; the system has an "
            "index above one, differentiate these equations or leave states out."
        )
    solved = np.linalg.solve(inner, np.hstack([a[rank:, :rank], b[rank:]]))
    xa, xb = solved[:, :rank], solved[:, rank:]
    return (
        a[:rank, :rank] - a[:rank, rank:] @ xa,
        b[:rank] - a[:rank, rank:] @ xb,
        c[:, :rank] - c[:, rank:] @ xa,
        D - c[:, rank:] @ xb,
    )


def _inverse(size: Array) -> Array:
    return np.exp2(-np.round(np.log2(np.where(size > 0, size, 1.0))))
