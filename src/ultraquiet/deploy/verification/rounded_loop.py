"""The loop with the rounded law, analysed again: what the word length cost it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, frequency_array, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.deploy.law.form_choice import loop_radius
from ultraquiet.values.interconnect import sensitivity
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

FREQUENCIES = 3  # of the plant's own band, where none are named: its ends and its middle
LOSS_DB = 0.5  # attenuation that a law may lose through its code
FAINTEST = 1e-9  # of S, as at 0 Hz under an integrator: what is below hangs on the rounding of the analysis itself


@dataclass(frozen=True, eq=False)
class LoopFigures:
    """A loop in figures: the largest pole, peak sensitivity, worst margins over the loops, attenuation at tones.

    `attenuation_db` is -20 log10 of the largest singular value of S = (I - G K)^-1 over the directions that the
    actuators reach (`analyse.band_attenuation`), the worst of them, one per tone; negative where it gets louder, zero
    where they reach none.
    Margins are the smallest of all loops, opened one at a time at the plant's output.
    """

    pole_radius: float
    peak_sensitivity_db: float
    gain_margin_db: float
    phase_margin_deg: float
    delay_margin_s: float
    disk_margin: float
    attenuation_db: FloatArray

    @property
    def stable(self) -> bool:
        """True when every pole lies inside the unit circle."""
        return self.pole_radius < 1.0


@dataclass(frozen=True, eq=False)
class Reanalysis(Shown):
    """The loop as designed and with the law's rounded coefficients, on one plant."""

    status: Status
    tones_hz: FloatArray
    designed: LoopFigures
    rounded: LoopFigures

    @property
    def loss_db(self) -> FloatArray:
        """Attenuation lost at each tone in the worst direction, in dB."""
        return self.designed.attenuation_db - self.rounded.attenuation_db

    @property
    def ok(self) -> bool:
        """True when the rounded loop is stable and loses less than half a decibel."""
        return self.status.ok

    def rows(self) -> list[tuple[str, str, str]]:
        """Return what, as designed, as rounded, for a table."""
        one, two = self.designed, self.rounded
        named = [
            ("largest pole of the loop", one.pole_radius, two.pole_radius, ".6f"),
            ("peak sensitivity, dB", one.peak_sensitivity_db, two.peak_sensitivity_db, ".2f"),
            ("gain margin, dB", one.gain_margin_db, two.gain_margin_db, ".2f"),
            ("phase margin, degrees", one.phase_margin_deg, two.phase_margin_deg, ".1f"),
            ("delay margin, us", 1e6 * one.delay_margin_s, 1e6 * two.delay_margin_s, ".1f"),
            ("disk margin", one.disk_margin, two.disk_margin, ".3f"),
        ]
        for f, a, b in zip(self.tones_hz, one.attenuation_db, two.attenuation_db, strict=True):
            named.append((f"attenuation of the worst direction at {f:g} Hz, dB", a, b, ".2f"))
        return [(what, format(a, form), format(b, form)) for what, a, b, form in named]


def reanalysis(
    controller: StateSpace, rounded: StateSpace, plant: StateSpace, tones_hz: ArrayLike | None = None
) -> Reanalysis:
    """Return stability, margins and worst-direction attenuation of a loop before and after rounding.

    Args:
        controller: the law as designed, u = K y.
        rounded: the law with the code's coefficients, `Deployment.quantised`.
        plant: G of y = G u.
        tones_hz: where attenuation is stated, Hz; the ends and the middle of the plant's own band when absent.

    Returns:
        `Reanalysis`; its status is `unstable` when rounding upsets the loop, `degraded` when a tone loses half a
        decibel or more.

    Raises:
        InputError: shapes or rates that close no loop, a law in continuous time, a tone beyond the Nyquist frequency.

    >>> G = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=1000.0)
    >>> K = StateSpace([[0.9]], [[0.1]], [[-0.5]], [[-0.3]], rate_hz=1000.0)
    >>> print(reanalysis(K, K, G, [5.0, 25.0]).status)
    ok: The loop with the rounded law is stable and loses at most 0.00 dB of attenuation at 5, 25 Hz.
    """
    same_rate("reanalysis", "the controller", controller.rate_hz, "the plant", plant.rate_hz)
    if plant.rate_hz is None:
        raise InputError("reanalysis: plant and law are in continuous time, code has a rate; discretise them first.")
    f = frequency_array("reanalysis", own_frequencies(plant) if tones_hz is None else tones_hz)
    if f.max(initial=0.0) > plant.rate_hz / 2:
        raise InputError(f"reanalysis: {f.max():g} Hz lie beyond Nyquist's {plant.rate_hz / 2:g} Hz; leave them away.")
    figures = [_figures(law, plant, f) for law in (controller, rounded)]
    comparison = Reanalysis(Status(StatusWord.OK, ""), f, *figures)
    return Reanalysis(_status(comparison), f, *figures)


def own_frequencies(plant: StateSpace) -> FloatArray:
    """Return a few frequencies of the plant's own band in Hz, in three digits."""
    return np.array([float(f"{f:.3g}") for f in np.geomspace(*even_plant(plant).band_hz, FREQUENCIES)])


def _figures(law: StateSpace, plant: StateSpace, f: FloatArray) -> LoopFigures:
    from ultraquiet.analyse import loop_margins, peak_sensitivity
    from ultraquiet.analyse.loop_response import reached_directions

    radius = loop_radius(plant, law)
    S = sensitivity(plant, law)
    reached = reached_directions(plant)(f)
    size = np.linalg.norm(np.moveaxis(S.frequency_response(f), 2, 0) @ reached, 2, axis=(1, 2))
    size = np.where(reached.any(axis=(1, 2)), np.maximum(size, FAINTEST), 1.0)
    margins = loop_margins(plant, law)
    return LoopFigures(
        pole_radius=radius,
        peak_sensitivity_db=peak_sensitivity(plant, law)[0],
        gain_margin_db=float(np.minimum(margins.gain_up_db, margins.gain_down_db).min()),
        phase_margin_deg=float(margins.phase_deg.min()),
        delay_margin_s=float(margins.delay_s.min()),
        disk_margin=float(margins.disk.min()),
        attenuation_db=-20 * np.log10(size),
    )


def _status(comparison: Reanalysis) -> Status:
    if not comparison.designed.stable:
        return Status(StatusWord.UNSTABLE, "The loop with this plant is unstable already as designed.")
    if not comparison.rounded.stable:
        return Status(
            StatusWord.UNSTABLE, "The loop is stable as designed, not with the rounded law; take another form."
        )
    worst = float(comparison.loss_db.max(initial=0.0))
    tones = ", ".join(f"{f:.4g}" for f in comparison.tones_hz)
    if worst >= LOSS_DB:
        return Status(StatusWord.DEGRADED, f"The rounded law loses up to {worst:.2f} dB of attenuation at {tones} Hz.")
    return Status(
        StatusWord.OK,
        f"The loop with the rounded law is stable and loses at most {max(worst, 0.0):.2f} dB of attenuation at"
        f" {tones} Hz.",
    )
