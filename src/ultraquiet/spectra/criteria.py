"""Vibration criteria for sensitive equipment: VC curves and the ISO guidelines, and where a floor or payload stands."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, frequency_array, frozen
from ultraquiet._base.errors import InputError
from ultraquiet.spectra.bands import BandLevels, Bands, octave_bands
from ultraquiet.values import Channel
from ultraquiet.values.handed_over.kinds import of_kind

# Limits of velocity are flat above this frequency, limits of acceleration below: the velocity allowed rises as 1/f.
KNEE_HZ = 8.0
STOP_HZ = 80.0
UNITS_PER_METRE_PER_SECOND = {"m/s": 1.0, "mm/s": 1e3, "um/s": 1e6, "µm/s": 1e6, "μm/s": 1e6}


@dataclass(frozen=True)
class Criterion:
    """One curve: rms velocity in one-third octaves, `level_um_s` above 8 Hz; `rises` says it grows as 8/f below.

    >>> criterion("VC-A").limit_m_s([4.0, 8.0, 80.0]).round(7).tolist()
    [0.0001, 5e-05, 5e-05]
    """

    name: str
    level_um_s: float
    start_hz: float
    rises: bool

    @property
    def bands(self) -> Bands:
        """The one-third octaves it judges."""
        return octave_bands(self.start_hz, STOP_HZ)

    def limit_m_s(self, centre_hz: ArrayLike) -> FloatArray:
        """Return the limit in m/s at nominal or exact centres; not a number where the curve does not reach."""
        f = frequency_array("Criterion.limit_m_s", centre_hz)
        shape = np.maximum(1.0, KNEE_HZ / np.maximum(f, np.finfo(float).tiny)) if self.rises else np.ones_like(f)
        # Exact centres stand up to 1 % beside their names: 7.94 Hz is the band "8 Hz" and lies on the flat part.
        shape[np.abs(f / KNEE_HZ - 1.0) < 0.01] = 1.0
        inside = (f > 0.98 * self.start_hz) & (f < 1.02 * STOP_HZ)
        return np.where(inside, 1e-6 * self.level_um_s * shape, np.nan)


# From loose to strict. IEST-RP-CC012 and C. G. Gordon, Proc. SPIE 1619 (1991) 71-85, doi:10.1117/12.56822, with the
# exact halves of H. Amick et al., Proc. SPIE 5933 (2005), doi:10.1117/12.617970, which also gave VC-F and VC-G. There
# VC-A and VC-B are 260 and 130 ug below 8 Hz, which is 50 and 25 um/s at 8 Hz, rounded: here the curves meet exactly.
CRITERIA: tuple[Criterion, ...] = (
    Criterion("Workshop (ISO)", 800.0, 4.0, True),
    Criterion("Office (ISO)", 400.0, 4.0, True),
    Criterion("Residential day (ISO)", 200.0, 4.0, True),
    Criterion("Operating theatre (ISO)", 100.0, 4.0, True),
    Criterion("VC-A", 50.0, 4.0, True),
    Criterion("VC-B", 25.0, 4.0, True),
    Criterion("VC-C", 12.5, 1.0, False),
    Criterion("VC-D", 6.25, 1.0, False),
    Criterion("VC-E", 3.12, 1.0, False),
    Criterion("VC-F", 1.56, 1.0, False),
    Criterion("VC-G", 0.78, 1.0, False),
)


@dataclass(frozen=True, eq=False)
class Classification:
    """What a velocity spectrum meets.

    `met` holds for each channel the strictest criterion met in all its bands, or None; `margin_db`
    `(channel, criterion, band)` is limit over level in dB, negative where it is exceeded, not a number outside the
    criterion's range; `judged` are the criteria whose whole range was measured.
    """

    met: tuple[Criterion | None, ...]
    judged: tuple[Criterion, ...]
    margin_db: FloatArray
    levels: BandLevels

    @property
    def worst_db(self) -> FloatArray:
        """Smallest margin of each channel and criterion, `(channel, criterion)`."""
        return np.nanmin(self.margin_db, axis=2)

    @property
    def estimator(self) -> str:
        """How the levels were made."""
        return self.levels.estimator

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is met, one sentence a channel."""
        return tuple(self._sentence(k) for k in range(len(self.met)))

    def _sentence(self, k: int) -> str:
        name, met = self.levels.channels[k].name, self.met[k]
        if met is None:
            loosest = int(np.argmax([c.level_um_s for c in self.judged]))
            return (
                f"{name} meets none of the criteria; {self.judged[loosest].name} is exceeded by "
                f"{-self.worst_db[k, loosest]:.1f} dB."
            )
        j = self.judged.index(met)
        band = int(np.nanargmin(self.margin_db[k, j]))
        opening = f"{name} meets {met.name} with {self.worst_db[k, j]:.1f} dB to spare at "
        return f"{opening}{self.levels.bands.nominal_hz[band]:g} Hz, {met.start_hz:g} to {STOP_HZ:g} Hz."


