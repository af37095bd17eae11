"""What a search came to: figures of the finished law on every plant, by exact norms and not on the search's lines."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.analyse.margins import band_attenuation, peak_sensitivity
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.analyse.peaks import refined, response_at
from ultraquiet.design.peak_bounded.demands import Demands, OfFrequency
from ultraquiet.design.result import STABLE_WORDS, DesignResult
from ultraquiet.design.robustness import both_ends, fragility, weaker_end
from ultraquiet.values.interconnect import feedback, sensitivity, series
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

At = Callable[[FloatArray], ComplexArray]
ROUNDING_DB = 0.02  # a bound exceeded by less is met


@dataclass(frozen=True)
class PlantFigures:
    """One plant with the law: worst direction of the band, largest amplification and where, largest |K S|, tones.

    `control_gain` is in the scales of the search where channels differ in unit, else in the plant's own.
    """

    attenuation_db: float
    attenuation_hz: float
    peak_db: float
    peak_hz: float
    control_gain: float
    excess_db: float
    tones_db: dict[str, float]


@dataclass(frozen=True)
class SearchFigures:
    """What the search reached.

    Attributes:
        attenuation_db: least over the plants given.
        peak_db: largest over them.
        plants: each of them.
        drawn: attenuation and peak of every plant drawn near them.
        roof_hz, roof_gain: where the law had to stay small, and how small; infinite where nowhere.
        structure, states: of the law; states of each of its parts.
        lines: at which loops were judged in the end, all plants together.
        steps: taken.
    """

    attenuation_db: float
    peak_db: float
    plants: tuple[PlantFigures, ...]
    drawn: tuple[tuple[float, float], ...]
    roof_hz: float
    roof_gain: float
    structure: str
    states: int
    lines: int
    steps: int


def figures(plant: StateSpace, law: StateSpace, demands: Demands, control: float) -> PlantFigures:
    """Return what a law does to a plant, both in the units of the search, `control` turning K S back."""
    attenuation, at = band_attenuation(plant, law, demands.band_hz)
    peak, peak_hz = peak_sensitivity(plant, law)
    S = sensitivity(plant, law)
    KS = series(S, law)
    largest = hinf_norm(KS)[0]
    return PlantFigures(
        attenuation, at, peak, peak_hz, largest * control, _exceeded(S, KS, demands)[0], _tones(plant, law, demands)
    )


def exceeded(plant: StateSpace, law: StateSpace, demands: Demands) -> tuple[float, float]:
    """Return by how many dB a bound is exceeded on a grid that holds the loop's modes and is refined, and where, Hz."""
    S = sensitivity(plant, law)
    return _exceeded(S, series(S, law), demands)


def _exceeded(S: StateSpace, KS: StateSpace, demands: Demands) -> tuple[float, float]:
    top = 1e4 if S.rate_hz is None else S.rate_hz / 2
    f = np.unique(np.concatenate([np.geomspace(1e-5 * top, top * 0.9999, 1500), _mode_lines(S)]))
    worst, where = -np.inf, float("nan")
    for system, bound in ((S, demands.sensitivity_db), (KS, demands.control_db)):
        at = response_at(system)

        def over(lines: FloatArray, at: At = at, bound: OfFrequency = bound) -> FloatArray:
            size = np.linalg.norm(np.moveaxis(at(lines), 2, 0), 2, axis=(1, 2))
            level = np.exp((20 * np.log10(np.maximum(size, 1e-300)) - bound(lines)) / 20)
            return np.asarray(level, dtype=np.float64)

        size, at_hz = refined(over, f, over(f))
        level = 20 * float(np.log(size))
        worst, where = (level, at_hz) if level > worst else (worst, where)
    return worst, where


def _mode_lines(S: StateSpace) -> FloatArray:
    poles = S.poles()
    poles = poles[(poles.imag > 0) & (np.abs(poles) > 0)].astype(np.complex128)
    s = poles if S.rate_hz is None else np.log(poles) * S.rate_hz
    lines = (s.imag[:, None] + np.abs(s.real)[:, None] * np.array([-1.0, -0.3, 0.0, 0.3, 1.0])).ravel() / (2 * np.pi)
    return lines[(lines > 0) & (lines < (np.inf if S.rate_hz is None else S.rate_hz / 2))]


def _tones(plant: StateSpace, law: StateSpace, demands: Demands) -> dict[str, float]:
    out: dict[str, float] = {}
    for tone in demands.tones_hz:
        G, K = (s.frequency_response([tone])[:, :, 0] for s in (plant, law))
        S = np.linalg.inv(np.eye(G.shape[0]) - G @ K)
        U = np.linalg.svd(G, full_matrices=False)[0]
        out[f"{tone:g}"] = -20 * float(np.log10(np.linalg.norm(S @ U, 2)))
    return out


def among(result: DesignResult, plants: Sequence[StateSpace], found: SearchFigures, asked: float) -> DesignResult:
    """Return a verdict on the first of several plants as one on all of them, the worst word with its plant's number."""
    law = result.controller
    assert law is not None
    for k, plant in enumerate(plants[1:], 2):
        if result.status.word not in STABLE_WORDS:
            return result
        if not feedback(plant, law).is_stable():
            said = f"The loop with plant {k} of {len(plants)} is unstable; the controller must not be used."
            return replace(result, status=Status(StatusWord.UNSTABLE, said))
        margins = both_ends(plant, law)
        if result.status.ok and not margins[weaker_end(margins)].disk_all >= asked:
            said = f"Plant {k} of {len(plants)}: {fragility(plant, margins, asked)}"
            result = replace(result, status=Status(StatusWord.FRAGILE, said))
    over = max(each.excess_db for each in found.plants)
    if result.status.ok and over > ROUNDING_DB:
        said = f"A bound is exceeded by {over:.2g} dB, the best that was found. {result.status.sentence}"
        return replace(result, status=Status(StatusWord.SHORT, said))
    return result
