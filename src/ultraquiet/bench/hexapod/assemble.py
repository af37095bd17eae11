"""Bodies, struts and mounts put together: M q'' + C q' + E_v' F_v + E_p' K_p (E_p q - d V) + K_g q = 0."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.bench.hexapod.geometry import jacobian, joints
from ultraquiet.bench.hexapod.maxwell import Stage, stage
from ultraquiet.bench.hexapod.parameters import PAYLOAD, STRUTS, Base, Body, Geometry, Strut

# Modes below this are the free motions of a floating hexapod: nothing inside it can excite them, nor read them.
RIGID_BODY_HZ = 0.1


@dataclass(frozen=True, eq=False)
class Mechanics:
    """The structure in coordinates q = (base 6 unless immovable, payload 6, geophone positions 6), SI units.

    `E_p` and `E_v` map q to the elongations of stacks, with their feet, and stages; `K_p`, `C_p` `(6, 6)` are stiffness
    and damping of the former, `K_g`, `C_g` those of the base's mounts.
    """

    M: FloatArray
    E_p: FloatArray
    E_v: FloatArray
    K_g: FloatArray
    C_g: FloatArray
    K_p: FloatArray
    C_p: FloatArray
    stroke_m_per_v: float
    stage: Stage

    @property
    def geophones(self) -> FloatArray:
        """Rows that pick the positions of the geophones out of q, `(6, nq)`."""
        return np.eye(len(self.M))[-STRUTS:]

    @property
    def glass(self) -> float:
        """Stiffness of one stage with all dashpots locked, in N/m."""
        return self.stage.spring_n_per_m + float(self.stage.branch_n_per_m.sum())

    def stiffness(self, stage_n_per_m: float) -> FloatArray:
        """Return the stiffness matrix for a given stiffness of the stages, short-circuited stacks."""
        return self.E_p.T @ self.K_p @ self.E_p + stage_n_per_m * self.E_v.T @ self.E_v + self.K_g

    def modes(self) -> tuple[FloatArray, FloatArray]:
        """Return natural frequencies in Hz and mass-normalised shapes at static stiffness, free motions left out."""
        squares, shapes = eigh(self.stiffness(self.stage.spring_n_per_m), self.M)
        keep = squares > (2.0 * np.pi * RIGID_BODY_HZ) ** 2
        return np.sqrt(squares[keep]) / (2.0 * np.pi), shapes[:, keep]

    def displacement(self, f_hz: FloatArray) -> ComplexArray:
        """Return geophone positions per stack voltage in m/V, `(6, 6, nf)`, frequency by frequency."""
        w = 2.0 * np.pi * f_hz[:, np.newaxis, np.newaxis]
        k_v = self.stage.stiffness(f_hz)[:, np.newaxis, np.newaxis]
        Z = self.E_p.T @ (self.K_p + 1j * w * self.C_p) @ self.E_p + k_v * (self.E_v.T @ self.E_v)
        Z = Z + self.K_g + 1j * w * self.C_g - w**2 * self.M
        push = self.stroke_m_per_v * self.E_p.T @ self.K_p
        q = np.linalg.solve(Z, np.broadcast_to(push, (f_hz.size, *push.shape)))
        return np.moveaxis(q[:, -STRUTS:], 0, -1).astype(np.complex128)


def assemble(base: Base, geometry: Geometry, strut: Strut) -> Mechanics:
    """Return the structure on a given base."""
    at = joints(geometry)
    s = at.directions
    top = np.array([0.0, 0.0, geometry.height_m + PAYLOAD.centre_m])
    J_p = jacobian(at.platform, s, top)
    body = base.body
    J_b = np.zeros((STRUTS, 0)) if body is None else jacobian(at.base, s, np.array([0.0, 0.0, body.centre_m]))
    M_b = np.zeros(0) if body is None else _masses(body)
    nb = len(M_b)
    M = np.concatenate([M_b, _masses(PAYLOAD), np.full(STRUTS, strut.moving_mass_kg)])
    K_g = np.zeros((len(M), len(M)))
    w = 2.0 * np.pi * base.mount_hz
    K_g[:nb, :nb] = np.diag(M_b) * w**2
    C_g = np.zeros_like(K_g)
    C_g[:nb, :nb] = np.diag(M_b) * 2.0 * base.mount_damping * w
    K_p, C_p = _stacks(strut)
    return Mechanics(
        M=np.diag(M),
        E_p=np.hstack([-J_b, np.zeros((STRUTS, 6)), np.eye(STRUTS)]),
        E_v=np.hstack([np.zeros((STRUTS, nb)), J_p, -np.eye(STRUTS)]),
        K_g=K_g,
        C_g=C_g,
        K_p=K_p,
        C_p=C_p,
        stroke_m_per_v=strut.free_stroke_m_per_v,
        stage=stage(strut.stage_stiffness_n_per_m, strut.stage_loss),
    )


def _stacks(strut: Strut) -> tuple[FloatArray, FloatArray]:
    """Return stiffness and damping of the stacks on their feet, `(6, 6)`.

    K_p^-1 = diag(1 / k_p + f) - f u u', u = (-1, 1, -1, 1, -1, 1) / sqrt(6): every foot yields by f along its strut,
    but where neighbours push against each other all around, the plate would turn about z, and that is braced. Even
    yielding for the rest keeps G = G' on a rigid floor: K_p then commutes with what the struts carry.
    """
    k, foot = np.full(STRUTS, strut.stack_stiffness_n_per_m), np.full(STRUTS, strut.foot_m_per_n)
    twist = np.sqrt(foot) * np.tile([-1.0, 1.0], STRUTS // 2) / np.sqrt(STRUTS)
    K_p = np.linalg.inv(np.diag(1.0 / k + foot) - np.outer(twist, twist))
    resonance = float(np.sqrt(1.0 / ((1.0 / k[0] + foot[0]) * strut.moving_mass_kg)))
    return K_p, 2.0 * strut.stack_damping / resonance * K_p


def _masses(body: Body) -> FloatArray:
    return np.array([body.mass_kg] * 3 + list(body.inertia_kg_m2))
