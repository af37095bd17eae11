"""The vocabulary of an experiment list: what each command is called and what it takes."""

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

# Longer runs would not fit the memory of a small machine: 6 + 6 channels of float64 take 1 GB.
MOST_SAMPLES = 10_000_000
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


def _actuator(value: Any) -> Any:
    numbers = value if isinstance(value, list) else [value]
    counted = bool(numbers) and all(isinstance(n, int) and not isinstance(n, bool) and n >= 1 for n in numbers)
    if value not in ("each", "all") and not counted:
        raise ValueError('it must be a number from 1, a list of them, "each" (one after another) or "all" (at once)')
    if counted and len(set(numbers)) < len(numbers):
        raise ValueError("an actuator is listed twice")
    return value


def _name(value: str) -> str:
    # The name becomes a file name, on every file system.
    if not NAME.fullmatch(value):
        raise ValueError("it must begin with a letter or digit and hold only letters, digits, '-' and '_' (64 at most)")
    return value


Actuator = Annotated[Any, AfterValidator(_actuator)]
Name = Annotated[str, AfterValidator(_name)]
Samples = Annotated[int, Field(ge=1, le=MOST_SAMPLES, strict=True)]
Seed = Annotated[int, Field(ge=0, strict=True)]
# Each command is checked on its own by the compiler, so that one mistake does not hide those of its neighbours.
Commands = Annotated[list[Any], Field(min_length=1)]


class Strict(BaseModel):
    """Unknown keys are mistakes."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Method(BaseModel):
    """A registered method by its name; every other key is one of its settings."""

    model_config = ConfigDict(extra="allow", frozen=True)

    method: str

    @property
    def settings(self) -> dict[str, Any]:
        """The settings, lists turned into tuples."""
        return {key: tuple(v) if isinstance(v, list) else v for key, v in (self.model_extra or {}).items()}


class Set(BaseModel):
    """`set`: give names to numbers or texts; later commands use them as "$name"."""

    model_config = ConfigDict(extra="allow", frozen=True)

    do: Literal["set"]


class Configure(Strict):
    """`configure`: what holds for all later measurements: their length, their seed, a limit below the bench's own."""

    do: Literal["configure"]
    samples: Samples | None = None
    seed: Seed | None = None
    limit_v: Annotated[float, Field(gt=0)] | None = None


class Excite(Strict):
    """`excite`: send a signal to one actuator, to each in turn or to all at once, and record all sensors."""

    do: Literal["excite"]
    name: Name
    signal: Method
    actuator: Actuator = "each"
    samples: Samples | None = None
    seed: Seed | None = None


class RecordOnly(Strict):
    """`record`: record all sensors without an excitation."""

    do: Literal["record"]
    name: Name
    samples: Samples | None = None


class ControllerOn(Strict):
    """`controller-on`: close the loop in all later measurements with a controller from a file (HDF5)."""

    do: Literal["controller-on"]
    file: str


class ControllerOff(Strict):
    """`controller-off`: open the loop again."""

    do: Literal["controller-off"]


class DisturbanceOn(Strict):
    """`disturbance-on`: add a signal at the plant's input in all later measurements."""

    do: Literal["disturbance-on"]
    signal: Method
    actuator: Actuator = "all"
    seed: Seed | None = None


class DisturbanceOff(Strict):
    """`disturbance-off`: end it."""

    do: Literal["disturbance-off"]


class Wait(Strict):
    """`wait`: let the bench come to rest."""

    do: Literal["wait"]
    seconds: Annotated[float, Field(ge=0, le=86400)]


class Repeat(Strict):
    """`repeat`: execute commands several times; the records of round k end in `-rk`, and "$round" is k."""

    do: Literal["repeat"]
    times: Annotated[int, Field(ge=1, le=1000, strict=True)]
    commands: Commands


Command = Annotated[
    Set
    | Configure
    | Excite
    | RecordOnly
    | ControllerOn
    | ControllerOff
    | DisturbanceOn
    | DisturbanceOff
    | Wait
    | Repeat,
    Field(discriminator="do"),
]


class Content(Strict):
    """A whole experiment list."""

    title: str = ""
    seed: Seed = 0
    bench: Method | None = None
    commands: Commands


VOCABULARY: Mapping[str, type[BaseModel]] = {
    "set": Set,
    "configure": Configure,
    "excite": Excite,
    "record": RecordOnly,
    "controller-on": ControllerOn,
    "controller-off": ControllerOff,
    "disturbance-on": DisturbanceOn,
    "disturbance-off": DisturbanceOff,
    "wait": Wait,
    "repeat": Repeat,
}
