"""The stages that make the models of a study, and say what they are worth."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

from ultraquiet._base.beside import Said
from ultraquiet._base.shown.line import counted
from ultraquiet.pipeline import identification, validation
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.models import AnalysisFacts, IdentificationFacts, PlantFacts, ValidationFacts
from ultraquiet.pipeline.identification import of_unit
from ultraquiet.pipeline.making.designs import identify_key, identify_stage, plant_key, takes_several
from ultraquiet.pipeline.preflight import LoopPlan, as_unit
from ultraquiet.pipeline.stage import Cache, Outcome
from ultraquiet.pipeline.study import Study
from ultraquiet.values import PolynomialMatrix, Record, StateSpace

Say = Callable[[str], object]


@dataclass(frozen=True)
class ModelStages:
    """A study, the bench it is made on and its records: the models that are designed on, and what all are worth.

    `say` is told one line per finished stage. `bench_key` is what defines the bench (`store.identity`), for the stages
    that measure on it.
    """

    study: Study
    cache: Cache
    bench: Any
    records: Mapping[str, Record]
    say: Say
    bench_key: Any = None

    @cached_property
    def _record_hashes(self) -> dict[str, str]:
        return {name: record.hash for name, record in self.records.items()}

    def are_identified(self) -> bool:
        """Return whether the folder holds the models of all channels already."""
        return self.cache.holds("identify", identify_key(self._record_hashes, self.study))

    def plant(self) -> Outcome[PlantFacts]:
        """Return the model that is designed on."""
        settings = self.study.plant
        compute = partial(identification.plant, self.records, settings)
        key = plant_key(self._record_hashes, settings)
        outcome = self.cache.stage("plant", "models", key, compute, PlantFacts)
        self.say(f"plant for design: {counted(outcome.facts.states, 'state')}, {outcome.facts.status}")
        return outcome

    @cached_property
    def further(self) -> dict[str, StateSpace]:
        """Models of the bench's further units, where a design holds on several."""
        settings, found = self.study.plant, {}
        if self.bench is None or not any(map(takes_several, self.study.controllers.values())):
            return found
        for unit in settings.units:
            compute = partial(identification.further, as_unit(self.bench, unit), unit, self.records, settings)
            key = [*plant_key(self._record_hashes, settings), self.bench_key, unit]
            outcome = self.cache.stage(f"plant-{unit}", "models", key, compute, PlantFacts)
            self.say(f"plant for design, {unit}: {counted(outcome.facts.states, 'state')}, {outcome.facts.status}")
            found[unit] = outcome.values[of_unit(unit)]
        return found

    def judged(
        self, plant: StateSpace, plan: LoopPlan, models: Said
    ) -> tuple[Outcome[Any], Outcome[Any], Outcome[Any]]:
        """Identify channel by channel, and see what all models are worth."""
        models.wait()
        identified = identify_stage(self.cache, self.study, self.records)
        best = identified.facts.preferred
        if best is None:
            self.say("not ranked: no records drive one actuator after the other")
        else:
            self.say(f"identified: held-out records prefer {best.structure} of order {best.order}")
        validated, analysed = self._validate(identified, plant, plan), self._analyse(identified, plant)
        self.say("validated and analysed")
        return identified, validated, analysed

    def _key(self, plant: StateSpace) -> list[Any]:
        """Return what all judged models depend on: those of channels on what `identify` does, and the plant."""
        return [*identify_key(self._record_hashes, self.study), self.bench_key, plant.hash]

    def _validate(
        self, identified: Outcome[IdentificationFacts], plant: StateSpace, plan: LoopPlan
    ) -> Outcome[ValidationFacts]:
        models = {k: v for k, v in identified.values.items() if isinstance(v, PolynomialMatrix)}
        paper, held_out = self.study.paper, identification.sweep_groups(self.records, self.study.identify)[1]
        shown = tuple(paper.simulated) if paper else validation.worth_showing(self.records, held_out)
        beside_hz = self.study.validate_models.band_hz or plan.band_hz
        judge = validation.JudgedBy(held_out, shown, (paper and paper.band_hz) or plan.band_hz, beside_hz)
        compute = partial(validation.validated, self.records, models, plant, self.bench, judge)
        key = [*self._key(plant), judge]
        return self.cache.stage("validate", "models", key, compute, ValidationFacts)

    def _analyse(self, identified: Outcome[IdentificationFacts], plant: StateSpace) -> Outcome[AnalysisFacts]:
        asked = self.study.paper
        paper = None if asked is None else identified.values.get(stored.paper(asked.records[0]))
        rate_hz = next(iter(self.records.values())).rate_hz
        f_hz = validation.shown_hz(rate_hz, max(record.duration_s for record in self.records.values()))
        compute = partial(validation.analysed, plant, paper, f_hz)
        return self.cache.stage("analyse", "models", self._key(plant), compute, AnalysisFacts)
