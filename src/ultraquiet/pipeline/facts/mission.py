"""What was found of what laws are for: the payload, drawn benches, a law as it comes on."""

from collections.abc import Iterator, Mapping
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


@fact
class WorstCase:
    """A case of a campaign that is kept, with the command that evaluates it again."""

    case: int
    seed: int
    unit: str
    stable: bool
    attenuation_db: float
    peak_db: float
    status: str
    cause: str | None = None
    replay: str


@fact
class MeasuredCases:
    """How many benches of a campaign were measured besides: stable ones, and the spread of each figure."""

    benches: int
    stable: int
    attenuation_db: Mapping[str, float]
    peak_db: Mapping[str, float]


@fact
class CampaignFacts:
    """`campaign.json`: one law on `benches` drawn ones; least, 5 %, median, 95 % and most of each figure.

    `drivers`: figure -> drawn parameter -> Spearman's rank correlation, those beyond chance. `by_unit` holds the share
    of stable loops and the same spreads for each unit. `measured` is of those that were also measured.
    """

    law: str
    on: str
    benches: int
    first_seed: int
    band_hz: tuple[float, float]
    stable: int
    stable_share: float
    stable_interval: tuple[float, float]
    attenuation_db: Mapping[str, float]
    peak_db: Mapping[str, float]
    by_unit: Mapping[str, Mapping[str, Mapping[str, float]]]
    drivers: Mapping[str, Mapping[str, float]]
    worst: tuple[WorstCase, ...]
    lines_missing: int = 0
    measured: MeasuredCases | None = None
    campaign: str
    status: str

    def groups(self) -> Iterator[tuple[str, float, Mapping[str, Mapping[str, float]]]]:
        """Yield name, share of stable loops and spread of each figure: of every unit, and of what was measured too."""
        for unit, figures in self.by_unit.items():
            yield unit, figures["stable_share"]["share"], figures
        heard = self.measured
        if heard is not None:
            spreads = {"attenuation_db": heard.attenuation_db, "peak_db": heard.peak_db}
            yield f"{heard.benches} measured", heard.stable / heard.benches, spreads


@fact
class CampaignCurves:
    """What is drawn of a campaign: figures of every case by unit, and the worst direction of two cases over `f_hz`."""

    attenuation_db: Mapping[str, Vector]
    peak_db: Mapping[str, Vector]
    f_hz: Vector
    median_case_db: Vector | None = None
    worst_case_db: Vector | None = None


@fact
class CommissionedStep:
    """One gain of a law that came on: margins and peaks by end; `next_disk` was foreseen at `next_gain`."""

    gain: float
    disk: Mapping[str, float]
    disk_hz: Mapping[str, float]
    peak_db: Mapping[str, float]
    reduction_db: float | None
    next_disk: float | None = None
    next_gain: float | None = None


@fact
class CommissionedUnit:
    """How a law came on on one unit; `gain` is the last share of it that ran."""

    status: str
    ok: bool
    gain: float
    steps: tuple[CommissionedStep, ...]


@fact
class CommissioningFacts:
    """Stage `commission`: one law on every unit, without a model."""

    law: str
    margin: float
    units: Mapping[str, CommissionedUnit]
