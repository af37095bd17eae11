"""What the loop with the rounded law keeps at both ends, against what the law's design stated."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ultraquiet.values.status import Status, StatusWord

if TYPE_CHECKING:
    from ultraquiet.values import StateSpace


@dataclass(frozen=True)
class RoundedLoop:
    """Margins by end, the lines that say them, and the verdict; None where the loop is unstable, which others say."""

    ends: Mapping[str, Any]
    lines: tuple[str, ...]
    status: Status | None


def rounded_loop(plant: "StateSpace", rounded: "StateSpace", law: "StateSpace") -> RoundedLoop:
    """Return the margins of the loop with the rounded law, fragile where they are less than the law's design stated.

    Args:
        plant: G.
        rounded: the law with the code's coefficients.
        law: as designed; where its provenance states no `disk_margin` the default of designs is asked.
    """
    from ultraquiet.design.robustness import DISK_MARGIN, both_ends, described, kept
    from ultraquiet.values.interconnect import sensitivity

    ends = both_ends(plant, rounded)
    lines = tuple(f"rounded law, {line}" for line in described(plant, ends))
    if not sensitivity(plant, rounded).is_stable():
        return RoundedLoop(ends, lines, None)
    stated = law.provenance.settings.get("disk_margin", DISK_MARGIN)
    status = kept(plant, ends, float(stated))
    fragile = status.word is StatusWord.FRAGILE
    return RoundedLoop(ends, (*lines, str(status)) if fragile else lines, status)
