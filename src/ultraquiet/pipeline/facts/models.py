"""What the stages of records and models found out, in figures and words: one frozen dataclass a stage.

Frequencies are in Hz, attenuations in dB and positive where it is quieter; `status` is a word and a sentence.
"""

from collections.abc import Mapping
from dataclasses import field

from ultraquiet.pipeline.facts.typed import Matrix, Vector, fact


@fact
class RankedModel:
    """One structure and order over all channels, judged on held-out records: medians, worst fit, loss in V²."""

    structure: str
    order: int
    median_fit_percent: float
    worst_fit_percent: float
    median_loss: float
    fpe: float
    aic: float
    aicc: float
    bic: float
    mdl: float
    ok: int
    seconds: float


@fact
class PreferredModels:
    """The best structure for all channels alike, and what each channel's own record prefers, `(ny, nu)`."""

    structure: str
    order: int
    by_channel: tuple[tuple[str, ...], ...]
    verdicts: Mapping[str, int]


@fact
class PaperFit:
    """The paper's structure fitted to one test signal; `ok` counts channels."""

    median_fit_percent: float
    worst_fit_percent: float
    status: str
    ok: int
    stable: bool
    invertible: bool
    seconds: float


@fact
class IdentificationFacts:
    """Stage `identify`: the ranking, best first, and the paper's structure by test signal.

    Nothing is ranked, and nothing preferred, where no records drive one actuator after the other.
    """

    table: tuple[RankedModel, ...]
    preferred: PreferredModels | None
    paper: Mapping[str, PaperFit]


@fact
class RecordPlant:
    """Stage `plant`, from one record that excites all actuators; `fit_percent` is `(ny,)`."""

    status: str
    fit_percent: Vector
    states: int


@fact
class ResponsePlant:
    """Stage `plant`, from periodic responses, of which lines are held out; errors are relative, over these lines.

    `modes_by_order` are frequency in Hz and damping of the poles of every order tried, `(m, 2)`.
    """

    status: str
    states: int
    order: int
    held_out_error: float
    errors_by_order: Mapping[int, float]
    modes_by_order: Mapping[int, Matrix] = field(default_factory=dict)


@fact
class WeightedPlant:
    """Stage `plant`, from periodic responses weighed by their noise, of which no line is held out.

    `misfit_in_noise` is RMS at the lines fitted, in deviations of their noise: 1 where noise alone is left.
    `criterion_by_order` is what the order was chosen by, less its least; it is no error.
    """

    status: str
    states: int
    order: int
    misfit_in_noise: float
    criterion: str
    criterion_by_order: Mapping[int, float]


@fact
class JudgedPlant:
    """Stage `plant`, from periodic responses by a method that tries no orders: `status` says what it misses."""

    status: str
    states: int


PlantFacts = RecordPlant | ResponsePlant | WeightedPlant | JudgedPlant


@fact
class RecordFit:
    """How well models simulate a record at `channel`, the sensor that moved most; `actuator` drives it (from 0)."""

    channel: int
    actuator: int = 0
    fit_percent: Mapping[str, float]
    clipped_samples: int


@fact
class Agreement:
    """The largest differences of two responses over a band."""

    band_hz: tuple[float, float]
    diagonal_gain_db: float
    diagonal_phase_deg: float
    median_gain_db: float


@fact
class ResidualFacts:
    """Median p-values over the channels of residuals on held-out records."""

    whiteness_p_median: float
    correlation_p_median: float


@fact
class ValidationFacts:
    """Stage `validate`; `against_bench` is there where the bench knows its own linear response."""

    records: Mapping[str, RecordFit]
    agreement: Mapping[str, Agreement]
    residuals: ResidualFacts | None
    against_bench: Mapping[str, Agreement] | None = None


@fact
class Root:
    """A pole or zero, or a conjugate pair; `outside` the unit circle, `real` and `imag` in z."""

    frequency_hz: float
    zeta: float
    outside: bool
    real: float
    imag: float


@fact
class SingularValues:
    """Singular values `(k, nf)` of the design plant and of the paper's structure."""

    plant: Matrix
    paper: Matrix | None = None


@fact
class AnalysisFacts:
    """Stage `analyse`; errors of symmetry and `dominance_db` are `(nf,)` over `f_hz`, of square plants alone."""

    f_hz: Vector
    singular_values: SingularValues
    poles: tuple[Root, ...]
    transmission_zeros: tuple[Root, ...]
    paper_zeros: tuple[tuple[Root, ...], ...] = ()
    reciprocity_error: Vector | None
    threefold_error: Vector | None
    dominance_db: Vector | None
