"""What a law does for the payload under one disturbance: spectra of the same period with the law and without it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import FloatArray
from ultraquiet.simulate.payload.spectrum import PeriodSpectrum

SHOWN_HZ = 0.5  # lines of a drawn spectrum are means over this


@dataclass(frozen=True, eq=False)
class Heard:
    """Spectra of the payload's and the base's sensors in one run, and the largest command of each actuator `(nu,)`."""

    payload: PeriodSpectrum
    base: PeriodSpectrum | None
    largest: FloatArray


@dataclass(frozen=True, eq=False)
class PayloadReduction:
    """What a law does for the payload under one disturbance; all sensors of the payload count together.

    reduction = -20 log10(rms closed / rms open), the RMS being that of all the payload's sensors over a band. The
    sensors' own noise is in both; `silent_rms` says how much of it there is.
    """

    source: str
    level: float
    band_hz: tuple[float, float]
    unit: str
    sensors: tuple[str, ...]
    opened: Heard
    closed: Heard
    silent: Heard

    def reduction_db(self, low_hz: float | None = None, high_hz: float | None = None) -> float:
        """Reduction of the RMS of all sensors over a band, that of the disturbance when absent."""
        band = self._band(low_hz, high_hz)
        return float(-20 * np.log10(_all(self.closed.payload, band) / _all(self.opened.payload, band)))

    def each_db(self) -> FloatArray:
        """Reduction of each sensor's RMS over the band, `(sensors,)`."""
        return -20 * np.log10(self.closed.payload.rms(*self.band_hz) / self.opened.payload.rms(*self.band_hz))

    def rms(self) -> tuple[float, float, float]:
        """RMS of all sensors over the band: without the law, with it, and of the sensors alone at rest."""
        runs = (self.opened, self.closed, self.silent)
        without, with_law, silent = (_all(heard.payload, self.band_hz) for heard in runs)
        return without, with_law, silent

    def line_db(self, f_hz: float) -> float:
        """Reduction at the line next to a frequency, all sensors together."""
        at = int(np.argmin(np.abs(self.opened.payload.f_hz - f_hz)))
        power = [(np.abs(h.payload.amplitude[:, at]) ** 2).sum() for h in (self.opened, self.closed)]
        return float(10 * np.log10(power[0] / power[1]))

    def worst_db(self, width_hz: float = SHOWN_HZ) -> tuple[float, float]:
        """Return the least reduction of any part of the band, means over `width_hz`, and where it is in Hz.

        Of a band narrower than that it is the least of any line.
        """
        f, opened, closed = self._shown(width_hz)
        reduction = 10 * np.log10(opened / closed)
        return float(reduction.min()), float(f[int(np.argmin(reduction))])

    @cached_property
    def transmissibility(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Frequencies in Hz, and payload over base without and with the law, each the root of all its power.

        Over the command of the actuator that shakes where nothing is read on the base.
        """
        gains: list[FloatArray] = []
        width_hz = self._width(SHOWN_HZ)
        f, *payload = self._shown(width_hz)
        for power, heard in zip(payload, (self.opened, self.closed), strict=True):
            if heard.base is None:
                even = self.level**2 / (self.band_hz[1] - self.band_hz[0])
                gains.append(np.sqrt(power / even))
            else:
                at, base = heard.base.together(width_hz)
                gains.append(np.sqrt(power / base[self._inside(at)]))
        return f, gains[0], gains[1]

    def _shown(self, width_hz: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return frequencies of the band and the density of all sensors, without and with the law."""
        width_hz = self._width(width_hz)
        (f, opened), (_, closed) = (h.payload.together(width_hz) for h in (self.opened, self.closed))
        inside = self._inside(f)
        return f[inside], opened[inside], closed[inside]

    def _width(self, width_hz: float) -> float:
        """Return over what lines are meant: that of a single line where no mean lies inside the band."""
        some = self._inside(self.opened.payload.together(width_hz)[0]).any()
        return width_hz if some else self.opened.payload.line_hz

    def _inside(self, f_hz: FloatArray) -> NDArray[np.bool_]:
        return (f_hz >= self.band_hz[0]) & (f_hz <= self.band_hz[1])

    def _band(self, low_hz: float | None, high_hz: float | None) -> tuple[float, float]:
        low, high = self.band_hz
        return low if low_hz is None else low_hz, high if high_hz is None else high_hz


def _all(spectrum: PeriodSpectrum, band_hz: tuple[float, float]) -> float:
    return float(np.sqrt((spectrum.rms(*band_hz) ** 2).sum()))
