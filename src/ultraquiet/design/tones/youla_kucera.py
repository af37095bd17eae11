"""Adaptive regulation in the Youla-Kucera form: a stabilising law stays, a stable Q on its innovations adapts."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, one_of, positive, whole
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet._base.registry import formerly, register
from ultraquiet._base.threads import single_threaded
from ultraquiet.design.result import STABLE_WORDS, DesignResult, refused
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.tones.adaptive_law import (
    AdaptiveLaw,
    adapting,
    contiguous,
    largest_regressor,
    limits_of,
    without_faint_states,
)
from ultraquiet.design.tones.inner_loop import COARSE, Around, Inner, checked_tones, inner_loop, inverse
from ultraquiet.design.verification import judged
from ultraquiet.linalg.equations import discrete_riccati
from ultraquiet.values.door import takes_systems
from ultraquiet.values.interconnect import gain
from ultraquiet.values.state_space import StateSpace

QUIETEST = 1e-4  # regressors below this share of the largest carry nothing to learn from


@dataclass(frozen=True, eq=False)
class Central:
    """A stabilising law in observer form: x+ = A x + B v + L e, v = F x + Q e, e = y - C x - D v.

    With Q = 0 this is the central law. For a stable Q the loop with the model is stable, whatever Q is, because e does
    not depend on Q; and y = y0 + T Q e, T = (A + B F, B, C + D F, D), so the sensitivity is affine in Q.
    """

    plant: StateSpace
    F: FloatArray
    L: FloatArray

    def controller(self, Q: StateSpace | None = None) -> StateSpace:
        """Return the law u = K y for a given Q, from e `(ny,)` to v `(nu,)`; the central one when absent.

        Raises:
            InputError: Q does not fit, or the plant and Q both answer within the sample (D Dq not zero).
        """
        G, (ny, nu) = self.plant, self.plant.D.shape
        Q = gain(np.zeros((nu, ny)), G.rate_hz) if Q is None else Q
        if Q.D.shape != (nu, ny):
            raise InputError(f"Central: Q must be {nu} x {ny} (outputs x inputs), got {Q.D.shape[0]} x {Q.D.shape[1]}.")
        # v (I + Dq D) = (F - Dq C) x + Cq q + Dq y
        loop = np.eye(nu) + Q.D @ G.D
        v = np.linalg.solve(loop, np.hstack([self.F - Q.D @ G.C, Q.C, Q.D]))
        n, m = G.states, Q.states
        e = np.hstack([-G.C, np.zeros((ny, m)), np.eye(ny)]) - G.D @ v
        state = np.vstack(
            [
                np.hstack([G.A, np.zeros((n, m + ny))]) + G.B @ v + self.L @ e,
                np.hstack([np.zeros((m, n)), Q.A, np.zeros((m, ny))]) + Q.B @ e,
            ]
        )
        return StateSpace(state[:, : n + m], state[:, n + m :], v[:, : n + m], v[:, n + m :], G.rate_hz)

    def effect(self) -> StateSpace:
        """Return T, from what Q adds to the readings."""
        G = self.plant
        return StateSpace(G.A + G.B @ self.F, G.B, G.C + G.D @ self.F, G.D, G.rate_hz)


def central_law(plant: StateSpace, control_weight: float, sensor_noise: float) -> Central:
    """Return the central law of an LQG problem: |y|^2 + control_weight |u|^2, unit noise at the plant's input.

    Args:
        plant: G, discrete.
        control_weight: squared output units per squared input unit, over the largest squared gain of the plant.
        sensor_noise: variance of the readings' noise, in the same units.

    Raises:
        NumericalError: a mode on or outside the circle cannot be moved or seen.
    """
    A, B, C = plant.A, plant.B, plant.C
    ny, nu = plant.D.shape
    assert plant.rate_hz is not None
    with np.errstate(divide="ignore", invalid="ignore"):  # a pole on a line of the grid
        grid = np.abs(plant.frequency_response(np.linspace(0, plant.rate_hz / 2, COARSE)))
    size = grid[np.isfinite(grid)].max(initial=0.0) ** 2
    if not size:
        raise NumericalError("the plant has no gain, so no command does anything.")
    R, V = control_weight * size * np.eye(nu), sensor_noise * size * np.eye(ny)
    X = discrete_riccati(A, B, C.T @ C, R + plant.D.T @ plant.D, C.T @ plant.D).X
    Y = discrete_riccati(A.T, C.T, B @ B.T, V + plant.D @ plant.D.T, B @ plant.D.T).X
    F = -np.linalg.solve(R + plant.D.T @ plant.D + B.T @ X @ B, B.T @ X @ A + plant.D.T @ C)
    L = np.linalg.solve(V + plant.D @ plant.D.T + C @ Y @ C.T, C @ Y @ A.T + plant.D @ B.T).T
    return Central(plant, F, L)


@register("design", "youla-kucera")
@formerly(limit_v="limit")
@dataclass(frozen=True)
class YoulaKucera(StatedRobustness):
    """A stabilising law whose stable parameter Q learns, by recursive least squares, to cancel what is there.

    u = K0 y + v, v = F x + Q e, Q(z) = sum_k theta_k psi_k(z): psi a pair of filters (a damped resonance and its
    quadrature) per nominal tone, Laguerre filters or delays. Theta minimises the forgotten sum of |y0 + T Q e|^2, so
    the model of the disturbance arrives in the loop by itself, with no frequency estimated. With the true model the
    loop is stable for every theta.

    Args:
        basis: `tones`, two filters per tone of `tones_hz`; `laguerre`, filters of one pole; or `fir`, delays of the
            innovations, which only suits tones that are not far below the rate.
        tones_hz: middle of each pair of filters, Hz; the tone may be anywhere near. The basis `tones` needs one.
        zeta: half the relative width of the filters.
        order: number of Laguerre filters or delays.
        pole_hz: corner frequency of the Laguerre filters, Hz; the geometric mean of `tones_hz` when absent.
        memory_s: how fast the past is forgotten.
        leak: weight on theta, over the mean power of the regressors.
        central: `lqg`, or `none`: the plant's own stability, K = 0.
        control_weight, sensor_noise: of `central_law`.
        update_every: samples between two steps of theta.
        limit: largest |v| per actuator, in its unit; its own when absent. A law
            that is brought to rest takes its state feedback along: a plant that is unstable by itself should get its
            stabiliser as `around`.
        around: K0, a `StateSpace` or the name of a design method; Q then works on the loop that it closes.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=1000.0)
    >>> result = YoulaKucera(tones_hz=(30.0,), limit=5.0).design(plant)
    >>> result.status.ok, result.law.step([0.0]).tolist()
    (True, [0.0])

    Landau, Constantinescu and Rey 2005, doi:10.1016/j.automatica.2004.11.022.
    """

    basis: str = "tones"
    tones_hz: tuple[float, ...] = ()
    zeta: float = 0.2
    order: int = 4
    pole_hz: float | None = None
    memory_s: float = 0.2
    leak: float = 0.1
    central: str = "lqg"
    control_weight: float = 10.0
    sensor_noise: float = 10.0
    update_every: int = 8
    limit: float | tuple[float, ...] | None = None
    around: Around = None

    asks_limit: ClassVar[bool] = True  # a study gives it what it knows

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("YoulaKucera", "basis", self.basis, ("tones", "laguerre", "fir"))
        one_of("YoulaKucera", "central", self.central, ("lqg", "none"))
        for name in ("memory_s", "leak", "control_weight", "sensor_noise"):
            positive("YoulaKucera", name, getattr(self, name))
        between("YoulaKucera", "zeta", self.zeta, 1e-3, 0.9)
        if self.pole_hz is not None:
            positive("YoulaKucera", "pole_hz", self.pole_hz)
        for name in ("order", "update_every"):
            whole("YoulaKucera", name, getattr(self, name), 1)

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the law of a discrete plant: `law` adapts, `controller` is the central law.

        `details` holds the number of `parameters` and the `regressor_states`; `law.central` is the observer form.

        Raises:
            InputError: no tone for the basis `tones`, no corner and no tone for `laguerre`, one outside
                (0, rate / 2) or at which the plant has no gain, an unstable plant without a law around it, one that
                does not fit, an actuator without a limit.
        """
        who = "YoulaKucera"
        lqg = self.central == "lqg"
        inner = inner_loop(who, plant, self.around, stable=not lqg)
        rate = inner.seen.rate_hz
        assert rate is not None
        filters = self.filters(rate)
        if self.basis == "tones":
            for tone in checked_tones(who, self.tones_hz, rate):
                inverse(who, inner.seen, tone, 1.0)
        limit = limits_of(who, self.limit, plant.actuators)
        ny, nu = plant.D.shape
        try:
            form = (
                central_law(inner.seen, self.control_weight, self.sensor_noise)
                if lqg
                else Central(inner.seen, np.zeros((nu, inner.seen.states)), np.zeros((inner.seen.states, ny)))
            )
        except NumericalError as error:
            return refused(f"{who}: {error}")
        regressors = without_faint_states(form.effect())
        details = {
            "parameters": filters[1].size * nu * ny,
            "regressor_states": regressors.states,
        }
        whole_law = inner.joined(form.controller())
        result = judged(plant, whole_law, self, float("nan"), float("nan"), {}, details)
        if result.status.word in STABLE_WORDS and result.controller is not None:
            law = YoulaLaw(self, inner, form, regressors, filters, limit, result.controller)
            return adapting(result, law)
        return result

    def filters(self, rate_hz: float) -> tuple[FloatArray, FloatArray]:
        """Return A `(m, m)` and b `(m,)` of the filters psi, whose states are their outputs."""
        if self.basis == "tones":
            return _resonances(checked_tones("YoulaKucera", self.tones_hz, rate_hz), self.zeta, rate_hz)
        if self.basis == "fir":
            return _laguerre(self.order, 0.0)
        return _laguerre(self.order, float(np.exp(-2 * np.pi * self._corner_hz(rate_hz) / rate_hz)))

    def _corner_hz(self, rate_hz: float) -> float:
        if self.pole_hz is not None:
            return between("YoulaKucera", "pole_hz", self.pole_hz, 0.0, rate_hz / 2, "Hz")
        if not np.size(self.tones_hz):
            raise InputError("YoulaKucera: the basis 'laguerre' needs 'pole_hz' or the 'tones_hz' to take it from.")
        return float(np.exp(np.mean(np.log(checked_tones("YoulaKucera", self.tones_hz, rate_hz)))))


