"""What the stage of code found out, in figures and words: the code of one law, or why there is none."""

from collections.abc import Mapping
from typing import Literal

from ultraquiet.pipeline.facts.typed import fact
from ultraquiet.values.status import CODE_FAULTS, StatusWord


@fact
class WordFormatFacts:
    """The words that the code keeps a quantity in, see `deploy.WordFormat`; `words` say the same to a reader."""

    quantity: Literal["coefficients", "states", "sums", "readings and commands"]
    bits: int
    significant: int | None = None
    fractional: tuple[int, int] | None = None
    words: str


class Proved:
    """What a proof of code came to, and what rounding did to its law, of the facts that hold both."""

    status: str
    verification: str

    @property
    def verdict(self) -> str:
        """What the proof of the code came to; what rounding did where that is too much and the proof found no fault."""
        return self.status if self._inexact and not self._faulty else self.verification

    @property
    def failed(self) -> bool:
        """True where the proof found a fault, or rounding changes too much; what could not be run here is none."""
        return self._faulty or self._inexact

    @property
    def _faulty(self) -> bool:
        return self.verification.partition(":")[0] in CODE_FAULTS

    @property
    def _inexact(self) -> bool:
        return self.status.partition(":")[0] == StatusWord.INEXACT.value


@fact
class CodeFacts(Proved):
    """Stage `deploy`: see `deploy.Deployment.tables`; None is what could not be measured here.

    `instructions_on` and `output_instructions_on` hold what was counted on every processor of the study. Those of the
    Cortex-M7 and M4F stand beside them once more, by the names that summaries have had from the first.
    """

    states: int
    form: str
    precision: str
    anti_windup: bool
    c31_cycles: int
    c31_kernel_cycles: int
    c31_output_cycles: int
    c31_budget: int
    c31_budget_share: float
    c31_fits_the_model: bool
    c31_words: int
    c31_internal_words: int
    c31_largest_order: int
    cortex_m7_instructions: int | None
    coefficients: int
    response_error: float | None
    forms_tried: Mapping[str, float]
    eigenvector_condition: float | None
    bit_exact: bool | None
    anti_windup_because: str
    flash_bytes: int
    ram_bytes: int
    stack_bytes: int | None
    flash_from: str
    cortex_m7_output_instructions: int | None = None
    instructions_on: Mapping[str, int] | None = None
    output_instructions_on: Mapping[str, int] | None = None
    bit_exact_on: Mapping[str, bool] | None = None
    latency_us: Mapping[str, float] | None = None
    cortex_m4f_instructions: int | None = None
    cortex_m4f_output_instructions: int | None = None
    c31_vectors: str | None = None
    measurements: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    word_formats: tuple[WordFormatFacts, ...] = ()
    status: str
    verification: str


@fact
class WholeNumberFacts(Proved):
    """Stage `deploy` of a study whose precision is `q31` or `q15`: see `deploy.FixedDeployment.tables`."""

    states: int
    form: str
    precision: Literal["q31", "q15"]
    scaling: str
    response_error: float
    state_bound: float
    accumulator_bound: float
    noise_v: float
    noise_bound_v: float
    multiply_adds: int
    coefficient_bytes: int
    bit_exact: bool | None
    measurements: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    word_formats: tuple[WordFormatFacts, ...] = ()
    status: str
    verification: str

    @property
    def coefficients(self) -> int:
        """How many stored words."""
        return self.coefficient_bytes // (4 if self.precision == "q31" else 2)


@fact
class NoCode:
    """Stage `deploy`, where no code was generated; `status` says why, `failed` whether there should be some."""

    status: str
    failed: bool = True

    @property
    def verdict(self) -> str:
        """Why there is no code."""
        return self.status


DeploymentFacts = CodeFacts | WholeNumberFacts | NoCode
