"""What the stage of limits found out, in figures and words: one frozen dataclass a stage.

Frequencies are in Hz, attenuations in dB and positive where it is quieter; `status` is a word and a sentence.
"""

from collections.abc import Mapping

from ultraquiet.pipeline.facts.typed import fact

Band = tuple[float, float]


@fact
class RefusedBand:
    """A band whose limit could not be had; `status` says why."""

    band_hz: Band
    peak_db: float
    control_gain: float
    status: str


@fact
class BandLimit:
    """What can be reached over a band at a price, and what cannot; `binding` are Hz over which a demand is used up.

    `robust_attenuation_db` and `robust_bound_db` are those of every plant off by `uncertainty`, a relative error.
    """

    band_hz: Band
    peak_db: float
    control_gain: float
    attenuation_db: float
    bound_db: float
    binding: Mapping[str, tuple[Band, ...]]
    status: str
    uncertainty: float = 0.0
    robust_attenuation_db: float | None = None
    robust_bound_db: float | None = None
    robust_status: str | None = None


@fact
class NoDistance:
    """A design whose distance to its limit could not be had; `status` says why."""

    status: str


@fact
class DesignLimit:
    """A design beside the limit at its own price; `left_db` is what another one could add at most.

    `robust_alone_db` and `robust_limit_db` are what can be reached, and what cannot, at that price on every plant off
    by `uncertainty`, a relative error.
    """

    band_hz: Band
    attenuation_db: float
    peak_db: float
    control_gain: float
    limit_db: float
    left_db: float
    alone_db: float | None
    status: str
    uncertainty: float = 0.0
    robust_alone_db: float | None = None
    robust_limit_db: float | None = None


@fact
class LimitFacts:
    """Stage `limits`: bands from the broadest, designs by name."""

    bands: tuple[BandLimit | RefusedBand, ...]
    designs: Mapping[str, DesignLimit | NoDistance]
