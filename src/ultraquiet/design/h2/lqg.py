"""Linear-quadratic-Gaussian control in discrete time, with frequency-shaped cost and loop transfer recovery."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, frozen, one_of, positive, real_array
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.norms import h2_norm
from ultraquiet.analyse.plant_scale import EvenPlant, below_nyquist
from ultraquiet.design.gain_search import from_plant
from ultraquiet.design.h2.loop_transfer_recovery import recovery
from ultraquiet.design.h2.lqg_problem import (
    LqgParts,
    generalised,
    integrator,
    regular_noise,
    shaped,
)
from ultraquiet.design.h2.riccati import H2Problem, Solution, solve
from ultraquiet.design.h2.synthesis import AGREEMENT
from ultraquiet.design.h2.usual_numbers import UsualVariances
from ultraquiet.design.result import DesignResult, refused
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.stabilisability import BORDER, lost_integrators, lost_modes, stable_weight
from ultraquiet.design.verification import judged
from ultraquiet.design.weights.filters import band_pass, high_pass
from ultraquiet.linalg import balance
from ultraquiet.linalg.norms import peak_gain
from ultraquiet.values.door import system, takes_systems
from ultraquiet.values.generalised import full
from ultraquiet.values.interconnect import append, feedback, gain, lft, series
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

CHEAP = 1e-6  # weight on u against the gain from u to the cost, below which half of the digits are gone
# Where one of these is given, the others are what is usual for the plant; with none, it is the measure.
NUMBERS = ("control_weight", "disturbance", "sensor_noise")
LEAK = "set 'integral_leak_hz' above 0 Hz"
RISE = 10.0  # in gain, of the weight on u above `control_hz`


@register("design", "lqg")
@dataclass(frozen=True, eq=False)
class Lqg(StatedRobustness):
    """The controller of least mean square weighted output and control, for disturbance and sensor noise of any colour.

    min E[|W y|^2 + |Wu u|^2] with x+ = A x + B (u + d), y = C x + D (u + d) + v.

    By default all is measured by the plant itself: its channels are evened out over its own band (`even_plant`), the
    disturbance is white at its inputs, and noise and control weigh 1 / g^2 each, g halved from 32 until the loop keeps
    `disk_margin` at both ends. Who gives one of `control_weight`, `disturbance`, `sensor_noise`, a weight or a model
    gets exactly what these numbers ask for, in the plant's own units; the others are what is usual for this plant
    (`UsualVariances`).

    Args:
        control_weight: rho = Wu^2, squared output units per squared input unit; 1e-7 of the square of the plant's
            typical gain over the band where only others are given.
        control_hz: corner from which on Wu rises, tenfold at most; None for a constant.
        disturbance: variance of d per input (in its unit squared) when it enters at the plant's input, of the output
            disturbance (output units squared) when `disturbance_at` is `output`; likewise, a hundred times the sensor
            noise at the outputs, or one.
        disturbance_at: `output` or `input`; absent, at the input by default and at the output where numbers are given
            for a plant without poles on or beyond the stability boundary, whose state nothing at the output moves.
            White noise at the input, as in the paper's section 4.2, is mostly noise at the plant's resonances, and that
            is where the controller then works; at the output, all frequencies of the band count alike.
        sensor_noise: variance of v per output; likewise, 0.01 of the disturbance at the outputs. The paper calls 0.01 a
            covariance; it is the mean standard deviation of its sensors, so their variance would be 1e-4.
        band_hz: corner frequencies of the band-pass W; None weights all frequencies alike.
        band_order: order of W, even.
        floor: gain of W outside the band, one inside it.
        band_at: `cost`, or `loop`: W becomes a part of the controller, whose gain then follows its shape.
        integral_hz: corner below which every measurement is integrated, inside the controller; None for no integrator.
        integral_leak_hz: where the rise towards low frequency ends; 0 is a pure integrator, pole at z = 1.
        recovery: LTR: at the input, white noise of `recovery - 1` times `disturbance` is added there; at the output,
            `recovery - 1` times |y|^2 is added to the cost. Large factors recover the target loop of minimum-phase
            plants without delay.
        recovery_at: `input` or `output`.
        estimator: `current` uses y[k] for u[k], `predicted` only what came before (D of the controller is zero).
        output_weight: W as a system, `(1, 1)` or `(ny, ny)`, in place of the band.
        input_weight: Wu as a system, `(1, 1)` or `(nu, nu)`, in place of `control_weight` and `control_hz`.
        disturbance_model: in place of `disturbance`, a covariance matrix or a filter that shapes white noise of unit
            variance, with as many outputs as the place of the disturbance has channels.
        noise_model: likewise for v, in place of `sensor_noise`.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> result = Lqg(control_weight=0.01, band_hz=None).design(plant)
    >>> result.status.ok, abs(result.gamma / result.achieved - 1) < 1e-6
    (True, True)
    >>> Lqg().design(plant).details["attenuation_rms_db"] > 10
    True

    Kwakernaak and Sivan 1972; recovery: Maciejowski 1985, doi:10.1109/TAC.1985.1103975.
    """

    control_weight: float | None = None
    disturbance: float | None = None
    disturbance_at: str | None = None
    sensor_noise: float | None = None
    band_hz: tuple[float, float] | None = None
    band_order: int = 8
    floor: float = 0.06
    recovery: float = 1.0
    recovery_at: str = "input"
    estimator: str = "current"
    control_hz: float | None = None
    band_at: str = "cost"
    integral_hz: float | None = None
    integral_leak_hz: float = 0.0
    output_weight: StateSpace | None = None
    input_weight: StateSpace | None = None
    disturbance_model: StateSpace | FloatArray | None = None
    noise_model: StateSpace | FloatArray | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in (*NUMBERS, "control_hz"):
            if getattr(self, name) is not None:
                positive("Lqg", name, getattr(self, name))
        for name in ("output_weight", "input_weight"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, system("Lqg", name, getattr(self, name)))
        between("Lqg", "recovery", self.recovery, 1.0, np.finfo(float).max)
        one_of("Lqg", "recovery_at", self.recovery_at, ("input", "output"))
        if self.disturbance_at is not None:
            one_of("Lqg", "disturbance_at", self.disturbance_at, ("input", "output"))
        one_of("Lqg", "estimator", self.estimator, ("current", "predicted"))
        one_of("Lqg", "band_at", self.band_at, ("cost", "loop"))
        between("Lqg", "floor", self.floor, 0.0, 1.0)
        for name in ("disturbance_model", "noise_model"):
            model: Any = getattr(self, name)
            if model is not None and not isinstance(model, StateSpace):
                object.__setattr__(self, name, frozen(real_array("Lqg", name, model, 2)))

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the controller u = K y of a discrete plant.

        `gamma` is the standard deviation of the weighted cost that the two Riccati equations promise, `achieved` the H2
        norm of the finished loop, both with what recovery adds; `details["recovery"]` holds
        sigma(L - L_target) over frequency, `details["weights"]` the weights, of one channel where numbers are given.
        By default the two are in the even plant's units, and `details` says which these are (`from_plant`).

        Raises:
            InputError: the plant is in continuous time; a weight or a noise model does not fit it, or is not stable.
        """
        if plant.rate_hz is None:
            raise InputError("Lqg: the plant is in continuous time; discretise it first.")
        sentence = lost_modes("Lqg", plant)
        if sentence:
            return refused(sentence)
        if self._measured_by_the_plant():
            return from_plant(plant, self, self._attempt, self.band_hz)
        found = self.settled(plant)._found(plant)
        if found.controller is None:
            return found
        law, details = found.controller, found.details
        return judged(plant, law, self, found.gamma, found.achieved, found.residuals, details)

    def _measured_by_the_plant(self) -> bool:
        models = (self.output_weight, self.input_weight, self.disturbance_model, self.noise_model)
        return all(getattr(self, name) is None for name in NUMBERS) and all(model is None for model in models)

    def settled(self, plant: StateSpace) -> "Lqg":
        """Return the same with what is left out as it is usual for a plant, itself where that is the measure."""
        if self._measured_by_the_plant():
            return self
        settled = self if self.disturbance_at else replace(self, disturbance_at=_place(plant))
        weighted, noisy = self.input_weight is not None, self.noise_model is not None
        moved = self.disturbance_model is not None and self.recovery == 1.0
        left_out = ((self.control_weight, weighted), (self.sensor_noise, noisy), (self.disturbance, moved))
        if all(number is not None or modelled for number, modelled in left_out):
            return settled
        usual = UsualVariances.of(plant, self.band_hz, settled.disturbance_at == "input")
        variance, noise = usual.both(self.disturbance, self.sensor_noise)
        weight = usual.control_weight if self.control_weight is None else self.control_weight
        return replace(settled, control_weight=weight, disturbance=variance, sensor_noise=noise)

    def _attempt(self, even: EvenPlant, g: float) -> DesignResult:
        """Return what is found for the even plant when noise and control weigh 1 / g^2."""
        at = self.disturbance_at or "input"
        numbers = replace(self, control_weight=g**-2, sensor_noise=g**-2, disturbance=1.0, disturbance_at=at)
        found = numbers._found(even.plant)
        ny, nu = even.plant.D.shape
        W = numbers.weights(even.plant)
        weights = even.weights(append(*[W["performance"]] * ny), append(*[W["control"]] * nu))
        return replace(found, details={**found.details, "weights": weights})

    def _found(self, plant: StateSpace) -> DesignResult:
        """Return the controller and what the equations say of it, its loop not yet judged, or a refusal."""
        parts = self.parts(plant)
        integrating = parts.loop is not None and not parts.loop.is_stable()
        sentence = lost_modes("Lqg", plant) or (lost_integrators("Lqg", plant, "output", LEAK) if integrating else "")
        if sentence:
            return refused(sentence)
        even, sentence = plant, ""
        # modal coordinates first: the units in which a plant comes may differ by many decades; then its own, which a
        # transformation of poor condition would spoil
        form = balance.modal(plant.A, plant.B, plant.C)
        true = generalised(plant, parts)
        ny, nu = plant.D.shape
        for even in (StateSpace(form.A, form.B, form.C, plant.D, plant.rate_hz), plant):
            P = true if even is plant else generalised(even, parts)
            solved = self._solved(P, true, ny, nu)
            if not isinstance(solved, str):
                break
            sentence = sentence or f"Lqg: {solved}{_advice(P, ny, nu)}"
        else:
            return refused(sentence)
        solution, core, promised, achieved = solved
        K = core if parts.loop is None else series(parts.loop, core)
        try:
            firm = feedback(K, plant).is_stable()
        except InputError as error:
            return refused(f"Lqg: {error}{_advice(P, ny, nu)}")
        if not firm:
            said = "the loop hangs on rounding errors: no digit tells on which side of the stability boundary it is."
            return refused(f"Lqg: {said}{_advice(P, ny, nu)}")
        recovered = recovery(self.recovery_at, even, parts.loop, core, P, solution)
        details = {"recovery": recovered, "weights": self.weights(plant)}
        status = Status(StatusWord.OK, f"The equations promise a cost of {promised:.6g}, and the loop has it.")
        return DesignResult(status, K, promised, achieved, residuals=solution.residuals, details=details)

    def _solved(
        self, P: StateSpace, true: StateSpace, ny: int, nu: int
    ) -> tuple[Solution, StateSpace, float, float] | str:
        """Return gains, controller, promised and achieved cost, or what is wrong.

        The equations are solved for P; what is achieved is measured on `true`, the same system as it was given.
        """
        try:
            solution = solve(H2Problem.of(P, ny, nu), discrete=True)
            core = StateSpace(*solution.controller(current=self.estimator == "current"), rate_hz=P.rate_hz)
            achieved = h2_norm(lft(true, core))
            promised = solution.cost() if self.estimator == "current" else h2_norm(lft(P, core))
        except (NumericalError, InputError) as error:
            return str(error)
        if not abs(promised - achieved) <= AGREEMENT * achieved:
            return f"the equations promise a cost of {promised:.6g}, the loop has {achieved:.6g}."
        return solution, core, promised, achieved

    def generalised(self, plant: StateSpace) -> StateSpace:
        """Return the system from (d, probe, v, u) to (W y, Wu u, y), all noises of unit variance.

        With integral action or a band in the loop, y is what that filter makes of the measurement.
        """
        return generalised(plant, self.parts(plant))

    def parts(self, plant: StateSpace) -> LqgParts:
        """Return all that stands around a discrete plant: noise models, weights, the filter in the loop."""
        ny, nu = plant.D.shape
        assert plant.rate_hz is not None
        settled = self.settled(plant)
        weights = settled.weights(plant)
        at_input = settled.disturbance_at == "input"
        variance = settled.disturbance or 1.0  # where none is asked for, nothing moves by it
        setting = variance if self.disturbance_model is None else self.disturbance_model
        disturbance = shaped("Lqg", "disturbance_model", setting, nu if at_input else ny, plant.rate_hz)
        setting = (settled.sensor_noise or 1.0) if self.noise_model is None else self.noise_model
        noise = shaped("Lqg", "noise_model", setting, ny, plant.rate_hz)
        output = stable_weight("Lqg", "output_weight", full(weights["performance"], ny, "output_weight"), plant)
        control = stable_weight("Lqg", "input_weight", full(weights["control"], nu, "input_weight"), plant)
        more, probe = self.recovery - 1, gain(np.zeros((nu, 0)), plant.rate_hz)
        if more and self.recovery_at == "input":
            probe = gain(np.sqrt(more * variance) * np.eye(nu), plant.rate_hz)
        elif more:
            # the dual of noise at the input: cost on the output itself, whatever the weight's shape
            both = gain(np.vstack([np.eye(ny), np.sqrt(more) * np.eye(ny)]), plant.rate_hz)
            output = series(both, append(output, gain(np.eye(ny), plant.rate_hz)))
        disturbance = stable_weight("Lqg", "disturbance_model", disturbance, plant)
        noise = regular_noise("Lqg", "noise_model", stable_weight("Lqg", "noise_model", noise, plant))
        return LqgParts(disturbance, at_input, probe, noise, self._loop(ny, plant.rate_hz), output, control)

    def weights(self, plant: StateSpace) -> dict[str, StateSpace]:
        """Return the weights: `performance` W and `control` Wu, of one channel unless given for all of them."""
        rate = plant.rate_hz
        one = gain(np.eye(1), rate)
        size = float(np.sqrt(self.settled(plant).control_weight or 1.0))
        W = one if self.band_hz is None or self.band_at == "loop" else self._band(rate)
        U = gain([[size]], rate)
        if self.control_hz is not None:
            U = high_pass(below_nyquist(self.control_hz, rate), size, RISE * size, 1, rate)
        return {"performance": self.output_weight or W, "control": self.input_weight or U}

    def _loop(self, channels: int, rate_hz: float) -> StateSpace | None:
        """Return the filter that the controller carries on each measurement, None when there is none."""
        chain = []
        if self.band_hz is not None and self.band_at == "loop":
            chain.append(self._band(rate_hz))
        if self.integral_hz is not None:
            chain.append(integrator("Lqg", self.integral_hz, self.integral_leak_hz, rate_hz))
        if not chain:
            return None
        one = chain[0] if len(chain) == 1 else series(*chain)
        return append(*[one] * channels)

    def _band(self, rate_hz: float | None) -> StateSpace:
        assert self.band_hz is not None
        return band_pass(self.band_hz, 1.0, self.floor, self.band_order, rate_hz)


def _place(plant: StateSpace) -> str:
    """Return where the disturbance enters where nobody says it.

    White noise at the output leaves an integrator or an undamped mode at rest: no filter of finite gain then exists.
    """
    return "output" if np.abs(plant.poles()).max(initial=0.0) < 1 - BORDER else "input"


def _advice(P: StateSpace, ny: int, nu: int) -> str:
    """Return what to do when control costs next to nothing against what it moves: the usual cause of lost digits."""
    B, C, D = P.B[:, -nu:], P.C[:-ny], P.D[:-ny, -nu:]
    cost = np.linalg.svd(D, compute_uv=False)[-1]
    moved, _ = peak_gain(P.A, B, C, D, discrete=True)
    if cost > CHEAP * moved or not np.isfinite(moved):
        return ""
    return f" The weight on u, {cost:.1e}, is small against what u moves, {moved:.1e}; raise 'control_weight'."
