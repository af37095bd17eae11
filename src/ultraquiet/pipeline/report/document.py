"""The report of a study: its stages as sections."""

from ultraquiet._base.provenance import versions
from ultraquiet.pipeline.report import limits, loops, mission, models
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.report import Report


def report(result: StudyResult) -> Report:
    """Return the report of a finished study."""
    bench = result.study.bench
    named = "none" if bench is None else ", ".join([bench.title, *(f"{k} {v}" for k, v in bench.settings.items())])
    facts = [
        ("bench", named),
        ("records", f"{len(result.records)}, {sum(r.duration_s for r in result.records.values()):.0f} s"),
        ("versions", ", ".join(f"{k} {v}" for k, v in versions().items())),
        ("seed", str(result.study.study.seed)),
    ]
    lead = "Every number below was measured in this run. Designs saw records only; " + (
        "without a bench no loop was closed: what stands of loops is of the design model."
        if bench is None
        else "closed-loop figures come from the bench, never from the design model."
    )
    sections = [
        models.excitation(result),
        models.identification(result),
        models.validation(result),
        models.analysis(result),
        loops.design(result),
        *([] if bench is None else [loops.closed_loop(result)]),
        *([mission.payload(result)] if result.payload else []),
        *([] if result.campaign is None else [mission.campaign(*result.campaign)]),
        limits.limits(result),
        loops.code(result),
    ]
    return Report(result.study.study.title, lead, facts, sections)
