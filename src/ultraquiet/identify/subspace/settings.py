"""The settings of `Subspace`, below everything that works from them."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

from ultraquiet._base.constraints import one_of, whole, yes_or_no
from ultraquiet._base.errors import InputError
from ultraquiet.files import LongRecord
from ultraquiet.identify.searched_order import Auto, SearchedOrder
from ultraquiet.identify.subspace import fit, hankel
from ultraquiet.identify.subspace.start import SubspaceStart
from ultraquiet.values import Record

CANDIDATES = (10, 20, 40, 60, 90)  # block rows tried when no horizon is given; the lowest simulated error wins
COLUMNS_PER_ROW = 2  # a Hankel matrix must be this much longer than high
HIGHEST_ORDER = 500
FOCUSES = ("simulation", "prediction")


@dataclass(frozen=True)
class SubspaceSettings(SearchedOrder):
    """What the user sets, checked, and what follows from it alone; `Subspace` says what each setting means."""

    name: ClassVar[str]

    order: int | Auto | None = None
    horizon: int | None = None
    weight: str = "moesp"
    feedthrough: bool | None = None
    offset: bool = True
    refine: bool = False
    focus: str = "simulation"
    weighted: bool = True
    max_iterations: int = 100

    def __post_init__(self) -> None:
        self.settle_order(HIGHEST_ORDER)
        who = "Subspace"
        if self.horizon is not None:
            whole(who, "horizon", self.horizon, 2, 1000)
        for name in ("offset", "refine", "weighted"):
            yes_or_no(who, name, getattr(self, name))
        if self.feedthrough is not None:
            yes_or_no(who, "feedthrough", self.feedthrough)
        one_of(who, "weight", self.weight, hankel.WEIGHTS)
        one_of(who, "focus", self.focus, FOCUSES)
        whole(who, "max_iterations", self.max_iterations, 1)

    def allowing_feedthrough(self) -> Self:
        """Return settings under which D is estimated unless it is refused, for the record to say what it is worth."""
        return self if self.feedthrough is not None else replace(self, feedthrough=True)

    def of_start(self, start: SubspaceStart) -> "tuple[Self, SubspaceStart]":
        """Return settings and a start whose D is there or not as was asked, or as the record says."""
        if self.feedthrough is not None:
            return self, start
        settled = start.as_direct_as_needed()
        return replace(self, feedthrough=settled.bank.feedthrough), settled

    def horizons(self, record: Record | LongRecord, order: int) -> list[int]:
        """Return the numbers of block rows to try.

        Raises:
            InputError: a horizon too short for the order, a record too short for the least of them.
        """
        width = len(record.actuators) + len(record.sensors)
        least = order // len(record.sensors) + 2
        longest = record.samples // (2 * width * COLUMNS_PER_ROW)
        if self.horizon is not None and self.horizon < least:
            raise InputError(f"Subspace: order {order} needs at least {least} block rows, got {self.horizon}.")
        wanted = [self.horizon] if self.horizon else sorted({max(least, rows) for rows in CANDIDATES})
        if min(wanted) > longest:
            needed = min(wanted) * 2 * width * COLUMNS_PER_ROW
            raise InputError(
                f"Subspace: order {order} with {min(wanted)} block rows needs at least {needed} samples, the "
                f"record has {record.samples}; record longer or lower order or horizon."
            )
        return [rows for rows in wanted if rows <= longest]

    def options(self) -> fit.Options:
        """Return what the prediction-error search may move, and how it weighs."""
        return fit.Options(bool(self.feedthrough), self.offset, self.weighted, self.max_iterations)
