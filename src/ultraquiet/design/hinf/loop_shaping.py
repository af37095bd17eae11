"""Loop shaping: the loop's gain drawn first, then stabilised as robustly as that gain allows."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError

from ultraquiet._base.constraints import FloatArray, positive
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet._base.registry import register
from ultraquiet._base.shown.line import counted
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.margins import default_grid
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.analyse.plant_scale import EvenPlant, below_nyquist, even_plant
from ultraquiet.analyse.singular import singular_values
from ultraquiet.design.gain_search import from_plant
from ultraquiet.design.hinf import coprime_stabilisation as coprime
from ultraquiet.design.result import DesignResult, refused
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.stabilisability import lost_integrators, lost_modes
from ultraquiet.design.verification import judged
from ultraquiet.design.weights import shaped_loop
from ultraquiet.design.weights.filters import band_pass, high_pass, low_pass, peak, rational
from ultraquiet.design.weights.weight import Weight, weight
from ultraquiet.linalg.balance import modal
from ultraquiet.linalg.discretize import bilinear_to_continuous, bilinear_to_discrete
from ultraquiet.linalg.even import evened
from ultraquiet.values.door import takes_systems
from ultraquiet.values.generalised import four_block
from ultraquiet.values.interconnect import append, gain, lft, series
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

WHO = "LoopShaping"
AGREEMENT = 1e-3  # the achieved norm may pass the level designed for by this share
WEAKEST = 1e-3  # directions weaker than this share of the strongest are not raised when the plant is aligned
FALL = 0.1  # what the numbers' weight falls to beyond the roll-off, where it has one slope
# What each of these numbers is where only others are given; with none, the plant is the measure.
ABSOLUTE = {"height": 4.0, "floor": 0.05}
FURTHER = 5.0  # times the band's upper corner: where the loop is to end when nobody says it


@register("design", "loop-shaping")
@dataclass(frozen=True)
class LoopShaping(StatedRobustness):
    """The controller that keeps a drawn loop shape and stands the largest coprime-factor uncertainty.

    Gs = W2 G W1 = M^-1 N, M M* + N N* = I. Ks minimises ||[I; K] (I - Gs K)^-1 M^-1||, whose smallest value is
    gamma_min = sqrt(1 + rho(X Z)) in closed form; K = W1 Ks W2.

    By default the plant is the measure: its channels are evened out over the band (`even_plant`), and the height is
    halved from 32 until the loop keeps `disk_margin` at both ends. Who gives W1, W2, a height, a floor or a roll-off
    gets exactly that, in the plant's own units, the others as stated below.

    Args:
        pre: W1 at the plant's inputs, `(1, 1)`, `(nu, nu)` or numbers (see `weight`); integrators are welcome. Absent,
            it is made from the numbers below.
        post: W2 at the plant's outputs, `(1, 1)`, `(ny, ny)` or numbers; one when absent.
        band_hz: corners of the band where the loop is to be high, Hz; the plant's own band when absent.
        height: geometric mean of the loop's gains over the band and all directions; 4 where only others are given.
        align: whether W1 starts with the real matrix that makes the plant nearest to one at the band's centre, so that
            the loop is as high in its weak directions as in its strong ones; square plants only. By default it is
            left away where it costs the margin.
        floor: share of it that is left far outside the band, 0.05 likewise.
        order: states of the band-pass per channel, even.
        integral_hz: below this frequency the loop rises like an integrator, Hz; none when absent.
        roll_off_hz: beyond this frequency the loop falls by 20 dB per decade more, Hz; five times the band's upper
            corner when absent, 0.4 of the rate at most.
        tones_hz: frequencies at which the loop has peaks besides, Hz.
        tone_height: extra gain at each tone.
        tone_zeta: half the relative width of the peaks.
        margin: the controller is formed at margin times gamma_min. One gives the optimal controller, which has fewer
            states and very fast modes.

    >>> lag = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> result = LoopShaping(pre=1.0).design(lag)
    >>> round(result.details["gamma_min"], 4)
    1.0824

    A margin epsilon = 1 / gamma above 0.25 means that the drawn shape survives: the loop Gs Ks then stays within a
    factor of gamma of Gs wherever Gs is high or low, and the plant may be off by that share in gap metric.

    McFarlane and Glover 1992, doi:10.1109/9.256330; Skogestad and Postlethwaite 2005, section 9.4.
    """

    pre: Weight | None = None
    post: Weight | None = None
    band_hz: tuple[float, float] | None = None
    height: float | None = None
    floor: float | None = None
    align: bool = True
    order: int = 4
    integral_hz: float | None = None
    roll_off_hz: float | None = None
    tones_hz: tuple[float, ...] = ()
    tone_height: float = 100.0
    tone_zeta: float = 0.002
    margin: float = 1.1

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("height", "floor", "roll_off_hz", "tone_height", "tone_zeta"):
            if getattr(self, name) is not None:
                positive(WHO, name, getattr(self, name))
        if not positive(WHO, "margin", self.margin) >= 1:
            raise InputError(f"{WHO}: 'margin' must be at least one, got {self.margin!r}.")

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the controller u = K y of a plant, continuous or discrete, stable or not.

        `gamma` is the norm with the coprime factor M, `achieved` that of [I; Ks] (I - Gs Ks)^-1 [I, Gs], which is the
        same number by another way. `details` holds `gamma_min` and `gamma_min_mapped`, the same through the bilinear
        map; `epsilon`, the stability margin reached; `f_hz`, `wanted` and `loop`, the singular values of Gs and Gs Ks
        over frequency; `weights`; `loop_weights`, what the norm leaves to S, T and KS (`weights.shaped_loop`);
        `shaped`, Gs; `factor`, M^-1; `stabiliser`, Ks; `observer`, its gains F and H. By default it says besides which
        band, units and height the plant gave (`from_plant`).
        """
        # asked before: whether the integrator that is lost lands inside the circle is up to rounding
        integrating = self.integral_hz is not None and self.pre is None
        sentence = lost_modes(WHO, plant)
        if not sentence and integrating:
            sentence = lost_integrators(WHO, plant, "input", "leave 'integral_hz' away")
        return refused(sentence) if sentence else self._designed(plant)

    def _designed(self, plant: StateSpace) -> DesignResult:
        if self._measured_by_the_plant():
            aligned = from_plant(plant, self, self._attempt, self.band_hz)
            if aligned.status.ok or not self.align or plant.D.shape[0] != plant.D.shape[1]:
                return aligned
            # a direction that the plant hardly has is not raised robustly; as it is, it does no harm
            plain = replace(self, align=False)
            other = from_plant(plant, plain, plain._attempt, self.band_hz)
            return other if other.status.ok else aligned
        found = self._found(plant)
        law = found.controller
        if law is None:
            return found
        return judged(plant, law, self, found.gamma, found.achieved, found.residuals, found.details)

    def _measured_by_the_plant(self) -> bool:
        given = (self.pre, self.post, self.roll_off_hz, *(getattr(self, name) for name in ABSOLUTE))
        return all(setting is None for setting in given)

    def _attempt(self, even: EvenPlant, g: float) -> DesignResult:
        """Return what is found for the even plant at the height g, its weights as those of the plant."""
        found = replace(self, band_hz=even.band_hz, height=g)._found(even.plant, even.from_rest)
        if found.controller is None:
            return found
        rate, weights = even.plant.rate_hz, found.details["weights"]
        units = {
            "pre": series(weights["pre"], gain(np.diag(even.inputs), rate)),
            "post": series(gain(np.diag(even.outputs), rate), weights["post"]),
        }
        bounds = shaped_loop.on_loop(units["pre"], units["post"], found.details["factor"])
        return replace(found, details={**found.details, "weights": units, "loop_weights": bounds})

    def _found(self, plant: StateSpace, from_rest: bool = False) -> DesignResult:
        """Return the controller and what the equations say of it, its loop not yet judged, or a refusal."""
        weights = self._weights(plant, from_rest)
        shaped = _even(series(series(weights["pre"], plant), weights["post"]))
        M = (shaped.A, shaped.B, shaped.C, shaped.D)
        try:
            stabiliser = self._stabilised(M, shaped.rate_hz is not None)
            law = StateSpace(*stabiliser.controller, rate_hz=shaped.rate_hz)
            gamma = hinf_norm(lft(_coprime(shaped, stabiliser), law))[0]
            achieved = hinf_norm(lft(_gang(shaped), law))[0]
        except (NumericalError, LinAlgError) as error:
            return refused(
                f"{WHO}: the shaped plant W2 G W1 ({counted(shaped.states, 'state')}) cannot be stabilised: {error}"
            )
        level, factor = self.margin * stabiliser.gamma_min, _factor(shaped, stabiliser)
        if not achieved <= level * (1 + AGREEMENT):
            return refused(
                f"{WHO}: the loop reaches {achieved:.6g} where {level:.6g} was designed for; scale the plant."
                if np.isfinite(achieved)
                else f"{WHO}: the shaped plant W2 G W1 ({counted(shaped.states, 'state')}) is not stabilised by what "
                "its equations give; some of its slow or undamped modes hardly answer or hardly show."
            )
        details = {
            "gamma_min": stabiliser.gamma_min,
            "gamma_min_mapped": _mapped(M, shaped.rate_hz is not None),
            "level": level,
            "epsilon": 1 / achieved,
            "weights": weights,
            "loop_weights": shaped_loop.on_loop(weights["pre"], weights["post"], factor),
            "factor": factor,
            "shaped": shaped,
            "stabiliser": law,
            "observer": {"F": stabiliser.feedback, "H": stabiliser.injection},
            "conditions": stabiliser.conditions,
            **_shapes(shaped, law),
        }
        residuals = {"X": stabiliser.residuals[0], "Z": stabiliser.residuals[1]}
        K = series(series(weights["post"], law), weights["pre"])
        status = Status(StatusWord.OK, f"The shaped loop stands a coprime-factor error of {1 / achieved:.3g}.")
        return DesignResult(status, K, gamma, achieved, residuals=residuals, details=details)

    def weights(self, plant: StateSpace) -> dict[str, StateSpace]:
        """Return W1 as `pre` and W2 as `post`, in full size at the plant's rate."""
        return self._weights(plant, False)

    def _weights(self, plant: StateSpace, from_rest: bool) -> dict[str, StateSpace]:
        """Return the weights; `from_rest` tells that `band_hz` is a band of a plant loud from rest on."""
        ny, nu = plant.D.shape
        post = weight(WHO, "post", 1.0 if self.post is None else self.post, ny, plant.rate_hz, integrators=True)
        if self.pre is not None:
            return {"pre": weight(WHO, "pre", self.pre, nu, plant.rate_hz, integrators=True), "post": post}
        seen = series(plant, post)
        band_hz = self.band_hz
        if band_hz is None:
            even = even_plant(plant)
            band_hz, from_rest = even.band_hz, even.from_rest
        square = seen.D.shape == (nu, nu)
        mix = gain(_aligning(seen, float(np.sqrt(np.prod(band_hz)))) if self.align and square else np.eye(nu))
        mix = StateSpace(mix.A, mix.B, mix.C, mix.D, plant.rate_hz)
        shape = self._shape(series(mix, seen), band_hz, from_rest)
        return {"pre": series(append(*[shape] * nu), mix), "post": post}

    def _number(self, name: str) -> float:
        """Return a number as given, or what it is where only others are."""
        given: float | None = getattr(self, name)
        return ABSOLUTE[name] if given is None else given

    def _shape(self, plant: StateSpace, band_hz: tuple[float, float], from_rest: bool) -> StateSpace:
        """Return the weight of one channel that the numbers describe, scaled to the height asked for.

        A band from rest on has no lower edge: one at the lowest frequency that was looked at would put poles there, as
        many alike as there are channels and a million times slower than all others, which rounding makes unstable.
        """
        rate, floor = plant.rate_hz, self._number("floor")
        if from_rest:
            shape = low_pass(band_hz[1], 1.0, floor, max(self.order // 2, 1), rate)
        else:
            shape = band_pass(band_hz, 1.0, floor, self.order, rate)
        end = below_nyquist(self.roll_off_hz or FURTHER * band_hz[1], rate)
        shape = series(shape, high_pass(end, 1.0, FALL, 1, rate))
        if self.integral_hz is not None:
            w = 2 * np.pi * positive(WHO, "integral_hz", self.integral_hz, "Hz")
            shape = series(shape, rational(1.0, (-w,), (0.0,), rate, 1))
        f = np.geomspace(*band_hz, 100)
        sizes = singular_values(plant, f) * np.abs(shape.frequency_response(f)[0, 0])
        sizes = sizes[:, np.isfinite(sizes[0])]  # a line may stand on an undamped mode
        if not np.all(sizes[0] > 0):
            raise InputError(
                f"{WHO}: the plant has no gain over 'band_hz', {band_hz[0]:.4g}-{band_hz[1]:.4g} Hz; no loop can be "
                "shaped there."
            )
        # directions that the plant cannot move at all are left out of the mean
        mean = float(np.exp(np.mean(np.log(sizes[sizes > 1e-6 * sizes[0]]))))
        for tone_hz in self.tones_hz:
            shape = series(shape, peak(tone_hz, self.tone_height, self.tone_zeta, rate))
        return series(shape, gain([[self._number("height") / mean]], rate))

    def _stabilised(self, M: coprime.Matrices, discrete: bool) -> coprime.Stabiliser:
        if not discrete:
            return coprime.continuous(M, self.margin)
        if self.margin - 1 >= coprime.OPTIMAL:
            return coprime.discrete(M, self.margin)
        # the discrete formulas are singular at the optimum, those beyond the bilinear map are not
        mapped = coprime.continuous(bilinear_to_continuous(*M), 1.0)
        _, _, Z, _ = coprime.smallest_level(M, discrete=True)
        direct = coprime.discrete(M, 2.0)
        return mapped._replace(
            controller=bilinear_to_discrete(*mapped.controller),
            Z=Z,
            injection=direct.injection,
            innovation=direct.innovation,
        )


def _aligning(plant: StateSpace, f_hz: float) -> FloatArray:
    """Return the real matrix X that brings G(f) X nearest to one, up to a phase that all channels share."""
    G = plant.frequency_response([f_hz])[:, :, 0]
    turned = np.exp(-0.5j * np.angle(np.sum(G**2))) * G  # the phase at which G is most nearly real
    return np.linalg.pinv(turned.real, rcond=WEAKEST)


def _even(system: StateSpace) -> StateSpace:
    """Return a system in modal coordinates, whose states all weigh alike, in blocks of repeated poles too."""
    form = modal(system.A, system.B, system.C)
    return StateSpace(*evened(form.A, form.B, form.C), system.D, rate_hz=system.rate_hz)


def _mapped(M: coprime.Matrices, discrete: bool) -> float:
    """Return gamma_min of the system on the other side of the bilinear map, nan when a pole cannot be mapped."""
    try:
        if discrete:
            return coprime.smallest_level(bilinear_to_continuous(*M), discrete=False)[0]
        # s = 1 is moved to the speed of the plant, where the map bends least
        A, B, C, D = M
        speed = max(float(np.abs(np.linalg.eigvals(A)).mean()), 1e-300) if A.size else 1.0
        root = np.sqrt(speed)
        return coprime.smallest_level(bilinear_to_discrete(A / speed, B / root, C / root, D), discrete=True)[0]
    except (NumericalError, LinAlgError):
        return float("nan")


def _gang(shaped: StateSpace) -> StateSpace:
    """Return the system from (d, n, u) to (y, u, y), whose loop is [I; K] (I - G K)^-1 [G, I]."""
    ny, nu = shaped.D.shape
    one = [gain(np.eye(n), shaped.rate_hz) for n in (ny, nu)]
    return four_block(shaped, *one, disturbance=np.eye(nu), noise=np.eye(ny))


def _coprime(shaped: StateSpace, stabiliser: coprime.Stabiliser) -> StateSpace:
    """Return the system from (w, u) to (y, u, y) with y = M^-1 w + G u, M from the filter equation."""
    ny, nu = shaped.D.shape
    C = np.vstack([shaped.C, np.zeros((nu, shaped.states)), shaped.C])
    seen = np.hstack([stabiliser.innovation, shaped.D])
    D = np.vstack([seen, np.hstack([np.zeros((nu, ny)), np.eye(nu)]), seen])
    B = np.hstack([-stabiliser.injection @ stabiliser.innovation, shaped.B])
    return StateSpace(shaped.A, B, C, D, shaped.rate_hz)


def _factor(shaped: StateSpace, stabiliser: coprime.Stabiliser) -> StateSpace:
    """Return M^-1 of Gs = M^-1 N, from the filter equation."""
    B, D = -stabiliser.injection @ stabiliser.innovation, stabiliser.innovation
    return StateSpace(shaped.A, B, shaped.C, D, shaped.rate_hz)


def _shapes(shaped: StateSpace, law: StateSpace) -> dict[str, FloatArray]:
    f: Any = default_grid(shaped)
    f = f[f > 0]
    return {"f_hz": f, "wanted": singular_values(shaped, f), "loop": singular_values(series(law, shaped), f)}
