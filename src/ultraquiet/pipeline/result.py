"""Everything a study knows when it is through."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ultraquiet.design.weights.loop_weights import LoopWeights
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.code import DeploymentFacts
from ultraquiet.pipeline.facts.limits import LimitFacts
from ultraquiet.pipeline.facts.loops import DesignFacts, LoopFacts
from ultraquiet.pipeline.facts.mission import CampaignCurves, CampaignFacts, CommissioningFacts, PayloadFacts
from ultraquiet.pipeline.facts.models import AnalysisFacts, IdentificationFacts, PlantFacts, ValidationFacts
from ultraquiet.pipeline.facts.requirements import RequirementsFacts
from ultraquiet.pipeline.preflight import LoopPlan
from ultraquiet.pipeline.stage import Outcome
from ultraquiet.pipeline.study import Study
from ultraquiet.values import FrequencyResponse, PolynomialMatrix, Record, StateSpace


@dataclass(frozen=True)
class StudyResult:
    """The outcomes of all stages, what report and summary are written from; designs, loops and code by controller."""

    study: Study
    bench: Any
    plan: LoopPlan
    records: Mapping[str, Record]
    identification: Outcome[IdentificationFacts]
    plant: Outcome[PlantFacts]
    validation: Outcome[ValidationFacts]
    analysis: Outcome[AnalysisFacts]
    designs: Mapping[str, Outcome[DesignFacts]]
    loops: Mapping[str, Outcome[LoopFacts]]
    deployment: Mapping[str, DeploymentFacts]
    limits: Outcome[LimitFacts]
    requirements: RequirementsFacts | None = None
    commissioning: Outcome[CommissioningFacts] | None = None
    campaign: tuple[CampaignFacts, CampaignCurves] | None = None
    payload: Mapping[str, Outcome[PayloadFacts]] = field(default_factory=dict[str, Outcome[PayloadFacts]])

    @property
    def design_plant(self) -> StateSpace:
        """The model that controllers are designed from."""
        return self.plant.values[stored.PLANT]

    @property
    def preferred_model(self) -> PolynomialMatrix | None:
        """The matrix in which every channel has the model its held-out record prefers; None where none was ranked."""
        return self.identification.values.get(stored.PREFERRED)

    @property
    def laws(self) -> dict[str, StateSpace]:
        """The laws that run, by controller; none where a design found none."""
        return {name: outcome.values[name] for name, outcome in self.designs.items() if name in outcome.values}

    def loop_weights(self, controller: str) -> LoopWeights | None:
        """Return what a design's cost puts on S, T and KS; None where it puts nothing there."""
        functions = self.designs[controller].facts.weights_on
        values = self.designs[controller].values
        return (
            LoopWeights(**{each: values[stored.weight(controller, each)] for each in functions}) if functions else None
        )

    @property
    def response(self) -> FrequencyResponse | None:
        """The response that the design model was fitted to; None where it was fitted to a record."""
        return self.plant.values.get(stored.RESPONSE)

    def paper_model(self, signal: str) -> PolynomialMatrix:
        """Return the paper's structure fitted to a test signal."""
        return self.identification.values[stored.paper(signal)]

    def simulated(self, record: str) -> Record | None:
        """Return what models say to a record, one output a model; None where the study has no such record."""
        return self.validation.values.get(stored.simulated(record))

    def sensitivity(self, controller: str, unit: str) -> FrequencyResponse | None:
        """Return the sensitivity matrix measured on a unit; None where the loop did not settle."""
        return self.loops[controller].values.get(stored.sensitivity(controller, unit))

    def under_tone(self, controller: str, tone_hz: float) -> tuple[Record, Record] | None:
        """Return the records of the closed and of the open loop under a tone on the first unit, where there are any."""
        values = self.loops[controller].values
        closed, opened = stored.under_tone(controller, tone_hz), stored.open_under_tone(controller, tone_hz)
        return (values[closed], values[opened]) if closed in values and opened in values else None
