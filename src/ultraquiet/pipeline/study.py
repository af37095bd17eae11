"""The study file: what a study says, checked whole before anything starts."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, PrivateAttr, ValidationError

from ultraquiet._base.errors import InputError
from ultraquiet._base.lines import Place
from ultraquiet._base.mistakes import Mistakes, TableError, read_toml
from ultraquiet._base.tables import Method, Strict, settings_object
from ultraquiet.files import reason
from ultraquiet.identify.polynomial.methods import PolynomialMethod

QUICK_STRUCTURES, QUICK_ORDERS = ["arx", "box-jenkins"], [5, 8]
# Names of controllers become names of files; "open" names the records of the open loop.
FILE_NAME = re.compile(r"(?!open$)[A-Za-z0-9][A-Za-z0-9_.-]*")


def _file_name(name: str) -> str:
    if not FILE_NAME.fullmatch(name):
        raise ValueError("a name is made of letters, digits, '-', '_' and '.', starts with one of the first two")
    return name


def _rising(band_hz: tuple[float, float]) -> tuple[float, float]:
    if not band_hz[0] < band_hz[1]:
        raise ValueError("the band must rise")
    return band_hz


Positive = Annotated[float, Field(gt=0)]
Order = Annotated[int, Field(ge=1, le=20)]
Name = Annotated[str, AfterValidator(_file_name)]
Band = Annotated[tuple[Positive, Positive], AfterValidator(_rising)]


class StudyError(TableError):
    """A study with mistakes; `.mistakes` holds them as (line, sentence), sorted by line."""

    consequence = "; nothing was started"


class Head(Strict):
    """`[study]`: the seed is where test signals and sensor noise start."""

    title: str
    seed: Annotated[int, Field(ge=0)] = 0


class Experiment(Strict):
    """`[experiment]`: the list to execute; "suite" is the packaged one, anything else a file beside the study."""

    list: str = "suite"


class IdentifyTable(Strict):
    """`[identify]`: the channel-by-channel identification and its judges; records are named by their group."""

    structures: list[str] = Field(default=["arx", "armax", "output-error", "box-jenkins"], min_length=1)
    orders: list[Order] = Field(default=[2, 3, 4, 5, 6, 7, 8], min_length=1)
    records: str = "noise"
    held_out: str = "judge"
    paper_structure: str = "box-jenkins"
    paper_order: Order = 5
    paper_records: list[str] = Field(default=["chirp", "noise", "prbs"], min_length=1)


class Plant(Method):
    """`[plant]`: how the design model is identified, from which groups of records; a period makes them responses."""

    records: list[str] = Field(min_length=1)
    period_samples: int | None = Field(default=None, ge=2)


class Design(Strict):
    """`[controllers.NAME]`: a design method with its settings, and what follows it."""

    design: Method
    reduce: Method | None = None


class ClosedLoop(Strict):
    """`[closed_loop]`."""

    units: list[str] = Field(default=["ground"], min_length=1)
    tones_hz: list[Positive] = Field(default=[5.0, 25.0, 100.0], min_length=1)
    amplitude_v: Positive = 1.0
    duration_s: Positive = 2.0
    band_hz: Band = (10.0, 100.0)


class Deploy(Strict):
    """`[deploy]`."""

    precision: Literal["float32", "float64"] = "float32"


class Requirements(Strict):
    """`[requirements]`: what the named law must reach on every unit of `[closed_loop]`; what is absent is not asked.

    `disk_margin` is that of all channels at once, at both ends of the identified plant; the band is that of
    `[closed_loop]` when absent.
    """

    law: str
    band_hz: Band | None = None
    attenuation_db: float | None = None
    peak_db: float | None = None
    disk_margin: Positive | None = None
    payload_db: float | None = None
    tones_db: float | None = None


class Study(Strict):
    """A whole study file."""

    study: Head
    bench: Method
    experiment: Experiment = Experiment()
    identify: IdentifyTable = IdentifyTable()
    plant: Plant
    controllers: dict[Name, Design] = Field(min_length=1)
    closed_loop: ClosedLoop = ClosedLoop()
    deploy: Deploy = Deploy()
    requirements: Requirements | None = None
    _places: Mapping[Place, int] | None = PrivateAttr(default=None)

    def at(self, places: Mapping[Place, int]) -> "Study":
        """Return the study with the lines of its file on which things stand."""
        located = self.model_copy()
        located._places = places
        return located

    def mistakes(self) -> Mistakes:
        """Return a collector that knows these lines, if the study was read from a file."""
        return Mistakes(self._places)


def packaged_study(name: str) -> Study:
    """Return a study that ships with the package."""
    return load_study(Path(__file__).with_name(f"{name}.toml"))


def quick_study(study: Study) -> Study:
    """Return the study with two structures and two orders instead of a whole sweep, on its first unit alone."""
    fewer = {"structures": QUICK_STRUCTURES, "orders": QUICK_ORDERS, "paper_records": study.identify.paper_records[:2]}
    sweep = study.identify.model_copy(update=fewer)
    loop = study.closed_loop.model_copy(update={"units": study.closed_loop.units[:1]})
    return study.model_copy(update={"identify": sweep, "closed_loop": loop})


def reload_study(folder: Path) -> Study:
    """Return the study that a folder was made by.

    Raises:
        InputError: the folder holds no study.
    """
    path = folder / "study.json"
    try:
        return Study.model_validate_json(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValidationError) as error:
        raise InputError(f"report: '{folder}' holds no study that can be read ({type(error).__name__}).") from error


def load_study(path: Path) -> Study:
    """Read and check a study file; every mistake is told in one error, with its line.

    Raises:
        InputError: the file is missing, or a `StudyError` as of `parse`.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"study: '{path}' cannot be read ({reason(error)}).") from error
    return parse(text, str(path))


