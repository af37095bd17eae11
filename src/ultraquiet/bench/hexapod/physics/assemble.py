"""Bodies, struts and mounts put together: M q'' + C q' + E_v' F_v + E_p' K_p (E_p q - d V) + K_g q = F."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.bench.hexapod.physics.geometry import jacobian
from ultraquiet.bench.hexapod.physics.maxwell import Stage, stage
from ultraquiet.bench.hexapod.physics.monitors import AXES, ProofMass, triaxial_axes
from ultraquiet.bench.hexapod.physics.parameters import STRUTS, Body
from ultraquiet.bench.hexapod.physics.parts import HexapodParts

# Modes below this are the free motions of a floating hexapod: nothing inside it can excite them, nor read them.
RIGID_BODY_HZ = 0.1
FREEDOMS = 6  # of a rigid body
UP = np.array([[0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Mechanics:
    """The structure in coordinates q = (base 6 unless immovable, payload 6, geophone positions 6, proof masses), SI.

    `E_p` and `E_v` map q to the elongations of stacks and stages; `K_p`, `C_p` `(6, 6)` are stiffness and damping of
    the stacks, `K_g`, `C_g` those of mounts and of the springs of proof masses. `push` `(nq, nu)` are the forces on q
    per volt, `read` `(ny, nq)` the positions that the geophones feel.
    """

    M: FloatArray
    E_p: FloatArray
    E_v: FloatArray
    K_p: FloatArray
    C_p: FloatArray
    K_g: FloatArray
    C_g: FloatArray
    stages: Stage
    push: FloatArray
    read: FloatArray

    def stiffness(self, stages_n_per_m: FloatArray) -> FloatArray:
        """Return the stiffness matrix for given stiffnesses of the stages, `(6,)`, short-circuited stacks."""
        return self.E_p.T @ self.K_p @ self.E_p + (self.E_v.T * stages_n_per_m) @ self.E_v + self.K_g

    def damping(self) -> FloatArray:
        """Return the damping matrix, without that of the stages."""
        return self.E_p.T @ self.C_p @ self.E_p + self.C_g

    def modes(self) -> tuple[FloatArray, FloatArray]:
        """Return natural frequencies in Hz and mass-normalised shapes at static stiffness, free motions left out."""
        squares, shapes = eigh(self.stiffness(self.stages.spring_n_per_m), self.M)
        keep = squares > (2.0 * np.pi * RIGID_BODY_HZ) ** 2
        return np.sqrt(squares[keep]) / (2.0 * np.pi), shapes[:, keep]

    def displacement(self, f_hz: FloatArray) -> ComplexArray:
        """Return what the geophones feel per volt in m/V, `(ny, nu, nf)`, frequency by frequency."""
        w = 2.0 * np.pi * f_hz[:, np.newaxis, np.newaxis]
        k_v = self.stages.stiffness(f_hz).T[:, np.newaxis, :]
        Z = self.stiffness(np.zeros(STRUTS)) + (self.E_v.T * k_v) @ self.E_v + 1j * w * self.damping() - w**2 * self.M
        q = np.linalg.solve(Z, np.broadcast_to(self.push, (f_hz.size, *self.push.shape)))
        return np.moveaxis(self.read @ q, 0, -1).astype(np.complex128)


def assemble(parts: HexapodParts) -> Mechanics:
    """Return the structure that the parts make."""
    bodies = _bodies(parts)
    n = FREEDOMS * len(bodies) + STRUTS
    masses = _proof_masses(parts)
    total = n + len(masses)
    s, x = parts.at.directions, slice(n - STRUTS, n)
    E_p, E_v = np.zeros((STRUTS, total)), np.zeros((STRUTS, total))
    E_p[:, x], E_v[:, x] = np.eye(STRUTS), -np.eye(STRUTS)
    top = np.array([0.0, 0.0, parts.height_m]) + _centre(parts.payload)
    E_v[:, n - STRUTS - FREEDOMS : n - STRUTS] = jacobian(parts.at.platform, s, top)
    if parts.base.body is not None:
        E_p[:, :FREEDOMS] = -jacobian(parts.at.base, s, _centre(parts.base.body))
    M = np.zeros((total, total))
    M[:n, :n] = np.diag(np.concatenate([*map(_masses, bodies), parts.per_strut("moving_mass_kg")]))
    K_g, C_g = _mounts(parts, total)
    K_p, C_p = _stacks(parts)
    push = np.zeros((total, STRUTS + len(parts.proof_masses)))
    push[:, :STRUTS] = (E_p.T @ K_p) * parts.per_strut("free_stroke_m_per_v")
    for z, (j, p, body, at) in enumerate(masses, start=n):
        where = np.array([p.at_m]) - _centre(body)
        w = 2.0 * np.pi * p.suspension_hz
        M[z, z] = p.moving_mass_kg
        M[z, at] = M[at, z] = p.moving_mass_kg * jacobian(where, UP, np.zeros(3))[0]
        K_g[z, z], C_g[z, z] = p.moving_mass_kg * w**2, 2.0 * p.suspension_damping * w * p.moving_mass_kg
        push[z, STRUTS + j] = -p.newton_per_v
    stages = stage(parts.per_strut("stage_stiffness_n_per_m"), parts.per_strut("stage_loss"))
    return Mechanics(M, E_p, E_v, K_p, C_p, K_g, C_g, stages, push, _read(parts, total, n))


def _proof_masses(parts: HexapodParts) -> list[tuple[int, ProofMass, Body, slice]]:
    """Return the proof masses that stand on something that moves: number, body and the body's place in q."""
    payload = FREEDOMS * (len(_bodies(parts)) - 1)
    places = ((parts.base.body, slice(0, FREEDOMS)), (parts.payload, slice(payload, payload + FREEDOMS)))
    pairs = zip(parts.proof_masses, places, strict=False)
    return [(j, p, body, at) for j, (p, (body, at)) in enumerate(pairs) if body is not None]


