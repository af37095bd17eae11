"""The whole linear chain: hold -> amplifier RC -> stack -> structure -> geophone -> gain -> anti-alias -> sample."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, expm

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.bench.hexapod.physics.assemble import Mechanics
from ultraquiet.bench.hexapod.physics.parameters import RATE_HZ, STRUTS
from ultraquiet.bench.hexapod.physics.parts import HexapodParts
from ultraquiet.bench.hexapod.physics.sensors import Geophone

# The sampled response sums this many images of the spectrum to either side. The chain falls off as f^-4 and the hold as
# 1/f, so the images left out together hold less than 1e-5 of the response at any frequency up to 1500 Hz.
IMAGES = 40


@dataclass(frozen=True, eq=False)
class Chain:
    """x' = A x + B v, y = C x: commands in volts to sensor volts, without noise, limits or computing delay."""

    A: FloatArray
    B: FloatArray
    C: FloatArray

    def sampled(self, rate_hz: float = RATE_HZ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return A, B, C of the exact zero-order-hold equivalent."""
        n, nu = self.B.shape
        augmented = np.zeros((n + nu, n + nu))
        augmented[:n, :n], augmented[:n, n:] = self.A / rate_hz, self.B / rate_hz
        exponential = np.asarray(expm(augmented), dtype=np.float64)
        return exponential[:n, :n], exponential[:n, n:], self.C


@dataclass(frozen=True, eq=False)
class ModalBasis:
    """The structure's modes at rest, `(nq, n)`, and their frequencies `(n,)`: the coordinates of its motion.

    Any hexapod near the one they were taken from may be expressed in them, exactly: only the free motions are left out.
    """

    rad_s: FloatArray
    shapes: FloatArray
    volts_per_speed: float

    @classmethod
    def of(cls, mechanics: Mechanics, parts: HexapodParts) -> "ModalBasis":
        """Return the basis of a structure's own modes."""
        f_hz, shapes = mechanics.modes()
        line = parts.lines[0]
        return cls(2.0 * np.pi * f_hz, shapes, line.geophone_v_per_m_s * line.gain)


def chain(mechanics: Mechanics, parts: HexapodParts, basis: ModalBasis) -> Chain:
    """Connect structure and electronics; every state is in volts, so that none dwarfs another."""
    amplifier = np.diag(2.0 * np.pi * parts.amplifiers_hz)
    S = _structure(mechanics, basis)
    # Lengths are measured in a unit that turns a geophone's speed into its volts; for other sensors, here is the rest.
    volts = parts.per_line("geophone_v_per_m_s") * parts.per_line("gain") / basis.volts_per_speed
    speed = volts[:, np.newaxis] * S[2]
    G = _geophones(parts)
    F = _filters(parts)
    n = [len(amplifier), len(S[0]), len(G[0]), len(F[0])]
    A = np.asarray(block_diag(-amplifier, S[0], G[0], F[0]), dtype=np.float64)
    a, s, g, f = (slice(sum(n[:i]), sum(n[: i + 1])) for i in range(4))
    A[s, a] = S[1]
    A[g, s] = G[1] @ speed
    A[f, s] = F[1] @ speed
    A[f, g] = F[1] @ G[2]
    B, C = np.zeros((sum(n), len(amplifier))), np.zeros((len(parts.lines), sum(n)))
    B[a] = amplifier
    C[:, f] = F[2]
    return Chain(A, B, C)


def _structure(m: Mechanics, basis: ModalBasis) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return volts behind the amplifiers to speeds at the geophones in modal coordinates, with the stages' dashpots.

    States: modal deflections times their frequency, modal speeds, then for each branch the six dashpots r_j,
    r_j' = w_j (v - r_j), where v is a stage's elongation.
    """
    w, shapes, n = basis.rad_s, basis.shapes, basis.rad_s.size
    E_v = m.E_v @ shapes
    k, w_j = m.stages.branch_n_per_m, m.stages.branch_rad_s
    branches = len(k)
    A = np.zeros((2 * n + STRUTS * branches,) * 2)
    A[:n, n : 2 * n] = np.diag(w)
    A[n : 2 * n, :n] = -(shapes.T @ m.stiffness(m.stages.glass_n_per_m) @ shapes) / w
    A[n : 2 * n, n : 2 * n] = -(shapes.T @ m.damping() @ shapes)
    for j in range(branches):
        r = slice(2 * n + STRUTS * j, 2 * n + STRUTS * (j + 1))
        A[r, :n] = w_j[j] * w_j[j] * E_v / w
        A[r, r] = -w_j[j] * np.eye(STRUTS)
        A[n : 2 * n, r] = E_v.T * (k[j] / w_j[j])
    B = np.zeros((len(A), m.push.shape[1]))
    B[n : 2 * n] = basis.volts_per_speed * (shapes.T @ m.push)
    C = np.zeros((len(m.read), len(A)))
    C[:, n : 2 * n] = m.read @ shapes
    return A, B, C


def _geophones(parts: HexapodParts) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what geophones take away from the speeds u: y = u - (w^2 + 2 z w s) / (s^2 + 2 z w s + w^2) u."""
    w, z = 2.0 * np.pi * parts.per_line("geophone_hz"), parts.per_line("geophone_damping")
    one, none = np.eye(len(w)), np.zeros((len(w), len(w)))
    A = np.block([[none, np.diag(w)], [-np.diag(w), -np.diag(2.0 * z * w)]])
    return A, np.vstack([none, np.diag(w)]), np.hstack([-one, -np.diag(2.0 * z)])


def _filters(parts: HexapodParts) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the anti-alias filters w^2 / (s^2 + 2 z w s + w^2)."""
    w, z = 2.0 * np.pi * parts.per_line("filter_hz"), parts.per_line("filter_damping")
    one, none = np.eye(len(w)), np.zeros((len(w), len(w)))
    A = np.block([[none, np.diag(w)], [-np.diag(w), -np.diag(2.0 * z * w)]])
    return A, np.vstack([none, np.diag(w)]), np.hstack([one, none])


def continuous_response(mechanics: Mechanics, parts: HexapodParts, f_hz: FloatArray) -> ComplexArray:
    """Return commands to sensor volts before sampling, `(ny, nu, nf)`, from complex stiffnesses and eq. (4)."""
    s = 2j * np.pi * f_hz
    sensed = np.empty((len(parts.lines), f_hz.size), dtype=np.complex128)
    for i, e in enumerate(parts.lines):
        # differs from eq. (4): its minus sign is left to the wiring, so that a longer stack reads positive.
        num, den = Geophone.at(e.geophone_hz, e.geophone_damping, e.geophone_v_per_m_s).voltage()
        w = 2.0 * np.pi * e.filter_hz
        filtered = w**2 / (s**2 + 2.0 * e.filter_damping * w * s + w**2)
        sensed[i] = -np.polyval(num, s) / np.polyval(den, s) * e.gain * filtered
    amplifiers = 1.0 / (1.0 + 1j * f_hz / parts.amplifiers_hz[:, np.newaxis])
    return mechanics.displacement(f_hz) * sensed[:, np.newaxis] * amplifiers


def sampled_response(
    mechanics: Mechanics, parts: HexapodParts, f_hz: FloatArray, rate_hz: float = RATE_HZ
) -> ComplexArray:
    """Return the response between samples behind a zero-order hold, `(ny, nu, nf)`.

    G(e^jwT) = sum_k G_c(j w_k) (1 - e^{-j w T}) / (j w_k T), w_k = w + 2 pi k / T: hold, chain and all images.
    """
    total = np.zeros((len(mechanics.read), mechanics.push.shape[1], f_hz.size), dtype=np.complex128)
    rising = 1.0 - np.exp(-2j * np.pi * f_hz / rate_hz)
    for k in range(-IMAGES, IMAGES + 1):
        f = f_hz + k * rate_hz
        # A real system answers negative frequencies with the conjugate; at zero the geophone reads nothing.
        g = continuous_response(mechanics, parts, np.abs(f))
        g = np.where(f < 0, g.conj(), g)
        at_zero = f == 0
        hold = rising / (2j * np.pi * np.where(at_zero, 1.0, f) / rate_hz)
        total += g * np.where(at_zero, 1.0, hold)
    return total
