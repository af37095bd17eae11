"""The code of a law: generated, compiled and compared, and what is known of it as facts."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import StorageError, UltraquietError
from ultraquiet.pipeline.facts.code import CodeFacts, DeploymentFacts, NoCode, WholeNumberFacts, WordFormatFacts
from ultraquiet.pipeline.stage import Outcome
from ultraquiet.pipeline.tables.code import Deploy
from ultraquiet.values import StateSpace

if TYPE_CHECKING:
    from ultraquiet.deploy import Deployment, FixedDeployment

# What a study compares of every controller's code, here and on the processors it names; `ultraquiet deploy` takes more
# steps, and random bits besides.
COMPARED_STEPS = 5_000


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
    try:
        code = written(law, limits, folder / name, settings, plant)
        verified = _proved(code, settings, tones_hz)
    except StorageError:
        raise  # a full disk says nothing of the law
    except UltraquietError as error:
        return Outcome({}, NoCode(status=f"refused: {error}"))
    return Outcome({}, generated(code, verified))


def written(
    law: StateSpace, limits: FloatArray, folder: Path, settings: Deploy, plant: StateSpace | None = None
) -> "Deployment | FixedDeployment":
    """Write a law as the study's table asks."""
    from ultraquiet import deploy

    asked: dict[str, Any] = options(settings)
    if settings.whole_numbers:
        return deploy.generate_fixed(
            law, folder, settings.precision, plant=plant, **(asked | full_ranges(limits, settings))
        )
    return deploy.generate(law, folder, settings.precision, limits_v=limits, plant=plant, **asked)


def options(settings: Deploy) -> dict[str, Any]:
    """Return what the study's table says of `deploy.CodeOptions`, or for whole numbers of `deploy.FixedOptions`."""
    if settings.whole_numbers:
        return {"form": settings.form}
    return {"form": settings.form, "anti_windup": settings.anti_windup, "targets": tuple(settings.targets)}


def full_ranges(limits: ArrayLike | None, settings: Deploy) -> dict[str, Any]:
    """Return the ranges of whole numbers: one size for all readings, and the limits of the commands.

    None leaves them to the law's own channels.

    >>> full_ranges([[-5.0, 5.0], [-2.0, 3.0]], Deploy(precision="q15", range=10.0))
    {'input_v': 10.0, 'output_v': [[-5.0, 5.0], [-2.0, 3.0]]}
    """
    return {"input_v": settings.range, "output_v": None if limits is None else np.asarray(limits, dtype=float).tolist()}


def _proved(code: "Deployment | FixedDeployment", settings: Deploy, tones_hz: Sequence[float]) -> str:
    """Return what comparing the code with its twin came to."""
    from ultraquiet import deploy

    if isinstance(code, deploy.FixedDeployment):
        return str(code.verify(steps=COMPARED_STEPS).status)
    proof = code.verify(
        steps=COMPARED_STEPS, targets=tuple(settings.processors), fuzz_steps=0, tones_hz=tones_hz or None
    )
    return str(proof.status)


def generated(code: "Deployment | FixedDeployment", verification: str) -> CodeFacts | WholeNumberFacts:
    """Return what is known of generated code as facts; what was not measured is left out of tables inside them."""
    from ultraquiet import deploy

    kind = WholeNumberFacts if isinstance(code, deploy.FixedDeployment) else CodeFacts
    names = [field.name for field in fields(kind) if field.name in code.tables]
    figures = {name: _known(code.tables[name]) for name in names}
    if kind is CodeFacts:
        figures |= {f"{what}_on": counted(code.tables, what) for what in ("instructions", "output_instructions")}
    formats = tuple(WordFormatFacts(**asdict(each), words=str(each)) for each in code.word_formats)
    return kind(**figures, word_formats=formats, status=str(code.status), verification=verification)


def counted(tables: Mapping[str, Any], what: str) -> dict[str, int]:
    """Return a count of `Deployment.tables` by the name of each processor that ran the code.

    >>> counted({"cortex_m4f_instructions": 1719, "cortex_m7_instructions": None}, "instructions")
    {'cortex-m4f': 1719}
    """
    from ultraquiet.deploy.toolchain.targets import TARGETS

    counts = {name: tables.get(f"{target.key}_{what}") for name, target in TARGETS.items()}
    return {name: count for name, count in counts.items() if count is not None}


def _known(value: Any) -> Any:
    return {k: v for k, v in value.items() if v is not None} if isinstance(value, Mapping) else value
