"""The study file: what a study says, checked whole before anything starts."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, AliasChoices, ConfigDict, Field, PrivateAttr, ValidationError

from ultraquiet._base.errors import InputError, UnknownMethodError
from ultraquiet._base.lines import Place
from ultraquiet._base.mistakes import Mistakes, TableError, read_toml
from ultraquiet._base.registry import lookup
from ultraquiet._base.regular import read_regular_text
from ultraquiet._base.tables import Method, Strict, settings_object
from ultraquiet.files import reason, refuse_data
from ultraquiet.identify import Rational
from ultraquiet.identify.polynomial.methods import PolynomialMethod
from ultraquiet.pipeline.tables.around import check_around
from ultraquiet.pipeline.tables.blending import BlendingTable
from ultraquiet.pipeline.tables.code import Deploy
from ultraquiet.pipeline.tables.files import check_sources, with_all_records
from ultraquiet.pipeline.tables.mission import CampaignTable, CommissionTable, PayloadTable
from ultraquiet.pipeline.tables.numbers import LARGEST, Band, Decibels, FileName, Order, Positive, Seconds, Seed
from ultraquiet.pipeline.tables.paper import Paper, with_paper
from ultraquiet.pipeline.tables.sound import note_missing_files, without_refused

# Of a key by its older name, where it is looked for.
NEWER_PLACES: dict[Place, Place] = {("closed_loop", "amplitude_v"): ("closed_loop", "amplitude")}
QUICK_STRUCTURES, QUICK_ORDERS = ["arx", "box-jenkins"], [5, 8]
# Names of controllers become names of files; "open" names the records of the open loop.
FILE_NAME = re.compile(r"(?!open$)[A-Za-z0-9][A-Za-z0-9_.-]*")


def _file_name(name: str) -> str:
    if not FILE_NAME.fullmatch(name):
        raise ValueError("a name is made of letters, digits, '-', '_' and '.', starts with one of the first two")
    return name


Name = Annotated[str, AfterValidator(_file_name)]


class StudyError(TableError):
    """A study with mistakes; `.mistakes` holds them as (line, sentence), sorted by line."""

    consequence = "; nothing was started"


class Head(Strict):
    """`[study]`: the seed is where test signals and sensor noise start."""

    title: str
    seed: Seed = 0


class BenchTable(Method):
    """`[bench]`: a registered bench by its `method`, or `object`, "FILE.py:CALLABLE" beside the study; its settings."""

    method: str = ""
    object: str | None = None

    @property
    def title(self) -> str:
        """What the report calls the bench."""
        return self.method if self.object is None else Path(self.object.rpartition(":")[0]).name


class Experiment(Strict):
    """`[experiment]`: the list to execute; "suite" is the packaged one for the hexapod, anything else a file.

    A file is sought beside the study. Only the hexapod has a list of its own.
    """

    list: FileName | None = None


class RecordsTable(Strict):
    """`[records]`: files that were measured elsewhere, in place of an experiment list; see `files.read_record`.

    Each becomes a record by the name of its file; all of them hold the same channels.
    """

    files: list[FileName] = Field(min_length=1)
    rate_hz: Positive | None = None
    inputs: str | list[str] | None = None
    outputs: str | list[str] | None = None
    mapping: FileName | None = None


class IdentifyTable(Strict):
    """`[identify]`: the channel-by-channel identification and its judges; records are named by their group.

    Without `records` it is the first group that drives one actuator after the other, and without `held_out` the next
    of them; where there is no next, the last third of each record is kept back.
    """

    structures: list[str] = Field(default=["arx", "armax", "output-error", "box-jenkins"], min_length=1)
    orders: list[Order] = Field(default=[2, 3, 4, 5, 6, 7, 8], min_length=1)
    records: str | None = None
    held_out: str | None = None


class Plant(Method):
    """`[plant]`: how the design model is identified, from which groups of records; a period makes them responses.

    `units` are further ones of the bench: each gives records of the same signals and a model of its own, for designs
    that hold on several plants at once. Others take the model of the study's unit alone.
    """

    records: list[str] = Field(min_length=1)
    period_samples: Annotated[int, Field(ge=2, le=LARGEST, strict=True)] | None = None
    units: list[str] = Field(default=[])


class Design(Strict):
    """`[controllers.NAME]`: a design method with its settings, and what follows it.

    `around` names another law of the study, as it runs, round which this one is put.
    """

    design: Method
    reduce: Method | None = None
    around: Name | None = None


class ClosedLoop(Strict):
    """`[closed_loop]`: what is measured of every law, on the bench.

    Without `units` it is the bench as it stands; without tones none is sent. The amplitude is in the actuators' unit, a
    tenth of the smallest range when absent; tones last twenty periods of the lowest when absent, two seconds at least.
    The band is the plant's own when absent, in which it answers.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    units: list[str] = Field(default=[])
    tones_hz: list[Positive] = Field(default=[])
    amplitude: Positive | None = Field(default=None, validation_alias=AliasChoices("amplitude", "amplitude_v"))
    duration_s: Seconds | None = None
    band_hz: Band | None = None