def criterion(name: str) -> Criterion:
    """Return a criterion by its name, or by its first word.

    >>> criterion("office").level_um_s
    400.0
    """
    for one in CRITERIA:
        if str(name).lower() in (one.name.lower(), one.name.lower().removesuffix(" (iso)")):
            return one
    raise InputError(f"criteria: there is no '{name}'; known are {', '.join(c.name for c in CRITERIA)}.")


def classify(levels: BandLevels, criteria: Sequence[Criterion] = CRITERIA) -> Classification:
    """Return which vibration criteria a velocity spectrum in one-third octaves meets, and by how much.

    margin_db = 20 log10(limit / level)

    Args:
        levels: one-third octave levels of velocities, channels in m/s, mm/s or µm/s.
        criteria: the curves to hold against, any order.

    Returns:
        The strictest curve met by each channel. A curve counts only when all of its bands were measured: VC-C and
        stricter begin at 1 Hz, the others at 4 Hz.

    Raises:
        InputError: other bands than thirds, a channel that is no velocity, a range that covers no criterion.

    >>> from ultraquiet.spectra import band_levels, psd
    >>> from ultraquiet.values import Record
    >>> hum = Record(
    ...     [[0.0] * 60000],
    ...     6e-6 * np.random.default_rng(0).standard_normal((1, 60000)),
    ...     300.0,
    ...     sensors=[Channel("floor", "m/s")],
    ... )
    >>> found = classify(band_levels(psd(hum, segment_samples=4096), start_hz=1.0, stop_hz=80.0))
    >>> found.met[0].name
    'VC-E'

    Reference: IEST-RP-CC012.3 (2015); Gordon 1991, doi:10.1117/12.56822; ISO 2631-2:1989.
    """
    of_kind("classify", "levels", levels, BandLevels)
    if levels.bands.fraction != 3:
        raise InputError(f"classify: the criteria are for one-third octaves, got 1/{levels.bands.fraction} octaves.")
    scale = np.array([_per_metre_per_second(c) for c in levels.channels])
    velocity = levels.rms / scale[:, np.newaxis]
    centre = levels.bands.centre_hz
    judged = tuple(c for c in criteria if np.isin(c.bands.nominal_hz, levels.bands.nominal_hz).all())
    if not judged:
        raise InputError(
            f"classify: bands from {levels.bands.nominal_hz[0]:g} to {levels.bands.nominal_hz[-1]:g} Hz cover no "
            f"criterion; they need 4 to 80 Hz, VC-C and stricter 1 to 80 Hz."
        )
    limits = np.array([c.limit_m_s(centre) for c in judged])
    with np.errstate(divide="ignore"):
        margin = 20.0 * np.log10(limits / velocity[:, np.newaxis])
    worst = np.nanmin(margin, axis=2)
    order = np.argsort([c.level_um_s for c in judged])
    met = tuple(next((judged[j] for j in order if w[j] >= 0), None) for w in worst)
    return Classification(met, judged, frozen(margin), levels)


def _per_metre_per_second(channel: Channel) -> float:
    if channel.unit not in UNITS_PER_METRE_PER_SECOND:
        raise InputError(
            f"classify: channel '{channel.name}' is in {channel.unit or 'no unit'}, the criteria need a velocity in "
            f"{', '.join(UNITS_PER_METRE_PER_SECOND)}; divide by its sensitivity or convert it first."
        )
    return UNITS_PER_METRE_PER_SECOND[channel.unit]
