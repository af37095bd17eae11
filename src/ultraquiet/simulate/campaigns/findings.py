"""What the rows of a campaign say: how figures spread, the worst cases, and what drives them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.analyse.monte_carlo import wilson_interval
from ultraquiet.simulate.campaigns.evaluation import DRAWN, MEASURED, Row

FIGURES = {"attenuation_db": True, "peak_db": False}  # whether more is better
SHARES = (0.0, 0.05, 0.5, 0.95, 1.0)
SURE = 3.0  # deviations of a rank correlation of independent columns, 1 / sqrt(n - 1): less is chance
NAMED = 8  # drivers of a figure


@dataclass(frozen=True)
class Driver:
    """Spearman's rank correlation of a figure with a drawn parameter."""

    parameter: str
    correlation: float


@dataclass(frozen=True)
class Cause:
    """Which drawn parameter of a case pulls hardest towards its failure; `deviation` in standard deviations of all."""

    case: int
    parameter: str | None
    deviation: float


def spread(rows: Sequence[Row], figure: str) -> dict[str, float]:
    """Return least, 5 %, median, 95 % and most of a figure, unstable cases at their worst."""
    values = np.sort([float(row[figure]) for row in rows])
    # a case itself and no mean of two: one of them may be infinite
    return {f"{share:.0%}": float(values[round(share * (values.size - 1))]) for share in SHARES}


def measured(rows: Sequence[Row]) -> list[Row]:
    """Return rows of what was measured besides the truth, the figures under their own names."""
    known = ("case", "seed", "unit")
    return [
        {n.removeprefix(MEASURED): value for n, value in row.items() if n in known or n.startswith(MEASURED)}
        for row in rows
        if f"{MEASURED}stable" in row
    ]


def stable_share(rows: Sequence[Row]) -> tuple[float, tuple[float, float]]:
    """Return the share of stable loops and its 95 % interval (Wilson)."""
    stable = sum(bool(row["stable"]) for row in rows)
    return stable / len(rows), wilson_interval(stable, len(rows))


def worst_cases(rows: Sequence[Row], keep: int) -> list[Row]:
    """Return the worst rows: unstable ones, then those that peak highest, then those that attenuate least, in turn."""
    by_peak = sorted(rows, key=lambda row: (-float(row["peak_db"]), row["case"]))
    by_depth = sorted(rows, key=lambda row: (float(row["attenuation_db"]), row["case"]))
    chosen: dict[int, Row] = {}
    for pair in zip(by_peak, by_depth, strict=True):
        for row in pair:
            chosen.setdefault(row["case"], row)
    return list(chosen.values())[:keep]


def drivers(rows: Sequence[Row], figure: str) -> list[Driver]:
    """Return the drawn parameters whose rank goes with that of a figure, strongest first; chance is left away.

    Ranks are within a unit: what tells ground from flight is no draw. Units count by their cases.
    """
    units = [[row for row in rows if row["unit"] == unit] for unit in dict.fromkeys(row["unit"] for row in rows)]
    sums: dict[str, list[tuple[float, int]]] = {}
    for group in units:
        target = _ranks([float(row[figure]) for row in group])
        for name in (name for name in group[0] if name.startswith(DRAWN)):
            found = _correlation(_ranks([float(row[name]) for row in group]), target)
            sums.setdefault(name, []).append((found, len(group)))
    strong: list[Driver] = []
    for name, parts in sums.items():
        cases = sum(n for _, n in parts)
        mean = sum(found * n for found, n in parts) / cases
        if abs(mean) * np.sqrt(max(cases - len(parts), 1)) > SURE:
            strong.append(Driver(name, float(mean)))
    return sorted(strong, key=lambda driver: (-abs(driver.correlation), driver.parameter))[:NAMED]


def causes(rows: Sequence[Row], failed: Sequence[Row], figure: str) -> list[Cause]:
    """Name for each failed case the parameter that pulls it hardest the wrong way.

    The pull of a parameter is its deviation from the mean of all draws times its rank correlation with the figure: what
    is known of a cause without a model. Where no parameter drives the figure none is named.
    """
    strong = drivers(rows, figure)
    wrong = -1.0 if FIGURES[figure] else 1.0
    found: list[Cause] = []
    for row in failed:
        alike = [each for each in rows if each["unit"] == row["unit"]]
        pulls: list[tuple[float, str, float]] = []
        for driver in strong:
            if driver.parameter in row:
                column = np.array([float(each[driver.parameter]) for each in alike])
                off = (float(row[driver.parameter]) - column.mean()) / max(column.std(), np.finfo(float).tiny)
                pulls.append((wrong * driver.correlation * off, driver.parameter, float(off)))
        pull = max(pulls, default=(0.0, "", 0.0))
        found.append(Cause(row["case"], pull[1] or None, pull[2]) if pull[0] > 0 else Cause(row["case"], None, 0.0))
    return found


def _ranks(values: Sequence[float]) -> FloatArray:
    from scipy.stats import rankdata

    return np.asarray(rankdata(values), dtype=np.float64)


def _correlation(a: FloatArray, b: FloatArray) -> float:
    spread_of = float(a.std() * b.std())
    return 0.0 if spread_of == 0 else float(np.mean((a - a.mean()) * (b - b.mean())) / spread_of)
