"""Weights beside what they made of S, T and KS: each function of a loop under the most that its cost leaves to it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.chart import Chart, ChartPanel, Curve, Region, decibel_axis, frequency_axis

DEEPEST_DB = 100.0  # below the largest of a panel: what is smaller is not drawn
ROOM_DB = 30.0  # above the loops, in which a weight that is far from them is still drawn
ABOVE_DB = 0.05  # that a loop may lie above its weight by rounding alone
MEAN_SQUARES = ("lqg",)  # methods whose cost is an H2 norm
MEAN_SQUARE = (
    "an LQG cost is a mean square over all frequencies, whatever it weighs them by, and bounds S, T and KS at none."
)
EXCEEDED = (
    "A law lies above where it was reduced after its design, or designed for one channel and put on all: its cost is "
    "that of what it was designed for."
)


@dataclass(frozen=True, eq=False)
class WeightedFunction:
    """One function of a law's loop: its largest singular value `(nf,)`, and the most that the cost leaves to it."""

    law: str
    values: FloatArray
    left: FloatArray

    @property
    def over_db(self) -> FloatArray:
        """By how much it lies above what is left to it, dB; below it where negative."""
        return _db(self.values) - _db(self.left)


def weighted_loops(
    stem: str,
    f_hz: FloatArray,
    members: Mapping[str, Sequence[WeightedFunction]],
    colours: Mapping[str, str],
    units: Mapping[str, str],
    band_hz: tuple[float, float],
    open_laws: Mapping[str, str] = MappingProxyType({}),
) -> Chart:
    """Largest singular values of S, T and KS of every law that weighs them, under what its cost leaves; by member.

    `units` of a member follow "dB re"; `colours` are those of the laws; `open_laws` are those that are not drawn, for
    their cost leaves everything open, and their methods.
    """
    band = Region("", band_hz, colour="muted")
    panels: list[ChartPanel] = []
    for member, laws in members.items():
        limits = _limits(laws)
        axis = decibel_axis(f"|{member}|", units.get(member, ""), limits)
        curves = [curve for each in laws for curve in _curves(f_hz, each, colours[each.law], limits)]
        panels.append(ChartPanel(frequency_axis(), axis, curves, "", [band], height=220))
    caption = (
        "Solid: largest singular values on the design model, every law as it runs. Dashed: the most that the law's "
        "cost leaves to it, cost over weight; no loop of that cost lies above. "
    )
    caption += " ".join([*_told(f_hz, members), *_left_open(open_laws)])
    return Chart(stem, "Weights, and the loops they made", caption, panels)


def _curves(f_hz: FloatArray, each: WeightedFunction, colour: str, limits: tuple[float, float]) -> list[Curve]:
    left = _db(each.left)
    seen = np.where(np.isfinite(left) & (left <= limits[1]), left, np.nan)
    lines = [Curve(each.law, f_hz, np.maximum(_db(each.values), limits[0]), colour)]
    return [*lines, Curve(f"{each.law}: left by its weight", f_hz, seen, colour, "--")]


def _limits(laws: Iterable[WeightedFunction]) -> tuple[float, float]:
    """Return the ends of an axis: all loops that are not far below the largest, and weights that are near them."""
    values = [_db(each.values) for each in laws]
    top = max(float(db.max()) for db in values)
    floor = top - DEEPEST_DB
    low = min(float(db.min()) for db in values if db.max() >= floor)
    left = np.concatenate([_db(each.left) for each in laws])
    near = left[np.isfinite(left) & (left <= top + ROOM_DB)]
    high, low = max([top, *near.max(initial=top, keepdims=True)]), min([low, *near.min(initial=low, keepdims=True)])
    return max(float(low) - 3.0, floor), float(high) + 3.0


def _told(f_hz: FloatArray, members: Mapping[str, Sequence[WeightedFunction]]) -> list[str]:
    """Say of every law which weight shaped it most, and where."""
    nearest: dict[str, tuple[float, str, float]] = {}
    for member, laws in members.items():
        for each in laws:
            k = int(np.argmax(each.over_db))
            found = (float(each.over_db[k]), member, float(f_hz[k]))
            nearest[each.law] = max(found, nearest.get(each.law, found))
    told = [
        f"{law} is nearest in {member}, {_apart(over)} at {f:.4g} Hz." for law, (over, member, f) in nearest.items()
    ]
    return [*told, EXCEEDED] if any(over > ABOVE_DB for over, _, _ in nearest.values()) else told


def _left_open(laws: Mapping[str, str]) -> list[str]:
    """Say why laws have no weight here.

    >>> _left_open({"calm": "lqg", "slow": "peak-bounded"})[1]
    'Nothing in the design of slow weighs S, T or KS.'
    """
    squares = [law for law, method in laws.items() if method in MEAN_SQUARES]
    others = [law for law in laws if law not in squares]
    told = [f"Of {_listed(squares)} nothing is drawn: {MEAN_SQUARE}"] if squares else []
    return [*told, f"Nothing in the design of {_listed(others)} weighs S, T or KS."] if others else told


def _listed(names: Sequence[str]) -> str:
    return " and ".join([*([", ".join(names[:-1])] if names[1:] else []), names[-1]])


def _apart(over_db: float) -> str:
    """Say how far a loop lies from what is left to it.

    >>> _apart(-0.02), _apart(1.0)
    ('0.0 dB below', '1.0 dB above')
    """
    return f"{abs(over_db):.1f} dB {'above' if over_db > ABOVE_DB else 'below'}"


def _db(values: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore"):
        return 20 * np.log10(np.maximum(values, 1e-15))
