"""The walk: a study from its bench to its report, each stage reused when nothing it depends on has changed."""

import json
import shutil
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from ultraquiet import experiments
from ultraquiet._base.beside import Said
from ultraquiet._base.errors import InputError, StorageError, UltraquietError
from ultraquiet._base.shown.line import counted
from ultraquiet._base.threads import single_threaded
from ultraquiet.bench import Replay
from ultraquiet.files import reason, write_bytes
from ultraquiet.pipeline import control, preflight, study
from ultraquiet.pipeline.facts.mission import CampaignFacts
from ultraquiet.pipeline.facts.typed import to_plain
from ultraquiet.pipeline.making.models import Say
from ultraquiet.pipeline.making.processes import identifying_beside
from ultraquiet.pipeline.mission.campaign import How
from ultraquiet.pipeline.report.compare import finished
from ultraquiet.pipeline.report.document import report
from ultraquiet.pipeline.stage import Cache
from ultraquiet.pipeline.stages import Stages
from ultraquiet.pipeline.store.copies import Copies
from ultraquiet.pipeline.store.identity import identity
from ultraquiet.pipeline.store.lock import locked
from ultraquiet.pipeline.store.recorded import Records
from ultraquiet.pipeline.store.sources import bench_of, list_of, place_beside, sources
from ultraquiet.pipeline.store.sweep import sweep
from ultraquiet.pipeline.summary import Summary, summarise, to_json
from ultraquiet.pipeline.tables.blending import BlendingTable, blended, blended_records, driven, with_matrices
from ultraquiet.pipeline.tables.mission import CampaignTable
from ultraquiet.report import write
from ultraquiet.values import Record

STUDY_FILE = "study.json"
LONG_SAMPLES = 100_000  # of a list; while they are measured there is time to make ready what identifies them


@single_threaded
def measure(
    settings: study.Study,
    folder: Path,
    beside: Path | None = None,
    say: Say = print,
    stop: Callable[[], bool] | None = None,
) -> Mapping[str, Record]:
    """Return the records of a study's list, measured where they are not there yet; `walk` goes on from them.

    Args:
        settings: the checked study; it names a bench and a list.
        folder: where `records/` goes.
        beside: folder of the study file.
        say: told what was kept under another name.
        stop: asked while it measures, as `experiments.run` asks it.

    Raises:
        UltraquietError: as `walk`, up to its records.
        StoppedError: `stop` said yes.
    """
    own = bench_of(settings, beside)
    if own is None:
        raise InputError("study: it has no bench that could measure; drop files instead.")
    settings = with_read_matrices(settings, beside)
    bench = own if settings.blending is None else blended(own, settings.blending)
    listed = experiments.load(list_of(settings, beside), bench, settings.study.seed)
    with locked(folder, say), _on_a_disk(folder):
        sweep(folder)
        _require_space(folder)
        store = Records(listed, bench, partial(described, own, settings, beside), folder, say)
        store.claim()
        return store.take(stop)


