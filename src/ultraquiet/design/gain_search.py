"""Designs that ask a plant for as much as it gives robustly: their gain is halved until the stated margin is kept."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet.analyse.disk import ENDS, disk_margin
from ultraquiet.analyse.margins import default_grid, even_sensitivity
from ultraquiet.analyse.peaks import response_at
from ultraquiet.analyse.scalings.upper import balanced_norm
from ultraquiet.analyse.structure import structure
from ultraquiet.design.plant_scale import EvenPlant, even_plant
from ultraquiet.design.result import DesignResult, refused
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.verification import judged
from ultraquiet.values.interconnect import feedback
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

FIRST = 32.0  # 30 dB of loop gain in the mean over the band: more is noise in the actuators
LAST = 2.0**-6  # below it nothing worth calling control is left
CLEARLY = 1.1  # times the margin, on the lines of a grid: peaks between them are lower than that
LITTLE_DB = 1.0  # a law that lowers the RMS by less leaves the plant as it is
SPARE = 1.02  # of the margin, so that the last digits of another coordinate system do not decide


def from_plant(
    plant: StateSpace,
    settings: StatedRobustness,
    attempt: Callable[[EvenPlant, float], DesignResult],
    band_hz: tuple[float, float] | None = None,
    first: float = FIRST,
) -> DesignResult:
    """Return the design of the largest gain, halved from one attempt to the next, that keeps the margin asked for.

    Args:
        plant: G.
        settings: with the `disk_margin`.
        band_hz: where the plant is to be evened out; its own band when absent.
        attempt: gives what a method finds for the even plant at a gain g: its controller, or a refusal.
        first: the gain to begin with.

    The even plant has a mean square of one over its band, so that g is the loop gain that the method is asked for.
    `details` gains `gain`, g; `band_hz`, `inputs` and `outputs`, the band and the units of the even plant; and
    `attenuation_rms_db`, by how much the RMS of S G over that band is lower than that of G. Where no gain keeps the
    margin the loop that keeps most is returned, and is judged fragile; where none that keeps it lowers that RMS by a
    decibel, the quietest of them, and it is `short`.
    """
    even = even_plant(plant, band_hz, type(settings).__name__)
    enough = SPARE * settings.disk_margin
    best: tuple[tuple[float, float], float, DesignResult] | None = None
    refusal, g = "", first
    while g >= LAST:
        found = attempt(even, g)
        law = found.controller
        if law is None:
            refusal = refusal or found.status.sentence
        else:
            kept = margin_kept(even.plant, law, settings.disk_margin)
            quieter = even.rms_reduction_db(law)
            worth = (min(kept, enough), quieter)
            if kept > 0 and (best is None or worth > best[0]):
                best = (worth, g, found)
            if kept > 0 and kept >= enough and quieter >= LITTLE_DB:
                break
        g /= 2
    if best is None:
        return refused(refusal or f"{type(settings).__name__}: no gain gave a stable loop.")
    (_, quieter), g, found = best
    assert found.controller is not None
    details = {
        **found.details,
        "gain": g,
        "band_hz": even.band_hz,
        "inputs": even.inputs,
        "outputs": even.outputs,
        "attenuation_rms_db": quieter,
    }
    law = even.law(found.controller)
    result = judged(plant, law, settings, found.gamma, found.achieved, found.residuals, details)
    return result if quieter >= LITTLE_DB or not result.status.ok else _idle(result)


def _idle(result: DesignResult) -> DesignResult:
    """Return a loop that keeps its margin and makes nothing quiet, with a word that says so."""
    said = (
        "With that margin nothing gets quiet: give 'band_hz', or weights, for what is to be quiet. "
        f"{result.status.sentence}"
    )
    return replace(result, status=Status(StatusWord.SHORT, said))


def margin_kept(plant: StateSpace, law: StateSpace, asked: float) -> float:
    """Return the smaller of the disk margins at both ends; where that is below `asked`, a number not below it.

    Lines at which one channel, or all alike, already need less are found first: eigenvalues cost less than mu.
    """
    try:
        if not feedback(plant, law).is_stable() or not feedback(law, plant).is_stable():
            return 0.0
    except InputError:  # not well posed
        return 0.0
    most, sure = np.inf, np.inf
    for side in ENDS:
        S = even_sensitivity(plant, law, side)
        if not S.is_stable():
            return 0.0
        X = np.moveaxis(response_at(S)(default_grid(S)), 2, 0) - np.eye(S.D.shape[0]) / 2
        largest = max(np.abs(np.linalg.eigvals(X)).max(initial=0.0), np.abs(np.einsum("fii->fi", X)).max(initial=0.0))
        most = min(most, 1 / float(largest))
        channels = structure("margin_kept", None, S.D.shape)
        sure = min(sure, 1 / float(balanced_norm(X, channels).max(initial=np.finfo(float).tiny)))
    if most < asked:
        return most
    if sure >= CLEARLY * asked:
        return sure  # a norm says enough; the margin itself is found where the loop is judged
    return min(disk_margin(plant, law, side) for side in ENDS)
