"""The stage in which the study's law comes on, step by step, on every unit."""

from typing import Any

from ultraquiet import simulate
from ultraquiet._base.errors import UltraquietError, bench_failed
from ultraquiet.pipeline.facts.mission import CommissionedStep, CommissionedUnit, CommissioningFacts
from ultraquiet.pipeline.preflight import LoopPlan, as_unit
from ultraquiet.pipeline.stage import Outcome
from ultraquiet.pipeline.tables.mission import CommissionTable
from ultraquiet.values import StateSpace


def commissioned(
    name: str, law: StateSpace, bench: Any, plan: LoopPlan, table: CommissionTable
) -> Outcome[CommissioningFacts]:
    """Put a law on at every gain of the table, on every unit; what cannot be is told, not raised.

    Raises:
        BenchError: the bench failed, or was stopped by hand, which ends the stage.
    """
    units = {unit: _on(as_unit(bench, unit), law, plan, table) for unit in plan.units}
    return Outcome({}, CommissioningFacts(law=name, margin=table.margin, units=units))


def _on(bench: Any, law: StateSpace, plan: LoopPlan, table: CommissionTable) -> CommissionedUnit:
    how = {"margin": table.margin, "seconds": table.seconds, "settle_s": table.settle_s}
    try:
        found = simulate.commission(bench, law, plan.band_hz, gains=tuple(table.gains), **how)
    except UltraquietError as error:
        if bench_failed(error):
            raise  # a cable or an emergency stop: nothing of it is kept, and no other unit is moved
        return CommissionedUnit(status=f"refused: {error}", ok=False, gain=0.0, steps=())
    steps = [
        CommissionedStep(
            gain=step.gain,
            disk=step.disk,
            disk_hz=step.disk_hz,
            peak_db=step.peak_db,
            reduction_db=step.reduction_db,
            next_disk=step.next_disk,
            next_gain=step.next_gain,
        )
        for step in found.steps
    ]
    return CommissionedUnit(status=str(found.status), ok=found.status.ok, gain=found.gain, steps=tuple(steps))