class ValidateTable(Strict):
    """`[validate]`: over which band models are held against the bench's own response; that of the loop when absent."""

    band_hz: Band | None = None


class LimitsTable(Strict):
    """`[limits]`: the price at which bands are compared, and the bands; that of the loop when absent.

    `peak_db` is of |S|, every direction; `control_gain` of |K S|, in units of actuators per unit of sensors. Beside
    each limit stands that of every plant off by `uncertainty`, a relative error; 0 leaves it out.
    """

    peak_db: Annotated[float, Field(gt=0, le=300, strict=True)] = 6.0
    control_gain: Positive | None = None
    uncertainty: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.1
    bands_hz: list[Band] = Field(default=[])


class Requirements(Strict):
    """`[requirements]`: what the named law must reach on every unit of `[closed_loop]`; what is absent is not asked.

    `disk_margin` is that of all channels at once, at both ends of the identified plant; the band is that of
    `[closed_loop]` when absent.
    """

    law: str
    band_hz: Band | None = None
    attenuation_db: Decibels | None = None
    peak_db: Decibels | None = None
    disk_margin: Annotated[float, Field(gt=0, le=2, strict=True)] | None = None
    payload_db: Decibels | None = None
    tones_db: Decibels | None = None


class Study(Strict):
    """A whole study file."""

    study: Head
    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True, serialize_by_alias=True)

    bench: BenchTable | None = None
    records: RecordsTable | None = None
    experiment: Experiment = Experiment()
    blending: BlendingTable | None = None
    identify: IdentifyTable = IdentifyTable()
    paper: Paper | None = None
    plant: Plant
    controllers: dict[Name, Design] = Field(min_length=1)
    closed_loop: ClosedLoop = ClosedLoop()
    deploy: Deploy = Deploy()
    requirements: Requirements | None = None
    payload: PayloadTable | None = None
    campaign: CampaignTable | None = None
    commission: CommissionTable | None = None
    validate_models: ValidateTable = Field(default=ValidateTable(), alias="validate")
    limits: LimitsTable = LimitsTable()
    _places: Mapping[Place, int] | None = PrivateAttr(default=None)
    _name: str = PrivateAttr(default="study")

    def at(self, places: Mapping[Place, int], name: str = "study") -> "Study":
        """Return the study with the name of its file and the lines on which things stand in it."""
        located = self.model_copy()
        newer = {NEWER_PLACES[place]: line for place, line in places.items() if place in NEWER_PLACES}
        located._places, located._name = {**newer, **places}, name
        return located

    @property
    def name(self) -> str:
        """What opens the sentence about its mistakes: its file, if it was read from one."""
        return self._name

    def mistakes(self) -> Mistakes:
        """Return a collector that knows these lines, if the study was read from a file."""
        return Mistakes(self._places)


def packaged_study(name: str) -> Study:
    """Return a study that ships with the package."""
    return load_study(Path(__file__).with_name(f"{name}.toml"))


