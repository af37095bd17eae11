"""Designs that ask a plant for as much as it gives robustly: their gain is halved until the stated margin is kept."""

from collections.abc import Callable
from dataclasses import replace
from itertools import count, takewhile
from typing import NamedTuple

from ultraquiet._base.errors import InputError
from ultraquiet.analyse.plant_scale import EvenPlant, even_plant
from ultraquiet.design.margin_screen import about_kept, margin_kept, surely_less
from ultraquiet.design.result import DesignResult, refused
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.verification import judged
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

FIRST = 32.0  # 30 dB of loop gain in the mean over the band: more is noise in the actuators
LAST = 2.0**-6  # below it nothing worth calling control is left
# Of the margin: a law that only resembles the one judged keeps less than it, by a fifth on the worst of 40 plants.
CLEARLY_LESS = 0.7
LITTLE_DB = 1.0  # a law that lowers the RMS by less leaves the plant as it is
NOTHING_DB = 0.01  # such a law leaves the plant as it is in all digits that are looked at
IDLE = 2  # gains in turn with laws that do nothing, below which no other one is tried
SPARE = 1.02  # of the margin, so that the last digits of another coordinate system do not decide


def without_weights(who: str) -> InputError:
    """Return the refusal of a design that is asked for weights before its plant, which is their measure, gave them."""
    return InputError(
        f"{who}.weights: without an absolute number the plant is the measure and the gain is sought; "
        "design(plant).details['weights'] holds what came of it. Or give a height, a limit or a corner."
    )


def from_plant(
    plant: StateSpace,
    settings: StatedRobustness,
    attempt: Callable[[EvenPlant, float], DesignResult],
    band_hz: tuple[float, float] | None = None,
    first: float = FIRST,
    sketch: Callable[[EvenPlant, float], StateSpace | None] | None = None,
) -> DesignResult:
    """Return the design of the largest gain, halved from one attempt to the next, that keeps the margin asked for.

    Args:
        plant: G.
        settings: with the `disk_margin`.
        band_hz: where the plant is to be evened out; its own band when absent.
        attempt: gives what a method finds for the even plant at a gain g: its controller, or a refusal.
        first: the gain to begin with.
        sketch: gives about the same controller for much less work, unverified, or None. A gain whose sketch keeps
            clearly less than the margin is passed over; it is attempted after all where no gain keeps the margin.

    The even plant has a mean square of one over its band, so that g is the loop gain that the method is asked for.
    `details` gains `gain`, g; `band_hz`, `inputs` and `outputs`, the band and the units of the even plant; and
    `attenuation_rms_db`, by how much the RMS of S G over that band is lower than that of G. Where no gain keeps the
    margin the loop that keeps most is returned, and is judged fragile; where none that keeps it lowers that RMS by a
    decibel, the quietest of them, and it is `short`.
    """
    even = even_plant(plant, band_hz, type(settings).__name__)
    tried = _Tried(even, attempt, settings.disk_margin)
    best = tried.largest(first, sketch)
    if best is None:
        return refused(tried.refusal or f"{type(settings).__name__}: no gain gave a stable loop.")
    found = best.found
    assert found.controller is not None
    details = {
        **found.details,
        "gain": best.gain,
        "band_hz": even.band_hz,
        "inputs": even.inputs,
        "outputs": even.outputs,
        "attenuation_rms_db": best.quieter,
    }
    law = even.law(found.controller)
    result = judged(plant, law, settings, found.gamma, found.achieved, found.residuals, details)
    return result if best.quieter >= LITTLE_DB or not result.status.ok else _idle(result, settings.ask_for_more)


class _Loop(NamedTuple):
    """What a method found at a gain, and by how many decibels its loop is quieter than the plant."""

    gain: float
    found: DesignResult
    quieter: float


class _Tried:
    """The loops that a method finds for an even plant at one gain after another."""

    def __init__(self, even: EvenPlant, attempt: Callable[[EvenPlant, float], DesignResult], margin: float) -> None:
        self.refusal = ""
        self._even, self._attempt = even, attempt
        self._asked, self._enough = margin, SPARE * margin
        self._fragile: list[_Loop] = []

    def largest(self, first: float, sketch: Callable[[EvenPlant, float], StateSpace | None] | None) -> _Loop | None:
        """Return the loop of the largest gain that keeps the margin and quietens, else the best there is."""
        halvings = (first / 2**k for k in count())
        quietest, passed = self._quiet(list(takewhile(lambda g: g >= LAST, halvings)), sketch)
        if quietest is None and passed:
            quietest, _ = self._quiet(passed, None)  # what a sketch is worth is not known
        return quietest or self._firmest()

    def _quiet(
        self, gains: list[float], sketch: Callable[[EvenPlant, float], StateSpace | None] | None
    ) -> tuple[_Loop | None, list[float]]:
        """Return the first loop that keeps the margin and quietens, else the quietest, and the gains passed over."""
        quietest: _Loop | None = None
        passed: list[float] = []
        idle = 0
        for g in gains:
            drawn = None if sketch is None else sketch(self._even, g)
            if drawn is not None and surely_less(self._even.plant, drawn, CLEARLY_LESS * self._enough):
                passed.append(g)
                continue
            loop = self._kept(g)
            if loop is None:
                continue
            # of laws that do nothing the first: which is the quietest of them, rounding would say
            if quietest is None or loop.quieter > quietest.quieter + NOTHING_DB:
                quietest = loop
            if loop.quieter >= LITTLE_DB:
                return loop, passed
            idle = idle + 1 if abs(loop.quieter) < NOTHING_DB else 0
            if idle == IDLE:
                break
        return quietest, passed

    def _kept(self, g: float) -> _Loop | None:
        """Return the loop at a gain where it keeps the margin."""
        found = self._attempt(self._even, g)
        law = found.controller
        if law is None:
            self.refusal = self.refusal or found.status.sentence
            return None
        loop = _Loop(g, found, self._even.rms_reduction_db(law))
        if margin_kept(self._even.plant, law, self._enough):
            return loop
        self._fragile.append(loop)
        return None

    def _firmest(self) -> _Loop | None:
        """Return the loop that keeps most, of those that keep less than the margin."""
        best: tuple[tuple[float, float], _Loop] | None = None
        for loop in sorted(self._fragile, key=lambda loop: -loop.gain):
            assert loop.found.controller is not None
            kept = about_kept(self._even.plant, loop.found.controller, self._asked)
            worth = (min(kept, self._enough), loop.quieter)
            if kept > 0 and (best is None or worth > best[0]):
                best = (worth, loop)
        return None if best is None else best[1]


def _idle(result: DesignResult, advice: str) -> DesignResult:
    """Return a loop that keeps its margin and makes nothing quiet, with a word that says so."""
    said = f"With that margin nothing gets quiet: {advice}. {result.status.sentence}"
    return replace(result, status=Status(StatusWord.SHORT, said))
