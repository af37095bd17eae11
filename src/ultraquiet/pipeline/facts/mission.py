"""What was found of what laws are for: the payload, drawn benches, a law as it comes on."""

from collections.abc import Mapping
from dataclasses import field

from ultraquiet.pipeline.facts.typed import Vector, fact


@fact
class PayloadForce:
    """A force on the payload itself, where sensors elsewhere help little: reduction of the RMS, and its worst part."""

    source: str
    level: float
    reduction_db: float
    worst_db: float
    worst_hz: float


@fact
class PayloadLoop:
    """What a law does for the payload of one unit while the base is shaken by noise over `band_hz`.

    `reduction_db` is of the RMS of all the payload's sensors together over the band, those with frequencies over
    theirs where the band holds them; RMS in `unit`, `silent_rms` of the sensors alone at rest. `worst_db` is the least
    reduction of any half hertz. `through`: what ran in the loop. `tones_db` by frequency, in Hz.
    """

    source: str
    level: float
    unit: str
    band_hz: tuple[float, float]
    through: str
    reduction_db: float
    broadband_5_100_db: float | None
    broadband_10_100_db: float | None
    each_db: Mapping[str, float]
    open_rms: float
    closed_rms: float
    silent_rms: float
    worst_db: float
    worst_hz: float
    tones_db: Mapping[str, float] = field(default_factory=dict[str, float])
    force: PayloadForce | None = None


@fact
class NoPayload:
    """A unit on which the payload was not listened to; `status` says why."""

    status: str


@fact
class PayloadCurves:
    """Payload over base, and RMS of the payload up to each frequency, without the law and with it, over `f_hz`."""

    f_hz: Vector
    open_transmissibility: Vector
    closed_transmissibility: Vector
    open_cumulative: Vector
    closed_cumulative: Vector


@fact
class PayloadFacts:
    """Stage `payload`: one law on every unit, and what is drawn of it."""

    units: Mapping[str, PayloadLoop | NoPayload]
    curves: Mapping[str, PayloadCurves]
