"""What a law leaves of a disturbance on a bench, measured over the whole range that its sensors hear."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array, positive
from ultraquiet._base.errors import InputError, UnheardError
from ultraquiet._base.progress import task
from ultraquiet._base.shown.line import counted
from ultraquiet.bench import Bench
from ultraquiet.simulate.kick import ranges
from ultraquiet.simulate.open_loop import OpenLoop
from ultraquiet.simulate.sensitivity.measured import MeasuredSensitivity, is_heard_from, size_of
from ultraquiet.simulate.sensitivity.pair import HIDDEN, BandLines, LoopPair
from ultraquiet.simulate.sweeps.band import LOUD
from ultraquiet.values import FrequencyResponse, StateSpace
from ultraquiet.values.controller import Controller

UNHEARD = 1.25  # of the range of the sweeps that has no line
# A loop that amplifies by more than this at its lowest lines, and there nearly as much as anywhere else, may amplify
# most below: it is measured further down, as long as it does, the open loop is heard and a run is long enough. So many
# lines count that noise in one of them cannot hide a peak: those up to so much above the lowest.
AMPLIFIES, NEARLY, LOWEST = 1.06, 0.9, 1.1


def measure_sensitivity(
    bench: Bench,
    controller: StateSpace | Controller,
    f_hz: ArrayLike | None = None,
    *,
    opened: OpenLoop | None = None,
    down_to_hz: float | None = None,
) -> MeasuredSensitivity:
    """Measure S on the bench with swept disturbances in its own directions, open and closed loop.

    Each run sweeps from the lowest to the highest frequency and then waits until the plant has come to rest, so that
    Y(f) is the Fourier transform of the whole response and free of leakage at every line of a run: for as long as more
    silence helps, on a bench in real time four times. Where it ends displaced or moving, as an integrator or a free
    body does, the rest of the transform is known and added; what rings on is counted like noise. A run drives one
    right singular vector of the open loop, as loud as ranges allow at each frequency: weak directions stand as far
    above the noise as strong ones. Where they do not, the open loop is swept again in the directions that its own lines
    give, three times at most. Lines are where S is: closer together between lines that differ by more than 0.5 dB,
    down to one over the length of a run, or of the longer ones that a loop which rings asked for. A line is heard with
    its neighbours, as many of them as noise alone tells apart from a smooth S: the largest of many noisy lines would
    read too much. A pass is repeated, louder where noise hid a line, four times at most; what noise leaves open in the
    open loop is the same in all passes and is not averaged away.

    Args:
        bench: any bench; with fewer sensors than actuators S is full, with more it is that of the reached directions.
        controller: acts as u = K y.
        f_hz: lines in Hz that are asked for, moved to the nearest of a run; chosen from S itself when absent, over the
            whole range of the sweep, and further down where S still rises there and a run is long enough.
        opened: the open loop of the same bench, measured before; its runs are made once for all laws.
        down_to_hz: where a band begins that something is asked over: without `f_hz`, it is measured down to there as
            long as the open loop is heard, with longer runs where these are too short.

    Returns:
        `MeasuredSensitivity`, every line asked for in it.

    Raises:
        InputError: lines beyond the Nyquist frequency, an open loop of another bench, a band that begins at no
            frequency above zero.
    """
    opened = OpenLoop(bench) if opened is None else opened
    if opened.bench is not bench and opened.bench != bench:
        raise InputError("measure_sensitivity: 'opened' is the open loop of another bench.")
    if down_to_hz is not None:
        positive("measure_sensitivity", "down_to_hz", down_to_hz, "Hz")
    pairs = [LoopPair(band, controller) for band in opened.bands]
    asked = [None] * len(pairs) if f_hz is None else _asked(opened, f_hz)
    with task("sensitivity on the bench", len(pairs)) as progress:
        parts = []
        for pair, lines in zip(pairs, asked, strict=True):
            parts.append(pair.at(lines))
            progress.advance(note=f"to {pair.band.sweep.high_hz:.3g} Hz")
        if f_hz is None:
            parts = [*_lower(opened, controller, parts, down_to_hz), *parts]
    found = _joined(opened, parts)
    if f_hz is not None:
        return found
    return replace(found, below=_rises_below(found), unheard=_unheard(found, opened))


def _lower(
    opened: OpenLoop, controller: StateSpace | Controller, parts: list[BandLines], down_to_hz: float | None
) -> list[BandLines]:
    """Return the bands below that a loop asks for, or a band that begins down there, from the lowest up."""
    lower, bands = opened.downwards(down_to_hz), list[BandLines]()
    while (lines := [*bands, *parts])[0].f_hz.size:
        rises = may_peak_below(*_all_lines(lines))
        if not rises and (down_to_hz is None or is_heard_from(float(lines[0].f_hz[0]), down_to_hz)):
            break
        try:
            if (below := next(lower, None)) is None:
                break
            bands.insert(0, LoopPair(below, controller).at(None, most_hidden=0.0 if rises else HIDDEN))
        except InputError as error:
            if not error.of_question:
                raise
            break  # a bench that refuses runs of that length is heard no further down
    return bands


def _asked(opened: OpenLoop, f_hz: ArrayLike) -> list[np.ndarray]:
    """Return the places of the lines asked for among those of each band."""
    f = np.sort(frequency_array("measure_sensitivity", f_hz))
    low, high = opened.bands[0].sweep.lines_hz[0], opened.bands[-1].sweep.lines_hz[-1]
    if f[0] < low or f[-1] > high:
        raise InputError(
            f"measure_sensitivity: 'f_hz' must lie between {low:.4g} and {high:.4g} Hz, got {f[0]:g} to {f[-1]:g}; "
            f"a longer OpenLoop(bench, seconds=...) begins lower."
        )
    places, below = [], -np.inf
    for band in opened.bands:
        lines, above = band.sweep.lines_hz, band.sweep.high_hz if band is not opened.bands[-1] else np.inf
        mine = f[(f > below) & (f <= above)]
        places.append(np.rint((mine - lines[0]) / (lines[1] - lines[0])).astype(int).clip(0, lines.size - 1))
        below = above
    return places


def _rises_below(found: MeasuredSensitivity) -> str:
    if found.hidden[0] or not may_peak_below(found.f_hz, found.S.values):
        return ""
    lowest_db = 20 * np.log10(_near_lowest(found.f_hz, size_of(found.S.values)))
    return f"The loop amplifies by {lowest_db:.1f} dB near the lowest, {found.f_hz[0]:.3g} Hz, and perhaps more below."


def _unheard(found: MeasuredSensitivity, opened: OpenLoop) -> str:
    low, high = opened.bands[0].sweep.low_hz, opened.bands[-1].sweep.high_hz
    first, last = found.f_hz[0], found.f_hz[-1]
    parts = [f"below {first:.3g} Hz"] if first > UNHEARD * low else []
    parts += [f"above {last:.3g} Hz"] if last < high / UNHEARD else []
    return f"The open loop is not heard {' and '.join(parts)}: nothing is known there." if parts else ""


def _all_lines(parts: list[BandLines]) -> tuple[FloatArray, ComplexArray]:
    """Return the lines of all parts and S there."""
    return np.concatenate([part.f_hz for part in parts]), np.concatenate([part.S for part in parts], axis=2)


def may_peak_below(f_hz: FloatArray, S: ComplexArray) -> bool:
    """Return whether the loop amplifies at its lowest lines nearly as much as anywhere above; `(ny, ny, lines)`."""
    size = size_of(S)
    return _near_lowest(f_hz, size) > max(AMPLIFIES, NEARLY * float(size.max()))


def _near_lowest(f_hz: FloatArray, size: FloatArray) -> float:
    return float(size[f_hz <= LOWEST * f_hz[0]].max())


def _joined(opened: OpenLoop, parts: list[BandLines]) -> MeasuredSensitivity:
    f, S = _all_lines(parts)
    bench = opened.bench
    if not f.size:
        advice = _louder(bench) or "raise the sensors' gain or lower their noise"
        raise UnheardError(f"measure_sensitivity: noise hides every line; {advice}.")
    ny, nu = len(bench.sensors), len(bench.actuators)
    reached = counted(nu, "actuator reaches", "actuators reach")
    seconds = ", ".join(f"{band.sweep.samples / bench.rate_hz:g}" for band in opened.bands)
    text = f"disturbance to sensors, sweeps of {seconds} s"
    opened_y, closed_y = (
        np.concatenate([getattr(part, name) for part in parts], axis=2) for name in ("opened", "closed")
    )
    deviation = np.concatenate([part.deviation for part in parts])
    return MeasuredSensitivity(
        FrequencyResponse(f, S, estimator=text),
        opened_y,
        closed_y,
        deviation,
        f"{reached} {nu} of {ny} directions of the sensors; in the others no law does anything." if nu < ny else "",
        louder=_louder(bench),
        rings=any(part.rings for part in parts),
    )


def _louder(bench: Bench) -> str:
    if np.isfinite([*ranges(bench.actuators), *ranges(bench.sensors)]).all():
        return ""
    kept = f"readings are kept to {LOUD:g} times their noise"
    if not np.isfinite(ranges(bench.actuators)).any():
        kept = f"commands are kept to one unit and {kept}"
    return f"give each channel its low and high: without them {kept}"
