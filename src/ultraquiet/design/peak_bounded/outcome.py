"""What a search came to: figures of the finished law on every plant given, by exact norms."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ultraquiet._base.shown.line import fall, rounded
from ultraquiet.analyse.gang import gang_of_four
from ultraquiet.analyse.loop_response import band_attenuation, loop_response, reached_directions
from ultraquiet.analyse.margins import peak_sensitivity
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.analyse.plant_scale import even_plant
from ultraquiet.design.peak_bounded.demands import Demands
from ultraquiet.design.peak_bounded.loops.largest import LEAST
from ultraquiet.design.peak_bounded.units import SearchUnits
from ultraquiet.design.result import LITTLE_DB, STABLE_WORDS, DesignResult
from ultraquiet.design.robustness import both_ends, fragility, keeps
from ultraquiet.values.interconnect import feedback
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

ROUNDING_DB = 0.02  # a bound exceeded by less is met
DEAR_DB = 2.0  # of attenuation: what plants drawn cost beyond it is told


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
        alone_db: attenuation that the search came to on them before any plant drawn near had a say.
        drawn: attenuation and peak of every plant drawn near them.
        roof_hz, roof_gain: where the law had to stay small, and how small; infinite where nowhere.
        structure, states: of the law; states of each of its parts.
        lines: at which loops were judged in the end, all plants together.
        steps: taken.
    """

    attenuation_db: float
    peak_db: float
    plants: tuple[PlantFigures, ...]
    alone_db: float
    drawn: tuple[tuple[float, float], ...]
    roof_hz: float
    roof_gain: float
    structure: str
    states: int
    lines: int
    steps: int


def figures(plant: StateSpace, law: StateSpace, demands: Demands, control: float, excess_db: float) -> PlantFigures:
    """Return what a law does to a plant, both in the units of the search, `control` turning K S back.

    The bounds are held against both exact norms too, at whatever frequency they are reached, 0 Hz among them.
    """
    attenuation, at = band_attenuation(plant, law, demands.band_hz)
    peak, peak_hz = peak_sensitivity(plant, law)
    largest, largest_hz = hinf_norm(gang_of_four(plant, law)["KS"])
    over = max(
        excess_db,
        peak - float(demands.sensitivity_db(np.array([peak_hz]))[0]),
        20 * float(np.log10(max(largest, LEAST))) - float(demands.control_db(np.array([largest_hz]))[0]),
    )
    return PlantFigures(attenuation, at, peak, peak_hz, largest * control, over, _tones(plant, law, demands))


def _tones(plant: StateSpace, law: StateSpace, demands: Demands) -> dict[str, float]:
    f = np.array(demands.tones_hz, dtype=float)
    left = np.linalg.norm(loop_response(plant, law, f)[0] @ reached_directions(plant)(f), 2, axis=(1, 2))
    return {f"{tone:g}": -20 * float(np.log10(size)) for tone, size in zip(demands.tones_hz, left, strict=True)}


def among(
    result: DesignResult,
    plants: Sequence[StateSpace],
    found: SearchFigures,
    asked: float,
    band_hz: tuple[float, float],
) -> DesignResult:
    """Return a verdict on the first of several plants as one on all of them, the worst word with its plant's number.

    A law without tones that makes nothing quieter, neither S in its worst direction nor S G in the mean, is `short`.
    """
    law = result.controller
    assert law is not None
    for k, plant in enumerate(plants[1:], 2):
        if result.status.word not in STABLE_WORDS:
            return result
        if not feedback(plant, law).is_stable():
            said = f"The loop with plant {k} of {len(plants)} is unstable; the controller must not be used."
            return replace(result, status=Status(StatusWord.UNSTABLE, said))
        margins = both_ends(plant, law)
        if result.status.ok and not keeps(margins, asked):
            said = f"Plant {k} of {len(plants)}: {fragility(plant, margins, asked)}"
            result = replace(result, status=Status(StatusWord.FRAGILE, said))
    over = max(each.excess_db for each in found.plants)
    if result.status.ok and over > ROUNDING_DB:
        said = f"A bound is exceeded by {over:.2g} dB, the best that was found. {result.status.sentence}"
        return replace(result, status=Status(StatusWord.SHORT, said))
    if result.status.ok and not any(each.tones_db for each in found.plants):
        return _unless_idle(result, plants, found.attenuation_db, band_hz)
    return result


def with_price(result: DesignResult, found: SearchFigures, gain_spread: float, mode_spread: float) -> DesignResult:
    """Return a verdict that tells what the plants drawn near cost, where that is much."""
    cost = found.alone_db - found.attenuation_db
    if not result.status.ok or not found.drawn or cost < DEAR_DB:
        return result
    said = (
        f"For the plants given alone the search came to {rounded(found.alone_db)} dB; that the law also holds on "
        f"plants drawn near them, gains up to {gain_spread:.0%} and modes up to {mode_spread:.1%} off ('gain_spread' "
        f"and 'mode_spread'), costs {rounded(cost)} dB of it."
    )
    return replace(result, status=Status(result.status.word, f"{result.status.sentence} {said}"))


def _unless_idle(
    result: DesignResult, plants: Sequence[StateSpace], attenuation_db: float, band_hz: tuple[float, float]
) -> DesignResult:
    """Return a verdict as it is, or `short` where the law makes no plant quieter: no law meets bounds too."""
    law = result.controller
    assert law is not None
    quieter = max(rms_reduction_db(plant, law, band_hz) for plant in plants)
    reached = any(reached_directions(plant)(np.array(band_hz)).any() for plant in plants)
    if (reached and attenuation_db >= LITTLE_DB) or quieter >= LITTLE_DB:
        return result
    low, high = band_hz
    if not reached:
        said = f"Nothing gets quiet over {low:.4g}-{high:.4g} Hz. {result.status.sentence}"
        return replace(result, status=Status(StatusWord.SHORT, said))
    said = (
        f"Within these bounds nothing gets quiet: over {low:.4g}-{high:.4g} Hz the worst direction of S "
        f"{fall(attenuation_db, 2)} and the RMS of S G {fall(quieter, 2)}. Name the "
        f"band that is to be quiet, or allow more amplification. {result.status.sentence}"
    )
    return replace(result, status=Status(StatusWord.SHORT, said))


def rms_reduction_db(plant: StateSpace, law: StateSpace, band_hz: tuple[float, float]) -> float:
    """Return by how many dB a law lowers the RMS of S G over a band, in the units in which its channels are even."""
    even = even_plant(plant, band_hz)
    return even.rms_reduction_db(SearchUnits(even.inputs, even.outputs, band_hz).taken(law))
