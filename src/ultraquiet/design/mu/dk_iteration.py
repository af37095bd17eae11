"""D-K synthesis: performance that holds for every plant of an uncertain family, not only for the model."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ultraquiet._base.constraints import FloatArray, positive, rising_band, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.margins import default_grid
from ultraquiet.analyse.mu import MuBounds, mu_bounds, mu_peak
from ultraquiet.analyse.plant_scale import EvenPlant, below_nyquist, even_plant
from ultraquiet.design.gain_search import from_plant
from ultraquiet.design.hinf.synthesis import synthesize_hinf
from ultraquiet.design.mu import performance_weights
from ultraquiet.design.mu.scalings import Scaling, constant, fitted, fitted_of_every_order, scaled
from ultraquiet.design.result import STABLE_WORDS, DesignResult, refused
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.verification import judged
from ultraquiet.design.weights.filters import band_pass, high_pass, with_tones
from ultraquiet.design.weights.weight import Weight, weight
from ultraquiet.values.door import takes_systems
from ultraquiet.values.generalised import uncertain
from ultraquiet.values.interconnect import lft
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

WHO = "MuSynthesis"
LINES = 120  # at which the scalings are found; the peak itself is refined between them
SETTLED = 2e-3  # an iteration that lowers the peak by less than this share is the last but one
PATIENCE = 2  # iterations without gain
# Scalings go further than the bound's by this share of the way; more after a success, less after a failure.
PUSH, LARGEST_PUSH, LEAST_PUSH = 1.0, 4.0, 0.2
DECADE, DECADES = 10.0, 4  # steps and range of the constant scalings that start the iteration
# What each of these numbers is where only others are given; with none, the plant is the measure.
ABSOLUTE = {"height": 4.0, "floor": 0.4}
ERROR, ERROR_BEYOND = 0.1, 2.0  # of an actuator in the band and far beyond it
FURTHER = 5.0  # times the band's upper corner: where control is to end
RISE = 10.0  # of the weight on u, from there on
REACH = 10.0  # times its height: what K S may be in the units of the even plant
Blocks = tuple[tuple[int, int], ...]


class _Step(NamedTuple):
    """One iteration: the controller, mu's peak and where, the level of the K-step, its scaling, loop and mu."""

    result: DesignResult
    peak: tuple[float, float]
    level: float
    scaling: Scaling
    loop: StateSpace
    bounds: MuBounds


