"""Where a study's records come from: its bench and its list, or its files; what is wrong with them is told at once."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from ultraquiet import experiments
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.lines import NO_LINE, Place
from ultraquiet._base.mistakes import Mistakes
from ultraquiet._base.registry import lookup
from ultraquiet._base.regular import check_regular
from ultraquiet.bench import Replay
from ultraquiet.bench.from_file import from_file
from ultraquiet.experiments import ExperimentList
from ultraquiet.files import read_record, reason
from ultraquiet.files.mapping import load_mapping
from ultraquiet.identify.record_checks import in_and_out
from ultraquiet.pipeline.store.of_the_bench import require_of_bench, taken_for
from ultraquiet.pipeline.study import RecordsTable, Study
from ultraquiet.pipeline.tables.blending import BlendingTable, blended, in_modes, with_matrices
from ultraquiet.values import Record

PACKAGED_LISTS = ("suite",)
Refusal = InputError | StorageError


@dataclass(frozen=True)
class Sources:
    """What a study's records come from, as far as it could be made.

    `own` is the bench, `bench` the one that is recorded, `seen` a bench or record of the channels and the rate that
    laws have; `names` are those of the records, None where nobody can tell them; `said` is what stands for what.
    """

    own: Any
    bench: Any
    blending: BlendingTable | None
    read: Mapping[str, Record]
    seen: Any
    listed: ExperimentList | None
    names: tuple[str, ...] | None
    said: tuple[str, ...] = ()


def sources(settings: Study, beside: Path | None, mistakes: Mistakes) -> Sources:
    """Return the bench, the list and the files of a study; what is wrong with any of them is noted with its line.

    Raises:
        InputError: nothing is wrong but a list or a mapping, which is told with the lines of that file.
    """
    apart: list[tuple[Place, Refusal]] = []  # what is to be mended in another file
    before = len(mistakes)
    own, sound = _bench(settings, beside, mistakes)
    read = {} if settings.records is None else _read(settings.records, beside, mistakes, apart)
    if settings.records is not None and own is not None:
        require_of_bench(settings.records, own, read, mistakes)
    whole = sound and not apart and len(mistakes) == before
    bench, blending, seen = own, None, next(iter(read.values()), own)
    if settings.blending is not None:
        bench = seen = None
        if whole:
            player = Replay(tuple(read.values())) if own is None else own
            blending, recorded, seen = _fitting(settings.blending, player, beside, mistakes)
            bench = None if own is None else recorded
    listed, names = None, None
    if settings.records is not None:
        names = tuple(dict.fromkeys(Path(name).stem for name in settings.records.files))
    else:
        listed = _listed(settings, beside, bench, mistakes, apart)
        names = None if listed is None else tuple(m.name for m in listed.measurements)
    _tell(apart, mistakes)
    said = () if own is None else taken_for(own, read)
    return Sources(own, bench, blending, read, seen, listed, names, said)


def bench_of(settings: Study, beside: Path | None) -> Any:
    """Return the study's bench; one that draws noise starts from the study's seed unless it has its own."""
    table = settings.bench
    if table is None:
        return None
    if table.object is not None:
        return from_file(table.object, beside or Path(), table.settings, settings.study.seed)
    kind = lookup("bench", table.method)
    draws = any(f.name == "seed" for f in fields(kind)) and "seed" not in table.settings
    return table.make("bench", **({"seed": settings.study.seed} if draws else {}))


def list_of(settings: Study, beside: Path | None) -> str:
    """Return the name of the packaged list that a study runs, or the path of its own.

    Raises:
        InputError: it names none and its bench has none.
    """
    name = settings.experiment.list
    if name is None and settings.bench is not None and settings.bench.method == "hexapod":
        return PACKAGED_LISTS[0]
    if name is None:
        raise InputError(
            "study: [experiment] names no 'list', a file of commands (TOML) beside the study; only the hexapod has one."
        )
    return name if name in PACKAGED_LISTS or beside is None else str(place_beside(name, beside))


def place_beside(name: str, beside: Path | None) -> Path:
    """Return the path of a file that a study names; what is relative stands beside the study."""
    path = Path(name) if beside is None else beside / name
    try:
        with suppress(FileNotFoundError, NotADirectoryError):  # whoever reads it says that
            path.lstat()
        # A link keeps its own name, by which a record is called.
        return path if beside is None else path.parent.resolve() / path.name
    except (OSError, ValueError, RuntimeError) as error:  # too long, a NUL, links that go round in a circle
        raise InputError(f"study: {name!r:.60} is no name of a file ({reason(error)}).") from error


def _tell(apart: list[tuple[Place, Refusal]], mistakes: Mistakes) -> None:
    """Note what is wrong in other files too, with their lines; where that is all, its own error says it best."""
    if len(apart) == 1 and not mistakes:
        raise apart[0][1]
    for place, error in apart:
        within: tuple[tuple[int, str], ...] = getattr(error, "mistakes", ())
        name = str(error).partition(":")[0]
        for line, said in within or ((NO_LINE, str(error)),):
            mistakes.add(place, said if line == NO_LINE else f"{name}, line {line}: {said}")


def _bench(settings: Study, beside: Path | None, mistakes: Mistakes) -> tuple[Any, bool]:
    """Return the bench, and whether it could be made."""
    try:
        return bench_of(settings, beside), True
    except (InputError, StorageError) as error:
        table = settings.bench
        assert table is not None  # without a table there is nothing to refuse
        kind = "object" if table.object is not None else "method"
        for said in _sentences(error):
            key = _named(said, table.settings)
            mistakes.add(("bench", kind if key is None else key), said)
        return None, False


def _listed(
    settings: Study, beside: Path | None, bench: Any, mistakes: Mistakes, apart: list[tuple[Place, Refusal]]
) -> ExperimentList | None:
    """Return the list planned for the bench; where there is none, that the list can be read is seen to all the same."""
    place = ("experiment", "list")
    try:
        path = list_of(settings, beside)
        if bench is not None:
            return experiments.load(path, bench, settings.study.seed)
        if path not in PACKAGED_LISTS:
            check_regular(path)
    except OSError as error:
        mistakes.add(place, f"experiment list: '{error.filename}' cannot be read ({reason(error)}).")
    except InputError as error:
        if getattr(error, "mistakes", ()):
            apart.append((place, error))
        else:
            mistakes.add(place, str(error))
    return None


def _fitting(
    table: BlendingTable, player: Any, beside: Path | None, mistakes: Mistakes
) -> tuple[BlendingTable | None, Any, Any]:
    """Return the table with its matrices, the bench that is recorded and the one in modes; or note what does not fit.

    Also matrices of files have the line of theirs.
    """
    try:
        blending = with_matrices(table, beside)
        return blending, blended(player, blending), in_modes(player, blending)
    except InputError as error:
        key = _named(str(error), ("sensors", "actuators"))
        mistakes.add(("blending", *([] if key is None else [key])), str(error))
        return None, None, None


def _read(
    table: RecordsTable, beside: Path | None, mistakes: Mistakes, apart: list[tuple[Place, Refusal]]
) -> dict[str, Record]:
    """Return the records of a study's files by the names of these; each file that will not do is noted."""
    records: dict[str, Record] = {}
    mapping = None
    if table.mapping is not None:
        try:
            mapping = load_mapping(place_beside(table.mapping, beside))
        except InputError as error:
            apart.append((("records", "mapping"), error))
    stems: set[str] = set()
    for k, name in enumerate(table.files):
        try:
            path = place_beside(name, beside)
            if path.stem in stems:
                raise InputError(f"study: two files of [records] are called '{path.stem}'; rename one.")
            stems.add(path.stem)
            if apart and table.mapping is not None and mapping is None:
                check_regular(path)  # how it is to be read is not known
                continue
            record = read_record(path, table.rate_hz, table.inputs, table.outputs, mapping, keep_clock=True)
            if same := in_and_out(record):
                raise InputError(
                    f"study: '{same[0]}' of '{name}' goes in and comes out as well; name every column once."
                )
            records[path.stem] = record
            _require_alike(name, record, records)
        except (InputError, OSError) as error:
            known = isinstance(error, Refusal)
            said = _sentences(error) if known else [f"study: '{name}' cannot be read ({reason(error)})."]
            for sentence in said:
                mistakes.add(_place_of(sentence, table, k), sentence)
    return records


