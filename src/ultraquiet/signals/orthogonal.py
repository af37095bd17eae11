"""Multisines for several actuators at once whose spectra, over as many experiments, form a unitary matrix."""

import numpy as np

from ultraquiet._base.constraints import FloatArray, whole
from ultraquiet.signals._abstract import clock, draws
from ultraquiet.signals.multisine import Multisine


def orthogonal_multisines(signal: Multisine, inputs: int, samples: int, rate_hz: float, seed: int = 0) -> FloatArray:
    """Return commands `(experiment, input, samples)` in the actuators' units for as many experiments as inputs.

    U_je(k) = a T_je exp(i phi_j(k)) with T the DFT matrix: at every line U U^H is diagonal, so the response of each
    input comes out as if it had been excited alone in all experiments, with `inputs` times less variance than one
    actuator at a time at the same level.

    Args:
        signal: band, period and peak; its phases are drawn anew for each input.
        inputs: number of actuators.
        samples: length of each experiment; the last period may be cut short.
        rate_hz: samples per second.
        seed: draws the phases; another seed is another realisation.

    >>> u = orthogonal_multisines(Multisine(period_samples=1000), inputs=3, samples=2000, rate_hz=3500.0, seed=1)
    >>> U = np.moveaxis(np.fft.rfft(u[:, :, :1000])[:, :, 30], 0, 1)
    >>> gram = U @ U.conj().T
    >>> u.shape, bool(np.abs(gram - np.diag(np.diag(gram))).max() < 1e-9 * np.abs(gram).max())
    ((3, 3, 2000), True)

    Reference: T. P. Dobrowiecki, J. Schoukens, P. Guillaume, IEEE Trans. Instrum. Meas. 55 (2006) 697-703,
    doi:10.1109/TIM.2006.870332.
    """
    m = whole("orthogonal_multisines", "inputs", inputs, 1)
    n, rate = clock("orthogonal_multisines", samples, rate_hz)
    period = signal.period_samples
    k = signal.harmonics(rate)
    phase = draws("orthogonal_multisines", seed).uniform(0.0, 2.0 * np.pi, (m, k.size))
    turn = np.exp(2j * np.pi * np.outer(np.arange(m), np.arange(m)) / m)
    lines = np.zeros((m, m, period // 2 + 1), dtype=np.complex128)
    lines[:, :, k] = turn[:, :, np.newaxis] * np.exp(1j * phase)
    u = np.fft.irfft(lines, period, axis=2)
    # One scale for each input over all experiments: another would be another size of excitation.
    peak = signal.level_of("peak")
    u *= peak / np.abs(u).max(axis=(0, 2))[np.newaxis, :, np.newaxis]
    u = np.clip(u, -peak, peak)
    return np.tile(u, (1, 1, -(-n // period)))[:, :, :n]
