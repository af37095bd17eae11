"""The vocabulary of an experiment list: what each command is called and what it takes."""

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, AliasChoices, BaseModel, ConfigDict, Field

from ultraquiet._base.tables import Method, Strict

# Longer runs would not fit the memory of a small machine: 6 + 6 channels of float64 take 1 GB.
MOST_SAMPLES = 10_000_000
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


def _actuator(value: Any) -> Any:
    listed = value if isinstance(value, list) else [value]
    if not listed or not all(_one(n) for n in listed):
        raise ValueError(
            'it must be a number from 1, the name of an actuator, a list of these, "each" (one after another) or '
            '"all" (at once)'
        )
    return value


def _one(value: Any) -> bool:
    counted = isinstance(value, int) and not isinstance(value, bool) and value >= 1
    return counted or (isinstance(value, str) and bool(value.strip()))


def _name(value: str) -> str:
    # The name becomes a file name, on every file system.
    if not NAME.fullmatch(value):
        raise ValueError("it must begin with a letter or digit and hold only letters, digits, '-' and '_' (64 at most)")
    return value


Actuator = Annotated[Any, AfterValidator(_actuator)]
Name = Annotated[str, AfterValidator(_name)]
Samples = Annotated[int, Field(ge=1, le=MOST_SAMPLES, strict=True)]
Seed = Annotated[int, Field(ge=0, strict=True)]
Limit = Annotated[float, Field(gt=0, allow_inf_nan=False)]
# Each command is checked on its own by the compiler, so that one mistake does not hide those of its neighbours.
Commands = Annotated[list[Any], Field(min_length=1)]


class Set(BaseModel):
    """`set`: give names to numbers or texts; later commands use them as "$name"."""

    model_config = ConfigDict(extra="allow", frozen=True)

    do: Literal["set"]


class Configure(Strict):
    """`configure`: what holds from here on: length and seed of measurements, a limit below the bench's own.

    `max_duration_s` holds for the whole list: the longest time it may take on the bench, waits included.
    """

    do: Literal["configure"]
    samples: Samples | None = None
    seed: Seed | None = None
    limit: Limit | None = Field(default=None, validation_alias=AliasChoices("limit", "limit_v"))
    max_duration_s: Limit | None = None


class Excite(Strict):
    """`excite`: send a signal to one actuator, to each in turn or to all at once, and record all sensors."""

    do: Literal["excite"]
    name: Name
    signal: Method
    actuator: Actuator = "each"
    samples: Samples | None = None
    seed: Seed | None = None
    comment: str = ""


class RecordOnly(Strict):
    """`record`: record all sensors without an excitation."""

    do: Literal["record"]
    name: Name
    samples: Samples | None = None
    comment: str = ""


class Temperature(Strict):
    """`temperature`: read the bench's temperature; later records carry it under this name."""

    do: Literal["temperature"]
    name: Name = "bench"


class ControllerOn(Strict):
    """`controller-on`: close the loop in all later measurements with a controller from a file (HDF5)."""

    do: Literal["controller-on"]
    file: str


class ControllerOff(Strict):
    """`controller-off`: open the loop again."""

    do: Literal["controller-off"]


class DisturbanceOn(Strict):
    """`disturbance-on`: add a signal at the plant's input in all later measurements, in place of one that is on.

    `source` is another word for `actuator`, for those that are there to disturb: `source = "base proof mass"`.
    """

    do: Literal["disturbance-on"]
    signal: Method
    actuator: Actuator | None = None
    source: Actuator | None = None
    seed: Seed | None = None


class DisturbanceOff(Strict):
    """`disturbance-off`: end it."""

    do: Literal["disturbance-off"]


class Wait(Strict):
    """`wait`: let the bench come to rest; a simulated bench is at rest at once, and is not waited for."""

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
    | Temperature
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
    "temperature": Temperature,
    "controller-on": ControllerOn,
    "controller-off": ControllerOff,
    "disturbance-on": DisturbanceOn,
    "disturbance-off": DisturbanceOff,
    "wait": Wait,
    "repeat": Repeat,
}
