"""State space of fitted sections."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg import pole_residue
from ultraquiet.linalg.sections.search import FrequencySamples, SectionShape, to_poles

# Residue directions that matter less than this share of the quietest line's noise are left out.
RANK_SHARE = 1e-3


def realised(
    samples: FrequencySamples, shape: SectionShape, theta: FloatArray, rho: FloatArray, noise: float, delay: int
) -> tuple[FloatArray, ...]:
    """Return A, B, C, D of sections with numerators rho `(ny, nu, linear)`, late by whole samples in discrete time."""
    rate_hz = samples.rate_hz
    poles, slopes = to_poles(theta, shape, rate_hz, samples.scale)
    x = poles / samples.scale if rate_hz is None else poles - 1
    unit = samples.scale if rate_hz is None else 1.0
    at = 1j * samples.f_rad if rate_hz is None else np.exp(1j * samples.f_rad / rate_hz)
    blocks = []
    for k in range(shape.order):
        if poles[k].imag < 0:
            continue
        R = unit * _numerator(rho, shape, k, complex(x[k])) / slopes[k]
        reach = float(np.max(1.0 / np.abs(at - poles[k])))
        blocks.append(pole_residue.block(complex(poles[k]), R, RANK_SHARE * noise / reach))
    A, B, C = pole_residue.joined(blocks)
    D = rho[:, :, -1] if shape.direct else np.zeros(rho.shape[:2])
    return pole_residue.delayed(A, B, C, D, delay)


def _numerator(rho: FloatArray, shape: SectionShape, k: int, x: complex) -> ComplexArray:
    """Return the numerator of pole k's section at that pole."""
    if k == shape.order - 1 and shape.order % 2:
        return rho[:, :, k].astype(np.complex128)
    first = k - k % 2
    return np.asarray(rho[:, :, first] * x + rho[:, :, first + 1], dtype=np.complex128)