def _bodies(parts: HexapodParts) -> list[Body]:
    return [parts.payload] if parts.base.body is None else [parts.base.body, parts.payload]


def _stacks(parts: HexapodParts) -> tuple[FloatArray, FloatArray]:
    """Return stiffness and damping of the stacks on their feet, `(6, 6)`.

    K_p^-1 = diag(1 / k_p + f) - f u u', u = (-1, 1, -1, 1, -1, 1) / sqrt(6): every foot yields by f along its strut,
    but where neighbours push against each other all around, the plate would turn about z, and that is braced. Even
    yielding for the rest keeps G = G' on a rigid floor: K_p then commutes with what the struts carry.
    The damping is a fraction of critical of each strut's own resonance, shared in proportion to the stiffness.
    """
    k, foot = parts.per_strut("stack_stiffness_n_per_m"), parts.per_strut("foot_m_per_n")
    twist = np.sqrt(foot) * np.tile([-1.0, 1.0], STRUTS // 2) / np.sqrt(STRUTS)
    K_p = np.linalg.inv(np.diag(1.0 / k + foot) - np.outer(twist, twist))
    resonance = 1.0 / np.sqrt((1.0 / k + foot) * parts.per_strut("moving_mass_kg"))
    share = np.sqrt(2.0 * parts.per_strut("stack_damping") / resonance)
    return np.asarray(K_p, np.float64), np.asarray(share[:, np.newaxis] * K_p * share, np.float64)


def _mounts(parts: HexapodParts, total: int) -> tuple[FloatArray, FloatArray]:
    """Return stiffness and damping of the base's mounts."""
    K_g, C_g = np.zeros((total, total)), np.zeros((total, total))
    if parts.base.body is not None:
        masses, w = _masses(parts.base.body), 2.0 * np.pi * parts.base.mount_hz
        K_g[:FREEDOMS, :FREEDOMS] = np.diag(masses) * w**2
        C_g[:FREEDOMS, :FREEDOMS] = np.diag(masses) * 2.0 * parts.base.mount_damping * w
    return K_g, C_g


def _read(parts: HexapodParts, total: int, struts_end: int) -> FloatArray:
    """Return what geophones feel of q: their struts' masses, or along their axes the bodies, amid the joints."""
    rows = np.zeros((len(parts.lines), total))
    rows[:STRUTS, struts_end - STRUTS : struts_end] = np.eye(STRUTS)
    if parts.triaxial:
        payload = struts_end - STRUTS - FREEDOMS
        for row, body, at in ((STRUTS, parts.base.body, 0), (STRUTS + len(AXES), parts.payload, payload)):
            if body is not None:
                middle = np.tile(-_centre(body), (len(AXES), 1))
                rows[row : row + len(AXES), at : at + FREEDOMS] = jacobian(middle, triaxial_axes(), np.zeros(3))
    return rows


def _centre(body: Body) -> FloatArray:
    """Return the centre of mass from the middle of the body's joints."""
    return np.array([*body.aside_m, body.centre_m])


def _masses(body: Body) -> FloatArray:
    return np.array([body.mass_kg] * 3 + list(body.inertia_kg_m2))
