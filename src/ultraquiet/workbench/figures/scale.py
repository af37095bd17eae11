"""How frequencies and gains are shown: Hz or rad/s, decibels or plain."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray
from ultraquiet.chart.spec import Axis, Range


@dataclass(frozen=True)
class Scale:
    """What the keys `H` and `D` switch."""

    radians: bool = False
    decibels: bool = True

    def x(self, f_hz: ArrayLike) -> FloatArray:
        """Return frequencies as they are shown."""
        f = np.asarray(f_hz, dtype=float)
        return 2 * np.pi * f if self.radians else f

    def hz(self, x: float) -> float:
        """Return what is shown as a frequency in Hz."""
        return x / (2 * np.pi) if self.radians else x

    def y(self, gain: ArrayLike) -> FloatArray:
        """Return sizes as they are shown; zero is a gap."""
        size = np.abs(np.asarray(gain))
        with np.errstate(divide="ignore"):
            shown = 20 * np.log10(size) if self.decibels else size.astype(float)
        return np.where(size > 0, shown, np.nan)

    def frequencies(self, band_hz: Range | None = None) -> Axis:
        """Return the axis of frequencies."""
        ends = None if band_hz is None else (float(self.x(band_hz[0])), float(self.x(band_hz[1])))
        return Axis("frequency (rad/s)" if self.radians else "frequency (Hz)", "log", ends)

    def gains(self, what: str, unit: str = "", limits_db: Range | None = None) -> Axis:
        """Return the axis of gains in a unit."""
        if self.decibels:
            label = f"{what} (dB re {unit})" if unit else f"{what} (dB)"
            return Axis(label.strip() if what else label.strip(" ()"), "linear", limits_db, "dB")
        return Axis(f"{what} ({unit})" if unit and what else what or unit or "gain", "log")
