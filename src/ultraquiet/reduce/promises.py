"""What a law promised its loop, and whether the law that runs in its place keeps it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.analyse.disk import ENDS, disk_margin
from ultraquiet.analyse.loop_response import loop_response, reached_directions
from ultraquiet.analyse.margins import default_grid, peak_sensitivity
from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.values.interconnect import sensitivity
from ultraquiet.values.state_space import StateSpace

LOSS_DB = 0.5  # of the peak, of the band and of each tone: what may be lost unasked
MARGIN_SHARE = 0.1  # of a disk margin, likewise
# Without a stated band: where the loop quietens every direction by half of what it does at best, if that is audible.
QUIET_SHARE, AUDIBLE_DB = 0.5, 3.0


@dataclass(frozen=True)
class Promise:
    """What a reduction must leave of a loop.

    At most `loss_db` may be lost in its peak, in its worst direction over the band and at every tone that it quietens,
    in the RMS of S G over the band, and come to the largest gain of the control, K S, which is what the actuators pay;
    at most `margin_share` of its disk margins at both ends. Without a band the first is where the loop quietens every
    direction by half of what it reaches at best, in dB, and the RMS is that over the plant's own band.

    With more sensors than actuators the directions are those that actuators reach: in the others every loop leaves the
    readings as they are.
    """

    band_hz: tuple[float, float] | None = None
    tones_hz: tuple[float, ...] = ()
    loss_db: float = LOSS_DB
    margin_share: float = MARGIN_SHARE

    @classmethod
    def of(cls, controller: StateSpace, loss_db: float = LOSS_DB) -> "Promise":
        """Return a promise over the band and at the tones that a law's design stated; of neither where it stated none.

        Whether it was designed from the plant at hand does not matter: what it does for that loop is to be kept.
        """
        stated = controller.provenance.settings
        band, tones = stated.get("band_hz"), stated.get("tones_hz") or ()
        return cls(None if band is None else (float(band[0]), float(band[1])), tuple(map(float, tones)), loss_db)


@dataclass(frozen=True, eq=False)
class Delivered:
    """What a law does for its loop on the design model.

    In dB: the largest amplification of any direction at any frequency, the reduction of the worst direction over the
    band (None without one) and at each tone (Hz), the largest gain of K S, and by how much the RMS of S G is below that
    of G; and the disk margin of each end, all channels at once.
    """

    peak_db: float
    band_db: float | None
    tones_db: Mapping[float, float]
    control_db: float
    rms_db: float
    disk: Mapping[str, float] = field(default_factory=dict)


class Judge:
    """Compares laws on one plant with the one that made the promise."""

    def __init__(self, plant: StateSpace, controller: StateSpace, promise: Promise) -> None:
        self._plant, self.promise = plant, promise
        S = sensitivity(plant, controller)
        self._f = np.union1d(default_grid(S), promise.band_hz or ())
        self._quiet = None
        if promise.band_hz is None:
            self._quiet = _quiet(self._f, _sizes(_responses(plant, controller, self._f)[0]))
        self._even = even_plant(plant, promise.band_hz, "reduce")
        self._known: list[tuple[StateSpace, Delivered]] = []
        self.before = self.of(controller)

    def of(self, law: StateSpace, margins: bool = True) -> Delivered:
        """Return what a law delivers; without `margins` in a tenth of the time, its peak as far as lines show it."""
        if not margins:
            return self._measured(law, margins)
        for known, delivered in self._known:
            if all(np.array_equal(getattr(known, key), getattr(law, key)) for key in "ABCD"):
                return delivered
        self._known.append((law, self._measured(law, margins)))
        return self._known[-1][1]

    def _measured(self, law: StateSpace, margins: bool) -> Delivered:
        own = default_grid(sensitivity(self._plant, law))
        f = np.union1d(self._f, own)
        size, control = (_sizes(each) for each in _responses(self._plant, law, f))
        band = self._in_band(f)
        tones = np.array(self.promise.tones_hz)
        at_tones = _sizes(_responses(self._plant, law, tones)[0]) if tones.size else tones
        return Delivered(
            peak_db=peak_sensitivity(self._plant, law)[0] if margins else float(_db(size.max())),
            band_db=-float(_db(size[band].max())) if band.any() else None,
            tones_db={float(t): -float(_db(s)) for t, s in zip(tones, at_tones, strict=True)},
            control_db=float(_db(control.max())),
            rms_db=self._even.rms_reduction_db(self._even.even_law(law)),
            disk={end: disk_margin(self._plant, law, end) for end in ENDS} if margins else {},
        )

    def broken(self, after: Delivered) -> tuple[str, ...]:
        """Return one phrase for each promise that a law breaks; a quiet that was none promised nothing."""
        before, loss = self.before, self.promise.loss_db
        said = []
        if after.peak_db - before.peak_db > loss:
            said.append(f"the peak rises from {before.peak_db:.1f} to {after.peak_db:.1f} dB")
        if before.band_db is not None and after.band_db is not None and 0 < before.band_db > after.band_db + loss:
            said.append(_fall("the worst direction in the band", before.band_db, after.band_db))
        for tone, reduction in before.tones_db.items():
            if 0 < reduction > after.tones_db[tone] + loss:
                said.append(_fall(f"the worst direction at {tone:g} Hz", reduction, after.tones_db[tone]))
        if 0 < before.rms_db > after.rms_db + loss:
            said.append(_fall("the RMS of the readings under disturbances", before.rms_db, after.rms_db))
        if after.control_db - before.control_db > loss:
            said.append(f"the largest gain of the control rises by {after.control_db - before.control_db:.1f} dB")
        for end, alpha in after.disk.items():
            if alpha < (1 - self.promise.margin_share) * before.disk[end]:
                said.append(f"the disk margin at the plant's {end} falls from {before.disk[end]:.3f} to {alpha:.3f}")
        return tuple(said)

    def _in_band(self, f: FloatArray) -> np.ndarray:
        if self.promise.band_hz is not None:
            low, high = self.promise.band_hz
            return (f >= low) & (f <= high)
        return np.interp(f, self._f, np.asarray(self._quiet, dtype=np.float64)) == 1.0


def _fall(what: str, before_db: float, after_db: float) -> str:
    return f"the reduction of {what} falls from {before_db:.1f} to {after_db:.1f} dB"


def _quiet(f: FloatArray, size: FloatArray) -> np.ndarray:
    """Return where a loop is quiet; not at rest, where a law that integrates leaves nothing but round-off."""
    reduction, moving = -_db(size), f > 0
    best = float(reduction[moving].max())
    return (reduction >= QUIET_SHARE * best) & (best >= AUDIBLE_DB) & moving


def _responses(plant: StateSpace, law: StateSpace, f: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return S = (I - G K)^-1, in what G reaches, and K S at each line, frequency first."""
    S, KS = loop_response(plant, law, f)
    ny, nu = plant.D.shape
    if ny > nu:
        S = np.asarray(S @ reached_directions(plant)(f), dtype=np.complex128)
    return S, KS


def _sizes(response: ComplexArray) -> FloatArray:
    """Return the largest singular value at each line."""
    size = np.asarray(np.linalg.svd(response, compute_uv=False)[:, 0], dtype=np.float64)
    return np.maximum(size, np.finfo(float).tiny)


def _db(size: FloatArray | float) -> FloatArray:
    return np.asarray(20 * np.log10(size), dtype=np.float64)
