"""Tests of what a state-space model leaves of a record: one-step errors, or simulated ones, which have colour."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray, frozen, one_of, whole
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet.linalg import portmanteau, prediction, score
from ultraquiet.linalg.innovation import fitted_past
from ultraquiet.linalg.modes.modal_spread import LINES_AT_ONCE, ModalSensitivities, RecordEnd, spread_root
from ultraquiet.validate.compare import compare
from ultraquiet.validate.predict import innovations
from ultraquiet.validate.residuals import DEFAULT_LAGS, ORIGINS, ResidualTest, origin_of
from ultraquiet.values import InnovationForm, Record, StateSpace
from ultraquiet.values.handed_over.kinds import takes_values

COLOR_LAGS = 200  # what an autoregression leaves of an error's colour enters the variance of the test


@dataclass(frozen=True)
class CoefficientErrors:
    """How errors of a model's parameters, as large as this record leaves them, move its outputs.

    Attributes:
        at: sensitivities of the simulated system, or of the one-step predictor.
        root: `(p, k)`, R R' the covariance of the parameters.
        drive: `(ports, n)` what drives the system, less its means.
        ended: where the record ends.
    """

    at: ModalSensitivities
    root: FloatArray
    drive: FloatArray
    ended: RecordEnd


def by_simulation(model: StateSpace) -> bool:
    """Return whether a model is judged by its simulated error: it says nothing of noise, or was found for simulation.

    The noise model of one found so (`focus` "simulation" in its settings) is a by-product: plant and noise share their
    poles, and noise of another colour leaves one-step errors of a good plant coloured.
    """
    if not isinstance(model, InnovationForm) or not model.is_invertible():
        return True
    return model.provenance.settings.get("focus") == "simulation"


@takes_values
def state_space_test(model: StateSpace, record: Record, lags: int = DEFAULT_LAGS, origin: str = "auto") -> ResidualTest:
    """Return what a state-space model leaves of any record of its channels, and its tests, as of `residual_test`.

    The innovations of an `InnovationForm` are to be white and free of the inputs. A plain `StateSpace` says nothing of
    noise, and one found for simulation little: of its simulated error, whose colour enters the variance, tested is
    whether it is free of the inputs. Parameters from another record have errors, which are taken to be as large as this
    record would leave them; where poles have no modes of their own, and on the record that the model names as its own,
    they are taken as exact. On its own record p-values err upwards.

    Args:
        model: what is tested, `(ny, nu)` channels.
        record: `(nu, n)` inputs and `(ny, n)` outputs at the model's rate.
        lags: how many lags each test takes.
        origin: as of `residual_test`.

    Raises:
        InputError: other channels or another rate than the model's, fewer than 10 samples a lag, an unstable model that
            is judged by its simulated error.

    >>> import numpy as np, ultraquiet as uq
    >>> u, e = np.random.default_rng(1).standard_normal((2, 1, 1000))
    >>> lag = uq.StateSpace([[0.5]], [[0.5]], [[1.0]], [[0.0]], rate_hz=1.0)
    >>> test = state_space_test(lag, uq.Record(u, lag.simulate(u) + 0.1 * e, rate_hz=1.0))
    >>> test.simulated, bool(test.correlation_p[0, 0] > 0.001)
    (True, True)

    Reference: Ljung, System Identification, 2nd ed., section 16.6.
    """
    who = "state_space_test"
    one_of(who, "origin", origin, ORIGINS)
    whole(who, "lags", lags, 1)
    if record.samples < 10 * lags:
        raise InputError(f"{who}: {lags} lags need at least {10 * lags} samples, the record has {record.samples}.")
    origin = origin_of(model, record) if origin == "auto" else origin
    simulates = by_simulation(model)
    e = _errors(who, model, record, simulates)
    u = record.inputs - record.inputs.mean(axis=1, keepdims=True)
    noise = np.stack([_not_of_inputs(x, u, lags) for x in e]) if simulates else e
    whitened = [prediction.whitening(x)[0] if simulates else np.ones(1) for x in noise]
    off = _coefficient_errors(model, record, noise, simulates) if origin == "another record" else None
    tested = [prediction.filtered(x - x.mean(), a, np.ones(1)) for x, a in zip(e, whitened, strict=True)]
    moved = None if off is None else _moved(off, whitened, tested, u, lags)
    memory = min(COLOR_LAGS, record.samples // 10) if simulates else 0
    p = np.array(
        [
            [_p_values(x, v, lags, memory, None if moved is None else moved[i][k]) for k, v in enumerate([x, *u])]
            for i, x in enumerate(tested)
        ]
    )
    return ResidualTest(
        frozen(e),
        np.mean(e**2, axis=1),
        np.stack([portmanteau.autocorrelation(x, lags) for x in e]),
        np.full(len(e), np.nan) if simulates else p[:, 0, 1],
        p[:, 1:, 0],
        p[:, 1:, 1],
        "exact" if off is None and origin == "another record" else origin,
        simulates,
    )


def _errors(who: str, model: StateSpace, record: Record, simulates: bool) -> FloatArray:
    if not simulates and isinstance(model, InnovationForm):
        return innovations(model, record)
    if not model.is_stable():
        raise InputError(f"{who}: the model is unstable, its simulated error has no bound and nothing to test.")
    return record.outputs - compare(model, record).outputs


def _not_of_inputs(v: FloatArray, u: FloatArray, lags: int) -> FloatArray:
    """Return v less what an autoregression driven by the inputs explains of it, as large as the noise must have been.

    Taken for noise, what a wrong model leaves at its resonance would excuse an error of the model there.
    """
    moving = u[np.ptp(u, axis=1) > 0.0]
    memory = min(prediction.MEMORY, v.size // 20)
    taps = 1 + min(lags, v.size // (20 * max(1, len(moving))))
    v = v - v.mean()
    X = np.hstack([score.shifted(v, 1, memory), *(score.shifted(x, 0, taps) for x in moving)])[memory:]
    size = np.linalg.norm(X, axis=0)
    size[size == 0.0] = 1.0
    found = np.linalg.lstsq(X / size, v[memory:], rcond=None)[0] / size
    a = np.concatenate([[1.0], -found[:memory]])
    if memory and np.abs(np.roots(a)).max(initial=0.0) >= 1.0:
        return v
    heard = np.einsum(
        "jn->n", [prediction.filtered(x, found[memory + j * taps :][:taps], a) for j, x in enumerate(moving)]
    )
    return (v - heard) * np.sqrt(v.size / (v.size - found.size))


def _coefficient_errors(
    model: StateSpace, record: Record, noise: FloatArray, simulates: bool
) -> CoefficientErrors | None:
    """Return how far the parameters lie off when a record as informative as this one gave them; None where none say.

    Nothing is known where poles have no modes of their own, or outputs leave nothing or the same.
    """
    drive = record.inputs - record.inputs.mean(axis=1, keepdims=True)
    heard = record.outputs - record.outputs.mean(axis=1, keepdims=True)
    system = model
    if not simulates and isinstance(model, InnovationForm):
        system, drive = model.predictor(), np.vstack([drive, heard])
    try:
        at = ModalSensitivities(system.A, system.B, system.C, system.D, len(record.actuators) if model.D.any() else 0)
        misses = heard - system.simulate(drive)
        root = spread_root(at, drive, noise if simulates else misses, None, colored=simulates)
    except (NumericalError, np.linalg.LinAlgError):
        return None
    if not np.isfinite(root).all():
        return None
    began = fitted_past(at.A, at.C, misses)[0]
    return CoefficientErrors(at, root, drive, RecordEnd.of(at.A, at.B, at.blocks, drive, began))


def _moved(
    off: CoefficientErrors, whitened: list[FloatArray], tested: list[FloatArray], u: FloatArray, lags: int
) -> FloatArray:
    """Return the sums of a S R over x(t - k), `(ny, 1 + nu, 2 lags + 1, k)` for k = -lags .. lags, x the error and u.

    S is the derivative of an output by the parameters, a the whitening of its error; over lines of the record.
    """
    n, parameters = off.drive.shape[1], len(off.root)
    lines = np.arange(1, (n + 1) // 2)
    z = np.exp(2j * np.pi * lines / n)
    drive = np.fft.rfft(off.drive, axis=1)[:, lines].T
    heard = [[np.fft.rfft(x)[lines].conj() for x in (e, *u)] for e in tested]
    shifts = np.arange(-lags, lags + 1)
    sums = np.zeros((len(tested), 1 + len(u), shifts.size, parameters))
    for k in range(0, lines.size, LINES_AT_ONCE):
        some = slice(k, k + LINES_AT_ONCE)
        S = off.at.of(z[some], drive[some], off.ended)[:, :, :parameters]
        turn = z[some, None] ** shifts
        for i, a in enumerate(whitened):
            through = (z[some, None] ** -np.arange(a.size) @ a)[:, None] * S[:, i]
            for j, x in enumerate(heard[i]):
                sums[i, j] += 2.0 / n * ((turn * x[some, None]).T @ through).real
    return sums @ off.root


def _p_values(e: FloatArray, x: FloatArray, lags: int, memory: int, moved: FloatArray | None) -> tuple[float, float]:
    """Return the p-values that e holds nothing of x(t), ..., x(t - lags), and nothing of x(t + 1), ..., x(t + lags)."""
    n = e.size
    color = np.array([e[k:] @ e[: n - k] for k in range(memory + 1)]) / n
    own = np.array([x[k:] @ x[: n - k] for k in range(lags + memory + 1)]) / n
    if x is e:  # white, as is asked of it
        own[1:] = 0.0
    past = np.array([e[k:] @ x[: n - k] for k in range(lags + 1)]) / n
    ahead = np.array([x[k:] @ e[: n - k] for k in range(1, lags + 1)])[::-1] / n
    early, late = (None, None) if moved is None else (moved[lags:] / n, moved[:lags] / n)
    return (
        portmanteau.cross_correlation_of(past, own, color, n, early).p_value,
        portmanteau.cross_correlation_of(ahead, own[:-1], color, n, late).p_value,
    )
