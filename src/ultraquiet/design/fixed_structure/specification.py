"""What a controller is to achieve, in numbers: every design is scored against it, tunable ones are tuned to it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, numbers, positive, rising_band
from ultraquiet._base.errors import InputError
from ultraquiet.analyse.loop_response import largest_in_band
from ultraquiet.analyse.margins import peak_sensitivity
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.design.fixed_structure.problem import Requirement
from ultraquiet.design.hinf.band_attenuation import BandAttenuation, worst_attenuation_db
from ultraquiet.design.mean_channel import require_square
from ultraquiet.linalg.response import principal_gains
from ultraquiet.values.generalised import output_shaping
from ultraquiet.values.interconnect import feedback, gain, lft, sensitivity
from ultraquiet.values.state_space import StateSpace

# Corners of a rational weight lie a tenth outside the band that is to be quiet.
OUTSIDE = 1.1
INVERTING, POINTS = 130.0, 60  # the control limit where none is given, and the points at which the band is looked at
TIGHT = 0.997  # of the bounds, when tuned to: the grid's peaks are that near to the exact norms
FLOOR = 1.25  # W1 outside the band is this share of the inverse peak: the weights' corners take the rest


@dataclass(frozen=True, eq=False)
class Score:
    """How a controller stands against a specification.

    Attributes:
        measured: each requirement's value on the plant, in the unit of its name.
        shortfall: how much is missing in the same unit (ratios for gains), zero where the requirement is met.
        stable: whether the loop is.
    """

    measured: Mapping[str, float]
    shortfall: Mapping[str, float]
    stable: bool

    @property
    def met(self) -> bool:
        """Whether everything asked for is there."""
        return self.stable and not any(v > 0 for v in self.shortfall.values())

    @property
    def sentence(self) -> str:
        """What is missing, in words."""
        if not self.stable:
            return "The loop is unstable."
        short = [f"{k} {self.measured[k]:.4g}, short by {v:.3g}" for k, v in self.shortfall.items() if v > 0]
        return "The specification is met." if not short else f"The specification is not met: {'; '.join(short)}."


@dataclass(frozen=True)
class Specification:
    """What a loop u = K y round a plant is to do. S = (I - G K)^-1.

    Args:
        band_hz: band to be quiet, Hz; the plant's own when absent (`even_plant`).
        attenuation_db: by how much in the worst direction, -20 log10 of the largest singular value of S there.
        peak_db: largest amplification of S anywhere.
        control_limit: largest singular value of K S, units of the actuators a unit of the sensors; absent, 130 times
            what inverts the plant's strongest direction where it is weakest in the band.
        disk_margin: least 1 / ||S - I/2||, for gains and phases that change in all loops at once; None or 0 asks
            nothing.
        roll_off_hz, roll_off_db: from here on, |T| = |G K S| is to be at most -roll_off_db; None asks nothing.
        tones_hz, tone_db: worst direction of the attenuation at single frequencies.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> law = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-3.0]], rate_hz=3500.0)
    >>> score = Specification(band_hz=(1.0, 10.0), attenuation_db=11.5, peak_db=4.0).score(plant, law)
    >>> score.met, score.measured["attenuation_db"] > 11.5
    (True, True)

    The bounds are on gains, so every one is an H-infinity requirement: Skogestad and Postlethwaite 2005, section 2.8.
    """

    band_hz: tuple[float, float] | None = None
    attenuation_db: float = 12.0
    peak_db: float = 8.0
    control_limit: float | None = None
    disk_margin: float | None = None
    roll_off_hz: float | None = None
    roll_off_db: float = 10.0
    tones_hz: tuple[float, ...] = ()
    tone_db: float = 20.0

    def __post_init__(self) -> None:
        who = "Specification"
        if self.band_hz is not None:
            rising_band(who, self.band_hz)
        for name in ("attenuation_db", "peak_db", "roll_off_db", "tone_db"):
            positive(who, name, getattr(self, name))
        if self.control_limit is not None:
            positive(who, "control_limit", self.control_limit)
        if self.disk_margin is not None:
            between(who, "disk_margin", self.disk_margin, 0.0, 2.0)
        if self.roll_off_hz is not None:
            positive(who, "roll_off_hz", self.roll_off_hz, "Hz")
        tones = tuple(numbers(who, "tones_hz", self.tones_hz).tolist())
        for tone in tones:
            positive(who, "tones_hz", tone, "Hz")
        if not np.ndim(self.tones_hz):  # one tone by itself is taken as one
            object.__setattr__(self, "tones_hz", tones)

    def fits(self, who: str, plant: StateSpace) -> None:
        """Refuse a plant that is not square or too slow for the frequencies asked.

        Raises:
            InputError: the sentence.
        """
        require_square(who, plant)
        asked = [*(self.band_hz or ()), *self.tones_hz, *([] if self.roll_off_hz is None else [self.roll_off_hz])]
        if plant.rate_hz is not None and max(asked, default=0.0) >= plant.rate_hz / 2:
            raise InputError(
                f"{who}: the specification asks for {max(asked):g} Hz, at or above Nyquist, {plant.rate_hz / 2:g} Hz; "
                "ask below it or sample faster."
            )

    def on(self, plant: StateSpace) -> "Specification":
        """Return the specification with the plant's own band and a control limit in its units where none is given."""
        wanted = self if self.band_hz is not None else replace(self, band_hz=even_plant(plant).band_hz)
        if wanted.control_limit is not None:
            return wanted
        heard = wanted.gains(plant)
        return replace(wanted, control_limit=INVERTING / float(heard.min()) if heard.size else 1.0)

    def gains(self, plant: StateSpace) -> FloatArray:
        """Return the plant's largest gain over the band, where it has one."""
        f = np.geomspace(*band_of(self), POINTS)
        largest = principal_gains(plant.frequency_response(f))[0]
        return largest[np.isfinite(largest) & (largest > 0)]

    def score(self, plant: StateSpace, controller: StateSpace) -> Score:
        """Measure a controller on a plant.

        Norms over all frequencies are exact (`hinf_norm`); a band is looked at between lines too.

        Raises:
            InputError: sizes or rates that do not fit, frequencies above Nyquist.
        """
        self.fits("Specification", plant)
        band_hz, limit = band_of(self.on(plant)), self.on(plant).control_limit
        stable = feedback(plant, controller).is_stable()
        S = sensitivity(plant, controller)
        n = plant.D.shape[0]
        KS = lft(
            output_shaping(plant, gain(np.zeros((0, n)), plant.rate_hz), gain(np.eye(n), plant.rate_hz)), controller
        )
        measured = {
            "attenuation_db": worst_attenuation_db(plant, controller, band_hz),
            "peak_db": peak_sensitivity(plant, controller)[0],
            "control_gain": hinf_norm(KS)[0],
        }
        wanted = {"attenuation_db": self.attenuation_db, "peak_db": -self.peak_db}
        if self.disk_margin is not None:
            half = StateSpace(S.A, S.B, S.C, S.D - np.eye(n) / 2, S.rate_hz)
            size = hinf_norm(half)[0]
            measured["disk_margin"], wanted["disk_margin"] = 1 / size if size else np.inf, self.disk_margin
        if self.roll_off_hz is not None:
            measured["roll_off_db"], wanted["roll_off_db"] = self._roll_off(plant, S), self.roll_off_db
        for f in self.tones_hz:
            measured[f"tone_{f:g}_hz_db"] = worst_attenuation_db(plant, controller, (f, f))
            wanted[f"tone_{f:g}_hz_db"] = self.tone_db
        sign = {"peak_db": -1.0}
        shortfall = {k: max(0.0, v - sign.get(k, 1.0) * measured[k]) for k, v in wanted.items()}
        shortfall["control_gain"] = max(0.0, measured["control_gain"] / _given(limit) - 1)
        return Score(measured, shortfall, stable)

    def requirements(self, plant: StateSpace) -> tuple[StateSpace, tuple[Requirement, ...]]:
        """Return the generalised plant from (w, u) to (S w, K S w, (S - I/2) w, T w, y), and the bounds on its rows.

        Attenuation is soft: it is made as large as peak, control gain and margins allow.
        """
        self.fits("Specification", plant)
        n, A = plant.D.shape[0], plant
        one, none = np.eye(n), np.zeros((n, n))
        direct = [(one, A.D), (none, one), (one / 2, A.D), (none, A.D), (one, A.D)]
        C = np.vstack([A.C, np.zeros((n, A.states)), A.C, A.C, A.C])
        D = np.vstack([np.hstack(pair) for pair in direct])
        P = StateSpace(A.A, np.hstack([np.zeros((A.states, n)), A.B]), C, D, A.rate_hz)
        S, KS, half, T = (slice(k * n, (k + 1) * n) for k in range(4))
        wanted = [
            Requirement("attenuation", S, self._quiet),
            Requirement("peak", S, self._flat(10 ** (self.peak_db / 20)), hard=True),
            Requirement("control", KS, self._flat(_given(self.on(plant).control_limit)), hard=True),
        ]
        if self.disk_margin:
            wanted.append(Requirement("margin", half, self._flat(1 / self.disk_margin), hard=True))
        if self.roll_off_hz is not None:
            wanted.append(Requirement("roll-off", T, self._ended, hard=True))
        return P, tuple(wanted)

    def grid_hz(self) -> FloatArray:
        """Return frequencies at which the bounds must be looked at: the band with its ends, the tones."""
        ends = [] if self.roll_off_hz is None else [self.roll_off_hz]
        low, high = band_of(self)
        return np.array([*np.geomspace(low, high, 60), low, high, *self.tones_hz, *ends])

    def weighted(self, plant: StateSpace, order: int = 8) -> BandAttenuation:
        """Return the same wish for a plant as rational weights for an H-infinity design, W1 S, W2 K S, W3 T."""
        low, high = band_of(self)
        peak = 10 ** (self.peak_db / 20)
        return BandAttenuation(
            band_hz=(low / OUTSIDE, high * OUTSIDE),
            height=10 ** (self.attenuation_db / 20) * FLOOR,
            floor=FLOOR / peak,
            order=order,
            control_limit=_given(self.on(plant).control_limit) / FLOOR,
            tones_hz=self.tones_hz,
        )

    @staticmethod
    def _flat(bound: float) -> Callable[[FloatArray], FloatArray]:
        return lambda f_hz: np.full(f_hz.shape, TIGHT * bound)

    def _quiet(self, f_hz: FloatArray) -> FloatArray:
        low, high = band_of(self)
        inside = (f_hz >= low * (1 - 1e-9)) & (f_hz <= high * (1 + 1e-9))
        bound = np.where(inside, 10 ** (-self.attenuation_db / 20), np.inf)
        for tone in self.tones_hz:
            bound = np.where(np.abs(f_hz - tone) <= 1e-9 * tone, 10 ** (-self.tone_db / 20), bound)
        return bound

    def _ended(self, f_hz: FloatArray) -> FloatArray:
        assert self.roll_off_hz is not None
        return np.where(f_hz >= self.roll_off_hz * (1 - 1e-9), 10 ** (-self.roll_off_db / 20), np.inf)

    def _roll_off(self, plant: StateSpace, S: StateSpace) -> float:
        assert self.roll_off_hz is not None
        top = 100 * self.roll_off_hz if S.rate_hz is None else S.rate_hz / 2
        one = np.eye(S.D.shape[0])
        size, _ = largest_in_band(S, plant, (self.roll_off_hz, top), lambda S, _: S - one)
        return -20 * float(np.log10(max(size, 1e-300)))


def band_of(wanted: Specification) -> tuple[float, float]:
    """Return the band of a specification that has one, as `on` gives it."""
    assert wanted.band_hz is not None
    return wanted.band_hz


def _given(limit: float | None) -> float:
    assert limit is not None
    return limit


def specified(value: "Specification | Mapping[str, Any] | None") -> Specification | None:
    """Return a specification given as itself or, from a study file, as a table of its settings."""
    if value is None or isinstance(value, Specification):
        return value
    if not isinstance(value, Mapping):
        raise InputError(f"Specification: give a Specification or a table of its settings, got {value!r}.")
    known = [f.name for f in fields(Specification)]
    unknown = [k for k in value if k not in known]
    if unknown:
        raise InputError(f"Specification: there is no setting '{unknown[0]}', only {', '.join(known)}.")
    settings: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in value.items()}
    return Specification(**settings)