@single_threaded
def walk(
    settings: study.Study,
    folder: Path,
    beside: Path | None = None,
    say: Say = print,
    record_again: bool = False,
    compare: Path | None = None,
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
        compare: folder of another finished study that the report sets beside this one.

    Raises:
        UltraquietError: a stage refuses; those before it are kept and reused.
        StorageError: another run is at work in the folder, it holds records of another list or bench, the disk is full.
    """
    other = None if compare is None else finished(compare, folder)
    with prepared(settings, folder, beside, say, record_again, identified=True) as stages:
        result = stages.run()
        summary = summarise(result)
        write_bytes(folder / "summary.json", to_json(summary))
        write(report(result, other), folder / "report.html")
        sweep(folder)
    return summary


@single_threaded
def conduct(
    settings: study.Study, folder: Path, beside: Path | None, say: Say, how: How, benches: int | None = None
) -> CampaignFacts:
    """Run the campaign of a study, or what is left of it; of the study only what its law needs is done before.

    Args:
        settings: the checked study; without `[campaign]` that table's own defaults are taken.
        folder: of the study; `campaign.parquet` and `campaign.json` go there.
        beside: folder of the study file.
        say: told one line per finished stage.
        how: where it runs, and whether it goes on with what is there.
        benches: how many, in place of the study's number.

    Raises:
        UltraquietError: as `walk`; results of another campaign with `resume`.
    """
    _require_bench(settings)
    table = settings.campaign or CampaignTable()
    asked = table if benches is None else table.model_copy(update={"benches": benches})
    with prepared(settings.model_copy(update={"campaign": asked}), folder, beside, say) as stages:
        return stages.campaign(how)


@single_threaded
def one_case(settings: study.Study, folder: Path, beside: Path | None, say: Say, case: int) -> dict[str, Any]:
    """Return the row of one case of a study's campaign, evaluated again."""
    _require_bench(settings)
    with prepared(settings, folder, beside, say) as stages:
        return stages.campaign_of(settings.campaign or CampaignTable()).evaluate(case)


def _require_bench(settings: study.Study) -> None:
    """Refuse a campaign of a study that has none to draw, before anything is written."""
    if settings.bench is None:
        raise InputError("campaign: the study has no bench that could be drawn.")


@contextmanager
def prepared(
    settings: study.Study,
    folder: Path,
    beside: Path | None,
    say: Say,
    record_again: bool = False,
    identified: bool = False,
) -> Generator[Stages]:
    """Take a study's records, and hold its folder while the stages after them are at work; see `walk`.

    `identified`: whether all structures will be compared, for which a process makes itself ready meanwhile.
    """
    mistakes = settings.mistakes()
    found = sources(settings, beside, mistakes)
    preflight.check(settings, found.bench, found.names, found.listed, found.seen, mistakes)
    own, bench, blending, read, listed = found.own, found.bench, found.blending, found.read, found.listed
    resolved = settings.model_copy(update={"blending": blending})
    describe = partial(described, own, resolved, beside)
    with locked(folder, say) as lock, _on_a_disk(folder), ExitStack() as processes:
        sweep(folder)
        _require_space(folder)
        cache, ahead = Cache(folder, say, lock), Said()
        if listed is None:
            copies = Copies(read, folder)
            copies.claim()
            _write_study(settings, folder, beside)
            records, bench_key = copies.take(), None if bench is None else describe()
            say(f"read: {counted(len(records), 'record')}")
            for sentence in found.said:
                say(sentence)
        else:
            store = Records(listed, bench, describe, folder, say)
            store.claim(record_again)
            _write_study(settings, folder, beside)
            for sentence in listed.said:
                say(sentence)
            calculated = getattr(bench, "side_by_side", False) and blending is None
            wanted = identified and calculated and store.missing_samples >= LONG_SAMPLES
            ahead = processes.enter_context(identifying_beside(cache, wanted))
            records, bench_key = store.take(), store.bench_key
            say(f"recorded: {counted(len(records), 'record')}, {listed.duration_s:.0f} s on the bench")
        if blending is not None:
            bench, records = _in_modes(own, blending, records, say)
        if bench is not None and not preflight.reacts(bench):
            say("the bench plays back its records: no loop is closed on it")
            bench = None
        left = preflight.unheard(settings) if bench is None else []
        if left:
            say(f"closed_loop: without a bench no loop is closed and no tone is sent; unused: {', '.join(left)}")
        complete = control.with_limits(settings, next(iter(records.values())).actuators, records.values())
        if complete is not settings:
            settings = complete
            _write_study(settings, folder, beside)  # for whoever designs beside, and for the report
        key = bench_key_of(resolved, bench_key)
        yield Stages(settings, cache, bench, records, say, key, ahead=ahead)


def _in_modes(
    own: Any, table: BlendingTable, records: Mapping[str, Record], say: Say
) -> tuple[Any, Mapping[str, Record]]:
    """Return the bench, where there is one, and its records in modes; what was noticed of the channels is said."""
    done = blended_records(Replay(tuple(records.values())) if own is None else own, table, records)
    for sentence in done.sentences:
        say(sentence)
    return None if own is None else done.bench, done.records


def bench_table(settings: study.Study) -> dict[str, Any]:
    """Return `[bench]` with its file by itself, so that the content of it counts."""
    if settings.bench is None:
        return {}
    table = settings.bench.model_dump()
    if settings.bench.object is not None:
        table["object"], _, table["callable"] = settings.bench.object.rpartition(":")
    return table


def described(own: Any, settings: study.Study, beside: Path | None) -> dict[str, Any]:
    """Return what defines the bench that a study records, in plain types: its own, and the modes it is driven by.

    `settings` are those of `with_read_matrices`.
    """
    return {**identity(own, bench_table(settings), beside), **driven(own, settings.blending)}


def with_read_matrices(settings: study.Study, beside: Path | None) -> study.Study:
    """Return the study with the matrices of its blending in place of the files that hold them.

    Raises:
        InputError: a file that holds none.
    """
    if settings.blending is None:
        return settings
    return settings.model_copy(update={"blending": with_matrices(settings.blending, beside)})


def bench_key_of(settings: study.Study, bench: Any) -> Any:
    """Return what defines the bench for the stages that measure on it: what it is, and how its channels are blended.

    `settings` are those of `with_read_matrices`, so that of a file the content counts; `bench` is as `described`.
    """
    plain = json.loads(json.dumps(to_plain(bench)))
    return plain if settings.blending is None else [plain, settings.blending]


def _write_study(settings: study.Study, folder: Path, beside: Path | None) -> None:
    """Leave the study in its folder, with where its files stand, so that `report` finds them again."""
    write_bytes(folder / STUDY_FILE, _located(settings, beside).model_dump_json(indent=1).encode())


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


def _located(settings: study.Study, beside: Path | None) -> study.Study:
    """Return the study with where its files stand."""
    found: dict[str, Any] = {}
    if settings.records is None:
        found["experiment"] = study.Experiment(list=list_of(settings, beside))
    else:
        files = [str(place_beside(name, beside)) for name in settings.records.files]
        mapping = settings.records.mapping and str(place_beside(settings.records.mapping, beside))
        found["records"] = settings.records.model_copy(update={"files": files, "mapping": mapping})
    if settings.blending is not None:
        matrices = {name: getattr(settings.blending, name) for name in ("sensors", "actuators")}
        located = {name: str(place_beside(file, beside)) for name, file in matrices.items() if isinstance(file, str)}
        found["blending"] = settings.blending.model_copy(update=located)
    if settings.bench is not None and settings.bench.object is not None:
        name, _, attribute = settings.bench.object.rpartition(":")
        found["bench"] = settings.bench.model_copy(update={"object": f"{place_beside(name, beside)}:{attribute}"})
    return settings.model_copy(update=found)


def _require_space(folder: Path) -> None:
    if shutil.disk_usage(folder).free < NEEDED_BYTES:
        raise StorageError(f"study: '{folder}' has less than {NEEDED_BYTES >> 20} MB free; nothing was started.")


# Records, loops and models of the packaged study take about 60 MB.
NEEDED_BYTES = 100 << 20
