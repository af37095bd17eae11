"""Channels hidden by mixed coordinates: found by the law's response, made visible again."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.balance import without_faint
from ultraquiet.values.interconnect import append
from ultraquiet.values.state_space import StateSpace

# What may pass between channels, over the largest response: fifty times below what the choice of a form accepts at
# 60 dB under the peak. It is left out, and counted in the error that is stated.
LEAK = 1e-7
# Hankel values below such a share of a channel's largest belong to the states of other channels, or to rounding, which
# may leave them unstable: the smallest share is taken that leaves no more states than the law has, all stable.
FAINT = (1e-11, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6)
POINTS, DECADES = 48, 4.0
# Transforms worse conditioned than this would amplify rounding more than they save.
CONDITION = 100.0


def separated(law: StateSpace) -> StateSpace | None:
    """Return the same law with the states of its channels kept apart, or None when channels are coupled.

    K(z) = S diag(k_c(z)) T is sought with the identity first, then with S the eigenvectors of M N^-1, where M and N are
    two real combinations of K over frequency: both are S times a diagonal times T. Each k_c is then K seen between its
    directions, without the states it does not reach.

    Args:
        law: discrete and stable, as many commands as measurements.
    """
    if law.D.shape[0] != law.D.shape[1] or not law.states or not law.is_stable():
        return None
    top = (law.rate_hz or 2.0) / 2
    H = np.moveaxis(law.frequency_response(np.geomspace(top / 10**DECADES, top, POINTS)), 2, 0)
    m = len(law.D)
    for S, T in ((np.eye(m), np.eye(m)), _transforms(H)):
        if max(np.linalg.cond(S), np.linalg.cond(T)) > CONDITION:
            continue
        K = np.linalg.solve(S, H) @ np.linalg.inv(T)
        direct = np.linalg.solve(S, law.D) @ np.linalg.inv(T)
        between = max(np.abs(_off(K)).max(), np.abs(_off(direct)).max())
        if between <= LEAK * np.abs(K).max():
            return _apart(law, S, T)
    return None


def _off(K: ComplexArray | FloatArray) -> ComplexArray | FloatArray:
    return K * (1.0 - np.eye(K.shape[-1]))


def _transforms(H: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return S and T of unit columns and rows; of condition infinity where there are none."""
    none = np.zeros((H.shape[1], H.shape[1]))
    even = H / np.maximum(np.abs(H).max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)
    real = np.concatenate([even.real, even.imag])
    # Fixed incommensurable weights: the same law gives the same code each time.
    weights = np.cos(np.outer((1.0, np.sqrt(2.0)), 1.0 + np.arange(len(real))))
    M, N = np.einsum("wf,fij->wij", weights, real)
    if np.linalg.cond(N) > 1 / np.finfo(float).eps ** 0.5:
        return none, none
    vectors = np.linalg.eig(M @ np.linalg.inv(N))[1]
    if np.iscomplexobj(vectors) or np.linalg.cond(vectors) > CONDITION:
        return none, none
    S = np.asarray(vectors, dtype=np.float64)
    T = np.linalg.solve(S, N)
    return S, T / np.linalg.norm(T, axis=1, keepdims=True)


def _apart(law: StateSpace, S: FloatArray, T: FloatArray) -> StateSpace | None:
    B, C = law.B @ np.linalg.inv(T), np.linalg.solve(S, law.C)
    D = np.linalg.solve(S, law.D) @ np.linalg.inv(T)
    for share in FAINT:
        each = []
        for c in range(len(D)):
            own = (law.A, B[:, c : c + 1], C[c : c + 1], D[c : c + 1, c : c + 1])
            each.append(StateSpace(*without_faint(own, share, discrete=True), rate_hz=law.rate_hz))
        if sum(k.states for k in each) <= law.states and all(k.is_stable() for k in each):
            whole = append(*each)
            return StateSpace(whole.A, whole.B @ T, S @ whole.C, S @ whole.D @ T, rate_hz=law.rate_hz)
    return None
