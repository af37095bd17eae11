"""The code of a law: generated, compiled and compared, and what is known of it as facts."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import StorageError, UltraquietError
from ultraquiet.pipeline.facts.loops import CodeFacts, DeploymentFacts, NoCode, WordFormatFacts
from ultraquiet.pipeline.stage import Outcome
from ultraquiet.pipeline.study import Deploy
from ultraquiet.values import StateSpace

if TYPE_CHECKING:
    from ultraquiet.deploy import Deployment

# What a study compares of every controller's code, here and on an emulated Cortex-M7; `ultraquiet deploy` takes more
# steps, the Cortex-M4F and random bits besides.
COMPARED_STEPS, TARGETS = 5_000, ("cortex-m7",)


def deployed(
    name: str,
    law: StateSpace,
    plant: StateSpace,
    limits: FloatArray,
    folder: Path,
    settings: Deploy,
    tones_hz: Sequence[float],
) -> Outcome[DeploymentFacts]:
    """Generate, compile and compare the controller's code; what cannot be done is said, not raised.

    Forms and rounding are judged by what they do to the loop with the identified plant.
    """
    from ultraquiet import deploy

    try:
        code = deploy.generate(law, folder / name, settings.precision, limits_v=limits, plant=plant)
        verified = code.verify(steps=COMPARED_STEPS, targets=TARGETS, fuzz_steps=0, tones_hz=tones_hz or None)
    except StorageError:
        raise  # a full disk says nothing of the law
    except UltraquietError as error:
        return Outcome({}, NoCode(status=f"refused: {error}"))
    return Outcome({}, generated(code, str(verified.status)))


def generated(code: "Deployment", verification: str) -> CodeFacts:
    """Return what is known of generated code as facts; what was not measured is left out of tables inside them."""
    names = [field.name for field in fields(CodeFacts) if field.name in code.tables]
    figures = {name: _known(code.tables[name]) for name in names}
    formats = tuple(WordFormatFacts(**asdict(each), words=str(each)) for each in code.word_formats)
    return CodeFacts(**figures, word_formats=formats, status=str(code.status), verification=verification)


def _known(value: Any) -> Any:
    return {k: v for k, v in value.items() if v is not None} if isinstance(value, Mapping) else value
