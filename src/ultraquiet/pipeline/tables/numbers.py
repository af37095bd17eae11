"""Numbers and names that several tables of a study file hold, each with what it must be."""

from typing import Annotated

from pydantic import AfterValidator, Field


def _rising(band_hz: tuple[float, float]) -> tuple[float, float]:
    if not band_hz[0] < band_hz[1]:
        raise ValueError("the band must rise")
    return band_hz


def _named(name: str) -> str:
    if not name.strip():
        raise ValueError("the name of a file is missing")
    return name


Positive = Annotated[float, Field(gt=0)]
Band = Annotated[tuple[Positive, Positive], AfterValidator(_rising)]
Order = Annotated[int, Field(ge=1, le=20)]
FileName = Annotated[str, AfterValidator(_named)]
