"""The stages that make controllers, put them on the bench and turn them into code."""

from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ultraquiet import simulate
from ultraquiet._base.errors import InputError, UltraquietError
from ultraquiet._base.progress import task
from ultraquiet.pipeline.cache import Outcome
from ultraquiet.pipeline.preflight import as_unit
from ultraquiet.pipeline.study import ClosedLoop, Deploy, Design
from ultraquiet.values import StateSpace
from ultraquiet.values.controller import Controller

# The bands that every summary reports, whatever band the study asks for.
BROADBAND_HZ = ((5.0, 100.0), (10.0, 60.0))
# What a study compares of every controller's code, here and on an emulated Cortex-M7; `ultraquiet deploy` takes more
# steps, the Cortex-M4F and random bits besides.
COMPARED_STEPS, TARGETS = 5_000, ("cortex-m7",)


def designed(name: str, plant: StateSpace, settings: Design) -> Outcome:
    """Design one controller from the identified plant, and reduce it when the study says so."""
    with task(f"design {name}", 1 + (settings.reduce is not None)) as progress:
        result = settings.design.make("design").design(plant)
        facts: dict[str, Any] = {
            "method": settings.design.method,
            "status": str(result.status),
            "ok": result.status.ok,
            "gamma": result.gamma,
            "achieved": result.achieved,
            "peak_sensitivity_db": result.peak_sensitivity_db,
            "margins": _plain(result.margins),
            "residuals": _plain(result.residuals),
            "details": _plain(result.details),
            "adaptive": result.law is not None and settings.reduce is None,
        }
        progress.advance(note=str(result.status))
        law = result.controller
        if law is None:
            return Outcome({}, {**facts, "states": 0})
        if settings.reduce is not None:
            reduced = settings.reduce.make("reduce").reduce(law, plant, result.details.get("weights"))
            facts["reduction"] = {
                "from_states": law.states,
                "cost_before": reduced.cost_before,
                "cost_after": reduced.cost_after,
                "status": str(reduced.status),
            }
            law = reduced.controller if reduced.status.ok else law
            progress.advance(note=str(reduced.status))
    return Outcome({name: law}, {**facts, "states": law.states})


def adapting(plant: StateSpace, settings: Design) -> Controller | None:
    """Return the law that runs where a design adapts: it is no value that could be kept, so it is made again."""
    return settings.design.make("design").design(plant).law


def closed(name: str, law: StateSpace | Controller, bench: Any, settings: ClosedLoop) -> Outcome:
    """Close the loop on the bench of every unit: does it settle, what does it do to tones, to every direction."""
    facts: dict[str, Any] = {}
    values: dict[str, Any] = {}
    for unit in settings.units:
        on = as_unit(bench, unit)
        check = simulate.check_stability(on, law)
        facts[unit] = {"stable": check.status.ok, "status": str(check.status)}
        if not check.status.ok:
            continue
        try:
            tones = simulate.attenuation(on, law, settings.tones_hz, settings.amplitude_v, settings.duration_s)
            matrix = simulate.measure_sensitivity(on, law)
        except UltraquietError as error:
            # A law that runs away under a stronger disturbance is a finding about the law.
            facts[unit] = {"stable": False, "status": f"unstable: Under disturbances the loop ran away: {error}"}
            continue
        facts[unit] |= _measured(tones, matrix, settings)
        values[f"{name}-{unit}-sensitivity"] = matrix.S
        if unit == settings.units[0]:
            for f, opened, run in zip(settings.tones_hz, tones.opened, tones.closed, strict=True):
                values[f"{name}-{f:g}hz"] = run
                values[f"open-{f:g}hz"] = opened
    return Outcome(values, facts)


def _measured(
    tones: simulate.Attenuation, matrix: simulate.MeasuredSensitivity, settings: ClosedLoop
) -> dict[str, Any]:
    worst_reduction, worst_paper = tones.worst_reduction_db, tones.worst_paper_db
    low, high = settings.band_hz
    return {
        "tones": {
            f"{f:g}": {
                "reduction_db": worst_reduction[k],
                "paper_db": worst_paper[k],
                "reduction_db_per_channel": tones.reduction_db[k],
                "paper_db_per_channel": tones.paper_db[k],
                "worst_direction_db": matrix.worst_in_band_db(f, f) if f in matrix.f_hz else None,
                "open_v": tones.open_v[k],
                "closed_v": tones.closed_v[k],
                "floor_v": tones.floor_v[k],
            }
            for k, f in enumerate(settings.tones_hz)
        },
        **{f"broadband_{a:g}_{b:g}_db": matrix.broadband_db(a, b) for a, b in BROADBAND_HZ},
        "band_hz": settings.band_hz,
        "worst_direction_band_db": matrix.worst_in_band_db(low, high),
        "peak_amplification_db": matrix.peak_amplification_db(),
        "mean_log_sensitivity_db": matrix.mean_log_db(),
    }


def deployed(name: str, law: StateSpace, plant: StateSpace, bench: Any, folder: Path, settings: Deploy) -> Outcome:
    """Generate, compile and compare the controller's code; what cannot be done is said, not raised.

    Forms and rounding are judged by what they do to the loop with the identified plant.
    """
    from ultraquiet import deploy

    limits = np.array([[c.low, c.high] for c in bench.actuators])
    try:
        made = deploy.generate(law, folder / name, settings.precision, limits_v=limits, plant=plant)
        verified = made.verify(steps=COMPARED_STEPS, targets=TARGETS, fuzz_steps=0)
    except UltraquietError as error:
        return Outcome({}, {"status": f"refused: {error}"})
    return Outcome({}, {**_plain(made.tables), "status": str(made.status), "verification": str(verified.status)})


def _plain(value: Any) -> Any:
    """Return what JSON can hold of a result's details; systems are left out."""
    if is_dataclass(value) and not isinstance(value, type | StateSpace):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        held = {str(k): _plain(v) for k, v in value.items()}
        return {k: v for k, v in held.items() if v is not None}
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
