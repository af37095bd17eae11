"""Three estimates of one response from cross spectra: H1, H2 and Hv, each with the variance of its gains.

All arrays have the frequency first: `S_uu (nf, nu, nu)`, `S_yu (nf, ny, nu)`, `S_yy (nf, ny, ny)`.
Reference: R. J. Rocklin, J. Crowley, H. Vold, Proc. IMAC 3 (1985) 272-278; Bendat and Piersol 2010, chapters 6, 7, 9,
doi:10.1002/9781118032428; Pintelon and Schoukens 2012, section 2.6, doi:10.1002/9781118287422.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InputError


@dataclass(frozen=True, eq=False)
class Spectra:
    """The blocks of the cross spectral matrix, and how many independent segments stand behind them."""

    S_uu: ComplexArray
    S_yu: ComplexArray
    S_yy: ComplexArray
    independent: float

    @property
    def output_power(self) -> FloatArray:
        """Auto spectra of the outputs, `(nf, ny)`."""
        return np.einsum("fii->fi", self.S_yy).real

    @property
    def degrees(self) -> float:
        """Independent segments left after each input has taken one."""
        return max(self.independent - self.S_uu.shape[1], 0.0)


def h1(s: Spectra) -> tuple[ComplexArray, FloatArray]:
    """Return G = S_yu S_uu^-1 and its variance; noise at the outputs averages out, noise on the inputs shrinks G."""
    G = right_divide(s.S_yu, s.S_uu)
    residual = s.output_power - np.einsum("fij,fij->fi", G, s.S_yu.conj()).real
    return G, _scaled(residual, np.linalg.inv(s.S_uu), s.degrees)


def h2(s: Spectra) -> tuple[ComplexArray, FloatArray]:
    """Return G = S_yy S_uy^-1 and its variance; noise on the inputs averages out, noise at the outputs swells G.

    One input needs no inverse: every output then has its own S_yy / S_uy. More inputs need as many outputs.
    """
    ny, nu = s.S_yu.shape[1:]
    if nu == 1:
        return _h2_single(s)
    if nu != ny:
        raise InputError(f"frf: H2 of {nu} inputs needs {nu} outputs, got {ny}; take H1 or Hv, or pick outputs.")
    silent = np.flatnonzero((s.output_power == 0).any(axis=0))
    if silent.size:
        raise InputError(
            f"frf: H2 of {nu} inputs needs {nu} outputs that move, output {silent[0] + 1} stands still where several "
            f"inputs are excited together; take H1 or Hv, or pick outputs."
        )
    S_uy = np.conj(np.swapaxes(s.S_yu, 1, 2))
    G = right_divide(s.S_yy, S_uy)
    inner = np.linalg.inv(S_uy)
    # An instrumental estimate whose instruments are the outputs: its spread is S_uy^-H S_yy S_uy^-1.
    spread = np.conj(np.swapaxes(inner, 1, 2)) @ s.S_yy @ inner
    return G, _scaled(_misfit(s, G), spread, s.degrees)


def hv(s: Spectra, noise: FloatArray | None = None) -> tuple[ComplexArray, FloatArray]:
    """Return the total least squares G of each output, and its variance.

    (S - lambda N) [g* ; -1] = 0 for the smallest lambda, S the cross spectra of all inputs and one output, N the
    diagonal of what noise each of them is thought to hold: given as `noise` `(nu + ny,)`, densities up to one common
    factor; or each channel's own power, which for one input makes |Hv| the geometric mean of |H1| and |H2|.
    """
    ny, nu = s.S_yu.shape[1:]
    nf = len(s.S_uu)
    G = np.empty((nf, ny, nu), dtype=np.complex128)
    power_u = np.einsum("fjj->fj", s.S_uu).real
    for i in range(ny):
        S = np.empty((nf, nu + 1, nu + 1), dtype=np.complex128)
        S[:, :nu, :nu], S[:, nu, nu] = s.S_uu, s.S_yy[:, i, i]
        S[:, nu, :nu], S[:, :nu, nu] = s.S_yu[:, i], s.S_yu[:, i].conj()
        if noise is None:
            size = np.sqrt(np.column_stack([power_u, s.output_power[:, i]]))
        else:
            size = np.broadcast_to(np.sqrt(np.append(noise[:nu], noise[nu + i])), (nf, nu + 1))
        size = np.where(size > 0, size, 1.0)  # an output that stands still has a gain of zero whatever its size
        least = np.linalg.eigh(S / (size[:, :, np.newaxis] * size[:, np.newaxis]))[1][:, :, 0] / size
        G[:, i] = -(least[:, :nu] / least[:, nu:]).conj()
    explained = np.clip(multiple(s), np.finfo(float).tiny, 1.0)
    # First order, exact for one input with the default noise; the level scatters less than half of it, the
    # phase more.
    share = 0.5 * (1.0 - explained) * (1.0 + 1.0 / explained) * s.output_power
    return G, _scaled(share, np.linalg.inv(s.S_uu), s.degrees)


def instrumental(
    s: Spectra, S_rr: ComplexArray, S_ur: ComplexArray, S_yr: ComplexArray
) -> tuple[ComplexArray, FloatArray]:
    """Return G = S_yr S_rr^-1 S_ru (S_ur S_rr^-1 S_ru)^-1 and its variance, by references r free of either noise.

    As many references as inputs make it S_yr S_ur^-1, without bias; more of them leave one of (references / segments).
    """
    S_ru = np.conj(np.swapaxes(S_ur, 1, 2))
    projected = S_ur @ np.linalg.solve(S_rr, S_ru)
    G = right_divide(S_yr @ np.linalg.solve(S_rr, S_ru), projected)
    degrees = max(s.independent - S_rr.shape[1], 0.0)
    return G, _scaled(_misfit(s, G), np.linalg.inv(projected), degrees)


def multiple(s: Spectra) -> FloatArray:
    """Return the share of each output's power that all inputs explain together, `(nf, ny)`, 0 to 1."""
    explained = np.einsum("fij,fij->fi", right_divide(s.S_yu, s.S_uu), s.S_yu.conj()).real
    power = s.output_power
    return np.clip(np.divide(explained, power, out=np.zeros_like(power), where=power > 0), 0.0, 1.0)


