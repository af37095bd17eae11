"""Linear-quadratic-Gaussian control in discrete time, with frequency-shaped cost and loop transfer recovery."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, one_of, positive
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.norms import h2_norm
from ultraquiet.design._abstract import DesignResult, refused
from ultraquiet.design._verify import judged
from ultraquiet.design.h2_kernel import Problem, Solution, solve
from ultraquiet.design.ltr import recovery_error
from ultraquiet.design.weights import band_pass
from ultraquiet.values.interconnect import append, gain, lft, series
from ultraquiet.values.state_space import StateSpace

RECOVERY_POINTS = 200


@register("design", "lqg")
@dataclass(frozen=True)
class Lqg:
    """The controller of least mean square weighted output and control, for white disturbance and sensor noise.

    min E[|W y|^2 + rho |u|^2] with x+ = A x + B (u + w), y = C x + D (u + w) + v.

    Args:
        control_weight: rho, squared output units per squared volt.
        disturbance: variance of w per input (volts squared) when it enters at the plant's input, of the output
            disturbance (output units squared) when `disturbance_at` is `output`.
        disturbance_at: `output` or `input`. White noise at the input, as in the paper's section 4.2, is mostly noise at
            the plant's resonances, and that is where the controller then works; at the output, all frequencies of the
            band count alike.
        sensor_noise: variance of v per output. The paper calls 0.01 a covariance; it is the mean standard deviation of
            its sensors, so their variance would be 1e-4.
        band_hz: corner frequencies of the band-pass W; None weights all frequencies alike.
        band_order: order of W, even.
        floor: gain of W outside the band, one inside it.
        recovery: LTR: factor on the disturbance (recovery at the input) or on 1 / control_weight (at the output).
        recovery_at: `input` or `output`.
        estimator: `current` uses y[k] for u[k], `predicted` only what came before (D of the controller is zero).

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> result = Lqg(control_weight=0.01, band_hz=None).design(plant)
    >>> result.status.ok, abs(result.gamma / result.achieved - 1) < 1e-6
    (True, True)

    Kwakernaak and Sivan 1972; recovery: Maciejowski 1985, doi:10.1109/TAC.1985.1103975.
    """

    control_weight: float = 1e-8
    disturbance: float = 1.0
    disturbance_at: str = "output"
    sensor_noise: float = 0.01
    band_hz: tuple[float, float] | None = (9.0, 108.0)
    band_order: int = 8
    floor: float = 0.06
    recovery: float = 1.0
    recovery_at: str = "input"
    estimator: str = "current"

    def __post_init__(self) -> None:
        for name in ("control_weight", "disturbance", "sensor_noise", "recovery"):
            positive("Lqg", name, getattr(self, name))
        for name in ("disturbance_at", "recovery_at"):
            one_of("Lqg", name, getattr(self, name), ("input", "output"))
        if self.recovery != 1.0 and self.recovery_at == "input" and self.disturbance_at == "output":
            raise InputError("Lqg: recovery at the input needs 'disturbance_at' to be 'input', got 'output'.")
        one_of("Lqg", "estimator", self.estimator, ("current", "predicted"))
        between("Lqg", "floor", self.floor, 0.0, 1.0)

    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the controller u = K y of a discrete plant.

        `gamma` is the standard deviation of the weighted cost that the two Riccati equations promise, `achieved` the H2
        norm of the finished loop; `details["recovery"]` holds sigma(L - L_target) over frequency, `details["weights"]`
        the weights of one channel.

        Raises:
            InputError: the plant is in continuous time.
        """
        if plant.rate_hz is None:
            raise InputError("Lqg: the plant is in continuous time; discretise it first.")
        P = self.generalised(plant)
        ny, nu = plant.D.shape
        try:
            found = solve(Problem.of(P, ny, nu), discrete=True)
        except NumericalError as error:
            return refused(f"Lqg: {error}")
        K = StateSpace(*found.controller(current=self.estimator == "current"), rate_hz=plant.rate_hz)
        achieved = h2_norm(lft(P, K))
        promised = found.cost() if self.estimator == "current" else achieved
        details = {"recovery": self._recovery(plant, P, K, found), "weights": self.weights(plant)}
        return judged(plant, K, self, promised, achieved, found.residuals, details)

    def generalised(self, plant: StateSpace) -> StateSpace:
        """Return the system from (w, v, u) to (W y, sqrt(rho) u, y), all noises of unit variance."""
        ny, nu = plant.D.shape
        boost = self.recovery if self.recovery_at == "input" else 1.0
        rho = self.control_weight / (self.recovery if self.recovery_at == "output" else 1.0)
        v = np.sqrt(self.sensor_noise) * np.eye(ny)
        if self.disturbance_at == "input":
            Bw, Dw = plant.B * np.sqrt(self.disturbance * boost), plant.D * np.sqrt(self.disturbance * boost)
        else:
            Bw, Dw = np.zeros((plant.states, ny)), np.sqrt(self.disturbance * boost) * np.eye(ny)
        m = Bw.shape[1]
        open_loop = StateSpace(
            plant.A,
            np.hstack([Bw, np.zeros((plant.states, ny)), plant.B]),
            np.vstack([plant.C, np.zeros((nu, plant.states)), plant.C]),
            np.block(
                [
                    [Dw, np.zeros((ny, ny)), plant.D],
                    [np.zeros((nu, m + ny)), np.sqrt(rho) * np.eye(nu)],
                    [Dw, v, plant.D],
                ]
            ),
            plant.rate_hz,
        )
        W = append(*[self.weights(plant)["performance"]] * ny)
        return series(open_loop, append(W, gain(np.eye(nu + ny), plant.rate_hz)))

    def weights(self, plant: StateSpace) -> dict[str, StateSpace]:
        """Return the weights of one channel: `performance` W and `control` sqrt(rho)."""
        rate = plant.rate_hz
        one = gain(np.eye(1), rate)
        W = one if self.band_hz is None else band_pass(self.band_hz, 1.0, self.floor, self.band_order, rate)
        return {"performance": W, "control": gain(np.sqrt([[self.control_weight]]), rate)}

    def _recovery(
        self, plant: StateSpace, P: StateSpace, K: StateSpace, found: Solution
    ) -> dict[str, FloatArray | str]:
        assert plant.rate_hz is not None
        f = np.geomspace(plant.rate_hz / 5000, plant.rate_hz / 2, RECOVERY_POINTS)
        ny, nu = plant.D.shape
        if self.recovery_at == "input":
            target = StateSpace(P.A, P.B[:, -nu:], -found.F, np.zeros((nu, nu)), P.rate_hz)
            error = recovery_error(series(plant, K), target, f)
        else:
            target = StateSpace(P.A, found.L, -P.C[-ny:], np.zeros((ny, ny)), P.rate_hz)
            error = recovery_error(series(K, plant), target, f)
        return {"at": self.recovery_at, "f_hz": f, "error": error[0], "relative_error": error[1]}