def parse(text: str, name: str = "study") -> Study:
    r"""Check the text of a study file.

    Raises:
        StudyError: it is not TOML, or holds mistakes; all of them are told, each with its line.

    >>> parse('[study]\ntitle = "short"\nseed = -1\n[deploy]\nprecison = "float64"')
    Traceback (most recent call last):
    ultraquiet.pipeline.study.StudyError: study: 5 mistakes; nothing was started.
      line 1: 'bench' is missing.
      line 1: 'controllers' is missing.
      line 1: 'plant' is missing.
      line 3: 'seed' should be greater than or equal to 0, got -1.
      line 5: there is no key 'precison' here; did you mean 'precision'? Known are precision.
    """
    content, places = read_toml(text, name, StudyError)
    mistakes = Mistakes(places)
    for place, family, table in _methods(content):
        _check_method(place, family, table, mistakes)
    try:
        study = Study.model_validate(content)
    except ValidationError as error:
        mistakes.add_refusal((), error, Study)
        raise StudyError(name, mistakes.by_line()) from None
    _check_requirements(study, mistakes)
    mistakes.refuse(StudyError, name)
    return study.at(places)


def _check_requirements(study: Study, mistakes: Mistakes) -> None:
    """Note a law that the study does not design, and what nothing in it measures."""
    asked = study.requirements
    if asked is None:
        return
    if asked.law not in study.controllers:
        fault = f"there is no law '{asked.law}' among the controllers {', '.join(study.controllers)}."
        mistakes.add(("requirements", "law"), f"requirements.law: {fault}")
    if asked.payload_db is not None:
        fault = "the study has no payload table, so nothing measures it; leave it away."
        mistakes.add(("requirements", "payload_db"), f"requirements.payload_db: {fault}")


def _check_method(place: Place, family: str, table: Mapping[str, Any], mistakes: Mistakes) -> None:
    """Note everything that the registry or the method refuses, whatever else is wrong with the file."""
    try:
        method = (Plant if place == ("plant",) else Method).model_validate(table)
    except ValidationError:
        return  # the schema notes it
    candidate = settings_object(family, method.method, method.settings, place, mistakes)
    if candidate is not None and place[0] == "identify" and not isinstance(candidate, PolynomialMethod):
        mistakes.add(place, f"'{method.method}' is no polynomial structure.")


def _methods(content: Mapping[str, Any]) -> Iterator[tuple[Place, str, Mapping[str, Any]]]:
    """Yield place, family and table of every method that a study names."""
    tables: list[tuple[Place, str, Any]] = [
        (("bench",), "bench", content.get("bench")),
        (("plant",), "identify", content.get("plant")),
    ]
    controllers = content.get("controllers")
    for name, entry in controllers.items() if isinstance(controllers, dict) else ():
        if isinstance(entry, dict):
            tables += [(("controllers", name, family), family, entry.get(family)) for family in ("design", "reduce")]
    sweep = content.get("identify")
    if isinstance(sweep, dict):
        structures = sweep.get("structures")
        for k, name in enumerate(structures if isinstance(structures, list) else []):
            tables.append((("identify", "structures", k), "identify", {"method": name}))
        if "paper_structure" in sweep:
            tables.append((("identify", "paper_structure"), "identify", {"method": sweep["paper_structure"]}))
    return ((place, family, table) for place, family, table in tables if isinstance(table, dict))
