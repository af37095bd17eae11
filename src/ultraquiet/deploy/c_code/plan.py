"""What a law's code is made of, worked out once: every generator, target, export and frame reads it here."""

from dataclasses import dataclass
from pathlib import Path

from ultraquiet.deploy.c_code.self_test import ScriptRow, generator_scales, self_test
from ultraquiet.deploy.law.coefficients import CoefficientSection, numbers, sections
from ultraquiet.deploy.law.law import Law, Rounded


@dataclass(frozen=True, eq=False)
class CodePlan:
    """A law laid out as code.

    `sections` are its coefficients in the code's order, `coefficients` all of them in one row: the bank. `quiet` and
    `loud` scale the self-test's random numbers, whole ones of 24 bits, to measurements in volts that keep every command
    inside its limits, and that meet most limits. `script` is the self-test, each call with the digest expected after
    it. `model_hash` names the controller that the law was rounded from.
    """

    law: Law
    model_hash: str
    sections: tuple[CoefficientSection, ...]
    coefficients: Rounded
    quiet: float
    loud: float
    script: tuple[ScriptRow, ...]


def plan_code(law: Law, model_hash: str = "") -> CodePlan:
    """Return the plan of a law's code."""
    quiet, loud = generator_scales(law)
    script = tuple(self_test(law, quiet, loud))
    return CodePlan(law, model_hash, tuple(sections(law)), numbers(law), quiet, loud, script)


class GeneratedCode:
    """A folder of generated C99 and the plan that it was written from."""

    def __init__(self, plan: CodePlan, folder: Path) -> None:
        self.plan, self.folder = plan, folder

    @property
    def law(self) -> Law:
        """The law with its rounded coefficients."""
        return self.plan.law

    @property
    def model_hash(self) -> str:
        """SHA-256 of the controller that the law was rounded from."""
        return self.plan.model_hash