@register("design", "mu-synthesis")
@dataclass(frozen=True)
class MuSynthesis(StatedRobustness):
    """The controller that lowers the structured singular value of a loop whose plant is not known exactly.

    min over K and D of max over f of ||D F(P, K) D^-1||, by turns: the K-step is an H-infinity synthesis with D held,
    the D-step scales the loop found, frequency by frequency, and fits the scalings by stable minimum-phase filters. mu
    of the blocks (each input's error, each output's error, performance) below one means that Wp S and Wc K S stay below
    one for every plant (I + Do Wo) G (I + Di Wi) with |each entry of the diagonal Di and Do| <= 1.

    Args:
        on_inputs: Wi, relative error of each actuator: a number, `(low, corner_hz, high)` or a `StateSpace`.
        on_outputs: Wo, relative error of each sensor; none when absent.
        performance: Wp on every output; absent, a band-pass from the numbers below.
        control: Wc on every input; absent, a gain that rises at high frequency from 1 / `control_limit`.
        band_hz: corners of the band to be quiet, Hz; the plant's own band when absent.
        height: gain of Wp in the band, 4 where only others are given.
        floor: gain of Wp outside it, 0.4 likewise.
        order: states of Wp per channel, even.
        tones_hz: frequencies at which Wp has peaks besides, Hz.
        tone_height: extra gain of Wp at each tone.
        tone_zeta: half the relative width of the peaks.
        control_limit: allowed gain from sensor to actuator, in their units; where others are given and this is not,
            K S has no weight.
        roll_off_hz: where control is to end, Hz; five times the band's upper corner when absent.
        iterations: D-K iterations at most. Plain H-infinity comes first, then constant scalings while these help; a
            dozen iterations and filters of order six reach the last few per cent.
        scaling_order: states of each scaling at most; a small one is taken where it is as good.
        margin: each controller is formed at margin times the smallest norm.

    >>> lag = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> design = MuSynthesis(on_inputs=0.2, performance=(10.0, 0.02, 0.5), iterations=2)
    >>> result = design.design(lag)
    >>> result.status.ok, result.details["mu_peak"] <= result.details["mu"][0]
    (True, True)

    Doyle 1982, doi:10.1049/ip-d.1982.0053; Skogestad and Postlethwaite 2005, section 8.12.
    """

    on_inputs: Weight | None = None
    on_outputs: Weight | None = None
    performance: Weight | None = None
    control: Weight | None = None
    band_hz: tuple[float, float] | None = None
    height: float | None = None
    floor: float | None = None
    order: int = 4
    tones_hz: tuple[float, ...] = ()
    tone_height: float = 100.0
    tone_zeta: float = 0.002
    control_limit: float | None = None
    roll_off_hz: float | None = None
    iterations: int = 4
    scaling_order: int = 4
    margin: float = 1.02

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("height", "floor", "tone_height", "tone_zeta", "control_limit", "roll_off_hz", "margin"):
            if getattr(self, name) is not None:
                positive(WHO, name, getattr(self, name))
        if self.band_hz is not None:
            rising_band(WHO, self.band_hz)
        if self.roll_off_hz is not None and self.control_limit is None:
            raise InputError(
                f"{WHO}: 'roll_off_hz' tells where the weight on K S rises, whose gain up to there is 'control_limit'; "
                "give both or neither."
            )
        whole(WHO, "iterations", self.iterations, 1, 50)
        whole(WHO, "scaling_order", self.scaling_order, 0, 10)

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the controller u = K y of least mu among the iterations.

        `gamma` is the norm that the K-step of this controller claims for the scaled loop, `achieved` that norm computed
        again. `details` holds `mu`, the peak of the upper bound after each iteration; `mu_peak` and `mu_peak_hz`, those
        of the finished loop; `robust_stability`, the peak for the uncertainty alone; `f_hz`, `mu_upper` and `mu_lower`
        over frequency; `scaling_orders`; the `weights`, and `loop_weights`, which of them stand on S, T and KS. A loop
        that is not stable for every plant of the family has the status `not robust`.
        """
        if self._measured_by_the_plant():
            result = from_plant(plant, self, self._attempt, self.band_hz, first=ABSOLUTE["height"])
        else:
            found = self._found(plant)
            law = found.controller
            if law is None:
                return found
            result = judged(plant, law, self, found.gamma, found.achieved, found.residuals, found.details)
        return _with_verdict(result) if result.status.word in (*STABLE_WORDS, StatusWord.SHORT) else result

    def _measured_by_the_plant(self) -> bool:
        given = (self.performance, self.control, self.control_limit, self.roll_off_hz, self.height, self.floor)
        errors = (self.on_inputs, self.on_outputs)
        full = any(isinstance(w, StateSpace) and w.D.shape != (1, 1) for w in errors)
        return not full and all(setting is None for setting in given)

    def _attempt(self, even: EvenPlant, g: float) -> DesignResult:
        """Return what is found for the even plant at the height g, its weights as those of the plant."""
        low, high = even.band_hz
        numbers = replace(self, band_hz=(low, high), height=g, control_limit=REACH * g)
        found = numbers._found(even.plant)
        if found.controller is None:
            return found
        weights = found.details["weights"]
        units = {**weights, **even.weights(weights["performance"], weights["control"])}
        bounds = performance_weights.in_units(found.details["loop_weights"], even)
        return replace(found, details={**found.details, "weights": units, "loop_weights": bounds})

    def _found(self, plant: StateSpace) -> DesignResult:
        """Return the controller of least mu, its loop not yet judged, or a refusal."""
        weights = self.weights(plant)
        P = uncertain(
            plant,
            weights["on_inputs"],
            weights.get("on_outputs"),
            weights["performance"],
            weights.get("control"),
        )
        blocks = _blocks(plant, weights)
        f = _lines(P)
        steps, reason = self._iterated(P, plant.D.shape, blocks, f)
        if not steps:
            return refused(f"{WHO}: the first H-infinity step failed: {reason}")
        best = min(steps, key=lambda s: s.peak[0])
        bounds = performance_weights.on_loop(weights, plant.D.shape)
        return _told(P, blocks, f, best, steps, {"weights": weights, "loop_weights": bounds, "stopped": reason})

    def weights(self, plant: StateSpace) -> dict[str, StateSpace]:
        """Return the weights in full size at the plant's rate, those left out missing."""
        (ny, nu), rate = plant.D.shape, plant.rate_hz
        needed = self.performance is None or self.on_inputs is None or self.control_limit is not None
        band_hz = self.band_hz or (even_plant(plant).band_hz if needed else (0.0, 0.0))
        end = below_nyquist(self.roll_off_hz or FURTHER * band_hz[1], rate)
        settings: dict[str, tuple[Weight | None, int]] = {
            "on_inputs": (self._errors(band_hz, rate), nu),
            "on_outputs": (self.on_outputs, ny),
            "performance": (self.performance, ny),
            "control": (self.control, nu),
        }
        if self.performance is None:
            height, floor = (ABSOLUTE[k] if getattr(self, k) is None else getattr(self, k) for k in ABSOLUTE)
            settings["performance"] = (band_pass(band_hz, height, floor, self.order, rate), ny)
        if self.control is None and self.control_limit is not None:
            low = 1 / self.control_limit
            settings["control"] = (high_pass(end, low, RISE * low, 1, rate), nu)
        weights = {k: weight(WHO, k, w, n, rate) for k, (w, n) in settings.items() if w is not None}
        weights["performance"] = with_tones(weights["performance"], self.tones_hz, self.tone_height, self.tone_zeta)
        return weights

    def _errors(self, band_hz: tuple[float, float], rate_hz: float | None) -> Weight:
        if self.on_inputs is not None:
            return self.on_inputs
        return ERROR, below_nyquist(2 * band_hz[1], rate_hz), ERROR_BEYOND

    def _iterated(
        self, P: StateSpace, shape: tuple[int, ...], blocks: Blocks, f: FloatArray
    ) -> tuple[list[_Step], str]:
        """Return every iteration that gave a stable loop, and why there is no further one."""
        steps, reason = self._started(P, shape, blocks, f)
        if reason:
            return steps, reason
        best, push, idle = min(steps, key=lambda s: s.peak[0]), PUSH, 0
        fits: list[Scaling] | None = None  # of the best loop, which may stay the best for several turns
        for _ in range(self.iterations - 1):
            M = best.loop.frequency_response(f)
            if fits is None:
                fits = fitted_of_every_order(M, best.bounds, self.scaling_order, P.rate_hz)
            scaling = fitted(fits, M, best.bounds, P.rate_hz, best.scaling, push)
            trial, reason = self._step(P, shape, scaling, f)
            if trial is not None:
                steps.append(trial)
            if trial is not None and trial.peak[0] < best.peak[0]:
                idle = idle + 1 if trial.peak[0] > best.peak[0] * (1 - SETTLED) else 0
                best, fits, push = trial, None, min(2 * push, LARGEST_PUSH) or LEAST_PUSH
                reason = "mu stands still"
                stands = idle >= PATIENCE
            else:
                reason, stands = reason or "mu rises with the scalings that fit it", push == 0
                push = push / 4 if push > LEAST_PUSH else 0.0
            if stands:
                fits = fits or fitted_of_every_order(
                    best.loop.frequency_response(f), best.bounds, self.scaling_order, P.rate_hz
                )
                every = self._of_every_order(P, shape, fits, f)
                steps += every
                other = min(every, key=lambda s: s.peak[0], default=best)
                if other.peak[0] > best.peak[0] * (1 - SETTLED):
                    return steps, reason
                best, fits, push, idle = other, None, PUSH, 0
        return steps, f"all {self.iterations} iterations were made"

    def _of_every_order(self, P: StateSpace, shape: tuple[int, ...], fits: list[Scaling], f: FloatArray) -> list[_Step]:
        """Return a step from where the iteration stands with scalings of each order above zero.

        Which order serves best is told by the fit to one loop, and that is a close thing; where it led nowhere another
        one may go on.
        """
        trials = [self._step(P, shape, scaling, f)[0] for scaling in fits[1:]]
        return [trial for trial in trials if trial is not None]

    def _started(self, P: StateSpace, shape: tuple[int, ...], blocks: Blocks, f: FloatArray) -> tuple[list[_Step], str]:
        """Return the plain H-infinity step, and steps with constant scalings while these lower mu.

        Iterations from one alone can creep for dozens of turns where errors and performance differ much in size.
        """
        first, reason = self._step(P, shape, constant(blocks, 1.0, P.rate_hz), f)
        if first is None:
            return [], reason
        steps, k = [first], int(np.argmax(first.bounds.upper))
        turn = DECADE if np.mean(np.log(first.bounds.levels[:-1, k])) > 0 else 1 / DECADE
        for power in range(1, DECADES + 1 if self.iterations > 1 else 1):
            step, _ = self._step(P, shape, constant(blocks, turn**power, P.rate_hz), f)
            if step is None:
                break
            steps.append(step)
            if step.peak[0] > steps[-2].peak[0]:
                break
        return steps, ""

    def _step(self, P: StateSpace, shape: tuple[int, ...], scaling: Scaling, f: FloatArray) -> tuple[_Step | None, str]:
        """Return one K-step and mu of its loop, or why there is none."""
        ny, nu = shape
        # each loop is judged by its own mu: a second opinion on the K-step's optimum would change nothing
        scaled_plant = scaled(P, scaling, ny, nu)
        synthesised = synthesize_hinf(scaled_plant, ny, nu, margin=self.margin, second_opinion=False)
        if synthesised.controller is None:
            return None, synthesised.status.sentence
        loop = lft(P, synthesised.controller)
        bounds = mu_bounds(loop, scaling.blocks, f)
        if not bounds.stable:
            return None, "the loop is unstable with the unscaled plant"
        return _Step(synthesised, bounds.peak, synthesised.gamma, scaling, loop, bounds), ""


