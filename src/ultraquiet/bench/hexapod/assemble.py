"""Bodies, struts and mounts put together: M q'' + C q' + E_v' F_v + E_p' k_p (E_p q - d V) + K_g q = 0."""

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

    `E_p` and `E_v` map q to the elongations of stacks and stages; `K_g`, `C_g` are the mounts of the base.
    """

    M: FloatArray
    E_p: FloatArray
    E_v: FloatArray
    K_g: FloatArray
    C_g: FloatArray
    k_p: float
    c_p: float
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
        return self.k_p * self.E_p.T @ self.E_p + stage_n_per_m * self.E_v.T @ self.E_v + self.K_g

    def modes(self) -> tuple[FloatArray, FloatArray]:
        """Return natural frequencies in Hz and mass-normalised shapes at static stiffness, free motions left out."""
        squares, shapes = eigh(self.stiffness(self.stage.spring_n_per_m), self.M)
        keep = squares > (2.0 * np.pi * RIGID_BODY_HZ) ** 2
        return np.sqrt(squares[keep]) / (2.0 * np.pi), shapes[:, keep]

    def displacement(self, f_hz: FloatArray) -> ComplexArray:
        """Return geophone positions per stack voltage in m/V, `(6, 6, nf)`, frequency by frequency."""
        w = 2.0 * np.pi * f_hz[:, np.newaxis, np.newaxis]
        k_v = self.stage.stiffness(f_hz)[:, np.newaxis, np.newaxis]
        Z = (self.k_p + 1j * w * self.c_p) * (self.E_p.T @ self.E_p) + k_v * (self.E_v.T @ self.E_v)
        Z = Z + self.K_g + 1j * w * self.C_g - w**2 * self.M
        push = self.k_p * self.stroke_m_per_v * self.E_p.T
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
    k_p = strut.stack_stiffness_n_per_m
    return Mechanics(
        M=np.diag(M),
        E_p=np.hstack([-J_b, np.zeros((STRUTS, 6)), np.eye(STRUTS)]),
        E_v=np.hstack([np.zeros((STRUTS, nb)), J_p, -np.eye(STRUTS)]),
        K_g=K_g,
        C_g=C_g,
        k_p=k_p,
        c_p=2.0 * strut.stack_damping * float(np.sqrt(k_p * strut.moving_mass_kg)),
        stroke_m_per_v=strut.free_stroke_m_per_v,
        stage=stage(strut.stage_stiffness_n_per_m, strut.stage_loss),
    )


def _masses(body: Body) -> FloatArray:
    return np.array([body.mass_kg] * 3 + list(body.inertia_kg_m2))
