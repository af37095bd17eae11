"""The report of a study: its first page, and its stages as sections."""

from ultraquiet.pipeline.report import claims, code, limits, loops, mission, models, provenance, records
from ultraquiet.pipeline.report.compare import Finished, compared
from ultraquiet.pipeline.report.front import front
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.report import Report


def report(result: StudyResult, other: Finished | None = None) -> Report:
    """Return the report of a finished study, beside another one where there is one to compare with."""
    bench = result.study.bench
    lead = "Every number below was measured in this run. Designs saw records only; " + (
        "without a bench no loop was closed: what stands of loops is of the design model."
        if bench is None
        else "closed-loop figures come from the bench, never from the design model."
    )
    printed = claims.claims(result)
    sections = [
        *([] if other is None else [compared(result, other)]),
        records.excitation(result),
        records.response(result),
        models.identification(result),
        models.validation(result),
        models.analysis(result),
        limits.limits(result),
        loops.design(result),
        code.code(result),
        *([] if bench is None else [loops.closed_loop(result)]),
        *([mission.payload(result)] if result.payload else []),
        *([] if result.commissioning is None else [mission.commissioning(result.commissioning.facts)]),
        *([] if result.campaign is None else [mission.campaign(*result.campaign)]),
        *([] if printed is None else [printed]),
        provenance.provenance(result),
    ]
    return Report(result.study.study.title, lead, provenance.facts(result), sections, front(result))
