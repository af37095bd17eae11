"""Why an H-infinity problem has no solution: the assumptions of the theory, tested one by one before it is used."""

import numpy as np

from ultraquiet.design.hinf.riccati import NormalisedPlant, direct_terms
from ultraquiet.linalg.ordered import Array
from ultraquiet.values.state_space import StateSpace

RANK = 1e-9  # relative; a pencil with a singular value below it has lost rank, in even units of its columns too
CERTAIN = 1e-13  # below this, whatever the units: what even units would make of it is round-off
SWEEPS = 10  # rows and columns made alike in size
# Poles and zeros this near the stability boundary are on it: in 1 - |z|, or relative to the fastest pole. A pole at
# 1e-6 Hz sampled at 10 kHz is a hundred times farther away.
ON_CIRCLE = 1e-12
ON_AXIS = 1e-13
# A double zero on the axis is computed this far from it; the rank of the pencil on the axis then decides.
NEAR_AXIS = 1e-6
RANK_AT_ZERO = 1e-12
WHO = "H-infinity synthesis"


def out_of_reach(P: StateSpace, ny: int, nu: int) -> str:
    """Return a sentence on modes that are not stable and cannot be moved or seen, empty when there are none."""
    p, m = P.D.shape[0] - ny, P.D.shape[1] - nu
    poles = np.linalg.eigvals(P.A) if P.states else np.zeros(0)
    size = np.abs(poles)
    unstable = poles[poles.real >= -ON_AXIS * size.max(initial=0.0) if P.rate_hz is None else size >= 1 - ON_CIRCLE]
    for what, A, B, wires in (("stabilised", P.A, P.B[:, m:], "B2"), ("seen", P.A.T, P.C[p:].T, "C2")):
        lost = [z for z in unstable if _loses_rank(A, B, z)]
        if lost:
            return (
                f"{WHO}: {len(lost)} unstable mode{'s' * (len(lost) > 1)} of A, the first {_place(lost[0], P)}, cannot "
                f"be {what} through {wires}; move it out of the plant or into the stable region (a weight with an "
                "integrator or without damping is a common cause)."
            )
    return ""


def zeros_on_boundary(plant: NormalisedPlant, rate_hz: float | None) -> str:
    """Return a sentence on zeros of P12 or P21 on the stability boundary, empty when there are none.

    Zeros of P12 are the eigenvalues of A - B2 D12' C1 that the outputs out of the controls' reach do not show.
    """
    D12, D21 = direct_terms(plant)
    for name, A, B2, C1, D in (
        ("P12 (controls to performance outputs)", plant.A, plant.B2, plant.C1, D12),
        ("P21 (disturbances to measurements)", plant.A.T, plant.C2.T, plant.B1.T, D21.T),
    ):
        inverse_A = A - B2 @ D.T @ C1
        rest = C1 - D @ D.T @ C1
        zeros = np.linalg.eigvals(inverse_A) if inverse_A.size else np.zeros(0)
        for z in zeros[(np.abs(zeros.real) <= NEAR_AXIS * np.maximum(1.0, np.abs(zeros))) & (zeros.imag >= 0)]:
            w = float(z.imag) if z.imag > NEAR_AXIS else 0.0
            if _loses_rank(inverse_A.T, rest.T, 1j * w, RANK_AT_ZERO):
                f_hz = _hertz(w * plant.speed, rate_hz)
                return f"{WHO}: {name} has a zero on the stability boundary at {f_hz:.4g} Hz; weight that frequency."
    return ""


def _loses_rank(A: Array, B: Array, z: complex, rank: float = RANK) -> bool:
    """Return whether [A - z I, B] lacks row rank.

    Units of states and signals change no rank: a slow pole beside fast ones may look lost for its units alone.
    """
    pencil = np.hstack([A - z * np.eye(A.shape[0]), B])
    pencil = pencil / _sizes(pencil, 1)
    left = _least_share(pencil)
    if left > rank or left <= CERTAIN:
        return left <= rank
    for _ in range(SWEEPS):
        pencil = pencil / np.sqrt(_sizes(pencil, 0))
        pencil = pencil / np.sqrt(_sizes(pencil, 1))
    return _least_share(pencil) <= rank


def _sizes(M: Array, axis: int) -> Array:
    return np.maximum(np.linalg.norm(M, axis=axis, keepdims=True), 1e-300)


def _least_share(M: Array) -> float:
    """Return the smallest singular value over the largest."""
    s = np.linalg.svd(M, compute_uv=False)
    return float(s[-1] / s[0]) if s[0] else 0.0


def _hertz(w: float, rate_hz: float | None) -> float:
    """Return the frequency of a point on the (mapped) imaginary axis."""
    return w / (2 * np.pi) if rate_hz is None else float(np.arctan(w)) * rate_hz / np.pi


def _place(z: complex, P: StateSpace) -> str:
    if P.rate_hz is None:
        return f"at {z.real:.3g}{z.imag:+.3g}j rad/s"
    return f"at {abs(np.angle(z)) * P.rate_hz / (2 * np.pi):.4g} Hz with |z| = {abs(z):.6g}"