def quick_study(study: Study) -> Study:
    """Return the study with two structures and two orders instead of a whole sweep, on one unit, one limit a law."""
    sweep = study.identify.model_copy(update={"structures": QUICK_STRUCTURES, "orders": QUICK_ORDERS})
    paper = study.paper and study.paper.model_copy(update={"records": study.paper.records[:1]})
    loop = study.closed_loop.model_copy(update={"units": study.closed_loop.units[:1]})
    limits = study.limits.model_copy(update={"bands_hz": [], "uncertainty": 0.0})  # that of the loop and plant alone
    return study.model_copy(update={"identify": sweep, "paper": paper, "closed_loop": loop, "limits": limits})


def reload_study(folder: Path) -> Study:
    """Return the study that a folder was made by.

    Raises:
        InputError: the folder holds no study.
    """
    path = folder / "study.json"
    try:
        return Study.model_validate_json(read_regular_text(path))
    except (FileNotFoundError, NotADirectoryError) as error:
        what = f"in '{folder}' there is no study.json" if folder.is_dir() else f"there is no folder '{folder}'"
        if folder.is_file():
            what = f"'{folder}' is a file"
        raise InputError(f"report: {what}; name the folder that a study was run in (`run --out`).") from error
    except (OSError, UnicodeDecodeError, ValidationError) as error:
        raise InputError(
            f"report: '{path}' cannot be read as a study ({type(error).__name__}); run the study once more."
        ) from error


def load_study(path: Path) -> Study:
    """Read and check a study file; every mistake is told in one error, with its line.

    Raises:
        InputError: the file is missing, or a `StudyError` as of `parse`.
    """
    refuse_data("study", path, "a study (TOML)")
    try:
        text = read_regular_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"study: '{path}' cannot be read ({reason(error)}).") from error
    return parse(text, str(path), path.parent)


def parse(text: str, name: str = "study", beside: Path | None = None) -> Study:
    r"""Check the text of a study file; with its folder, also that its files are there, where anything else is wrong.

    Raises:
        StudyError: it is not TOML, or holds mistakes; all of them are told, each with its line.

    >>> parse('[study]\ntitle = "short"\nseed = -1\n[deploy]\nprecison = "float64"')  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ultraquiet.pipeline.study.StudyError: study: 5 mistakes; nothing was started.
      line 1: 'bench' is missing.
      line 1: 'controllers' is missing.
      line 1: 'plant' is missing.
      line 3: study: 'seed' should be greater than or equal to 0, got -1.
      line 5: deploy: there is no key 'precison' here; did you mean 'precision'? Known are precision, ...
    """
    content, places = read_toml(text, name, StudyError)
    if "commands" in content and "study" not in content:
        raise InputError(
            f"study: '{name}' is an experiment list; `ultraquiet experiment` takes it, and a study names it under "
            "[experiment] as 'list'."
        )
    content, places = with_paper(content, places)
    content = with_all_records(content)
    mistakes = Mistakes(places)
    check_sources(content, mistakes)
    for place, family, table in _methods(content):
        _check_method(place, family, table, mistakes)
    study = _sound(content, mistakes)
    if study is not None:
        check_around(study.controllers, mistakes)
        _check_requirements(study, mistakes)
    if beside is not None and (mistakes or study is None):
        note_missing_files(content, beside, mistakes)
    if mistakes or study is None:
        raise StudyError(name, mistakes.by_line())
    return study.at(places, name)


def _sound(content: Mapping[str, Any], mistakes: Mistakes) -> Study | None:
    """Return the study of what the schema takes; note what it refuses."""
    try:
        return Study.model_validate(content)
    except ValidationError as error:
        mistakes.add_refusal((), error, Study)
        rest = without_refused(content, error)
    try:
        return None if rest is None else Study.model_validate(rest)
    except ValidationError:  # what was refused stood for more
        return None


