"""The walk: a study from its bench to its report, each stage reused when nothing it depends on has changed."""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

from ultraquiet import experiments
from ultraquiet._base.errors import StorageError
from ultraquiet._base.provenance import content_hash
from ultraquiet._base.registry import lookup
from ultraquiet.deploy.toolchain.compiler import compiler
from ultraquiet.files import write_bytes
from ultraquiet.pipeline import control, identification, limits, preflight, report, study, summary, validation
from ultraquiet.pipeline.cache import Cache, Outcome
from ultraquiet.pipeline.result import StudyResult
from ultraquiet.report import write
from ultraquiet.values import PolynomialMatrix, Record, StateSpace

PACKAGED_LISTS = ("suite",)
STUDY_FILE = "study.json"
Say = Callable[[str], object]


def walk(settings: study.Study, folder: Path, beside: Path | None = None, say: Say = print) -> dict[str, Any]:
    """Run a study and return its summary.

    Args:
        settings: the checked study.
        folder: where `summary.json`, `report.html`, `records/`, `models/`, `controllers/` and `code/` go.
        beside: folder of the study file, where its experiment list is sought.
        say: told one line per finished stage.

    Raises:
        UltraquietError: a stage refuses; those before it are kept and reused.
    """
    bench = _bench(settings)
    listed = experiments.load(_list_of(settings, beside), bench, settings.study.seed)
    preflight.check(settings, bench, listed)
    _prepare(settings, folder, beside)
    records = _recorded(listed, bench, settings, folder)
    say(f"recorded: {len(records)} records, {listed.duration_s:.0f} s on the bench")
    done = _stages(settings, Cache(folder), bench, records, say)
    told = summary.summarise(done)
    write_bytes(folder / "summary.json", summary.to_json(told))
    write(report.report(done, told), folder / "report.html")
    return told


def _recorded(listed: experiments.ExperimentList, bench: Any, settings: study.Study, folder: Path) -> dict[str, Record]:
    """Return the records of this list on this bench, taking up a run that was broken off; else record anew.

    Records say nothing of the bench's settings that a resumed run could compare, so those of another list or bench go
    before the new key is written; records that no study left are never touched.
    """
    place = folder / "records"
    mark, kept = content_hash(listed.hash, bench).encode(), place / "list.key"
    every = [m.name for m in listed.measurements]
    there = [name for name in every if (place / f"{name}.h5").exists()]
    if there and not kept.exists():
        raise StorageError(
            f"study: '{place}' holds records that no study left ({there[0]}, ...); choose another --out."
        )
    place.mkdir(exist_ok=True)
    if not (kept.exists() and kept.read_bytes() == mark):
        for name in there:
            (place / f"{name}.h5").unlink()
        write_bytes(kept, mark)
    return experiments.run(listed, place, bench, resume=True, repeat=every)


def _stages(settings: study.Study, cache: Cache, bench: Any, records: Mapping[str, Record], say: Say) -> StudyResult:
    marks = {name: record.hash for name, record in records.items()}
    found = cache.stage(
        "identify", "models", [marks, settings.identify], partial(identification.identified, records, settings.identify)
    )
    best = found.facts["preferred"]
    say(f"identified: held-out records prefer {best['structure']} of order {best['order']}")
    plant = cache.stage(
        "plant", "models", [marks, _key(settings.plant)], partial(identification.plant, records, settings.plant)
    )
    say(f"plant for design: {plant.facts['states']} states, {plant.facts['status']}")
    system = plant.values["plant"]
    control.require_bench(bench, system)
    polynomial = {k: v for k, v in found.values.items() if isinstance(v, PolynomialMatrix)}
    marks_and_models = [marks, settings.identify, bench, system.hash]
    validated = cache.stage(
        "validate", "models", marks_and_models, partial(validation.validated, records, polynomial, system, bench)
    )
    paper = polynomial[f"paper-{settings.identify.paper_records[0]}"]
    analysed = cache.stage("analyse", "models", marks_and_models, partial(validation.analysed, system, paper))
    say("validated and analysed")
    designs, loops, deployment = {}, {}, {}
    for name, wanted in settings.controllers.items():
        key = [system.hash, _key(wanted.design), wanted.reduce and _key(wanted.reduce)]
        made = cache.stage(f"design-{name}", "controllers", key, partial(control.designed, name, system, wanted))
        designs[name] = made
        say(f"designed {name}: {made.facts['status']}")
        if name not in made.values:
            continue
        law = made.values[name]
        adapts = made.facts["adaptive"]
        loop_key = [law.hash, bench, settings.closed_loop, *([system.hash, _key(wanted.design)] if adapts else [])]
        loops[name] = cache.stage(
            f"loop-{name}", "loops", loop_key, partial(_closed, name, law, system, bench, settings, adapts)
        )
        if adapts:
            deployment[name] = {"status": "not generated: the law adapts; C99 is generated from linear laws alone."}
            say(f"closed {name}, which adapts and is not deployed")
            continue
        code = cache.folder / "code"
        generate = partial(control.deployed, name, law, system, bench, code, settings.deploy)
        deployment[name] = cache.stage(
            f"deploy-{name}",
            "code",
            [law.hash, system.hash, bench.actuators, settings.deploy, compiler()],
            generate,
            needs=code / name,
        ).facts
        say(f"closed and deployed {name}: {deployment[name].get('verification', deployment[name]['status'])}")
    laws = {name: made.values[name] for name, made in designs.items() if name in made.values}
    band_hz = settings.closed_loop.band_hz
    limits_key = [system.hash, band_hz, {name: law.hash for name, law in laws.items()}]
    bounded = cache.stage("limits", "models", limits_key, partial(limits.bounded, system, laws, band_hz))
    say(f"limits: {bounded.facts['bands'][-1]['status']}")
    return StudyResult(settings, bench, records, found, plant, validated, analysed, designs, loops, deployment, bounded)


def _closed(name: str, law: StateSpace, plant: StateSpace, bench: Any, settings: study.Study, adapts: bool) -> Outcome:
    acting = control.adapting(plant, settings.controllers[name]) if adapts else None
    return control.closed(name, acting or law, bench, settings.closed_loop)


def _bench(settings: study.Study) -> Any:
    """Return the study's bench; one that draws noise starts from the study's seed unless it has its own."""
    kind = lookup("bench", settings.bench.method)
    draws = any(f.name == "seed" for f in fields(kind)) and "seed" not in settings.bench.settings
    return settings.bench.make("bench", **({"seed": settings.study.seed} if draws else {}))


def _key(method: study.Method) -> dict[str, Any]:
    """Return all that a method's table says; its settings are not declared fields and must be asked for."""
    return method.model_dump()


def _list_of(settings: study.Study, beside: Path | None) -> str:
    name = settings.experiment.list
    return name if name in PACKAGED_LISTS or beside is None else str((beside / name).resolve())


def _prepare(settings: study.Study, folder: Path, beside: Path | None) -> None:
    """Make the folder and leave the study in it, with where its list stands, so that `report` finds both again."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(
            f"study: '{folder}' cannot be made ({error.strerror}); choose another with --out."
        ) from error
    if shutil.disk_usage(folder).free < NEEDED_BYTES:
        raise StorageError(f"study: '{folder}' has less than {NEEDED_BYTES >> 20} MB free; nothing was started.")
    listed = study.Experiment(list=_list_of(settings, beside))
    kept = settings.model_copy(update={"experiment": listed})
    write_bytes(folder / STUDY_FILE, kept.model_dump_json(indent=1).encode())


# Records, loops and models of the packaged study take about 60 MB.
NEEDED_BYTES = 100 << 20