class YoulaLaw(AdaptiveLaw):
    """The law that runs; `frozen()` is the linear law that it is at this moment."""

    def __init__(
        self,
        settings: YoulaKucera,
        inner: Inner,
        central: Central,
        regressors: StateSpace,
        filters: tuple[FloatArray, FloatArray],
        limit: FloatArray,
        law: StateSpace,
    ) -> None:
        rate = inner.seen.rate_hz
        assert rate is not None
        self.central, self._filters = central, filters
        self._seen, self._regress = contiguous(inner.seen), contiguous(regressors)
        self._gains = np.array(central.F, order="C"), np.array(central.L, order="C")
        forget = 1.0 - settings.update_every / (settings.memory_s * rate)
        floor = (QUIETEST * largest_regressor(inner.seen, limit)) ** 2
        self._settings = np.array([settings.update_every, forget, settings.leak, floor])
        if forget <= 0:
            raise InputError("YoulaKucera: 'memory_s' must be longer than the samples between two updates.")
        super().__init__("YoulaKucera", inner, law, limit)

    def _start(self) -> None:
        nu, ny = self._inner.first.D.shape
        m, n = self._filters[1].size, self._seen[0].shape[0]
        columns, states = nu * ny, self._regress[0].shape[0]
        p = m * columns
        self._theta = np.zeros((m, nu, ny))
        floor = self._settings[3]
        self._squares = np.eye(p) / floor, self._settings, np.zeros(1, dtype=np.int64), np.full(1, floor)
        self._state = (
            (np.zeros(n), np.zeros(n), np.zeros(nu), np.zeros(ny), np.zeros((ny, m)), self._theta, np.zeros(nu)),
            (
                np.zeros((states, columns + 1)),
                np.zeros((states, columns + 1)),
                np.zeros((ny, columns, m + 1)),
                np.zeros((ny, p)),
                np.zeros(m),
            ),
        )

    def _adapt(self, y: FloatArray) -> int:
        from ultraquiet.design.tones.kernels import youla_step

        models = self._seen, self._gains, self._regress, self._filters
        return youla_step(y, models, self.limit, self._squares, self._state, self._v, self._y0)

    def frozen(self) -> StateSpace:
        """Return the linear law u = K y of the parameters that stand now."""
        A, b = self._filters
        m, nu, ny = self._theta.shape
        C = self._theta.transpose(1, 2, 0).reshape(nu, ny * m)
        Q = StateSpace(np.kron(np.eye(ny), A), np.kron(np.eye(ny), b[:, None]), C, np.zeros((nu, ny)), self._rate)
        return self._inner.joined(self.central.controller(Q))


def _resonances(tones_hz: FloatArray, zeta: float, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return damped rotations, one per tone, of unit gain at their frequencies."""
    m = 2 * tones_hz.size
    A, b = np.zeros((m, m)), np.zeros(m)
    for k, tone in enumerate(tones_hz):
        w = 2 * np.pi * tone / rate_hz
        rho = np.exp(-zeta * w)
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = rho * np.array([[np.cos(w), -np.sin(w)], [np.sin(w), np.cos(w)]])
        b[2 * k] = 2 * (1 - rho)
    return A, b


def _laguerre(order: int, pole: float) -> tuple[FloatArray, FloatArray]:
    """Return the chain sqrt(1 - a^2) / (z - a) ((1 - a z) / (z - a))^k; delays 1 to `order` for a = 0."""
    rows, columns = np.indices((order, order))
    gap = rows - columns
    below = np.where(gap > 0, (1 - pole**2) * (-pole) ** np.maximum(gap - 1, 0), 0.0)
    return pole * np.eye(order) + below, np.sqrt(1 - pole**2) * (-pole) ** np.arange(order, dtype=np.float64)
