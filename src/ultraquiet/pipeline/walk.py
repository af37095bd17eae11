"""The walk: a study from its bench to its report, each stage reused when nothing it depends on has changed."""

import shutil
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

from ultraquiet import experiments
from ultraquiet._base.errors import StorageError, UltraquietError
from ultraquiet._base.registry import lookup
from ultraquiet._base.threads import single_threaded
from ultraquiet.files import reason, write_bytes
from ultraquiet.pipeline import preflight, study
from ultraquiet.pipeline.cache import Cache
from ultraquiet.pipeline.report.document import report
from ultraquiet.pipeline.stages import Say, Stages
from ultraquiet.pipeline.store.identity import identity
from ultraquiet.pipeline.store.lock import locked
from ultraquiet.pipeline.store.recorded import Records
from ultraquiet.pipeline.store.sweep import sweep
from ultraquiet.pipeline.summary import Summary, summarise, to_json
from ultraquiet.report import write

PACKAGED_LISTS = ("suite",)
STUDY_FILE = "study.json"


@single_threaded
def walk(
    settings: study.Study, folder: Path, beside: Path | None = None, say: Say = print, record_again: bool = False
) -> Summary:
    """Run a study and return its summary.

    One run at a time works in a folder. What a run leaves is whole: a run that was killed is taken up where it was, and
    what was changed by hand is said and kept under another name.

    Args:
        settings: the checked study.
        folder: where `summary.json`, `report.html`, `records/`, `models/`, `controllers/` and `code/` go.
        beside: folder of the study file, where its experiment list is sought.
        say: told one line per finished stage.
        record_again: set finished records aside, and measure anew.

    Raises:
        UltraquietError: a stage refuses; those before it are kept and reused.
        StorageError: another run is at work in the folder, it holds records of another list or bench, the disk is full.
    """
    bench = _bench(settings)
    listed = experiments.load(_list_of(settings, beside), bench, settings.study.seed)
    preflight.check(settings, bench, listed)
    describe = partial(identity, bench, settings.bench.model_dump(), beside)
    with locked(folder, say) as lock, _on_a_disk(folder):
        sweep(folder)
        _require_space(folder)
        store = Records(listed, bench, describe, folder, say)
        store.claim(record_again)
        write_bytes(folder / STUDY_FILE, _located(settings, beside).model_dump_json(indent=1).encode())
        records = store.take()
        say(f"recorded: {len(records)} records, {listed.duration_s:.0f} s on the bench")
        result = Stages(settings, Cache(folder, say, lock), bench, records, say, store.bench_key).run()
        summary = summarise(result)
        write_bytes(folder / "summary.json", to_json(summary))
        write(report(result), folder / "report.html")
        sweep(folder)
    return summary


@contextmanager
def _on_a_disk(folder: Path) -> Generator[None]:
    """Turn what a disk refuses, wherever it does, into one sentence."""
    try:
        yield
    except UltraquietError:
        raise
    except OSError as error:
        raise StorageError(
            f"study: '{error.filename or folder}' could not be written or read ({reason(error)}); finished stages are "
            "kept."
        ) from error


def _bench(settings: study.Study) -> Any:
    """Return the study's bench; one that draws noise starts from the study's seed unless it has its own."""
    kind = lookup("bench", settings.bench.method)
    draws = any(f.name == "seed" for f in fields(kind)) and "seed" not in settings.bench.settings
    return settings.bench.make("bench", **({"seed": settings.study.seed} if draws else {}))


def _list_of(settings: study.Study, beside: Path | None) -> str:
    name = settings.experiment.list
    return name if name in PACKAGED_LISTS or beside is None else str((beside / name).resolve())


def _located(settings: study.Study, beside: Path | None) -> study.Study:
    """Return the study with where its list stands, so that `report` finds it again."""
    return settings.model_copy(update={"experiment": study.Experiment(list=_list_of(settings, beside))})


def _require_space(folder: Path) -> None:
    if shutil.disk_usage(folder).free < NEEDED_BYTES:
        raise StorageError(f"study: '{folder}' has less than {NEEDED_BYTES >> 20} MB free; nothing was started.")


# Records, loops and models of the packaged study take about 60 MB.
NEEDED_BYTES = 100 << 20