def _blocks(plant: StateSpace, weights: dict[str, StateSpace]) -> Blocks:
    """Return (outputs, inputs) of each block of the loop: one a channel that is uncertain, one for performance."""
    ny, nu = plant.D.shape
    channels = nu + (ny if "on_outputs" in weights else 0)
    costs = sum(weights[k].D.shape[0] for k in ("performance", "control") if k in weights)
    return (*((1, 1),) * channels, (costs, ny))


def _lines(P: StateSpace) -> FloatArray:
    """Return a thinned grid of frequencies that keeps the neighbourhood of the poles."""
    grid = default_grid(P)
    grid = grid[grid > 0]
    return grid[np.unique(np.linspace(0, grid.size - 1, min(LINES, grid.size)).round().astype(int))]


def _told(
    P: StateSpace,
    blocks: Blocks,
    f: FloatArray,
    best: _Step,
    steps: list[_Step],
    details: dict[str, Any],
) -> DesignResult:
    """Return the best iteration with what its mu is worth."""
    assert best.result.controller is not None
    loop = lft(P, best.result.controller)
    bounds = mu_bounds(loop, blocks, _lines(loop))
    errors = len(blocks) - 1
    alone = StateSpace(loop.A, loop.B[:, :errors], loop.C[:errors], loop.D[:errors, :errors], loop.rate_hz)
    stability = mu_peak(alone, blocks[:-1], f)[0]
    peak, at = bounds.peak
    details = {
        **details,
        "mu": tuple(s.peak[0] for s in steps),
        "levels": tuple(s.level for s in steps),
        "scaling_orders": tuple(s.scaling.order for s in steps),
        "mu_peak": peak,
        "mu_peak_hz": at,
        "robust_stability": stability,
        "f_hz": bounds.f_hz,
        "mu_upper": bounds.upper,
        "mu_lower": bounds.lower,
    }
    return replace(best.result, details={**best.result.details, **details})


def _with_verdict(result: DesignResult) -> DesignResult:
    peak, at, stability = (float(result.details[k]) for k in ("mu_peak", "mu_peak_hz", "robust_stability"))
    first, n = result.details["mu"][0], len(result.details["mu"])
    summary = f"mu peaks at {peak:.3f}, at {at:.4g} Hz, in {n} iterations ({first:.3f} by plain H-infinity)"
    if stability >= 1:
        sentence = (
            f"{summary}, for the uncertainty alone at {stability:.3f}: plants of the family may be unstable; ask less."
        )
        return replace(result, status=Status(StatusWord.NOT_ROBUST, sentence))
    worth = "performance holds for every plant of the family"
    if peak >= 1:
        share = f"{1 / peak:.0%}"
        worth = f"every plant of the family is stable; {share} of the performance holds for {share} of the errors"
    return replace(result, status=Status(result.status.word, f"{summary}; {worth}. {result.status.sentence}"))
