"""Are a study's requirements met? Judged from facts, for the law they name, on every unit."""

from collections.abc import Iterator, Mapping
from math import inf

import numpy as np

from ultraquiet import analyse
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown.line import loudness, on_its_side
from ultraquiet.analyse.disk import ENDS
from ultraquiet.linalg.response import principal_gains
from ultraquiet.pipeline.facts.loops import StableLoop, UnstableLoop
from ultraquiet.pipeline.facts.mission import NoPayload, PayloadLoop
from ultraquiet.pipeline.facts.requirements import RequirementFacts, RequirementsFacts
from ultraquiet.pipeline.study import Band, Requirements
from ultraquiet.values import FrequencyResponse, StateSpace

Peak = tuple[float, float]  # in dB, and where, in Hz
Units = Mapping[str, StableLoop | UnstableLoop]
# How far below what was heard, and how near to half the rate above it, the design model is asked.
DEEPEST, NEAREST = 1e-3, 0.999
ROUNDING_DB = 1e-6  # what files and another order of summing leave between a figure and the line it was read from
# Each requirement with its unit and whether more of it is better.
MEASURED = {"attenuation_db": (" dB", True), "peak_db": (" dB", False), "tones_db": (" dB", True)}
PAYLOAD = "payload_db"
SAYS = {
    "attenuation_db": "reduction of the worst direction over {low:g}-{high:g} Hz",
    "peak_db": "largest amplification of any direction",
    "tones_db": "reduction of the worst channel at the worst tone",
    PAYLOAD: "reduction of the payload's RMS while the base is shaken",
    "disk_margin": "disk margin of all channels at once at the plant's {where}",
}
# The same as a line of a table.
SHORT = {
    "attenuation_db": "worst direction, {low:.4g}-{high:.4g} Hz",
    "peak_db": "largest amplification anywhere",
    "tones_db": "worst channel at the worst tone",
    PAYLOAD: "payload, base shaken",
    "disk_margin": "disk margin, all channels at once",
}


def judge(
    asked: Requirements,
    band_hz: Band,
    units: Units | None,
    disk: Mapping[str, float],
    payload: Mapping[str, PayloadLoop | NoPayload] | None = None,
    silent: Mapping[str, Peak] | None = None,
    faint: Mapping[str, Peak] | None = None,
    read: Mapping[str, FrequencyResponse] | None = None,
) -> RequirementsFacts:
    """Return every requirement with its figure and its verdict.

    Args:
        asked: the study's `[requirements]`; what is None is not asked.
        band_hz: over which the worst direction counts.
        units: how the law's loop did on the bench of each unit; None where there is no law of that name, or no loop.
        disk: disk margins of the design model's loop by end, all channels at once.
        payload: what the law does for the payload of each unit; None where it was not listened to.
        silent: peaks by unit that the design model has where the bench is not heard (`unheard_peaks`); one that is
            above what was heard is what counts of `peak_db`.
        faint: least reductions by unit that the design model has where the bench is not heard within the band
            (`unheard_reductions`); one that is below what was heard is what counts of `attenuation_db`. Without it,
            the reduction over such a band was not measured.
        read: sensitivities by unit as they were read. Where noise hides the line that decides, what counts is a bound
            of it, and the sentence says so and what was read.

    What was not measured, because a loop is unstable or was never closed, is missed.
    """
    beyond = {"peak_db": silent or {}, "attenuation_db": faint or {}}
    judged = [*_measured(asked, band_hz, units, beyond, read or {}), *_of_payload(asked, band_hz, payload)]
    if asked.disk_margin is not None:
        for end in ENDS:
            judged.append(_one("disk_margin", end, asked.disk_margin, disk.get(end), band_hz))
    return RequirementsFacts(law=asked.law, band_hz=band_hz, judged=tuple(judged))


def in_short(name: str, band_hz: Band) -> tuple[str, str]:
    """Return a requirement as a line of a table names it, and its unit with a space before it.

    >>> in_short("attenuation_db", (10.0, 100.0))
    ('worst direction, 10-100 Hz', ' dB')
    """
    low, high = band_hz
    return SHORT[name].format(low=low, high=high), " dB" if name.endswith("_db") else ""


def margins_of(plant: StateSpace, law: StateSpace) -> dict[str, float]:
    """Return the disk margins of a loop at both ends of its plant; none of a loop that cannot be closed."""
    try:
        return {end: analyse.disk_margin(plant, law, end) for end in ENDS}
    except InputError:
        return {}


def unheard_peaks(plant: StateSpace, law: StateSpace, units: Units) -> dict[str, Peak]:
    """Return the largest amplification in dB that the design model has where a unit was not heard, and its Hz.

    None of a unit that was heard over the whole range, or whose loop is unstable on the bench.
    """
    found: dict[str, Peak] = {}
    for unit, loop in units.items():
        if not isinstance(loop, StableLoop) or loop.heard_hz is None:
            continue
        low, high = loop.heard_hz
        top = inf if plant.rate_hz is None else plant.rate_hz / 2
        bands = [(low * DEEPEST, low), (high, NEAREST * top)]
        peaks = [analyse.band_attenuation(plant, law, band) for band in bands if band[0] < band[1] < inf]
        found |= {unit: max((-quieter, at) for quieter, at in peaks)} if peaks else {}
    return found


