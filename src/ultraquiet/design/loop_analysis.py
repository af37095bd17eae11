"""All that can be said of a loop between design and deployment: stability, margins, peaks, attenuation over a band."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import between
from ultraquiet._base.shown.line import hertz, rounded
from ultraquiet.analyse.disk import EndMargins
from ultraquiet.analyse.gang import Gang, Peak, gang_of_six
from ultraquiet.analyse.margins import even_sensitivity
from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.design.instability import unstable
from ultraquiet.design.robustness import DISK_MARGIN, UNSTABLE_LAW, WIDEST, both_ends, kept
from ultraquiet.design.worst_direction import ALIKE, WHO, Scales, scales_of, strongest, worst_in
from ultraquiet.values.channel import ratio
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord


@dataclass(frozen=True)
class SlowestMode:
    """The pole of a loop that decays most slowly, or grows: growth in 1/s, frequency in Hz, damping ratio."""

    growth_per_s: float
    f_hz: float
    damping: float


@dataclass(frozen=True)
class MemberPeak:
    """Largest gain of S, T or KS: its size, where, and the channels between which it is largest there.

    `gain` is in output units per input unit; `unit` says which, and is empty for S and T, whose units cancel.
    """

    gain: float
    gain_db: float
    f_hz: float
    into: str
    out_of: str
    unit: str = ""


@dataclass(frozen=True, eq=False)
class LoopAnalysis:
    """What a loop of a plant and a law keeps.

    Attributes:
        status: `ok`, `fragile` (less disk margin than `disk_margin` at an end) or `unstable`.
        slowest: the pole that decays most slowly; None for a loop without states.
        margins: at the plant's `input` and `output`.
        peaks: of `S`, `T` and `KS` at the outputs; infinite for an unstable loop.
        band_hz: where the attenuation counts.
        attenuation_db, attenuation_hz: of the worst direction over the band, and where; see `band_attenuation`.
        even: whether channels of several units were weighed by the plant's own scales; then `KS` has no unit.
        gang: the responses, in the scales in which they were compared.
        command_scale: what KS of `gang` is multiplied by to be in the channels' units.
    """

    status: Status
    slowest: SlowestMode | None
    margins: Mapping[str, EndMargins]
    peaks: Mapping[str, MemberPeak]
    band_hz: tuple[float, float]
    attenuation_db: float
    attenuation_hz: float
    even: bool
    gang: Gang
    command_scale: float

    @property
    def stable(self) -> bool:
        """Whether the loop is."""
        return self.gang.stable


def analyse_loop(
    plant: StateSpace,
    controller: StateSpace,
    band_hz: tuple[float, float] | None = None,
    disk_margin: float = DISK_MARGIN,
) -> LoopAnalysis:
    """Return stability, margins at both ends, peaks of S, T and KS, and the attenuation of the worst direction.

    S = (I - G K)^-1, T = S - I, KS = K S, with u = K y. An end whose channels are of several units is taken in units of
    the plant's own (`even_plant`): a change of a channel's unit changes nothing. Sensors of one unit stay in it, so S
    and T are those of `peak_sensitivity` whatever the actuators' units are.

    Args:
        plant: G, `(ny, nu)`.
        controller: K, its sign inside.
        band_hz: (low, high) in Hz; the plant's own band when absent.
        disk_margin: what a loop called `ok` keeps at both ends, all channels of an end at once.

    Returns:
        `LoopAnalysis`.

    Raises:
        InputError: rates or shapes that do not fit, a band that does not rise or ends beyond the Nyquist frequency.

    >>> G = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> found = analyse_loop(G, StateSpace([[0.0]], [[0.0]], [[0.0]], [[-0.5]], rate_hz=100.0), (1.0, 5.0))
    >>> found.status.word.value, round(found.peaks["S"].gain_db, 2), round(found.attenuation_db, 2)
    ('ok', 3.52, 5.24)

    Reference: Skogestad and Postlethwaite, Multivariable Feedback Control, 2nd ed., sections 3.3 and 9.4.
    """
    asked = between(WHO, "disk_margin", disk_margin, 0.0, WIDEST)
    own = even_plant(plant, band_hz, WHO)
    band = own.band_hz if band_hz is None else (float(band_hz[0]), float(band_hz[1]))
    scales = scales_of(plant, own.inputs, own.outputs)
    G, K = scales.scaled(plant, controller)
    margins = both_ends(plant, controller)
    gang = gang_of_six(G, K)
    worst = worst_in(scales, plant, controller, band)
    members = {"S": gang.So, "T": gang.To, "KS": gang.KSo}
    wide = gang.peaks()
    peaks = {
        name: _peak(wide[key], plant, scales, name) for name, key in zip(members, ("So", "To", "KSo"), strict=True)
    }
    if not gang.stable:
        said = unstable(plant, controller, gang.So)
        status = Status(StatusWord.UNSTABLE, f"{said}; the law must not run on this plant.")
    else:
        status = _verdict(plant, margins, peaks["S"], asked)
        law = [] if controller.is_stable() else [f"The controller is {UNSTABLE_LAW}."]
        status = Status(status.word, " ".join([status.sentence, *law, worst.sentences]))
    slowest = _slowest(even_sensitivity(plant, controller, "output"))
    return LoopAnalysis(
        status,
        slowest,
        margins,
        peaks,
        band,
        worst.attenuation_db,
        worst.f_hz,
        scales.even,
        gang,
        scales.command,
    )


def _verdict(plant: StateSpace, margins: Mapping[str, EndMargins], peak: MemberPeak, asked: float) -> Status:
    loudest = f"it amplifies by at most {rounded(peak.gain_db)} dB, at {hertz(peak.f_hz)}; "
    return kept(plant, margins, asked, loudest)


def _peak(found: Peak, plant: StateSpace, s: Scales, name: str) -> MemberPeak:
    receivers = plant.actuators if name == "KS" else plant.sensors
    common = not s.even and name == "KS"
    gain = found.gain * (s.command if common else 1.0)
    db = 20 * float(np.log10(gain)) if gain > 0 else -np.inf
    unit = ratio(receivers[0].unit, plant.sensors[0].unit) if common else ""
    into, out_of = strongest(found.inputs, plant.sensors), strongest(found.outputs, receivers)
    return MemberPeak(float(gain), db, found.f_hz, into, out_of, unit)


def _slowest(S: StateSpace) -> SlowestMode | None:
    poles = S.poles()
    if not poles.size:
        return None
    if S.rate_hz is None:
        s = poles
    else:
        # a pole at zero has decayed at once
        s = S.rate_hz * np.log(np.maximum(np.abs(poles), np.finfo(float).tiny)) + 1j * S.rate_hz * np.angle(poles)
    near = np.flatnonzero(s.real >= s.real.max() - ALIKE * np.abs(s.real.max()))
    slowest = complex(s[near[np.argmin(np.abs(s[near].imag))]])
    size = abs(slowest)
    return SlowestMode(slowest.real, abs(slowest.imag) / (2 * np.pi), -slowest.real / size if size else 0.0)