def _check_requirements(study: Study, mistakes: Mistakes) -> None:
    """Note a law that the study does not design, and what nothing in it measures."""
    if study.bench is None and study.payload is not None:
        mistakes.add(("payload",), "payload: the study has no bench that could be shaken; leave it away.")
    _check_campaign(study, mistakes)
    asked = study.requirements
    if asked is None:
        return
    if asked.law not in study.controllers:
        fault = f"there is no law '{asked.law}' among the controllers {', '.join(study.controllers)}."
        mistakes.add(("requirements", "law"), f"requirements.law: {fault}")
    if study.bench is None:
        for key in ("attenuation_db", "peak_db", "tones_db"):
            if getattr(asked, key) is not None:
                fault = "the study has no bench, so nothing measures it; leave it away."
                mistakes.add(("requirements", key), f"requirements.{key}: {fault}")
    elif asked.tones_db is not None and not study.closed_loop.tones_hz:
        fault = "the study sends no tones; name them as closed_loop.tones_hz."
        mistakes.add(("requirements", "tones_db"), f"requirements.tones_db: {fault}")
    if asked.payload_db is not None and study.payload is None:
        fault = "the study has no payload table, so nothing measures it; leave it away."
        mistakes.add(("requirements", "payload_db"), f"requirements.payload_db: {fault}")


def _check_campaign(study: Study, mistakes: Mistakes) -> None:
    """Note a campaign or a commissioning without a bench, about a law that is not designed, or that cannot tune one."""
    for name, table in (("campaign", study.campaign), ("commission", study.commission)):
        if table is None:
            continue
        if study.bench is None:
            mistakes.add((name,), f"{name}: the study has no bench for it; leave it away.")
        if table.law is not None and table.law not in study.controllers:
            fault = f"there is no law '{table.law}' among the controllers {', '.join(study.controllers)}."
            mistakes.add((name, "law"), f"{name}.law: {fault}")
    if study.campaign is not None and study.campaign.tune and not issubclass(_kind_of(study.plant), Rational):
        fault = 'it fits responses; give [plant] the method "rational", or leave it away.'
        mistakes.add(("campaign", "tune"), f"campaign.tune: {fault}")


def _kind_of(plant: Plant) -> type[Any]:
    """Return the class of a plant's method; of one that nobody knows, which is noted elsewhere, one that will do."""
    try:
        return lookup("identify", plant.method)
    except UnknownMethodError:
        return Rational


def _check_method(place: Place, family: str, table: Mapping[str, Any], mistakes: Mistakes) -> None:
    """Note everything that the registry or the method refuses, whatever else is wrong with the file."""
    try:
        method = (Plant if place == ("plant",) else Method).model_validate(table)
    except ValidationError:
        return  # the schema notes it
    candidate = settings_object(family, method.method, method.settings, place, mistakes)
    if candidate is not None and place[0] in ("identify", "paper") and not isinstance(candidate, PolynomialMethod):
        mistakes.add(place, f"'{method.method}' is no polynomial structure.")


def _methods(content: Mapping[str, Any]) -> Iterator[tuple[Place, str, Mapping[str, Any]]]:
    """Yield place, family and table of every method that a study names."""
    tables: list[tuple[Place, str, Any]] = [(("plant",), "identify", content.get("plant"))]
    bench = content.get("bench")
    if isinstance(bench, dict) and "method" in bench and "object" not in bench:
        tables.append((("bench",), "bench", bench))
    controllers = content.get("controllers")
    for name, entry in controllers.items() if isinstance(controllers, dict) else ():
        if isinstance(entry, dict):
            tables += [(("controllers", name, family), family, entry.get(family)) for family in ("design", "reduce")]
    sweep = content.get("identify")
    if isinstance(sweep, dict):
        structures = sweep.get("structures")
        for k, name in enumerate(structures if isinstance(structures, list) else []):
            tables.append((("identify", "structures", k), "identify", {"method": name}))
    paper = content.get("paper")
    if isinstance(paper, dict) and "structure" in paper:
        tables.append((("paper", "structure"), "identify", {"method": paper["structure"]}))
    return ((place, family, table) for place, family, table in tables if isinstance(table, dict))
