"""What kernels do with small arrays, compiled in a tenth of a second each.

`out[:] = values` takes three seconds, for sentences on shapes that differ, and numpy's solver seven.
"""

from typing import Any

import numpy as np

from ultraquiet._base.compiled import compiled


@compiled
def copy_vector(values: Any, out: Any) -> None:
    """Write one vector over another of its size."""
    for i in range(out.size):
        out[i] = values[i]


@compiled
def copy_matrix(values: Any, out: Any) -> None:
    """Write one matrix over another of its shape."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = values[i, j]


@compiled
def solve_positive(S: Any, B: Any) -> None:
    """Fill B with the solution X of S X = B, S symmetric and positive definite; its factor takes its place (Cholesky).

    The same bits whatever library numpy was built with.
    """
    n, columns = B.shape
    for k in range(n):
        for i in range(k):
            S[k, k] -= S[k, i] * S[k, i]
        S[k, k] = np.sqrt(S[k, k])
        for j in range(k + 1, n):
            for i in range(k):
                S[j, k] -= S[j, i] * S[k, i]
            S[j, k] /= S[k, k]
    for c in range(columns):
        for k in range(n):
            for i in range(k):
                B[k, c] -= S[k, i] * B[i, c]
            B[k, c] /= S[k, k]
        for k in range(n - 1, -1, -1):
            for i in range(k + 1, n):
                B[k, c] -= S[i, k] * B[i, c]
            B[k, c] /= S[k, k]
