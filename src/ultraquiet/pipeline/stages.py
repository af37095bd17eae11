"""The stages of a study after its records, each reused when nothing it depends on has changed."""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import partial
from threading import Lock
from typing import Any

from ultraquiet._base.beside import Said
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown.line import command
from ultraquiet._base.threads import in_threads
from ultraquiet.bench import Interlocks
from ultraquiet.bench.hardware.termination import DEPARTURE
from ultraquiet.deploy.toolchain.compiler import compiler
from ultraquiet.pipeline import control, requirements
from ultraquiet.pipeline import limits as attainable
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.code import DeploymentFacts, NoCode
from ultraquiet.pipeline.facts.limits import LimitFacts
from ultraquiet.pipeline.facts.loops import DesignFacts, LoopFacts, of_the_bench
from ultraquiet.pipeline.facts.mission import CampaignFacts, CommissioningFacts, PayloadFacts
from ultraquiet.pipeline.facts.requirements import RequirementsFacts
from ultraquiet.pipeline.facts.typed import to_plain
from ultraquiet.pipeline.making.code import deployed
from ultraquiet.pipeline.making.designs import (
    by_need,
    chains,
    design_key,
    design_stage,
    key_of,
)
from ultraquiet.pipeline.making.models import ModelStages
from ultraquiet.pipeline.making.processes import designing_beside, identifying_beside
from ultraquiet.pipeline.mission.campaign import CampaignOutcome, How, conducted, defined, law_of
from ultraquiet.pipeline.mission.commission import commissioned
from ultraquiet.pipeline.mission.payload import OpenPayloads, listened
from ultraquiet.pipeline.preflight import LoopPlan, loop_plan
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.pipeline.stage import Outcome
from ultraquiet.pipeline.study import Band
from ultraquiet.pipeline.tables.mission import CampaignTable
from ultraquiet.simulate import Campaign
from ultraquiet.values import StateSpace
from ultraquiet.values.controller import Controller

FAR = 2  # so many designs are worth a process of their own
# What is done beside the controllers, none of which is called so.
_OPEN, _MODELS, _LIMITS = "the open loops", "the models", "the limits"
Adapting = Callable[[], Controller | None]  # makes what runs where a law adapts


