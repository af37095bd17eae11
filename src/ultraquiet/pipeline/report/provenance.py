"""Where everything in the report comes from: seeds, versions, content hashes."""

import hashlib
from datetime import UTC, datetime

from ultraquiet._base.provenance import versions
from ultraquiet.pipeline.identification import group, grouped
from ultraquiet.pipeline.report.front import commands
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.report import Section, Table

SHOWN = 12  # digits of a hash


def study_hash(result: StudyResult) -> str:
    """Return what tells this study from any other: a hash of all its settings."""
    return hashlib.sha256(result.study.model_dump_json().encode()).hexdigest()


def facts(result: StudyResult) -> list[tuple[str, str]]:
    """Return the lines of the first page: when, which bench, which records, which versions, which seed."""
    bench = result.study.bench
    settings = {} if bench is None else bench.settings
    named = "none" if bench is None else ", ".join([bench.title, *(f"{k} {_plain(v)}" for k, v in settings.items())])
    return [
        ("written", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, study {study_hash(result)[:SHOWN]}"),
        ("bench", named),
        ("records", f"{len(result.records)}, {sum(r.duration_s for r in result.records.values()):.0f} s"),
        ("versions", ", ".join(f"{k} {v}" for k, v in versions().items())),
        ("seed", str(result.study.study.seed)),
    ]


def _plain(setting: object) -> str:
    """Return a setting as a reader writes it: a list without its brackets."""
    return " ".join(map(str, setting)) if isinstance(setting, list | tuple) else str(setting)


def provenance(result: StudyResult) -> Section:
    """What the study was made of, and the commands that make it again."""
    rows: list[tuple[object, ...]] = [("study", "settings", study_hash(result)[:SHOWN])]
    for name in grouped(result.records):
        for k, record in enumerate(group(result.records, name)):
            maker = record.provenance.made_by.replace("_", " ")
            rows.append((f"record {name} {k + 1}", maker or "read", record.hash[:SHOWN]))
    rows.append(("design plant", result.study.plant.method, result.design_plant.hash[:SHOWN]))
    rows += [(f"law {n}", result.designs[n].facts.method, law.hash[:SHOWN]) for n, law in result.laws.items()]
    seed = result.study.study.seed
    text = (
        f"Everything here follows from the study's settings, its records and seed {seed}; who has the folder makes "
        "report and summary again with: ultraquiet report DIR; who has the settings alone makes all of it with: "
        f"{'; '.join(commands(result))}. Numbers are the same where hashes are the same."
    )
    return Section("Provenance", [text], [Table("Content hashes", ("what", "made by", "hash"), rows, folded=True)])