def _require_alike(name: str, record: Record, records: Mapping[str, Record]) -> None:
    first, one = next(iter(records.items()))
    if (record.rate_hz, record.actuators, record.sensors) != (one.rate_hz, one.actuators, one.sensors):
        raise InputError(f"study: '{name}' has other channels or another rate than '{first}'.")


def _place_of(said: str, table: RecordsTable, k: int) -> Place:
    """Return where a file is mended that would not do: at a column that is named, at the rate, or at its own name."""
    for key in ("inputs", "outputs"):
        columns = getattr(table, key)
        names = [c.strip() for c in columns.split(",")] if isinstance(columns, str) else columns or []
        for j, name in enumerate(names):
            if f"'{name}'" in said:
                return ("records", key) if isinstance(columns, str) else ("records", key, j)
    if table.rate_hz is not None and f"{table.rate_hz:g} Hz" in said:
        return "records", "rate_hz"
    return "records", "files", k


def _named(said: str, keys: Iterable[str]) -> str | None:
    """Return the key that a sentence names, where a mistake is mended."""
    return next((key for key in keys if f"'{key}'" in said), None)


def _sentences(error: BaseException) -> list[str]:
    """Return what an error says, one sentence for each mistake."""
    return [said for _, said in getattr(error, "mistakes", ())] or [str(error)]