@dataclass(frozen=True)
class Stages(ModelStages):
    """All stages of a study after its records: its models, and what is designed on them, closed and made into code."""

    turns: dict[str, Lock] = field(default_factory=dict)  # whose design is being made, or read
    ahead: Said = field(default_factory=Said)  # a process that waits for records to identify

    def run(self) -> StudyResult:
        """Go through all stages; where the bench allows it, models and controllers are made beside one another."""
        several = self.bench is None or getattr(self.bench, "side_by_side", False)
        late = several and self.ahead.ended and not self.are_identified()
        with identifying_beside(self.cache, late and self.study.blending is None) as begun_late:
            models = begun_late if late else self.ahead
            models.begin()
            plant = self.plant()
            system: StateSpace = plant.values[stored.PLANT]
            if self.bench is not None:
                control.require_bench(self.bench, system)
            plan = loop_plan(self.study.closed_loop, self.bench, system)
            names = list(self.study.controllers)
            first = by_need(self.study)
            opened = None if self.bench is None else control.OpenLoops(self.bench, plan)
            payloads = self._payloads(plan)
            far = several and sum(not self._is_designed(name, system, plan) for name in first) >= FAR
            jobs_beside, words = len(chains(self.study)) + 1, (json.dumps(to_plain(plan)), *self.further)  # and limits
            with designing_beside(self.cache, far and self.study.blending is None, jobs_beside, *words) as designs:
                one = partial(self._controller, plant=system, plan=plan, opened=opened, payloads=payloads, said=designs)
                jobs: dict[str, Callable[[], Any]] = {_OPEN: opened.apart} if far and opened is not None else {}
                jobs |= {name: partial(one, name) for name in first}
                jobs[_MODELS] = partial(self.judged, system, plan, models)
                jobs[_LIMITS] = partial(_found_last, designs, first)
                # what waits for another process takes no processor's time
                workers = len(jobs) if far else None if several else 1
                with _ended_softly(self.bench):
                    done = in_threads("study", lambda job: jobs[job](), list(jobs), workers, bars=True)
                laws = {name: law for name in names if (law := done[name].law) is not None}
        identified, validated, analysed = done[_MODELS]
        loops = {name: loop for name in names if (loop := done[name].loop) is not None}
        payload = {name: heard for name in names if (heard := done[name].payload) is not None}
        return StudyResult(
            study=self.study,
            bench=self.bench,
            plan=plan,
            records=self.records,
            identification=identified,
            plant=plant,
            validation=validated,
            analysis=analysed,
            designs={name: done[name].design for name in names},
            loops=loops,
            deployment={name: code for name in names if (code := done[name].code) is not None},
            limits=self._limits(system, laws, plan),
            requirements=self._judge(system, laws, loops, plan, payload),
            payload=payload,
            commissioning=self._commission(laws, plan),
            campaign=self._campaign(laws, plan),
        )

    def campaign(self, how: How) -> CampaignFacts:
        """Design the law that the campaign is about, and nothing else; run the campaign, or what is left of it."""
        table = self.study.campaign or CampaignTable()
        facts, _ = conducted(self.campaign_of(table), law_of(self.study, table), table, self.cache.folder, how)
        return facts

    def campaign_of(self, table: CampaignTable) -> Campaign:
        """Return the campaign of a study, its law designed.

        Raises:
            InputError: there is no bench or no law, or the bench cannot be drawn.
        """
        if self.bench is None:
            raise InputError("campaign: the study has no bench that could be drawn.")
        system: StateSpace = self.plant().values[stored.PLANT]
        control.require_bench(self.bench, system)
        plan, name = loop_plan(self.study.closed_loop, self.bench, system), law_of(self.study, table)
        design = self._design(name, system, plan)
        if name not in design.values:
            raise InputError(f"campaign: {name} has no law: {design.facts.status}")
        return defined(self.study, self.bench, design.values[name], plan, table, self.bench_key)

    def _commission(self, laws: Mapping[str, StateSpace], plan: LoopPlan) -> Outcome[CommissioningFacts] | None:
        """Put the law on, step by step, where the study asks for it."""
        table = self.study.commission
        if table is None or self.bench is None:
            return None
        name = law_of(self.study, table)
        if name not in laws:
            return None
        key = [laws[name].hash, self.bench_key, plan.units, plan.band_hz, table]
        compute = partial(commissioned, name, laws[name], self.bench, plan, table)
        outcome = self.cache.stage("commission", "loops", key, compute, CommissioningFacts)
        for unit, found in outcome.facts.units.items():
            self.say(f"commissioned {name}, {unit}: {found.status}")
        return outcome

    def _campaign(self, laws: Mapping[str, StateSpace], plan: LoopPlan) -> CampaignOutcome | None:
        """Run the campaign that the study asks for; results that are there stay."""
        table = self.study.campaign
        if table is None or self.bench is None:
            return None
        name = law_of(self.study, table)
        if name not in laws:
            return None
        campaign = defined(self.study, self.bench, laws[name], plan, table, self.bench_key)
        again = command("ultraquiet", "campaign", self.cache.folder)  # the study as it ran: it may be a quick one
        outcome = conducted(campaign, name, table, self.cache.folder, How(resume=None, replay=again))
        self.say(f"campaign: {outcome[0].status}")
        return outcome

    def _controller(
        self,
        name: str,
        plant: StateSpace,
        plan: LoopPlan,
        opened: control.OpenLoops | None,
        payloads: OpenPayloads | None,
        said: Said,
    ) -> "_Controller":
        """Design one controller, close its loop, turn it into code and listen to the payload."""
        said.wait(name)
        design = self._design(name, plant, plan)
        if name not in design.values:
            return _Controller(design)
        law: StateSpace = design.values[name]
        adapting = None
        if design.facts.adaptive:
            around = self._around(name, plant, plan)
            adapting = partial(control.adapting, plant, self.study.controllers[name], around)
        loop = None if opened is None else self._close(name, law, adapting, plant, opened)
        code = self._deploy(name, law, plant, plan, design.facts.adaptive, loop)
        if payloads is None or loop is None:
            return _Controller(design, law, loop, code)
        return _Controller(design, law, loop, code, self._listen(name, law, adapting, payloads, loop.facts))

    def _payloads(self, plan: LoopPlan) -> OpenPayloads | None:
        table = self.study.payload
        if self.bench is None or table is None:
            return None
        return OpenPayloads(self.bench, plan, table, self.study.study.seed)

    def _listen(
        self,
        name: str,
        law: StateSpace,
        adapting: Adapting | None,
        payloads: OpenPayloads,
        loop: LoopFacts,
    ) -> Outcome[PayloadFacts]:
        """Listen to the payload with one law; `adapting` makes what runs where it adapts."""
        limits = control.command_limits(self.bench.actuators, self.records.values(), self.study.deploy)
        stable = {unit: each.stable for unit, each in loop.units.items()}
        asked, deploy = self.study.requirements, self.study.deploy
        as_code = deploy if asked is None or name == asked.law else None  # a stepped law takes a minute
        key = [law.hash, self.bench_key, payloads.setup, payloads.units, limits, as_code, compiler(), stable]
        key += [] if adapting is None else [key_of(self.study.controllers[name].design)]

        def compute() -> Outcome[PayloadFacts]:
            acting = law if adapting is None else adapting() or law
            return listened(name, acting, payloads, loop.units, limits, as_code)

        return self.cache.stage(f"payload-{name}", "loops", key, compute, PayloadFacts)

    def _required_hz(self, name: str, plan: LoopPlan) -> Band | None:
        """Return the band of the requirements of a law where it is not the one that is measured anyway."""
        asked = self.study.requirements
        if asked is None or asked.law != name or asked.band_hz in (None, plan.band_hz):
            return None
        return asked.band_hz

    def _judge(
        self,
        plant: StateSpace,
        laws: Mapping[str, StateSpace],
        loops: Mapping[str, Outcome[LoopFacts]],
        plan: LoopPlan,
        payload: Mapping[str, Outcome[PayloadFacts]],
    ) -> RequirementsFacts | None:
        """Return what came of the study's requirements, None where it has none."""
        asked = self.study.requirements
        if asked is None:
            return None
        loop, law = loops.get(asked.law), laws.get(asked.law)
        disk = requirements.margins_of(plant, law) if law is not None and asked.disk_margin is not None else {}
        band_hz = asked.band_hz or plan.band_hz
        units, heard = None if loop is None else loop.facts.units, payload.get(asked.law)
        silent = {} if law is None or asked.peak_db is None else requirements.unheard_peaks(plant, law, units or {})
        faint: dict[str, requirements.Peak] = {}
        if law is not None and asked.attenuation_db is not None:
            faint = requirements.unheard_reductions(plant, law, units or {}, band_hz)
        payloads = None if heard is None else heard.facts.units
        kept = {} if loop is None else loop.values
        names = {unit: stored.sensitivity(asked.law, unit) for unit in units or {}}
        read = {unit: kept[name] for unit, name in names.items() if name in kept}
        return requirements.judge(asked, band_hz, units, disk, payloads, silent, faint, read)

    def _is_designed(self, name: str, plant: StateSpace, plan: LoopPlan) -> bool:
        settings = self.study.controllers[name]
        if settings.around is not None and not self._is_designed(settings.around, plant, plan):
            return False
        key = design_key(plant, settings, plan, self.further, self._around(name, plant, plan))
        return self.cache.holds(f"design-{name}", key)

    def _design(self, name: str, plant: StateSpace, plan: LoopPlan) -> Outcome[DesignFacts]:
        """Design and reduce one controller."""
        outcome = self._made(name, plant, plan)
        self.say(f"designed {name}: {outcome.facts.status}")
        return outcome

    def _made(self, name: str, plant: StateSpace, plan: LoopPlan) -> Outcome[DesignFacts]:
        """Return the stage of one controller; whoever comes second to it waits, and reads it."""
        around = self._around(name, plant, plan)
        with self.turns.setdefault(name, Lock()):
            return design_stage(self.cache, name, self.study.controllers[name], plant, plan, self.further, around)

    def _around(self, name: str, plant: StateSpace, plan: LoopPlan) -> StateSpace | None:
        """Return the law round which a controller is put; None where it stands alone, or where that has no law."""
        inner = self.study.controllers[name].around
        return None if inner is None else self._made(inner, plant, plan).values.get(inner)

    def _close(
        self,
        name: str,
        law: StateSpace,
        adapting: Adapting | None,
        plant: StateSpace,
        opened: control.OpenLoops,
    ) -> Outcome[LoopFacts]:
        """Close its loop on the bench; a law that adapts is no value that could be kept, and is designed again."""
        plan = opened.plan
        required_hz = self._required_hz(name, plan)
        key = [law.hash, self.bench_key, plan]
        key += [] if adapting is None else [plant.hash, key_of(self.study.controllers[name].design)]
        key += [] if required_hz is None else [required_hz]

        def compute() -> Outcome[LoopFacts]:
            acting = law if adapting is None else adapting() or law
            return control.closed(name, acting, opened, required_hz)

        outcome = self.cache.stage(f"loop-{name}", "loops", key, compute, LoopFacts)
        for unit, loop in outcome.facts.units.items():
            self.say(f"closed {name} on {of_the_bench(unit)}: {loop.status}")
        return outcome

    def _deploy(
        self,
        name: str,
        law: StateSpace,
        plant: StateSpace,
        plan: LoopPlan,
        adaptive: bool,
        loop: Outcome[LoopFacts] | None,
    ) -> DeploymentFacts:
        """Turn it into code, unless it adapts, or its loop was seen unstable on the first unit of the study."""
        if adaptive:
            self.say(f"closed {name}, which adapts and is not deployed")
            sentence = "not generated: the law adapts; C99 is generated from linear laws alone."
            return NoCode(status=sentence, failed=False)
        settings = self.study.deploy
        actuators = plant.actuators if self.bench is None else self.bench.actuators
        limits = control.command_limits(actuators, self.records.values(), settings)
        unbearable = "" if loop is None else loop.facts.unbearable
        key = [law.hash, plant.hash, limits, settings, plan.tones_hz, compiler()]
        key += [unbearable] if unbearable else []

        def compute() -> Outcome[DeploymentFacts]:
            if unbearable:
                return Outcome({}, NoCode(status=f"refused: {unbearable}; no code is written of it."))
            place = self.cache.workplace("code", name)
            return deployed(name, law, plant, limits, place, settings, plan.tones_hz)

        facts = self.cache.stage(f"deploy-{name}", "code", key, compute, DeploymentFacts, writes=name).facts
        self.say(f"code of {name}: {facts.verdict}")
        return facts

    def _limits(self, plant: StateSpace, laws: Mapping[str, StateSpace], plan: LoopPlan) -> Outcome[LimitFacts]:
        outcome = attainable.stage(self.cache, self.study.limits, plant, laws, plan.band_hz)
        self.say(f"limits: {outcome.facts.bands[-1].status}")
        return outcome


@dataclass(frozen=True)
class _Controller:
    """What came of one controller; no law where the design found none."""

    design: Outcome[DesignFacts]
    law: StateSpace | None = None
    loop: Outcome[LoopFacts] | None = None
    code: DeploymentFacts | None = None
    payload: Outcome[PayloadFacts] | None = None


def _ended_softly(bench: Any) -> AbstractContextManager[None]:
    """Return a block in whose threads a signal that ends the process brings a guarded bench to rest before."""
    return DEPARTURE.holding(isinstance(getattr(bench, "interlocks", None), Interlocks))


def _found_last(designs: Said, names: Sequence[str]) -> None:
    """Let the processes beside find what can be reached, once they have said all laws."""
    for name in names:
        designs.wait(name)
    designs.begin()
    designs.wait()
