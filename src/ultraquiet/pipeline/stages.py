"""The stages of a study after its records, each reused when nothing it depends on has changed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

from ultraquiet._base.beside import beside
from ultraquiet._base.tables import Method
from ultraquiet._base.threads import in_threads
from ultraquiet.deploy.toolchain.compiler import compiler
from ultraquiet.pipeline import control, identification, limits, requirements, validation
from ultraquiet.pipeline.cache import Cache, Outcome
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.limits import LimitFacts
from ultraquiet.pipeline.facts.loops import DeploymentFacts, DesignFacts, LoopFacts, NoCode
from ultraquiet.pipeline.facts.models import AnalysisFacts, IdentificationFacts, PlantFacts, ValidationFacts
from ultraquiet.pipeline.facts.requirements import RequirementsFacts
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.pipeline.study import Band, Study
from ultraquiet.values import PolynomialMatrix, Record, StateSpace

WORKER = "ultraquiet.pipeline.worker"
Say = Callable[[str], object]


@dataclass(frozen=True)
class Stages:
    """A study, the bench it is made on and its records; `say` is told one line per finished stage.

    `bench_key` is what defines the bench (`store.identity`), for the stages that measure on it.
    """

    study: Study
    cache: Cache
    bench: Any
    records: Mapping[str, Record]
    say: Say
    bench_key: Any = None

    def run(self) -> StudyResult:
        """Go through all stages; where the bench allows it, models and controllers are made beside one another."""
        several = getattr(self.bench, "side_by_side", False)
        identify = "compare structures and orders", WORKER, str(self.cache.folder)
        with beside(*identify, wanted=several and not self._is_identified(), holds=self.cache.lock) as wait:
            plant = self._plant()
            system: StateSpace = plant.values[stored.PLANT]
            control.require_bench(self.bench, system)
            names = list(self.study.controllers)
            work = {name: partial(self._controller, name, system) for name in sorted(names, key=self._is_optional)}
            jobs: dict[str | None, Callable[[], Any]] = {**work, None: partial(self._models, system, wait)}
            done = in_threads("study", lambda job: jobs[job](), list(jobs), None if several else 1, bars=True)
        identified, validated, analysed = done[None]
        loops = {name: loop for name in names if (loop := done[name].loop) is not None}
        laws = {name: law for name in names if (law := done[name].law) is not None}
        return StudyResult(
            study=self.study,
            bench=self.bench,
            records=self.records,
            identification=identified,
            plant=plant,
            validation=validated,
            analysis=analysed,
            designs={name: done[name].design for name in names},
            loops=loops,
            deployment={name: code for name in names if (code := done[name].code) is not None},
            limits=self._limits(system, laws),
            requirements=self._judge(system, laws, loops),
        )

    def _is_optional(self, name: str) -> bool:
        """Tell whether nothing is required of a controller; one that the study is for comes first."""
        return self.study.requirements is None or name != self.study.requirements.law

    def _models(self, plant: StateSpace, wait: Callable[[], object]) -> tuple[Outcome[Any], Outcome[Any], Outcome[Any]]:
        """Identify channel by channel, and see what all models are worth."""
        wait()
        identified = self.identify()
        best = identified.facts.preferred
        self.say(f"identified: held-out records prefer {best.structure} of order {best.order}")
        validated, analysed = self._validate(identified, plant), self._analyse(identified, plant)
        self.say("validated and analysed")
        return identified, validated, analysed

    def _controller(self, name: str, plant: StateSpace) -> "_Controller":
        """Design one controller, close its loop and turn it into code."""
        design = self._design(name, plant)
        if name not in design.values:
            return _Controller(design)
        law: StateSpace = design.values[name]
        loop = self._close(name, law, plant, design.facts.adaptive)
        return _Controller(design, law, loop, self._deploy(name, law, plant, design.facts.adaptive))

    def _required_hz(self, name: str) -> Band | None:
        """Return the band of the requirements of a law where it is not the one that is measured anyway."""
        asked = self.study.requirements
        if asked is None or asked.law != name or asked.band_hz in (None, self.study.closed_loop.band_hz):
            return None
        return asked.band_hz

    def _judge(
        self, plant: StateSpace, laws: Mapping[str, StateSpace], loops: Mapping[str, Outcome[LoopFacts]]
    ) -> RequirementsFacts | None:
        """Return what came of the study's requirements, None where it has none."""
        asked = self.study.requirements
        if asked is None:
            return None
        loop, law = loops.get(asked.law), laws.get(asked.law)
        disk = requirements.margins_of(plant, law) if law is not None and asked.disk_margin is not None else {}
        band_hz = asked.band_hz or self.study.closed_loop.band_hz
        return requirements.judge(asked, band_hz, None if loop is None else loop.facts.units, disk)

    @cached_property
    def _record_hashes(self) -> dict[str, str]:
        return {name: record.hash for name, record in self.records.items()}

    @cached_property
    def _open_loops(self) -> control.OpenLoops:
        return control.OpenLoops(self.bench, self.study.closed_loop)

    @cached_property
    def _identify_key(self) -> list[Any]:
        return [self._record_hashes, self.study.identify]

    def _is_identified(self) -> bool:
        return self.cache.holds("identify", self._identify_key)

    def identify(self) -> Outcome[IdentificationFacts]:
        """Identify channel by channel."""
        settings = self.study.identify
        compute = partial(identification.identified, self.records, settings)
        return self.cache.stage("identify", "models", self._identify_key, IdentificationFacts, compute)

    def _plant(self) -> Outcome[PlantFacts]:
        settings = self.study.plant
        compute = partial(identification.plant, self.records, settings)
        key = [self._record_hashes, _key(settings)]
        outcome = self.cache.stage("plant", "models", key, PlantFacts, compute)
        self.say(f"plant for design: {outcome.facts.states} states, {outcome.facts.status}")
        return outcome

    def _models_key(self, plant: StateSpace) -> list[Any]:
        return [self._record_hashes, self.study.identify, self.bench_key, plant.hash]

    def _validate(self, identified: Outcome[IdentificationFacts], plant: StateSpace) -> Outcome[ValidationFacts]:
        models = {k: v for k, v in identified.values.items() if isinstance(v, PolynomialMatrix)}
        compute = partial(validation.validated, self.records, models, plant, self.bench)
        return self.cache.stage("validate", "models", self._models_key(plant), ValidationFacts, compute)

    def _analyse(self, identified: Outcome[IdentificationFacts], plant: StateSpace) -> Outcome[AnalysisFacts]:
        paper = identified.values[stored.paper(self.study.identify.paper_records[0])]
        compute = partial(validation.analysed, plant, paper)
        return self.cache.stage("analyse", "models", self._models_key(plant), AnalysisFacts, compute)

    def _design(self, name: str, plant: StateSpace) -> Outcome[DesignFacts]:
        """Design and reduce one controller."""
        settings = self.study.controllers[name]
        loop = self.study.closed_loop
        promised = settings.reduce and [_key(settings.reduce), loop.band_hz, loop.tones_hz]
        key = [plant.hash, _key(settings.design), promised]
        compute = partial(control.designed, name, plant, settings, loop)
        outcome = self.cache.stage(f"design-{name}", "controllers", key, DesignFacts, compute)
        self.say(f"designed {name}: {outcome.facts.status}")
        return outcome

    def _close(self, name: str, law: StateSpace, plant: StateSpace, adaptive: bool) -> Outcome[LoopFacts]:
        """Close its loop on the bench; a law that adapts is no value that could be kept, and is designed again."""
        design, settings = self.study.controllers[name], self.study.closed_loop
        required_hz = self._required_hz(name)
        key = [law.hash, self.bench_key, settings, *([plant.hash, _key(design.design)] if adaptive else [])]
        key += [] if required_hz is None else [required_hz]

        def compute() -> Outcome[LoopFacts]:
            acting = control.adapting(plant, design) if adaptive else None
            return control.closed(name, acting or law, self._open_loops, settings, required_hz)

        return self.cache.stage(f"loop-{name}", "loops", key, LoopFacts, compute)

    def _deploy(self, name: str, law: StateSpace, plant: StateSpace, adaptive: bool) -> DeploymentFacts:
        """Turn it into code, unless it adapts."""
        if adaptive:
            self.say(f"closed {name}, which adapts and is not deployed")
            sentence = "not generated: the law adapts; C99 is generated from linear laws alone."
            return NoCode(status=sentence, failed=False)
        settings = self.study.deploy
        key = [law.hash, plant.hash, self.bench.actuators, settings, compiler()]

        def compute() -> Outcome[DeploymentFacts]:
            place = self.cache.workplace("code", name)
            return control.deployed(name, law, plant, self.bench, place, settings)

        facts = self.cache.stage(f"deploy-{name}", "code", key, DeploymentFacts, compute, writes=name).facts
        self.say(f"closed and deployed {name}: {facts.verdict}")
        return facts

    def _limits(self, plant: StateSpace, laws: Mapping[str, StateSpace]) -> Outcome[LimitFacts]:
        band_hz = self.study.closed_loop.band_hz
        key = [plant.hash, band_hz, {name: law.hash for name, law in laws.items()}]
        outcome = self.cache.stage("limits", "models", key, LimitFacts, partial(limits.bounded, plant, laws, band_hz))
        self.say(f"limits: {outcome.facts.bands[-1].status}")
        return outcome


@dataclass(frozen=True)
class _Controller:
    """What came of one controller; no law where the design found none."""

    design: Outcome[DesignFacts]
    law: StateSpace | None = None
    loop: Outcome[LoopFacts] | None = None
    code: DeploymentFacts | None = None


def _key(method: Method) -> dict[str, Any]:
    """Return all that a method's table says; its settings are not declared fields and must be asked for."""
    return method.model_dump()
