"""Numbers and names that several tables of a study file hold, each with what it must be.

All are strict: a text that reads as a number, or a truth value, is somebody's slip, not a number. All have an end where
nothing of a bench lies beyond: what passes here is met hours later, in the middle of a run.
"""

from collections.abc import Sequence
from typing import Annotated, Any, cast

from pydantic import AfterValidator, BeforeValidator, Field


def _two(band_hz: Any) -> Any:
    if isinstance(band_hz, list | tuple) and len(cast("Sequence[Any]", band_hz)) < 2:
        raise ValueError("a band is two rising frequencies in Hz, as [10.0, 100.0] is")
    return band_hz


def _rising(band_hz: tuple[float, float]) -> tuple[float, float]:
    if not band_hz[0] < band_hz[1]:
        raise ValueError("the band must rise")
    return band_hz


def _named(name: str) -> str:
    if not name.strip():
        raise ValueError("the name of a file is missing")
    return name


LARGEST = 1e12  # of anything that is measured or sent, in whatever unit
LONGEST_S = 86400.0
LAST_SEED = 2**53  # the last whole number that JSON and Parquet hold as they should, cases counted on from it

Positive = Annotated[float, Field(gt=0, le=LARGEST, strict=True)]
Decibels = Annotated[float, Field(ge=-300, le=300, strict=True)]
Seconds = Annotated[float, Field(gt=0, le=LONGEST_S, strict=True)]
Gain = Annotated[float, Field(gt=0, le=10, strict=True)]
Seed = Annotated[int, Field(ge=0, le=LAST_SEED, strict=True)]
Flag = Annotated[bool, Field(strict=True)]
Band = Annotated[tuple[Positive, Positive], AfterValidator(_rising), BeforeValidator(_two)]
Order = Annotated[int, Field(ge=1, le=20, strict=True)]
FileName = Annotated[str, AfterValidator(_named)]
