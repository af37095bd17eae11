"""Eq. (10) of the paper behind a hold: symbols, their nominal values, and the response between samples."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg.response import points

GEOPHONE = ("m_g", "b_g", "k_g", "K")
STACK = ("m_p", "b_p", "k_p", "n", "C", "C_M", "R_M")
FILTER = ("filter_hz", "filter_damping")
SYMBOLS = GEOPHONE + STACK + FILTER
UNITS: Mapping[str, str] = MappingProxyType(
    {"m_g": "kg", "b_g": "N s/m", "k_g": "N/m", "K": "V s/m", "m_p": "kg", "b_p": "N s/m", "k_p": "N/m", "n": "C/m"}
    | {"C": "F", "C_M": "F", "R_M": "ohm", "filter_hz": "Hz", "filter_damping": ""}
)
# Where a search begins when the user says nothing: the paper's figures (geophone of 12 Hz and 0.1 V s/mm, stack of
# 1.5 kHz and 30 um over 165 V, filter of 1 kHz, sections 2.1 and 3.1) and round numbers of the trade for the rest.
NOMINAL: Mapping[str, float] = MappingProxyType(
    {
        "m_g": 0.01,
        "b_g": 1.0,
        "k_g": 0.01 * (2 * np.pi * 12.0) ** 2,
        "K": 100.0,
        "m_p": 0.06,
        "b_p": 10.0,
        "k_p": 0.06 * (2 * np.pi * 1500.0) ** 2,
        "n": 1.3,
        "C": 2e-6,
        "C_M": 6e-6,
        "R_M": 200.0,
        "filter_hz": 1000.0,
        "filter_damping": float(np.sqrt(0.5)),
    }
)
# Poles that coincide have no partial fractions; set this far apart (relative) they change the response by as little.
APART = 1e-6


class StrutFactors(NamedTuple):
    """k s^3 over the product of three real polynomials in s, each monic: geophone, strut (a cubic), filter."""

    gain: float
    geophone: FloatArray
    strut: FloatArray
    filter: FloatArray

    def poles(self) -> ComplexArray:
        """Return the seven poles in rad/s, no two alike."""
        roots = [np.roots(p) for p in (self.geophone, self.strut, self.filter)]
        return separated(np.concatenate(roots).astype(np.complex128))


def factors(value: Mapping[str, float]) -> StrutFactors:
    """Return eq. (10) times the filter, as a positive function; its minus sign is one of wiring.

    V_out / V_in = m_g K s^3 / (m_g s^2 + b_g s + k_g)
                   (n / C) / [(m_p s^2 + b_p s + k_p)(1/C + 1/C_M + R_M s) + (n^2 / C)(1/C_M + R_M s)]
                   w^2 / (s^2 + 2 zeta w s + w^2)
    """
    v = value
    circuit = np.array([v["R_M"], 1.0 / v["C_M"]])
    mechanics = np.array([v["m_p"], v["b_p"], v["k_p"]])
    strut = np.polyadd(np.polymul(mechanics, [v["R_M"], 1.0 / v["C_M"] + 1.0 / v["C"]]), v["n"] ** 2 / v["C"] * circuit)
    lead = v["m_p"] * v["R_M"]
    w = 2 * np.pi * v["filter_hz"]
    return StrutFactors(
        v["K"] * v["n"] / v["C"] / lead * w**2,
        np.array([1.0, v["b_g"] / v["m_g"], v["k_g"] / v["m_g"]]),
        np.asarray(strut / lead, dtype=np.float64),
        np.array([1.0, 2 * v["filter_damping"] * w, w**2]),
    )


def response_behind_hold(
    gain: float, zeros_at_dc: int, poles: ComplexArray, f_hz: FloatArray, rate_hz: float
) -> ComplexArray:
    """Return gain s^m / prod (s - p) behind a zero-order hold, exactly, `(nf,)`.

    G(z) = sum_p c_p (e^{pT} - 1) / p / (z - e^{pT}), c_p the residue at p.
    """
    return responses_behind_hold(np.array([gain]), np.array([zeros_at_dc]), poles[None], f_hz, rate_hz)[:, 0]


def responses_behind_hold(
    gains: FloatArray, zeros_at_dc: np.ndarray, poles: ComplexArray, f_hz: FloatArray, rate_hz: float
) -> ComplexArray:
    """Return `response_behind_hold` for k functions of as many poles each, `(k, n)`, side by side: `(nf, k)`."""
    discrete, weights = fractions(gains, zeros_at_dc, poles, rate_hz)
    z = points(f_hz, rate_hz)[:, None]
    out = np.zeros((f_hz.size, gains.size), dtype=np.complex128)
    for p, w in zip(discrete.T, weights.T, strict=True):
        out += w / (z - p)
    return out


def fractions(
    gains: FloatArray, zeros_at_dc: np.ndarray, poles: ComplexArray, rate_hz: float
) -> tuple[ComplexArray, ComplexArray]:
    """Return poles in z and residues of gain s^m / prod (s - p) behind a zero-order hold, `(k, n)` each."""
    gaps = poles[:, :, None] - poles[:, None, :]
    gaps[:, np.arange(poles.shape[1]), np.arange(poles.shape[1])] = 1.0
    # s^(m-1): the hold's own 1/s takes one zero at DC.
    weights = gains[:, None] * poles ** (zeros_at_dc[:, None] - 1) / gaps.prod(axis=2) * np.expm1(poles / rate_hz)
    return np.exp(poles / rate_hz), weights


def separated(poles: ComplexArray) -> ComplexArray:
    """Return the poles with those that coincide set apart by a hair, conjugates kept."""
    p = poles.copy()
    for i in range(1, p.size):
        near = np.abs(p[:i] - p[i]) < APART * np.abs(p[i])
        if near.any():
            p[i] *= 1.0 + 2.0 * APART * np.count_nonzero(near)
    return p


def quantities(value: Mapping[str, float]) -> dict[str, float]:
    """Return what any data can tell of eq. (10): suspension, circuit corner, stack resonance, gain.

    `gain_s` is the gain from speed of voltage to volts where the geophone reads velocity and the strut follows,
    V / (V/s).
    """
    f = factors(value)
    roots = np.roots(f.strut)
    real = roots[np.abs(roots.imag) <= 1e-9 * np.abs(roots)].real
    circuit = float(-real.min() if real.size == 1 else -real.max())
    rest = np.asarray(np.polydiv(f.strut, [1.0, circuit])[0])
    w_g, w_p = np.sqrt(f.geophone[2]), np.sqrt(max(rest[2], 0.0))
    return {
        "geophone_hz": float(w_g / (2 * np.pi)),
        "geophone_damping": float(f.geophone[1] / (2 * w_g)),
        "circuit_hz": circuit / (2 * np.pi),
        "stack_hz": float(w_p / (2 * np.pi)),
        "stack_damping": float(rest[1] / (2 * w_p)),
        "gain_s": float(f.gain / f.strut[3] / f.filter[2]),
        "filter_hz": value["filter_hz"],
        "filter_damping": value["filter_damping"],
    }
