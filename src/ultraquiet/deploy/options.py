"""What `generate` may be asked for: how the code is made, and how much of a TMS320C31's frame it may take."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from ultraquiet._base.constraints import between, one_of, positive, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.c31.cycles import budget_at
from ultraquiet.deploy.law.form_choice import TOLERANCE
from ultraquiet.deploy.law.law import OVERRUN_LIMIT
from ultraquiet.deploy.law.realisation import FORMS
from ultraquiet.deploy.settings import collected

RAMP_S = 0.5  # ten periods of the slowest isolated tone pass in 2 s; a quarter of that keeps the start below it
MAX_STEPS = 2**24  # beyond it float32 no longer counts every step
TARGET_CODES = ("c99", "c31")


@dataclass(frozen=True, eq=False)
class CodeOptions(Shown):
    """How a law becomes code.

    Args:
        form: `modal`, `delta`, `bank`, `bank-delta`, `schur`, `dense`, or `auto`: the cheapest whose rounded response
            is within `tolerance`.
        anti_windup: correct the state by what the limits took away; `auto` when the law has an unstable pole or one
            below 1 Hz, or its commands meet a limit under `disturbance_v`, and the budget allows.
        disturbance_v: design disturbance for `auto`, what the sensors show without control, `(ny, n)` volts.
        excitation_v: limits of what may be added to the commands, like the actuators'; a tenth of those when absent.
        overrun_limit: overruns in a row that latch a fault and ramp the command out.
        ramp_s: seconds from zero to full command, and back.
        tolerance: largest relative error that `auto` accepts.
        targets: `c99` alone, or with `c31` for TMS320C31 assembly of a modal or delta law beside it, whose commands
            need limits.

    Raises:
        InputError: the setting and what it may be.

    >>> CodeOptions(form="modal", ramp_s=1.0).targets
    ('c99',)
    """

    form: str = "auto"
    anti_windup: bool | str = False
    disturbance_v: ArrayLike | None = None
    excitation_v: ArrayLike | None = None
    overrun_limit: int = OVERRUN_LIMIT
    ramp_s: float = RAMP_S
    tolerance: float = TOLERANCE
    targets: Sequence[str] = ("c99",)

    def __post_init__(self) -> None:
        one_of("deploy", "form", self.form, ("auto", *FORMS))
        if isinstance(self.targets, str) or not isinstance(self.targets, Sequence) or "c99" not in self.targets:
            raise InputError(f"deploy: 'targets' must list 'c99' and may list 'c31', got {self.targets!r}.")
        for target in self.targets:
            one_of("deploy", "targets", target, TARGET_CODES)
        between("deploy", "tolerance", self.tolerance, 0.0, 1.0)
        positive("deploy", "ramp_s", self.ramp_s, "s")
        whole("deploy", "overrun_limit", self.overrun_limit, 1, MAX_STEPS)
        if not isinstance(self.anti_windup, bool):
            one_of("deploy", "anti_windup", self.anti_windup, ("auto",))

    def ramp_steps(self, rate_hz: float) -> int:
        """Return the ramp in samples; the one that nobody chose has a sample at least, however slow the rate.

        Raises:
            InputError: less than one sample, or more than float32 counts.
        """
        steps = round(self.ramp_s * rate_hz)
        return whole("deploy", "ramp_s in samples", max(steps, int(self.ramp_s == RAMP_S)), 1, MAX_STEPS)


@dataclass(frozen=True)
class C31Budget(Shown):
    """Instructions of a TMS320C31's frame that a law may take.

    Args:
        cycles: instructions a frame may take; when absent, the share of the law's own frame that the paper leaves to
            its laws: 2800 at 3500 Hz.
        enforce: refuse a law that does not fit.
        share: refuse a law that takes more than this share of `cycles`, 0 to 1.

    Raises:
        InputError: an impossible budget or share.

    >>> C31Budget(share=0.5).allowed_at(3500.0)
    1400.0
    """

    cycles: int | None = None
    enforce: bool = False
    share: float | None = None

    def __post_init__(self) -> None:
        if self.cycles is not None:
            whole("deploy", "budget_cycles", self.cycles, 1)
        if self.share is not None:
            between("deploy", "budget_share", self.share, 0.0, 1.0)

    @property
    def binding(self) -> bool:
        """True when a law that takes more is refused."""
        return self.enforce or self.share is not None

    def cycles_at(self, rate_hz: float) -> int:
        """Return the instructions of a frame at this rate."""
        return budget_at(rate_hz) if self.cycles is None else self.cycles

    def allowed_at(self, rate_hz: float) -> float:
        """Return the instructions that a law of this rate may take."""
        return self.cycles_at(rate_hz) * (1.0 if self.share is None else self.share)


# Settings of `generate` that stand in the budget, by the names it takes them under.
BUDGET_NAMES = {"budget_cycles": "cycles", "enforce_budget": "enforce", "budget_share": "share"}


def options_and_budget(
    options: CodeOptions | None, c31: C31Budget | None, settings: Mapping[str, Any]
) -> tuple[CodeOptions, C31Budget]:
    """Return options and budget, either as they are or made of single settings.

    Raises:
        InputError: a setting that is none, or one given beside the object that holds it.
    """
    of_budget = {name: settings[name] for name in BUDGET_NAMES if name in settings}
    of_code = {name: value for name, value in settings.items() if name not in of_budget}
    code = collected("deploy", "options", options, CodeOptions, of_code, also=tuple(BUDGET_NAMES))
    return code, collected("deploy", "c31", c31, C31Budget, of_budget, names=BUDGET_NAMES)
