"""The quadratic programme of a step, in whichever of its two forms is the smaller."""

from importlib import import_module
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray


def shortest(A: FloatArray, b: FloatArray, price: FloatArray) -> FloatArray:
    """Return x = (d, s) of least |d|^2 / 2 + price' s with A x <= b; not finite where no digits are left.

    With many unknowns and few bounds it is the dual that is solved: lambda >= 0 of least |G' lambda|^2 / 2 + b' lambda
    with E' lambda = -price, A = [G E]; then d = -G' lambda, and s are the multipliers of the equations, less a sign
    (Boyd and Vandenberghe 2004, "Convex Optimization", section 5.5.3).

    Args:
        A: `(m, n + p)`.
        b: `(m,)`.
        price: `(p,)` of the last unknowns.

    >>> A, b = np.array([[1.0, -1.0], [0.0, -1.0]]), np.array([-2.0, 0.0])
    >>> np.round(shortest(A, b, np.array([0.5])), 6).tolist()
    [-0.5, 1.5]
    """
    return by_bounds(A, b, price) if len(A) < A.shape[1] - price.size else by_unknowns(A, b, price)


def by_unknowns(A: FloatArray, b: FloatArray, price: FloatArray) -> FloatArray:
    """Solve the programme as it stands."""
    clarabel, sparse = _libraries()
    n = A.shape[1] - price.size
    P = sparse.diags(np.append(np.ones(n), np.zeros(price.size)), format="csc")
    found = _solve(P, np.append(np.zeros(n), price), A, b, [clarabel.NonnegativeConeT(len(A))])
    return np.array(found.x)


def by_bounds(A: FloatArray, b: FloatArray, price: FloatArray) -> FloatArray:
    """Solve its dual."""
    clarabel, sparse = _libraries()
    m, p = len(A), price.size
    G, E = A[:, :-p], A[:, -p:]
    rows, ends = np.vstack([E.T, -np.eye(m)]), np.concatenate([-price, np.zeros(m)])
    cones = [clarabel.ZeroConeT(p), clarabel.NonnegativeConeT(m)]
    found = _solve(sparse.csc_matrix(np.triu(G @ G.T)), b, rows, ends, cones)
    return np.concatenate([-G.T @ np.array(found.x), -np.array(found.z)[:p]])


def _solve(P: Any, q: FloatArray, A: FloatArray, b: FloatArray, cones: list[Any]) -> Any:
    clarabel, sparse = _libraries()
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    return clarabel.DefaultSolver(P, q, sparse.csc_matrix(A), b, cones, settings).solve()


def _libraries() -> tuple[Any, Any]:
    from scipy import sparse

    # it ships no types; as a plain module it is what it says
    return import_module("clarabel"), sparse
