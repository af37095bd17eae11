"""`summary.json`: the study's numbers under the names that the contract fixes."""

import json
import math
from typing import Any

from ultraquiet._base.provenance import plain, versions
from ultraquiet.pipeline.result import StudyResult


def summarise(done: StudyResult) -> dict[str, Any]:
    """Return the summary: identification, design, closed loop, deployment, limits, versions and seed."""
    return {
        "title": done.study.study.title,
        "identification": {
            "table": done.identified.facts["table"],
            "preferred": done.identified.facts["preferred"],
            "paper": done.identified.facts["paper"],
            "against_bench": done.validated.facts.get("against_bench"),
            "plant": done.plant.facts,
        },
        "design": {name: _design(outcome.facts) for name, outcome in done.designs.items()},
        "closed_loop": {name: dict(outcome.facts) for name, outcome in done.loops.items()},
        "deployment": {name: dict(tables) for name, tables in done.deployment.items()},
        "limits": {**done.bounds.facts, "mean_log_sensitivity_db": _mean_log(done)},
        "versions": versions(),
        "seed": done.study.study.seed,
    }


def _mean_log(done: StudyResult) -> dict[str, dict[str, float]]:
    """Return Bode's integral of every loop as the bench shows it, by controller and unit."""
    return {
        name: {unit: facts["mean_log_sensitivity_db"] for unit, facts in outcome.facts.items() if facts["stable"]}
        for name, outcome in done.loops.items()
    }


def _design(facts: Any) -> dict[str, Any]:
    kept = ("method", "status", "ok", "states", "gamma", "achieved", "peak_sensitivity_db", "margins", "reduction")
    return {key: facts[key] for key in kept if key in facts}


def to_json(summary: dict[str, Any]) -> bytes:
    """Return the summary as JSON; what is not a finite number is null there, as JSON knows no other word for it."""
    return json.dumps(_finite(json.loads(json.dumps(summary, default=plain))), indent=1).encode()


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
