"""A generated folder of whole-number code: its law in control, its proof."""

import time
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet._base.constraints import whole
from ultraquiet._base.errors import ToolError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.fixed_point.compiled import FixedCode, self_test_passes
from ultraquiet.deploy.fixed_point.law import FixedLaw, Whole
from ultraquiet.deploy.fixed_point.twin import FixedTwin
from ultraquiet.deploy.fixed_point.word_formats import fixed_formats
from ultraquiet.deploy.law.word_length import WordFormat
from ultraquiet.deploy.toolchain import compiler
from ultraquiet.deploy.verification.verify import MOST_STEPS
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

STEPS = 20_000


@dataclass(frozen=True)
class FixedVerification:
    """Whether the compiled code gave the twin's words; `bit_exact` is None when nothing could be compared."""

    status: Status
    bit_exact: bool | None
    steps: int = 0
    self_test: bool | None = None
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """True when every word was the same and the self-test passed."""
        return self.status.ok


class FixedDeployment(Shown):
    """A generated folder of whole-number code; `tables` holds its figures, `status` a sentence on the law."""

    def __init__(self, law: FixedLaw, folder: Path, tables: dict[str, Any], status: Status) -> None:
        self.law, self.folder, self.tables, self.status = law, folder, tables, status

    @property
    def quantised(self) -> StateSpace:
        """The linear law with its rounded coefficients, volts to volts."""
        return self.law.state_space()

    @property
    def word_formats(self) -> tuple[WordFormat, ...]:
        """How many bits the code keeps of each quantity, and where their point stands."""
        return fixed_formats(self.law)

    @cached_property
    def controller(self) -> "FixedTwin | FixedCode":
        """The law in control, from rest: the compiled code, without a compiler its twin."""
        cc = compiler.compiler()
        return FixedTwin(self.law) if cc is None else FixedCode(self.law, self.folder, cc)

    def verify(self, steps: int = STEPS, seed: int = 0) -> FixedVerification:
        """Compile the code and compare `steps` samples over the whole range, and the self-test, with the twin."""
        whole("FixedDeployment.verify", "steps", steps, 1, MOST_STEPS)
        whole("FixedDeployment.verify", "seed", seed, 0)
        cc = compiler.compiler()
        if cc is None:
            return FixedVerification(
                Status(StatusWord.NO_COMPILER, "No C compiler was found (cc, gcc, clang or $CC)."), None
            )
        began = time.perf_counter()
        try:
            code = FixedCode(self.law, self.folder, cc)
            passed = self_test_passes(self.law, self.folder, cc)
        except ToolError as refusal:
            return FixedVerification(Status(StatusWord.NOT_COMPILED, str(refusal)), None)
        y = measurements(self.law, steps, seed)
        same = bool(np.array_equal(code.run(y), FixedTwin(self.law).run(y)))
        self.tables["bit_exact"] = same and passed
        word = StatusWord.DIFFERS if not same else StatusWord.OK if passed else StatusWord.SELF_TEST_FAILED
        sentences = {
            StatusWord.OK: f"All words of {steps} steps and of the self-test are the twin's, compiled by {cc}.",
            StatusWord.DIFFERS: f"Words of {steps} steps differ from the twin's.",
            StatusWord.SELF_TEST_FAILED: f"{steps} steps agree but the shipped self-test does not pass here.",
        }
        return FixedVerification(
            Status(word, sentences[word]), same and passed, steps, passed, time.perf_counter() - began
        )


def measurements(law: FixedLaw, steps: int, seed: int) -> Whole:
    """Return words over the whole range: white noise, slow and fast square waves of full size, silence."""
    rng = np.random.default_rng(seed)
    top = law.top
    y = rng.integers(-top, top + 1, (law.inputs, steps))
    square = top * (1 - 2 * ((np.arange(steps) // rng.integers(1, 400, (law.inputs, 1))) % 2))
    kind = (np.arange(steps) // 500) % 3
    return np.where(kind == 0, y, np.where(kind == 1, square, y // 1024))
