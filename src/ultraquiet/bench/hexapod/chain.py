"""The whole linear chain: hold -> amplifier RC -> stack -> structure -> geophone -> gain -> anti-alias -> sample."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, expm

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.bench.hexapod.assemble import Mechanics
from ultraquiet.bench.hexapod.parameters import RATE_HZ, STRUTS, Electronics
from ultraquiet.bench.hexapod.sensors import Geophone

# The sampled response sums this many images of the spectrum to either side. The chain falls off as f^-4 and the hold as
# 1/f, so the images left out together hold less than 1e-5 of the response at any frequency up to 1500 Hz.
IMAGES = 40


@dataclass(frozen=True, eq=False)
class Chain:
    """x' = A x + B v, y = C x: stack commands in volts to sensor volts, without noise, limits or computing delay."""

    A: FloatArray
    B: FloatArray
    C: FloatArray

    def sampled(self, rate_hz: float = RATE_HZ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return A, B, C of the exact zero-order-hold equivalent."""
        n, nu = self.B.shape
        held = np.zeros((n + nu, n + nu))
        held[:n, :n], held[:n, n:] = self.A / rate_hz, self.B / rate_hz
        held = np.asarray(expm(held), dtype=np.float64)
        return held[:n, :n], held[:n, n:], self.C


def chain(mechanics: Mechanics, electronics: Electronics) -> Chain:
    """Connect structure and electronics; every state is in volts, so that none dwarfs another."""
    amplifier = 2.0 * np.pi * electronics.amplifier_hz * np.eye(STRUTS)
    S = _structure(mechanics, electronics.geophone_v_per_m_s * electronics.gain)
    G = _geophone(electronics)
    F = _filter(electronics)
    n = [STRUTS, len(S[0]), len(G[0]), len(F[0])]
    A = np.asarray(block_diag(-amplifier, S[0], G[0], F[0]), dtype=np.float64)
    a, s, g, f = (slice(sum(n[:i]), sum(n[: i + 1])) for i in range(4))
    A[s, a] = S[1]
    A[g, s] = G[1] @ S[2]
    A[f, s] = F[1] @ S[2]
    A[f, g] = F[1] @ G[2]
    B, C = np.zeros((sum(n), STRUTS)), np.zeros((STRUTS, sum(n)))
    B[a] = amplifier
    C[:, f] = F[2]
    return Chain(A, B, C)


def _structure(m: Mechanics, volts_per_speed: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return stack volts to geophone speeds (in volts) in modal coordinates, with the dashpots of the stages.

    States: modal deflections times their frequency, modal speeds, then for each branch the six dashpots r_j,
    r_j' = w_j (v - r_j), where v is a stage's elongation.
    """
    f_hz, shapes = m.modes()
    w = 2.0 * np.pi * f_hz
    n = w.size
    E_v, E_p, x = m.E_v @ shapes, m.E_p @ shapes, m.geophones @ shapes
    k, w_j = m.stage.branch_n_per_m, m.stage.branch_rad_s
    # Lengths are told in units that turn speeds of the geophones into volts and deflections into speeds.
    length = volts_per_speed
    branches = len(k)
    A = np.zeros((2 * n + STRUTS * branches,) * 2)
    A[:n, n : 2 * n] = np.diag(w)
    A[n : 2 * n, :n] = -(shapes.T @ m.stiffness(m.glass) @ shapes) / w
    A[n : 2 * n, n : 2 * n] = -(E_p.T @ m.C_p @ E_p + shapes.T @ m.C_g @ shapes)
    for j in range(branches):
        r = slice(2 * n + STRUTS * j, 2 * n + STRUTS * (j + 1))
        A[r, :n] = w_j[j] * w_j[j] * E_v / w
        A[r, r] = -w_j[j] * np.eye(STRUTS)
        A[n : 2 * n, r] = k[j] / w_j[j] * E_v.T
    B = np.zeros((len(A), STRUTS))
    B[n : 2 * n] = m.stroke_m_per_v * length * E_p.T @ m.K_p
    C = np.zeros((STRUTS, len(A)))
    C[:, n : 2 * n] = x
    return A, B, C


def _geophone(e: Electronics) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what a geophone takes away from the speed u: y = u - (w^2 + 2 z w s) / (s^2 + 2 z w s + w^2) u."""
    w, z, one = 2.0 * np.pi * e.geophone_hz, e.geophone_damping, np.eye(STRUTS)
    A = np.block([[0.0 * one, w * one], [-w * one, -2.0 * z * w * one]])
    return A, np.vstack([0.0 * one, w * one]), np.hstack([-one, -2.0 * z * one])


def _filter(e: Electronics) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the anti-alias filter w^2 / (s^2 + 2 z w s + w^2)."""
    w, z, one = 2.0 * np.pi * e.filter_hz, e.filter_damping, np.eye(STRUTS)
    A = np.block([[0.0 * one, w * one], [-w * one, -2.0 * z * w * one]])
    return A, np.vstack([0.0 * one, w * one]), np.hstack([one, 0.0 * one])


def continuous_response(mechanics: Mechanics, electronics: Electronics, f_hz: FloatArray) -> ComplexArray:
    """Return stack command to sensor volts before sampling, `(6, 6, nf)`, from complex stiffnesses and eq. (4)."""
    e = electronics
    s = 2j * np.pi * f_hz
    # differs from eq. (4): its minus sign is left to the wiring, so that a longer stack reads positive.
    num, den = Geophone.at(e.geophone_hz, e.geophone_damping, e.geophone_v_per_m_s).voltage()
    geophone = -np.polyval(num, s) / np.polyval(den, s) * e.gain
    w = 2.0 * np.pi * e.filter_hz
    filtered = w**2 / (s**2 + 2.0 * e.filter_damping * w * s + w**2)
    amplifier = 1.0 / (1.0 + 1j * f_hz / e.amplifier_hz)
    return mechanics.displacement(f_hz) * (geophone * filtered * amplifier)


def sampled_response(
    mechanics: Mechanics, electronics: Electronics, f_hz: FloatArray, rate_hz: float = RATE_HZ
) -> ComplexArray:
    """Return the response between samples behind a zero-order hold, `(6, 6, nf)`.

    G(e^jwT) = sum_k G_c(j w_k) (1 - e^{-j w T}) / (j w_k T), w_k = w + 2 pi k / T: hold, chain and all images.
    """
    total = np.zeros((STRUTS, STRUTS, f_hz.size), dtype=np.complex128)
    rising = 1.0 - np.exp(-2j * np.pi * f_hz / rate_hz)
    for k in range(-IMAGES, IMAGES + 1):
        f = f_hz + k * rate_hz
        # A real system answers negative frequencies with the conjugate; at zero the geophone reads nothing.
        g = continuous_response(mechanics, electronics, np.abs(f))
        g = np.where(f < 0, g.conj(), g)
        at_zero = f == 0
        hold = rising / (2j * np.pi * np.where(at_zero, 1.0, f) / rate_hz)
        total += g * np.where(at_zero, 1.0, hold)
    return total