def unheard_reductions(plant: StateSpace, law: StateSpace, units: Units, band_hz: Band) -> dict[str, Peak]:
    """Return the least reduction in dB that the design model has where a unit was not heard in a band, and its Hz.

    None of a unit that was heard over the whole band, or whose loop is unstable on the bench.
    """
    top = inf if plant.rate_hz is None else NEAREST * plant.rate_hz / 2
    found: dict[str, Peak] = {}
    for unit, loop in units.items():
        gaps = loop.unheard(band_hz) if isinstance(loop, StableLoop) else []
        within = [(low, min(high, top)) for low, high in gaps if low < top]
        if within:
            found[unit] = min(analyse.band_attenuation(plant, law, gap) for gap in within)
    return found


def _measured(
    asked: Requirements,
    band_hz: Band,
    units: Units | None,
    beyond: Mapping[str, Mapping[str, Peak]],
    read: Mapping[str, FrequencyResponse],
) -> Iterator[RequirementFacts]:
    for name in MEASURED:
        limit = getattr(asked, name)
        if limit is None:
            continue
        if not units:
            yield _one(name, "any unit", limit, None, band_hz)
        for unit, loop in (units or {}).items():
            if not isinstance(loop, StableLoop):
                yield _one(name, unit, limit, None, band_hz, loop.status)
                continue
            silent = beyond.get(name, {}).get(unit)
            if name == "attenuation_db" and silent is None and loop.unheard(band_hz):
                yield _one(name, unit, limit, None, band_hz, _heard(loop))
                continue
            figure = _figure(name, loop)
            source = _unsettled(loop) if name == "tones_db" else _at_a_bound(name, figure, read.get(unit), band_hz)
            yield _one(name, unit, limit, figure, band_hz, loop.status, silent, source)


def _of_payload(
    asked: Requirements, band_hz: Band, payload: Mapping[str, PayloadLoop | NoPayload] | None
) -> Iterator[RequirementFacts]:
    if asked.payload_db is None:
        return
    if not payload:
        yield _one(PAYLOAD, "any unit", asked.payload_db, None, band_hz, "the payload was not listened to")
    for unit, loop in (payload or {}).items():
        heard = isinstance(loop, PayloadLoop)
        yield _one(
            PAYLOAD,
            unit,
            asked.payload_db,
            loop.reduction_db if heard else None,
            band_hz,
            "" if heard else loop.status,
        )


def _figure(name: str, loop: StableLoop) -> float:
    if name == "attenuation_db":
        own = loop.required_band_db
        return loop.worst_direction_band_db if own is None else own
    if name == "peak_db":
        return loop.peak_amplification_db
    return min(tone.reduction_db for tone in loop.tones.values())


def _heard(loop: StableLoop) -> str:
    low, high = loop.heard_hz or (0.0, inf)
    return f"the bench is heard from {low:.4g} to {high:.4g} Hz"


def _at_a_bound(name: str, figure: float, read: FrequencyResponse | None, band_hz: Band) -> str:
    """Return what to say behind the figure of a worst direction where it is the bound of a hidden line, not a reading.

    A hidden line counts louder than it was read, so that the figure is then beyond the loudest reading.
    """
    if read is None:
        return ""
    low, high = band_hz if name == "attenuation_db" else (0.0, inf)
    band = (read.f_hz >= low) & (read.f_hz <= high)
    if not band.any():
        return ""
    loudest_db = 20.0 * float(np.log10(principal_gains(read.values)[0, band].max()))
    counted_db = -figure if name == "attenuation_db" else figure
    if not counted_db > loudest_db + ROUNDING_DB:
        return ""
    return f" (a bound, as noise hides the line; as read the worst is {loudness(-loudest_db, 2)})"


def _unsettled(loop: StableLoop) -> str:
    """Return what to say behind the figure of the worst tone where that tone's amplitude was still changing."""
    hz, tone = min(loop.tones.items(), key=lambda each: each[1].reduction_db)
    return "" if tone.settled else f" at {hz} Hz, still changing when the longest run ended"


def _one(
    name: str,
    where: str,
    asked: float,
    figure: float | None,
    band_hz: Band,
    status: str = "no loop was closed",
    beyond: Peak | None = None,
    source: str = "",
) -> RequirementFacts:
    unit, more = MEASURED.get(name, (" dB" if name == PAYLOAD else "", True))
    if figure is not None and beyond is not None and (beyond[0] < figure if more else beyond[0] > figure):
        modelled = f" by the design model, at {beyond[1]:.4g} Hz, where the bench is not heard"
        source = f"{modelled}; {figure:.4g}{unit} elsewhere{source}"
        figure = beyond[0]
    # NaN, which no comparison admits, meets nothing
    met = figure is not None and (figure >= asked if more else figure <= asked)
    what = SAYS[name].format(low=band_hz[0], high=band_hz[1], where=where)
    at = "" if name == "disk_margin" else f" on {where}"
    found = f"not measured ({status})"
    if figure is not None:
        found = f"{f'{figure:.4g}' if met else on_its_side(figure, asked, 4, 'g')}{unit}{source}"
    if figure is not None and more and unit and figure < 0:
        found = f"none, {loudness(figure)}{source}"
    bound = "at least" if more else "at most"
    sentence = f"{what}{at} is {found}, {bound} {asked:g}{unit} is asked: {'met' if met else 'missed'}."
    return RequirementFacts(requirement=name, where=where, asked=asked, figure=figure, met=met, sentence=sentence)
