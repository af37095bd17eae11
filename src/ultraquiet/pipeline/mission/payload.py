"""The stage of the payload: what a law does for what the bench carries, on every unit."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from threading import Lock
from typing import Any

from ultraquiet import simulate
from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError, UltraquietError
from ultraquiet._base.threads import in_threads
from ultraquiet.pipeline.facts.loops import StableLoop, UnstableLoop
from ultraquiet.pipeline.facts.mission import NoPayload, PayloadCurves, PayloadFacts, PayloadForce, PayloadLoop
from ultraquiet.pipeline.making.code import written
from ultraquiet.pipeline.preflight import LoopPlan, as_unit
from ultraquiet.pipeline.stage import Outcome
from ultraquiet.pipeline.tables.code import Deploy
from ultraquiet.pipeline.tables.mission import PayloadTable
from ultraquiet.values import StateSpace
from ultraquiet.values.controller import Controller

Found = tuple[PayloadLoop | NoPayload, PayloadCurves | None]


class OpenPayloads:
    """The payload of every unit without a law; listened to when the first law asks for it, once for all."""

    def __init__(self, bench: Any, plan: LoopPlan, table: PayloadTable, seed: int) -> None:
        self.units = plan.units
        self.setup = table.setup(plan.tones_hz, seed)
        self._by_unit = {unit: simulate.OpenPayload(as_unit(bench, unit), self.setup) for unit in plan.units}
        self._one_at_a_time = Lock()

    def apart(self) -> dict[str, simulate.OpenPayload]:
        """Return them measured, on benches of their own where those can be copied."""
        with self._one_at_a_time:
            return {unit: payload.apart() for unit, payload in self._by_unit.items()}


def listened(
    name: str,
    law: StateSpace | Controller,
    payloads: OpenPayloads,
    loops: Mapping[str, StableLoop | UnstableLoop],
    limits: FloatArray,
    settings: Deploy | None,
) -> Outcome[PayloadFacts]:
    """Listen to the payload of every unit with a law.

    With settings of code the law runs as its compiled code where there is a compiler. A unit on which the loop did not
    settle is not shaken with the law on.
    """
    opened = payloads.apart()
    with tempfile.TemporaryDirectory() as folder:
        acting, through = law, "the adaptive law" if not isinstance(law, StateSpace) else "the law itself"
        if settings is not None and isinstance(law, StateSpace):
            acting, through = _as_code(law, Path(folder), limits, settings)

        def on_unit(unit: str) -> Found:
            loop = loops.get(unit)
            if isinstance(loop, UnstableLoop):
                return NoPayload(status=f"not shaken: {loop.status}"), None
            try:
                return _listened_on(acting, opened[unit], through)
            except InputError as error:
                return NoPayload(status=f"not measured: {error}"), None

        # A law that is stepped has one state: its runs follow one another.
        found = in_threads(f"payload, {name}", on_unit, payloads.units, None if isinstance(acting, StateSpace) else 1)
    units = {unit: found[unit][0] for unit in payloads.units}
    curves = {unit: drawn for unit in payloads.units if (drawn := found[unit][1]) is not None}
    return Outcome({}, PayloadFacts(units=units, curves=curves))


def _as_code(
    law: StateSpace, folder: Path, limits: FloatArray, settings: Deploy
) -> tuple[StateSpace | Controller, str]:
    """Return a linear law as its compiled code, and in words what runs."""
    try:
        return written(law, limits, folder / "code", settings).controller, f"{settings.precision} code"
    except UltraquietError:
        return law, "the law itself; no code could be made of it"


def _listened_on(law: StateSpace | Controller, opened: simulate.OpenPayload, through: str) -> Found:
    heard = simulate.measure_payload(opened.own, law, opened.setup, opened=opened)
    noise, band = heard.noise, opened.setup.band_hz
    without, with_law, silent = noise.rms()
    worst_db, worst_hz = noise.worst_db()
    loop = PayloadLoop(
        source=noise.source,
        level=noise.level,
        unit=noise.unit,
        band_hz=band,
        through=through,
        reduction_db=noise.reduction_db(),
        broadband_5_100_db=_within(noise, 5.0, 100.0),
        broadband_10_100_db=_within(noise, 10.0, 100.0),
        each_db=dict(zip(noise.sensors, noise.each_db().tolist(), strict=True)),
        open_rms=without,
        closed_rms=with_law,
        silent_rms=silent,
        worst_db=worst_db,
        worst_hz=worst_hz,
        tones_db={f"{f:g}": db for f, db in heard.tones_db.items()},
        force=_force(heard.force),
    )
    f, bare, controlled = noise.transmissibility
    at = noise.opened.payload.f_hz
    places = [int(abs(at - each).argmin()) for each in f]
    curves = PayloadCurves(
        f_hz=f,
        open_transmissibility=bare,
        closed_transmissibility=controlled,
        open_cumulative=noise.opened.payload.cumulative_rms(band[0])[places],
        closed_cumulative=noise.closed.payload.cumulative_rms(band[0])[places],
    )
    return loop, curves


def _within(noise: simulate.PayloadReduction, low: float, high: float) -> float | None:
    """Return the reduction over a band; None where the noise did not fill it."""
    return noise.reduction_db(low, high) if noise.band_hz[0] <= low and high <= noise.band_hz[1] else None


def _force(pushed: simulate.PayloadReduction | None) -> PayloadForce | None:
    if pushed is None:
        return None
    worst_db, worst_hz = pushed.worst_db()
    return PayloadForce(
        source=pushed.source,
        level=pushed.level,
        reduction_db=pushed.reduction_db(),
        worst_db=worst_db,
        worst_hz=worst_hz,
    )
