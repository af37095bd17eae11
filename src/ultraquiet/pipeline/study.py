"""The study file: what a study says, checked whole before anything starts."""

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationError

from ultraquiet._base.errors import InputError, UltraquietError
from ultraquiet._base.registry import lookup
from ultraquiet.experiments import command
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


class Method(command.Method):
    """A registered method by name; every other key is one of its settings."""

    def make(self, family: str, **more: Any) -> Any:
        """Return the settings object, or say which setting is wrong; `more` are settings the table does not give."""
        kind = lookup(family, self.method)
        known = [f.name for f in fields(kind)]
        for key in self.settings:
            if key not in known:
                raise InputError(
                    f"{family} '{self.method}': there is no setting '{key}'; known are {', '.join(known)}."
                )
        return kind(**more, **self.settings)


class Head(command.Strict):
    """`[study]`: the seed is where test signals and sensor noise start."""

    title: str
    seed: Annotated[int, Field(ge=0)] = 0


class Experiment(command.Strict):
    """`[experiment]`: the list to execute; "suite" is the packaged one, anything else a file beside the study."""

    list: str = "suite"


class Sweep(command.Strict):
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


class Design(command.Strict):
    """`[controllers.NAME]`: a design method with its settings, and what follows it."""

    design: Method
    reduce: Method | None = None


class ClosedLoop(command.Strict):
    """`[closed_loop]`."""

    units: list[str] = Field(default=["ground"], min_length=1)
    tones_hz: list[Positive] = Field(default=[5.0, 25.0, 100.0], min_length=1)
    amplitude_v: Positive = 1.0
    duration_s: Positive = 2.0
    band_hz: Band = (10.0, 100.0)


class Deploy(command.Strict):
    """`[deploy]`."""

    precision: Literal["float32", "float64"] = "float32"


class Study(command.Strict):
    """A whole study file."""

    study: Head
    bench: Method
    experiment: Experiment = Experiment()
    identify: Sweep = Sweep()
    plant: Plant
    controllers: dict[Name, Design] = Field(min_length=1)
    closed_loop: ClosedLoop = ClosedLoop()
    deploy: Deploy = Deploy()


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
    """Read and check a study file; every mistake is named in one error.

    Raises:
        InputError: the file is missing, not TOML, or holds mistakes (all of them are listed).
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"study: '{path}' cannot be read ({reason(error)}).") from error
    return parse(text, str(path))


def parse(text: str, name: str = "study") -> Study:
    """Check the text of a study file."""
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{name}: this is not TOML: {error}.") from error
    mistakes: list[str] = []
    study = None
    try:
        study = Study.model_validate(content)
    except ValidationError as error:
        mistakes += [_sentence(e) for e in error.errors()]
    mistakes += list(_method_mistakes(content))
    if mistakes or study is None:
        raise InputError(listed(name, mistakes))
    return study


def listed(name: str, mistakes: Sequence[str]) -> str:
    """Return one message that tells all mistakes."""
    count = f"{len(mistakes)} mistake{'s' if len(mistakes) > 1 else ''}"
    return f"{name}: {count}.\n" + "\n".join(f"  - {m}" for m in mistakes)


def _sentence(error: Any) -> str:
    where = ".".join(str(part) for part in error["loc"] if part != "[key]")
    if error["type"] == "extra_forbidden":
        return f"{where}: there is no such key."
    if error["type"] == "missing":
        return f"{where}: this key is missing."
    said = error["msg"].removeprefix("Value error, ")
    return f"{where}: {said[0].lower()}{said[1:]}, got {error['input']!r}."


def _method_mistakes(content: Mapping[str, Any]) -> Iterator[str]:
    """Name every method or setting that the registry does not know, whatever else is wrong with the file."""
    for where, family, table in _methods(content):
        try:
            made = (Plant if where == "plant" else Method).model_validate(table).make(family)
            if where.startswith("identify.") and not isinstance(made, PolynomialMethod):
                yield f"{where}: '{table['method']}' is no polynomial structure."
        except ValidationError:
            continue  # the schema has named it already
        except (UltraquietError, TypeError, ValueError) as error:
            yield f"{where}: {error}"


def _methods(content: Mapping[str, Any]) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    places: list[tuple[str, str, Any]] = [
        ("bench", "bench", content.get("bench")),
        ("plant", "identify", content.get("plant")),
    ]
    controllers = content.get("controllers")
    for name, entry in controllers.items() if isinstance(controllers, dict) else ():
        if isinstance(entry, dict):
            places.append((f"controllers.{name}.design", "design", entry.get("design")))
            places.append((f"controllers.{name}.reduce", "reduce", entry.get("reduce")))
    sweep = content.get("identify")
    structures = sweep.get("structures", []) if isinstance(sweep, dict) else []
    for k, name in enumerate(structures if isinstance(structures, list) else []):
        places.append((f"identify.structures.{k}", "identify", {"method": name}))
    if isinstance(sweep, dict) and "paper_structure" in sweep:
        places.append(("identify.paper_structure", "identify", {"method": sweep["paper_structure"]}))
    return ((where, family, table) for where, family, table in places if isinstance(table, dict))
