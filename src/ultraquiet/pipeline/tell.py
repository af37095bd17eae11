"""The report of a study: its stages as sections."""

from typing import TYPE_CHECKING, Any

from ultraquiet._base.provenance import versions
from ultraquiet.pipeline import tell_limits, tell_loops, tell_models
from ultraquiet.report import Report

if TYPE_CHECKING:
    from ultraquiet.pipeline.walk import Done


def report(done: "Done", summary: dict[str, Any]) -> Report:
    """Return the report of a finished study."""
    bench = done.study.bench
    facts = [
        ("bench", ", ".join([bench.method, *(f"{k} {v}" for k, v in bench.settings.items())])),
        ("records", f"{len(done.records)}, {sum(r.duration_s for r in done.records.values()):.0f} s"),
        ("versions", ", ".join(f"{k} {v}" for k, v in versions().items())),
        ("seed", str(summary["seed"])),
    ]
    lead = (
        "Every number below was measured in this run. Designs saw records only; closed-loop figures come from the "
        "bench, never from the design model."
    )
    sections = [
        tell_models.excitation(done),
        tell_models.identification(done),
        tell_models.validation(done),
        tell_models.analysis(done),
        tell_loops.design(done),
        tell_loops.closed_loop(done),
        tell_limits.limits(done),
        tell_loops.code(done),
    ]
    return Report(done.study.study.title, lead, facts, sections)
