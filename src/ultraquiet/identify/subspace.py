"""A multivariable state-space model from one record: subspace for the poles, least squares for the rest."""

from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet.identify import hankel, modal
from ultraquiet.identify._abstract import Result, usable, worst
from ultraquiet.identify.starts import drawn_in
from ultraquiet.linalg import portmanteau
from ultraquiet.values import Record, Status

CANDIDATES = (10, 20, 40, 60, 90)  # block rows tried when no horizon is given; the lowest simulated error wins
COLUMNS_PER_ROW = 2  # a Hankel matrix must be this much longer than high
STABLE_RADIUS = 0.99999  # at 3.5 kHz a decay of 30 s: poles beyond are mirrored, the model must simulate
ROUNDS = 60  # of alternating least squares
GAIN = 1e-5
TEST_LAGS = 40
RESIDUAL_LAGS = 200  # the simulation error is coloured; this much of its memory enters the test's variance
SIGNIFICANCE = 1e-3


@register("identify", "subspace")
@dataclass(frozen=True)
class Subspace:
    """x+ = A x + B u, y = C x + D u + v: PO-MOESP for the poles, then B, C, D and the initial state by least squares.

    The extended observability matrix comes from the projection of future outputs on past data, orthogonal to future
    inputs, taken from the Gram matrix of the Hankel data (cost and memory do not grow with the record beyond one
    pass). A, and with it the poles, follow from its shift structure. B, D and initial state, and C in turn, then
    minimise the simulated error in modal coordinates.

    Args:
        order: number of states.
        horizon: block rows; the longest decay and the slowest mode must show within it. None tries several and keeps
            the one whose model simulates best.
        feedthrough: whether D is estimated; otherwise zero.
        offset: whether a constant at each output is fitted.

    Returns of `identify`: `Result` whose model is a `StateSpace` in real modal blocks. It has no noise model, so `loss`
    is the mean squared simulated error, and `not white` says that this error still holds something of the inputs.

    Reference: Verhaegen 1994, doi:10.1016/0005-1098(94)90229-1; Van Overschee and De Moor 1996, chapter 4.

    >>> import numpy as np, ultraquiet as uq
    >>> plant = uq.StateSpace([[0.9, 0.3], [-0.3, 0.9]], [[1.0], [0.5]], [[1.0, 0.0]], [[0.2]], rate_hz=100.0)
    >>> u = np.random.default_rng(0).standard_normal((1, 2000))
    >>> result = uq.identify.Subspace(order=2).identify(uq.Record(u, plant.simulate(u), rate_hz=100.0))
    >>> result.model.poles().round(4)
    array([0.9+0.3j, 0.9-0.3j])
    """

    name: ClassVar[str] = "subspace"

    order: int = 30
    horizon: int | None = None
    feedthrough: bool = True
    offset: bool = True

    def __post_init__(self) -> None:
        whole("Subspace", "order", self.order, 1, 500)
        if self.horizon is not None:
            whole("Subspace", "horizon", self.horizon, 2, 1000)

    def identify(self, record: Record) -> Result:
        """Return the state-space model of all channels of the record.

        Raises:
            InputError: too few samples for the order, a constant input or output, a horizon too short for the order.
        """
        horizons = self._horizons(record)
        u = record.inputs - record.inputs.mean(axis=1, keepdims=True)
        u_size, y_size = u.std(axis=1, keepdims=True), record.outputs.std(axis=1, keepdims=True)
        usable("Subspace", record, self.order, 0)
        scaled_u, scaled_y = record.inputs / u_size, record.outputs / y_size
        found = [self._modes(scaled_u, scaled_y, rows) for rows in horizons]
        best = min(range(len(found)), key=lambda k: found[k][0])
        return self._result(record, found[best][1], u_size, y_size, horizons[best])

    def _horizons(self, record: Record) -> list[int]:
        width = len(record.actuators) + len(record.sensors)
        least = self.order // len(record.sensors) + 2
        fits = record.samples // (2 * width * COLUMNS_PER_ROW)
        wanted = [self.horizon] if self.horizon else sorted({max(least, rows) for rows in CANDIDATES})
        if self.horizon is not None and self.horizon < least:
            raise InputError(f"Subspace: order {self.order} needs at least {least} block rows, got {self.horizon}.")
        usable_rows = [rows for rows in wanted if rows <= fits]
        if not usable_rows:
            needed = min(wanted) * 2 * width * COLUMNS_PER_ROW
            raise InputError(
                f"Subspace: order {self.order} with {min(wanted)} block rows needs at least {needed} samples, the "
                f"record has {record.samples}; record longer or lower order or horizon."
            )
        return usable_rows

    def _modes(self, u: FloatArray, y: FloatArray, rows: int) -> tuple[float, modal.Modes]:
        """Return the summed relative error and the modes found with `rows` block rows."""
        centred = (u - u.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True))
        basis, values = hankel.observability(*centred, rows)
        A, C = hankel.transition(basis, values, self.order, y.shape[0])
        poles, directions = _modal(A, C)
        bank = modal.Bank(poles, u, y, self.feedthrough, self.offset)
        modes = modal.alternate(bank, directions, ROUNDS, GAIN)
        return float(np.sum(bank.loss(modes))), modes

    def _result(self, record: Record, modes: modal.Modes, u_size: FloatArray, y_size: FloatArray, rows: int) -> Result:
        ny = len(record.sensors)
        made = Provenance(self.name, asdict(self), parents=(record.hash,), versions=versions())
        scaled = modal.Modes(
            modes.poles,
            np.hstack([modes.b[:, :-1] / u_size[:, 0], modes.b[:, -1:]]),
            modes.c * y_size,
            modes.D * y_size / u_size[:, 0],
            modes.constant * y_size[:, 0],
        )
        model = scaled.state_space(record.rate_hz, actuators=record.actuators, sensors=record.sensors, provenance=made)
        error = record.outputs - model.simulate(record.inputs) - _free(scaled, record.samples)
        spread = np.linalg.norm(record.outputs - record.outputs.mean(axis=1, keepdims=True), axis=1)
        p = [_free_of_inputs(e, record.inputs) for e in error]
        statuses = [_verdict(x) for x in p]
        lags = min(TEST_LAGS, record.samples // 10)
        return Result(
            model,
            worst(statuses),
            100.0 * (1.0 - np.linalg.norm(error, axis=1) / spread),
            np.mean(error**2, axis=1),
            np.full((ny, 0, 0), np.nan),
            np.array([portmanteau.ljung_box(e, lags).p_value for e in error]),
            np.array(p),
            np.zeros(ny, dtype=np.int64),
            tuple(statuses),
            made,
            {"horizon": rows},
        )


def _modal(A: FloatArray, C: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return the poles of the upper half plane, drawn inside the circle, and their output directions `(ny, m)`."""
    values, vectors = np.linalg.eig(A)
    values = drawn_in(values.astype(np.complex128), STABLE_RADIUS)
    real = np.abs(values.imag) <= modal.IMAGINARY
    kept = np.concatenate([np.flatnonzero(~real & (values.imag > 0)), np.flatnonzero(real)])
    directions = (C @ vectors)[:, kept].astype(np.complex128)
    count = int(np.count_nonzero(~real & (values.imag > 0)))
    poles = values[kept].copy()
    poles[count:] = poles[count:].real
    directions[:, count:] = directions[:, count:].real
    return poles, directions / np.linalg.norm(directions, axis=0)


def _free(modes: modal.Modes, n: int) -> FloatArray:
    """Return the response to the initial state, and the constant, `(ny, n)`."""
    powers = np.exp(np.log(modes.poles)[:, None] * np.arange(n))
    return (modes.c @ (modes.b[:, -1:] * powers)).real + modes.constant[:, None]


def _free_of_inputs(e: FloatArray, u: FloatArray) -> float:
    lags, memory = min(TEST_LAGS, e.size // 10), min(RESIDUAL_LAGS, e.size // 10)
    least = min(portmanteau.cross_correlation(e, x, lags, memory).p_value for x in u)
    return 1.0 - (1.0 - least) ** u.shape[0]


def _verdict(p: float) -> Status:
    if p < SIGNIFICANCE:
        return Status(
            "not white",
            f"The simulated error still holds something of the inputs (p = {p:.1e}): the order or the horizon leaves "
            f"part of the record unexplained.",
        )
    return Status("ok", f"The simulated error is free of the inputs (p = {p:.2f}).")
