"""Why an H-infinity problem has no solution: the assumptions of the theory, tested one by one."""

import numpy as np

from ultraquiet.linalg.ordered import Array
from ultraquiet.linalg.response import points
from ultraquiet.values.state_space import StateSpace

RANK = 1e-9  # relative; a pencil with a singular value below it has lost rank
WHO = "H-infinity synthesis"


def diagnose(P: StateSpace, ny: int, nu: int) -> str:
    """Return one sentence naming the block at fault, empty when every assumption holds."""
    p, m = P.D.shape[0] - ny, P.D.shape[1] - nu
    B2, C2 = P.B[:, m:], P.C[p:]
    poles = np.linalg.eigvals(P.A)
    unstable = poles[poles.real >= 0 if P.rate_hz is None else np.abs(poles) >= 1]
    for what, matrix, wires in (("stabilised", np.hstack([P.A, B2]), "B2"), ("seen", np.hstack([P.A.T, C2.T]), "C2")):
        lost = [z for z in unstable if _loses_rank(matrix, z)]
        if lost:
            return (
                f"{WHO}: {len(lost)} unstable mode{'s' * (len(lost) > 1)} of A, the first {_place(lost[0], P)}, cannot "
                f"be {what} through {wires}; move it out of the plant (a weight with an integrator is a common cause)."
            )
    return _axis_zeros(P, p, m)


def _loses_rank(matrix: Array, z: complex) -> bool:
    n = matrix.shape[0]
    shifted = matrix.astype(np.complex128)
    shifted[:, :n] -= z * np.eye(n)
    s = np.linalg.svd(shifted / np.maximum(np.linalg.norm(shifted, axis=1, keepdims=True), 1e-300), compute_uv=False)
    return bool(s[-1] < RANK * s[0])


def _axis_zeros(P: StateSpace, p: int, m: int) -> str:
    """Test P12 and P21 for zeros on the stability boundary, near the poles' frequencies and at the ends of the axis."""
    f = np.unique(np.concatenate([[0.0], _frequencies(P)]))
    for z, f_hz in zip(points(f, P.rate_hz), f, strict=True):
        for name, B, C, D in (
            ("P12 (controls to performance outputs)", P.B[:, m:], P.C[:p], P.D[:p, m:]),
            ("P21 (disturbances to measurements)", P.C[p:].T, P.B[:, :m].T, P.D[p:, :m].T),
        ):
            A = P.A if name.startswith("P12") else P.A.T
            pencil = np.block([[A - z * np.eye(P.states), B], [C, D]])
            s = np.linalg.svd(pencil / np.maximum(np.linalg.norm(pencil, axis=0), 1e-300), compute_uv=False)
            if s[-1] < RANK * s[0]:
                return f"{WHO}: {name} has a zero on the stability boundary at {f_hz:.4g} Hz; weight that frequency."
    return ""


def _frequencies(P: StateSpace) -> Array:
    poles: Array = np.linalg.eigvals(P.A)
    if P.rate_hz is None:
        return np.abs(poles.imag) / (2 * np.pi)
    return np.concatenate([np.abs(np.angle(poles)) * P.rate_hz / (2 * np.pi), [P.rate_hz / 2]])


def _place(z: complex, P: StateSpace) -> str:
    if P.rate_hz is None:
        return f"at {z.real:.3g}{z.imag:+.3g}j rad/s"
    return f"at {abs(np.angle(z)) * P.rate_hz / (2 * np.pi):.4g} Hz with |z| = {abs(z):.6g}"
