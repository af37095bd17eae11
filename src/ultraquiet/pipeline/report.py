"""The report of a study: its stages as sections."""

from typing import Any

from ultraquiet._base.provenance import versions
from ultraquiet.pipeline import report_limits, report_loops, report_models
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.report import Report


def report(done: StudyResult, summary: dict[str, Any]) -> Report:
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
        report_models.excitation(done),
        report_models.identification(done),
        report_models.validation(done),
        report_models.analysis(done),
        report_loops.design(done),
        report_loops.closed_loop(done),
        report_limits.limits(done),
        report_loops.code(done),
    ]
    return Report(done.study.study.title, lead, facts, sections)
