"""`summary.json`: the study's numbers under the names that the contract fixes."""

import json
from collections.abc import Mapping
from dataclasses import field, fields

from ultraquiet._base.provenance import versions
from ultraquiet.pipeline.facts.code import DeploymentFacts
from ultraquiet.pipeline.facts.limits import BandLimit, DesignLimit, NoDistance, RefusedBand
from ultraquiet.pipeline.facts.loops import (
    DesignFacts,
    DesignSummary,
    LoopMargins,
    Reduction,
    StableLoop,
    UnstableLoop,
)
from ultraquiet.pipeline.facts.mission import CampaignFacts, CommissioningFacts, NoPayload, PayloadLoop
from ultraquiet.pipeline.facts.models import Agreement, PaperFit, PlantFacts, PreferredModels, RankedModel
from ultraquiet.pipeline.facts.requirements import RequirementsFacts
from ultraquiet.pipeline.facts.typed import fact, finite, schema_of, to_plain
from ultraquiet.pipeline.result import StudyResult


@fact
class IdentificationSummary:
    """The ranking, the paper's structure, each model against the bench, the plant that designs use."""

    table: tuple[RankedModel, ...]
    preferred: PreferredModels | None
    paper: Mapping[str, PaperFit]
    against_bench: Mapping[str, Agreement] | None
    plant: PlantFacts


@fact
class ReducedDesignSummary(DesignSummary):
    """A controller that was reduced."""

    reduction: Reduction


@fact
class LimitSummary:
    """What no controller can reach, and Bode's integral of every loop as the bench shows it, by controller and unit."""

    bands: tuple[BandLimit | RefusedBand, ...]
    designs: Mapping[str, DesignLimit | NoDistance]
    mean_log_sensitivity_db: Mapping[str, Mapping[str, float]]


@fact
class Summary:
    """The whole summary; `closed_loop` by controller and unit, `margins` of the law that runs by controller and end.

    `payload` by controller and unit; `lines_missing`: of all sensitivities, not measured.
    """

    title: str
    identification: IdentificationSummary
    design: Mapping[str, DesignSummary | ReducedDesignSummary]
    margins: Mapping[str, Mapping[str, LoopMargins]] = field(default_factory=dict[str, Mapping[str, LoopMargins]])
    closed_loop: Mapping[str, Mapping[str, StableLoop | UnstableLoop]]
    deployment: Mapping[str, DeploymentFacts]
    limits: LimitSummary
    versions: Mapping[str, str]
    seed: int
    lines_missing: int = 0
    requirements: RequirementsFacts | None = None
    payload: Mapping[str, Mapping[str, PayloadLoop | NoPayload]] = field(
        default_factory=dict[str, Mapping[str, PayloadLoop | NoPayload]]
    )
    campaign: CampaignFacts | None = None
    commissioning: CommissioningFacts | None = None

    @property
    def failures(self) -> tuple[str, ...]:
        """One sentence for each stage that did not come to what comes after it."""
        lawless = [
            f"design {name}: {each.status}"
            for name, each in self.design.items()
            if name not in self.closed_loop and name not in self.deployment
        ]
        return (*lawless, *(f"code {name}: {each.verdict}" for name, each in self.deployment.items() if each.failed))

    @property
    def ok(self) -> bool:
        """True when every stage ran to its end and every requirement is met."""
        return not self.failures and (self.requirements is None or self.requirements.ok)


def summarise(result: StudyResult) -> Summary:
    """Return the summary: identification, design, closed loop, deployment, limits, versions, seed and requirements."""
    identification = result.identification.facts
    limits = result.limits.facts
    return Summary(
        title=result.study.study.title,
        identification=IdentificationSummary(
            table=identification.table,
            preferred=identification.preferred,
            paper=identification.paper,
            against_bench=result.validation.facts.against_bench,
            plant=result.plant.facts,
        ),
        design={name: _design(outcome.facts) for name, outcome in result.designs.items()},
        margins={name: outcome.facts.law_margins for name, outcome in result.designs.items()},
        closed_loop={name: outcome.facts.units for name, outcome in result.loops.items()},
        deployment=result.deployment,
        limits=LimitSummary(
            bands=limits.bands, designs=limits.designs, mean_log_sensitivity_db=_mean_log_sensitivity(result)
        ),
        versions=versions(),
        seed=result.study.study.seed,
        requirements=result.requirements,
        commissioning=None if result.commissioning is None else result.commissioning.facts,
        campaign=None if result.campaign is None else result.campaign[0],
        payload={name: outcome.facts.units for name, outcome in result.payload.items()},
        lines_missing=sum(
            loop.lines_missing
            for outcome in result.loops.values()
            for loop in outcome.facts.units.values()
            if isinstance(loop, StableLoop)
        ),
    )


def _mean_log_sensitivity(result: StudyResult) -> dict[str, dict[str, float]]:
    return {
        name: {
            unit: loop.mean_log_sensitivity_db
            for unit, loop in outcome.facts.units.items()
            if isinstance(loop, StableLoop)
        }
        for name, outcome in result.loops.items()
    }


def _design(facts: DesignFacts) -> DesignSummary:
    common = {field.name: getattr(facts, field.name) for field in fields(DesignSummary)}
    if facts.reduction is None:
        return DesignSummary(**common)
    return ReducedDesignSummary(**common, reduction=facts.reduction)


def to_json(summary: Summary) -> bytes:
    """Return the summary as JSON; what is not a finite number is null there, as JSON knows no other word for it."""
    return json.dumps(finite(to_plain(summary)), indent=1).encode()


def schema_text() -> str:
    """Return the JSON schema of `summary.json` as it stands in the documentation."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema_of(Summary)}
    return json.dumps(schema, indent=1) + "\n"
