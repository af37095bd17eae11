"""What no law can count on: the phase of a mode whose frequency is less certain than its width, near Nyquist."""

from collections.abc import Sequence

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.analyse.peaks import response_at
from ultraquiet.linalg.response import principal_gains
from ultraquiet.values.state_space import StateSpace

SKIRT = 3.0  # the roof begins so many times the spread of frequencies below the lowest such mode
LINES = 40  # around a mode, over its spread


def roof(
    plants: Sequence[StateSpace], band_hz: tuple[float, float], mode_spread: float, gain_spread: float, room: float
) -> tuple[float, float]:
    """Return from where on, in Hz, and below what gain the law must stay: infinity twice where all modes are certain.

    A mode of a damping ratio below the spread of its frequency may stand anywhere across its own resonance: the phase
    of the loop is unknown there and only its gain can keep it stable, |K| max |G| <= room. Room is 1 - 1 / peak, with
    which |S| <= 1 / (1 - |G K|) stays below the peak. Modes nearer to the band than to Nyquist are left to the
    scenarios, in which they move: there a loop may rely on the phase of actuators and sensors at one place.

    Args:
        plants: models.
        band_hz: in which there is to be attenuation.
        mode_spread: share by which frequencies may be off.
        gain_spread: share by which gains may be off.
        room: largest |G K| that is allowed.

    A roof needs a Nyquist frequency: there is none for plants in continuous time.
    """
    rate_hz = plants[0].rate_hz
    if rate_hz is None or mode_spread <= 0:
        return np.inf, np.inf
    nearer = float(np.sqrt(band_hz[1] * rate_hz / 2))
    lowest, largest = np.inf, 0.0
    for plant in plants:
        f, zeta = _modes(plant.poles(), rate_hz)
        uncertain = f[(zeta < mode_spread) & (f > nearer)]
        if not uncertain.size:
            continue
        lowest = min(lowest, float(uncertain.min()))
        share = 1 + mode_spread * np.linspace(-1, 1, LINES)
        lines = np.unique(np.minimum(uncertain[:, None] * share, rate_hz / 2))
        gains = principal_gains(response_at(plant)(lines))[0]
        largest = max(largest, float(gains.max()))
    if not np.isfinite(lowest) or largest == 0:
        return np.inf, np.inf
    return lowest * (1 - SKIRT * mode_spread), room / (largest * (1 + gain_spread))


def _modes(poles: ComplexArray, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return frequency in Hz and damping ratio of oscillating modes."""
    z = poles[(np.abs(poles) > 0) & (poles.imag > 0)].astype(np.complex128)
    s = np.log(z) * rate_hz
    return np.abs(s) / (2 * np.pi), -s.real / np.abs(s)
