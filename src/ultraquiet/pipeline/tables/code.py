"""`[deploy]` of a study file: how laws become code."""

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from ultraquiet._base.tables import Strict
from ultraquiet.deploy.law.law import DTYPES
from ultraquiet.deploy.toolchain.targets import TARGETS
from ultraquiet.pipeline.tables.numbers import Positive

WHOLE_FORMS = ("modal", "delta")  # forms that whole numbers come in


def _emulated(name: str) -> str:
    if name not in TARGETS:
        raise ValueError(f"an emulated processor is one of {', '.join(TARGETS)}")
    return name


def _switched(value: object) -> object:
    if not isinstance(value, bool) and value != "auto":  # 1 and 0 would pass for true and false
        raise ValueError(f"it is true, false or 'auto', got {value!r}")
    return value


Switch = Annotated[Literal[False, True, "auto"], BeforeValidator(_switched)]
Processor = Annotated[str, AfterValidator(_emulated)]


class Deploy(Strict):
    """`[deploy]`: how laws become code; see `deploy.CodeOptions` and, for `q31` and `q15`, `deploy.FixedOptions`.

    `limits`: the largest command, one number or one an actuator, in their unit, where actuators have no limits of their
    own; when absent there, the largest that the records hold: nothing louder was ever tried. `range`: the largest
    reading, in the sensors' unit, for whole numbers; the sensors' own when absent. `targets`: `c31` writes TMS320C31
    assembly beside the C99. `processors`: those emulated on which the code is proved and counted.
    """

    precision: Literal["float32", "float64", "q31", "q15"] = "float32"
    form: Literal["auto", "modal", "delta", "bank", "bank-delta", "schur", "dense"] = "auto"
    anti_windup: Switch = False
    targets: list[Literal["c99", "c31"]] = Field(default_factory=lambda: ["c99"], min_length=1)
    processors: list[Processor] = Field(default_factory=lambda: ["cortex-m7"])
    limits: Positive | Annotated[list[Positive], Field(min_length=1)] | None = None
    range: Positive | None = None

    @property
    def whole_numbers(self) -> bool:
        """True for code of whole numbers."""
        return self.precision not in DTYPES

    @model_validator(mode="after")
    def _together(self) -> "Deploy":
        """Refuse what code of this precision does not know."""
        if "c99" not in self.targets:
            raise ValueError("'targets' must list 'c99' and may list 'c31'")
        if not self.whole_numbers:
            if self.range is not None:
                raise ValueError(f"'range' is for q31 and q15; code in {self.precision} takes any reading")
            return self
        if self.anti_windup or "c31" in self.targets:
            raise ValueError(f"code in {self.precision} has no anti-windup and no C31 assembly; take float32")
        if "processors" in self.model_fields_set and self.processors:
            raise ValueError(f"code in {self.precision} is proved here only; leave 'processors' away")
        if self.form not in ("auto", *WHOLE_FORMS):
            raise ValueError(f"whole numbers come in modal and delta form, not in {self.form}")
        return self
