"""The least peak that a wanted attenuation implies, in closed form."""

import numpy as np

from ultraquiet._base.constraints import between, positive, rising_band
from ultraquiet._base.errors import InputError
from ultraquiet.limits import half_plane
from ultraquiet.values.door import takes_systems
from ultraquiet.values.state_space import StateSpace

WHO = "waterbed_peak"
DB = float(20 / np.log(10))


@takes_systems
def waterbed_peak(
    plant: StateSpace,
    band_hz: tuple[float, float],
    attenuation_db: float,
    bandwidth_hz: float | None = None,
) -> float:
    """Return the least peak of |S| in dB that attenuation over a band costs, whatever the linear controller.

    Poisson's integral at each zero s outside the stability region: share * (-attenuation) + rest * peak >= owed, with
    the harmonic measures of the band and of the other frequencies seen from s, and owed the sum of
    ln |s + conj(p)| / |s - p| over the unstable poles p. A delay is a zero at infinity in z: Bode's integral.

    Args:
        plant: G, continuous or discrete.
        band_hz: the quiet band, Hz.
        attenuation_db: wanted in it, in every direction.
        bandwidth_hz: above it the loop does nothing, S = 1; all frequencies may be amplified when absent.

    Returns:
        The least peak in dB; zero when nothing binds, as with a continuous plant without such zeros or `bandwidth_hz`.

    No controller does better than this; what one does, also with its gain limited, says `best_flat_attenuation`. With
    several channels the unstable poles of the plant are left out: they bind in their own directions only.

    >>> lag = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=1000.0)
    >>> round(waterbed_peak(lag, (0.001, 100.0), 20.0), 2)  # a fifth of the frequencies down by 20, the others up by 5
    5.0

    Freudenberg and Looze 1985, doi:10.1109/TAC.1985.1104004, theorem 2; Seron, Braslavsky and Goodwin 1997,
    doi:10.1007/978-1-4471-0965-5, chapter 3; Skogestad and Postlethwaite 2005, section 5.3.
    """
    low, high = rising_band(WHO, band_hz, plant.rate_hz)
    between(WHO, "attenuation_db", attenuation_db, 0.0, 1000.0, "dB")
    if bandwidth_hz is not None and positive(WHO, "bandwidth_hz", bandwidth_hz) <= high:
        raise InputError(
            f"{WHO}: 'bandwidth_hz' must lie above the band, which ends at {high:g} Hz; got {bandwidth_hz:g}."
        )
    scalar = plant.D.shape == (1, 1)
    poles = half_plane.unstable(plant.poles(), plant.rate_hz) if scalar else np.zeros(0, dtype=np.complex128)
    top = np.inf if bandwidth_hz is None else bandwidth_hz
    w = half_plane.speeds(np.array([low, high, min(top, 1e300)]), plant.rate_hz)
    peaks = [0.0]
    for zero in half_plane.binding_zeros(plant):
        a, b, c = half_plane.harmonic(zero.s, w)
        peaks.append(((b - a) * attenuation_db + DB * half_plane.owed(zero.s, poles)) / max(c - b + a, 1e-300))
    if plant.rate_hz is None and bandwidth_hz is not None and not np.any(plant.D):
        # Bode's integral of a loop that rolls off faster than 1 / s: area pi sum Re p in nepers rad/s
        area = attenuation_db * (high - low) + DB * float(poles.real.sum()) / 2
        peaks.append(area / (bandwidth_hz - (high - low)))
    return float(max(peaks))
