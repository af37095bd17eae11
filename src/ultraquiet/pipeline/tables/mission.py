"""`[payload]` of a study file: what its laws are for, measured where it is felt."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from ultraquiet._base.tables import Strict
from ultraquiet.pipeline.tables.numbers import Band, Flag, Gain, Positive, Seconds, Seed
from ultraquiet.simulate import PayloadSetup


def _rising(gains: list[float]) -> list[float]:
    if any(b <= a for a, b in pairwise(gains)):
        raise ValueError("the gains must rise, each above the one before")
    return gains


PayloadSeconds = Annotated[float, Field(gt=0, le=600, strict=True)]
Gains = Annotated[list[Gain], Field(min_length=1), AfterValidator(_rising)]


class PayloadTable(Strict):
    """`[payload]`: which actuator shakes the payload's base, which sensors on the payload listen, over which band.

    `base` are sensors on what is shaken, for the transmissibility; `force` is an actuator on the payload itself;
    `tones_hz` are sent by the shaker besides, those of the loop when absent; `level` is in the actuators' unit, a
    quarter of their range when absent; `seconds` are measured after `settle_s`. Channels that the study is not
    controlled by are those that the bench offers by `instrumented()`.
    """

    shaker: str
    sensors: list[str] = Field(min_length=1)
    band_hz: Band
    base: list[str] = Field(default=[])
    force: str | None = None
    tones_hz: list[Positive] | None = None
    level: Positive | None = None
    seconds: PayloadSeconds = 8.0
    settle_s: PayloadSeconds = 4.0

    def setup(self, tones_hz: Sequence[float] = (), seed: int = 0) -> PayloadSetup:
        """Return how it is measured; `tones_hz` are those of the study's loop."""
        return PayloadSetup(
            shaker=self.shaker,
            sensors=tuple(self.sensors),
            band_hz=self.band_hz,
            base=tuple(self.base),
            force=self.force,
            tones_hz=tuple(tones_hz if self.tones_hz is None else self.tones_hz),
            level=self.level,
            seconds=self.seconds,
            settle_s=self.settle_s,
            seed=seed,
        )


class CampaignTable(Strict):
    """`[campaign]`: how many benches are drawn, and where the law is judged.

    Args:
        benches: how many; they are drawn from the units of `[closed_loop]` in turn.
        on: "truth", the linear model of a drawn bench where it offers one, or "bench", measured on it.
        measured: so many of the first benches are measured besides, where the others are judged on their truth.
        law: which of the controllers; that of `[requirements]` when absent, else the first.
        first_seed: case k is drawn by the seed `first_seed` + k.
        keep: how many of the worst cases are named.
        tune: make the law again on each drawn bench, from a record of it, by the design and the identification of the
            study; one that begins with a law begins with the study's.
    """

    benches: Annotated[int, Field(ge=1, le=1_000_000, strict=True)] = 50
    on: Literal["truth", "bench"] = "truth"
    measured: Annotated[int, Field(ge=0, le=1_000_000, strict=True)] = 0
    law: str | None = None
    first_seed: Seed = 0
    keep: Annotated[int, Field(ge=1, le=100, strict=True)] = 5
    tune: Flag = False

    @model_validator(mode="after")
    def _measured_once(self) -> "CampaignTable":
        if self.measured and self.on == "bench":
            raise ValueError("with on = \"bench\" every bench is measured; leave 'measured' away")
        return self


class CommissionTable(Strict):
    """`[commission]`: the law comes on at rising shares of its gain on every unit, its margins measured at each.

    `law` is that of `[requirements]` when absent, else the first; below a disk margin of `margin`, all channels at
    once, it is taken off. `seconds` is a period of the injection, `settle_s` runs before it.
    """

    law: str | None = None
    gains: Gains = Field(default=[0.1, 0.3, 1.0])
    margin: Annotated[float, Field(gt=0, le=2, strict=True)] = 0.2
    seconds: Seconds = 4.0
    settle_s: Seconds = 2.0
