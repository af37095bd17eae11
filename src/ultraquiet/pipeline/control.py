"""The stages that make controllers, put them on the bench and turn them into code."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass, replace
from threading import Lock
from typing import Any

import numpy as np

from ultraquiet import analyse, reduce, simulate
from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError, UltraquietError, UnheardError, blames_no_law
from ultraquiet._base.progress import task
from ultraquiet._base.registry import lookup, older_names
from ultraquiet._base.tables import Method
from ultraquiet._base.threads import in_threads
from ultraquiet.design import DesignResult
from ultraquiet.design.result import refused
from ultraquiet.design.verification import judged
from ultraquiet.design.weights.loop_weights import LoopFunction
from ultraquiet.pipeline.facts import stored
from ultraquiet.pipeline.facts.loops import (
    DeliveredFacts,
    DesignFacts,
    LeastChange,
    LoopFacts,
    LoopMargins,
    RecoveryFacts,
    Reduction,
    StableLoop,
    ToneFacts,
    ToneLevels,
    UnstableLoop,
)
from ultraquiet.pipeline.identification import for_method
from ultraquiet.pipeline.preflight import LoopPlan, as_unit
from ultraquiet.pipeline.stage import Outcome
from ultraquiet.pipeline.study import Band, Deploy, Design, Study
from ultraquiet.values import Channel, Record, StateSpace, StatusWord
from ultraquiet.values.controller import Controller


def designed(
    name: str,
    plant: StateSpace,
    settings: Design,
    loop: LoopPlan,
    others: Mapping[str, StateSpace] | None = None,
    around: StateSpace | None = None,
) -> Outcome[DesignFacts]:
    """Design one controller from the identified plant, and reduce it when the study says so.

    What a reduction must keep is what the study measures: the worst direction over its band, its tones, the peak, and
    the margins. The facts are those of the law that runs, the reduced one unless it loses the loop. `others` are models
    of further units, for designs that hold on several plants; `around` is the law that the study puts this one round.
    """
    with task(f"design {name}", 1 + (settings.reduce is not None)) as progress:
        method = method_of(settings, around)
        if method is None:
            result = refused(f"'{settings.around}', round which it is to be put, has no law.")
        else:
            result = method.design(for_method(method, plant, others or {}))
        progress.advance(note=str(result.status))
        law = result.controller
        if method is None or law is None:
            return Outcome({}, _design_facts(result, settings, None, 0, {"design": {}, "law": {}}))
        weights = _weights(name, result)
        if settings.reduce is None:
            margins = _at_ends(result.margins, plant)
            at_ends = {"design": margins, "law": margins}
            return Outcome({name: law, **weights}, _design_facts(result, settings, None, law.states, at_ends))
        at_ends = {"design": _at_ends(result.margins, plant)}
        reduced = _reduced(law, plant, result, settings.reduce, loop)
        reduction = _reduction_facts(law, reduced)
        progress.advance(note=reduction.status)
        if reduced.status.word is not StatusWord.UNSTABLE:
            law = reduced.controller
            again = judged(plant, law, method, result.gamma, result.achieved, result.residuals, result.details)
            status = result.status if not result.status.ok else again.status
            result = replace(
                result, status=status, peak_sensitivity_db=again.peak_sensitivity_db, margins=again.margins
            )
    if not reduced.status.ok:
        result = replace(result, status=reduced.status)
    at_ends["law"] = _at_ends(result.margins, plant)
    return Outcome({name: law, **weights}, _design_facts(result, settings, reduction, law.states, at_ends))


def _weights(name: str, result: DesignResult) -> dict[str, StateSpace]:
    """Return what the cost puts on S, T and KS, by the names of its files."""
    return {stored.weight(name, function): W for function, W in _given_on_loop(result).items()}


def _given_on_loop(result: DesignResult) -> dict[LoopFunction, StateSpace]:
    """Return what the cost of a law puts on S, T and KS, by function; nothing where there is no law."""
    return {} if result.controller is None or result.loop_weights is None else result.loop_weights.given


def _reduced(
    law: StateSpace, plant: StateSpace, result: DesignResult, method: Method, loop: LoopPlan
) -> reduce.ReductionResult:
    """Return the law with fewer states, judged by what the study measures of its loop."""
    promised = {"band_hz": loop.band_hz, "tones_hz": tuple(loop.tones_hz)}
    known = {f.name for f in fields(lookup("reduce", method.method))}
    missing = {key: value for key, value in promised.items() if key in known and key not in method.settings}
    reduced = method.make("reduce", **missing).reduce(law, plant, result.weights)
    return reduced if missing else reduce.held(reduced, law, plant, reduce.Promise(**promised))


def _reduction_facts(law: StateSpace, reduced: reduce.ReductionResult) -> Reduction:
    return Reduction(
        from_states=law.states,
        cost_before=reduced.cost_before,
        cost_after=reduced.cost_after,
        before=_delivered(reduced.before),
        after=_delivered(reduced.after),
        ok=reduced.status.ok,
        status=str(reduced.status),
    )


def _delivered(figures: reduce.Delivered | None) -> DeliveredFacts | None:
    if figures is None:
        return None
    tones = {f"{tone:g}": reduction for tone, reduction in figures.tones_db.items()}
    return DeliveredFacts(
        peak_db=figures.peak_db,
        worst_direction_band_db=figures.band_db,
        tones_db=tones,
        control_db=figures.control_db,
        rms_db=figures.rms_db,
        disk=dict(figures.disk),
    )


def _design_facts(
    result: DesignResult,
    settings: Design,
    reduction: Reduction | None,
    states: int,
    margins: Mapping[str, Mapping[str, LoopMargins]],
) -> DesignFacts:
    recovery = result.recovery
    return DesignFacts(
        method=settings.design.method,
        status=str(result.status),
        ok=result.status.ok,
        states=states,
        gamma=result.gamma,
        achieved=result.achieved,
        peak_sensitivity_db=result.peak_sensitivity_db,
        margins=margins["design"],
        law_margins=margins["law"],
        residuals={name: float(value) for name, value in result.residuals.items()},
        adaptive=result.law is not None and settings.reduce is None,
        reduction=reduction,
        norm_without_control=result.norm_without_control,
        weights_on=tuple(_given_on_loop(result)),
        recovery=recovery and RecoveryFacts(at=recovery.at, least_relative_error=float(recovery.relative_error.min())),
        details=_plain(result.details),
    )


def _at_ends(margins: Mapping[str, Any], plant: StateSpace) -> dict[str, LoopMargins]:
    """Return the margins at both ends of a plant as facts, channels by their names."""
    found: dict[str, LoopMargins] = {}
    for side, at in margins.items():
        if isinstance(at, analyse.EndMargins):
            wires = plant.actuators if side == "input" else plant.sensors
            figures = {field.name: getattr(at, field.name) for field in fields(LoopMargins)}
            if at.least_change is not None:
                named = {**asdict(at.least_change), "channel": wires[at.least_change.channel].name}
                figures["least_change"] = LeastChange(**named)
            found[side] = LoopMargins(**figures)
    return found


def method_of(settings: Design, around: StateSpace | None) -> Any:
    """Return the design of a table, put round a law where the table says so; None where that law is missing."""
    if settings.around is None:
        return settings.design.make("design")
    return None if around is None else settings.design.make("design", around=around)


def adapting(plant: StateSpace, settings: Design, around: StateSpace | None = None) -> Controller | None:
    """Return the law that runs where a design adapts: it is no value that could be kept, so it is made again."""
    method = method_of(settings, around)
    return None if method is None else method.design(plant).law


_Runs = tuple[simulate.Attenuation | None, simulate.MeasuredSensitivity | None]


class OpenLoops:
    """The open loop of every unit; measured when the first law asks for them, once for all."""

    def __init__(self, bench: Any, plan: LoopPlan) -> None:
        self.plan = plan
        self._by_unit = {unit: simulate.OpenLoop(as_unit(bench, unit)) for unit in plan.units}
        self._one_at_a_time = Lock()

    @property
    def distinct(self) -> bool:
        """False where units are one and the same bench, whose runs must not overlap."""
        return len({id(loop.bench) for loop in self._by_unit.values()}) == len(self._by_unit)

    def apart(self) -> dict[str, simulate.OpenLoop]:
        """Return them measured, on benches of their own where those can be copied."""
        with self._one_at_a_time:
            return {unit: loop.apart() for unit, loop in self._by_unit.items()}


def closed(
    name: str,
    law: StateSpace | Controller,
    open_loops: OpenLoops,
    required_hz: Band | None = None,
) -> Outcome[LoopFacts]:
    """Close the loop on the bench of every unit: does it settle, what does it do to tones, to every direction.

    `required_hz` is a band that something is required over and that is not the study's own.
    """
    settings, loops = open_loops.plan, open_loops.apart()

    def on_unit(unit: str) -> tuple[StableLoop | UnstableLoop, _Runs]:
        return _closed_on(law, loops[unit], settings, required_hz)

    on_units = in_threads(f"close {name}", on_unit, settings.units, None if open_loops.distinct else 1)
    values: dict[str, Any] = {}
    for unit in settings.units:
        tones, matrix = on_units[unit][1]
        if matrix is not None:
            values[stored.sensitivity(name, unit)] = matrix.S
        if tones is not None and unit == settings.units[0]:
            for f, opened, run in zip(settings.tones_hz, tones.opened, tones.closed, strict=True):
                values[stored.under_tone(name, f)] = run
                values[stored.open_under_tone(name, f)] = opened
    return Outcome(values, LoopFacts(units={unit: on_units[unit][0] for unit in settings.units}))


def _closed_on(
    law: StateSpace | Controller, loop: simulate.OpenLoop, settings: LoopPlan, required_hz: Band | None
) -> tuple[StableLoop | UnstableLoop, _Runs]:
    """Return what a law does on one unit, and its runs and sensitivity where there are any."""
    check = simulate.check_stability(loop.bench, law)
    if not check.status.ok:
        growth, hz = _known_growth(check.growth_per_s), _known_growth(check.growth_hz)
        return UnstableLoop(status=str(check.status), growth_per_s=growth, growth_hz=hz), (None, None)
    try:
        tones = None
        if settings.tones_hz:
            tones = simulate.attenuation(loop.bench, law, settings.tones_hz, settings.amplitude, settings.duration_s)
        low_hz = min(band[0] for band in (settings.band_hz, required_hz) if band is not None)
        matrix = simulate.measure_sensitivity(loop.bench, law, opened=loop, down_to_hz=low_hz)
        measured = _measured(loop.bench, check, tones, matrix, settings, required_hz)
    except UnheardError as error:
        return UnstableLoop(status=f"not measured: The loop settles. {error}"), (None, None)
    except UltraquietError as error:
        if blames_no_law(error):
            raise
        # A law that runs away under a stronger disturbance is a finding about the law.
        return UnstableLoop(status=f"unstable: Under disturbances the loop ran away: {error}"), (None, None)
    return measured, (tones, matrix)


def _measured(
    bench: Any,
    check: simulate.LoopCheck,
    tones: simulate.Attenuation | None,
    matrix: simulate.MeasuredSensitivity,
    settings: LoopPlan,
    required_hz: Band | None,
) -> StableLoop:
    low, high = settings.band_hz
    return StableLoop(
        status=str(check.status),
        growth_per_s=_known_growth(check.growth_per_s),
        growth_hz=_known_growth(check.growth_hz),
        lines=matrix.f_hz.size,
        lines_missing=matrix.lines_missing,
        lines_hidden=matrix.unresolved(),
        heard_hz=(float(matrix.f_hz[0]), float(matrix.f_hz[-1])),
        tones={} if tones is None else _tones(bench, tones, matrix, settings),
        broadband_5_100_db=_broadband(matrix, (5.0, 100.0)),
        broadband_10_60_db=_broadband(matrix, (10.0, 60.0)),
        broadband_db=_broadband(matrix, settings.band_hz),
        band_hz=settings.band_hz,
        worst_direction_band_db=matrix.worst_in_band_db(low, high),
        peak_amplification_db=matrix.peak_amplification_db(),
        mean_log_sensitivity_db=matrix.mean_log_db(),
        required_band_db=None if required_hz is None else matrix.worst_in_band_db(*required_hz),
    )


def _broadband(matrix: simulate.MeasuredSensitivity, band_hz: Band) -> float | None:
    """Return the reduction of the RMS over a band; None where it reaches beyond what was measured."""
    low, high = band_hz
    if matrix.f_hz.size < 2 or low < matrix.f_hz[0] or high > matrix.f_hz[-1]:
        return None
    return matrix.broadband_db(low, high)


def _known_growth(figure: float) -> float | None:
    return float(figure) if np.isfinite(figure) else None


def _tones(
    bench: Any, tones: simulate.Attenuation, matrix: simulate.MeasuredSensitivity, settings: LoopPlan
) -> dict[str, ToneFacts]:
    """Return what became of each tone, by its frequency in Hz."""
    return {
        f"{f:g}": ToneFacts(
            reduction_db=float(tones.worst_reduction_db[k]),
            paper_db=float(tones.worst_paper_db[k]),
            reduction_db_per_channel=tones.reduction_db[k],
            paper_db_per_channel=tones.paper_db[k],
            worst_direction_db=_at(matrix, f),
            open_v=tones.open_v[k],
            closed_v=tones.closed_v[k],
            floor_v=tones.floor_v[k],
            settled=tones.settled[k],
            levels=ToneLevels(
                units=tuple(c.unit for c in bench.sensors),
                open=tones.open_v[k],
                closed=tones.closed_v[k],
                floor=tones.floor_v[k],
                command=settings.amplitude,
                command_units=tuple(c.unit for c in bench.actuators),
                below_command_db=tones.paper_db[k],
            ),
        )
        for k, f in enumerate(settings.tones_hz)
    }


def _at(matrix: simulate.MeasuredSensitivity, tone_hz: float) -> float | None:
    """Return what counts in the worst direction at the line next to a tone; None where there is none."""
    nearest = int(np.argmin(np.abs(matrix.f_hz - tone_hz)))
    return float(matrix.counted_db()[nearest]) if abs(matrix.f_hz[nearest] - tone_hz) < 0.01 * tone_hz else None


def command_limits(actuators: Sequence[Channel], records: Iterable[Record], settings: Deploy) -> FloatArray:
    """Return the limits of commands in code, `(nu, 2)`: the actuators' own, else the study's, else those of records."""
    own = np.array([[c.low, c.high] for c in actuators])
    if np.isfinite(own).all():
        return own
    if settings.limits is None:
        largest = np.max([np.abs(record.inputs).max(axis=1) for record in records], axis=0)
    else:
        largest = np.broadcast_to(np.asarray(settings.limits, dtype=float), len(own))
    return np.where(np.isfinite(own), own, np.column_stack([-largest, largest]))


def with_limits(study: Study, actuators: Sequence[Channel], records: Iterable[Record]) -> Study:
    """Return the study whose laws that adapt have a limit where their actuators state none: that of commands in code.

    Such a law is watched at its limit and asks for one.
    """
    if not np.isinf([[c.low, c.high] for c in actuators]).any():
        return study
    tables: dict[str, Design] = {}
    for name, table in study.controllers.items():
        kind = lookup("design", table.design.method)
        stated = {"limit", *(older for older, newer in older_names(kind).items() if newer == "limit")}
        if getattr(kind, "asks_limit", False) and not stated & set(table.design.settings):
            most = np.abs(command_limits(actuators, records, study.deploy)).min(axis=1).tolist()
            design = type(table.design).model_validate({**table.design.model_dump(), "limit": most})
            tables[name] = table.model_copy(update={"design": design})
    return study if not tables else study.model_copy(update={"controllers": {**study.controllers, **tables}})


def _plain(value: Any) -> Any:
    """Return what JSON can hold of a result's details; systems are left out."""
    if is_dataclass(value) and not isinstance(value, type | StateSpace):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        entries = {str(k): _plain(v) for k, v in value.items()}
        return {k: v for k, v in entries.items() if v is not None}
    if isinstance(value, np.ndarray):
        return value.tolist() if value.size <= 1000 and not np.iscomplexobj(value) else None
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return value.item()
    return value if isinstance(value, str | int | float | bool) else None


def require_bench(bench: Any, plant: StateSpace) -> None:
    """Refuse a bench whose channels are not those of the plant."""
    if (len(bench.sensors), len(bench.actuators)) != plant.D.shape:
        raise InputError(
            f"study: the bench has {len(bench.actuators)} actuators and {len(bench.sensors)} sensors, "
            f"the plant was identified with {plant.D.shape[1]} and {plant.D.shape[0]}."
        )