def ordinary(s: Spectra) -> FloatArray:
    """Return |S_yu|^2 / (S_yy S_uu) of each pair, `(nf, ny, nu)`."""
    power = s.output_power[:, :, np.newaxis] * np.einsum("fjj->fj", s.S_uu).real[:, np.newaxis]
    square = np.abs(s.S_yu) ** 2
    return np.clip(np.divide(square, power, out=np.zeros_like(square), where=power > 0), 0.0, 1.0)


def partial(s: Spectra) -> FloatArray:
    """Return the coherence of each pair once what the other inputs explain is taken from both, `(nf, ny, nu)`.

    With P the inverse of S_uu: |g_j|^2 / P_jj over that plus the residual, g the H1 gain.
    """
    G, _ = h1(s)
    own = np.abs(G) ** 2 / np.einsum("fjj->fj", np.linalg.inv(s.S_uu)).real[:, np.newaxis]
    residual = (s.output_power * (1.0 - multiple(s)))[:, :, np.newaxis]
    return np.divide(own, own + residual, out=np.zeros_like(own), where=own + residual > 0)


def right_divide(B: NDArray[Any], A: NDArray[Any]) -> ComplexArray:
    """Return B A^-1 for every frequency."""
    X = np.linalg.solve(np.swapaxes(A, 1, 2), np.swapaxes(B, 1, 2))
    return np.asarray(np.swapaxes(X, 1, 2), dtype=np.complex128)


def _h2_single(s: Spectra) -> tuple[ComplexArray, FloatArray]:
    power, cross = s.output_power, s.S_yu[:, :, 0].conj()
    G = np.divide(power, cross, out=np.zeros_like(cross), where=np.abs(cross) > 0)
    # |H2|^2 (1 - gamma^2) / (gamma^2 K): the same relative error as H1 (Bendat and Piersol, table 9.6). Of an output
    # that stands still the gain is zero for sure; of one that has nothing of the input, H2 is anything.
    ratio, degrees = ordinary(s)[:, :, 0], s.degrees
    share = np.divide(1.0 - ratio, ratio, out=np.ones_like(ratio), where=ratio > 0)
    told = ((ratio > 0) | (power == 0)) & (degrees > 0)
    variance = np.where(told, np.abs(G) ** 2 * share / (degrees or 1.0), np.inf)
    return G[:, :, np.newaxis], variance[:, :, np.newaxis]


def _misfit(s: Spectra, G: ComplexArray) -> FloatArray:
    """Return the power of y - G u, `(nf, ny)`."""
    crossed = np.einsum("fij,fij->fi", G, s.S_yu.conj()).real
    through = np.einsum("fij,fjk,fik->fi", G, s.S_uu, G.conj()).real
    return s.output_power - 2.0 * crossed + through


def _scaled(residual: FloatArray, spread: NDArray[Any], degrees: float) -> FloatArray:
    """Return residual_i spread_jj / degrees, `(nf, ny, nu)`; infinite without a degree of freedom."""
    if degrees <= 0:
        return np.full((*residual.shape, spread.shape[1]), np.inf)
    own = np.einsum("fjj->fj", spread).real
    return np.maximum(residual, 0.0)[:, :, np.newaxis] * own[:, np.newaxis] / degrees
