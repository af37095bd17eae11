"""Advice that is read off a model and its covariance: excitation, delay too short, order too high, resolution."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.linalg import realize, score
from ultraquiet.validate.bands import root
from ultraquiet.validate.gradient import delay, response_gradient
from ultraquiet.values import PolynomialModel, Record

# Each test of each channel errs once in a thousand good ones.
ALARM = 1e-3
SMOOTHED = 9  # lines of the input's periodogram that are averaged
# Below this share of the output's power the input cannot be heard; above this relative error of the response, likewise.
HEARD, UNCERTAIN = 0.3, 0.5
FEWEST_LINES = 4  # the lowest lines of a record are always poor
# A leading coefficient within so many deviations of zero, followed by one beyond the second figure, is a delay.
NOTHING, SOMETHING = 2.5, 6.0
CANCELLED = 0.05  # a pole whose residue could be zero at this significance is not needed

Said = Iterator[tuple[str, str, str]]


@dataclass(frozen=True, eq=False)
class Case:
    """One output of a model on a record, with its residual and what the tests must allow for."""

    record: Record
    output: int
    model: PolynomialModel
    e: FloatArray
    covariance: FloatArray | None
    fitted: FloatArray
    spread: FloatArray | None

    @property
    def sensor(self) -> str:
        """Name of the output."""
        return self.record.sensors[self.output].name

    def p_value(self, regressors: FloatArray, explained: FloatArray | None = None) -> float:
        """Return the p-value that the residual holds nothing of the regressors beyond what `given` explains."""
        fitted, spread, e = self.fitted, self.spread, self.e
        if explained is not None:
            fitted = score.orthonormal(np.hstack([fitted, explained]))
            e = e - fitted @ (fitted.T @ e)
        return score.score_test(e, regressors, fitted, spread).p_value

    def columns(self, j: int) -> tuple[int, int, int]:
        """Return where b_j begins among the coefficients, how many it has, and where f_j begins."""
        m = self.model
        at = m.a.size - 1
        for k in range(j):
            at += m.b[k].size - delay(m.b[k]) + m.f[k].size - 1
        count = m.b[j].size - delay(m.b[j])
        return at, count, at + count


def excitation(case: Case) -> Said:
    """Compare |G|^2 times the input's spectrum with the noise's, from the lowest line upwards."""
    m, record = case.model, case.record
    n = record.samples
    f = np.asarray(np.fft.rfftfreq(n, 1 / record.rate_hz)[1:], dtype=np.float64)
    noise = np.abs(m.noise_response(f)) ** 2 * np.mean(case.e**2)
    G = m.frequency_response(f)[0]
    error = np.zeros(G.shape)
    if case.covariance is not None:
        moved = np.einsum("jpf,pq->jqf", response_gradient(m, f), root(case.covariance))
        with np.errstate(over="ignore"):  # over nothing at all
            error = np.sqrt(np.sum(np.abs(moved) ** 2, axis=1)) / np.maximum(np.abs(G), np.finfo(float).tiny)
    for j, (x, actuator) in enumerate(zip(record.inputs, record.actuators, strict=True)):
        power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(n)))[1:] ** 2 / (n * 0.375)
        driven = np.abs(G[j]) ** 2 * np.convolve(power, np.ones(SMOOTHED) / SMOOTHED, mode="same")
        deaf = (driven < HEARD * (driven + noise)) | (error[j] > UNCERTAIN)
        count = int(np.argmin(deaf)) if not deaf.all() else deaf.size
        if count >= FEWEST_LINES:
            limit = f[count - 1]
            yield (
                "excitation",
                actuator.name,
                f"Below {limit:.3g} Hz '{case.sensor}' hears more noise than input; excite there (or record longer), "
                f"and do not trust the model there.",
            )


def delay_too_short(case: Case) -> Said:
    """Look for leading coefficients of B that are zero within their error, before ones that are not."""
    if case.covariance is None:
        return
    for j, actuator in enumerate(case.record.actuators):
        at, count, _ = case.columns(j)
        model_delay = delay(case.model.b[j])
        size = np.sqrt(np.maximum(np.diag(case.covariance)[at : at + count], np.finfo(float).tiny))
        steps = np.abs(case.model.b[j][model_delay:]) / size
        nothing = int(np.argmin(steps < NOTHING)) if np.any(steps >= NOTHING) else count
        if 0 < nothing < count and steps[nothing] > SOMETHING:
            yield (
                "delay",
                actuator.name,
                f"The first {nothing} coefficients towards '{case.sensor}' are zero within their error; the output "
                f"answers after {model_delay + nothing} samples: set delay={model_delay + nothing}.",
            )


def order_too_high(case: Case) -> Said:
    """Look for poles of F whose residue B(p) is zero within its error: a zero stands on the pole."""
    if case.covariance is None:
        return
    for j, actuator in enumerate(case.record.actuators):
        spare = sum(1 for _, needed in _poles(case, j) if not needed)
        if spare:
            yield (
                "order too high",
                actuator.name,
                f"{spare} of {case.model.f[j].size - 1} poles towards '{case.sensor}' are cancelled by zeros within "
                f"their error; lower the order.",
            )


def resolution(case: Case) -> Said:
    """Look for modes that ring on past the record's end: their damping rests on less than one decay."""
    for j, actuator in enumerate(case.record.actuators):
        for pole, needed in _poles(case, j):
            size = abs(pole)
            if pole.imag <= 0 or not needed or not 0 < size < 1:
                continue
            decay_s = -1.0 / (np.log(size) * case.record.rate_hz)
            if decay_s > case.record.duration_s:
                f_hz = float(np.angle(pole)) * case.record.rate_hz / (2 * np.pi)
                yield (
                    "resolution",
                    actuator.name,
                    f"The resonance at {f_hz:.4g} Hz towards '{case.sensor}' rings for {decay_s:.3g} s, the record "
                    f"lasts {case.record.duration_s:.3g} s; record at least {3 * decay_s:.2g} s to know its damping.",
                )


def slow_decays_s(m: PolynomialModel) -> list[float]:
    """Return the decay times of the real poles near z = 1, plant and noise: what follows a drift."""
    every = np.concatenate([realize.roots(p) for p in (m.a, m.d, *m.f)])
    real = every.real[(every.imag == 0) & (every.real > 0)]
    return [float(-1.0 / (np.log(min(x, 1 - 1e-12)) * m.rate_hz)) for x in real]


def _poles(case: Case, j: int) -> list[tuple[complex, bool]]:
    """Return the poles of F_j, and whether each is needed: not so when B(p) may be zero (always, unknown errors)."""
    poles = realize.roots(case.model.f[j])
    if case.covariance is None:
        return [(complex(p), True) for p in poles]
    L = root(case.covariance)
    return [(complex(p), _needed(case, j, complex(p), L)) for p in poles]


def _needed(case: Case, j: int, pole: complex, L: FloatArray) -> bool:
    b, f = case.model.b[j], case.model.f[j]
    at, count, other = case.columns(j)
    first = delay(b)
    if pole == 0:
        return False
    k_b, k_f = np.arange(b.size), np.arange(f.size)
    value = np.sum(b * pole**-k_b)
    slope_b = np.sum(-k_b * b * pole ** (-k_b - 1))
    slope_f = np.sum(-k_f * f * pole ** (-k_f - 1))
    gradient = np.zeros(L.shape[0], dtype=np.complex128)
    gradient[at : at + count] = pole ** -np.arange(first, first + count)
    # The pole itself moves with f: dp / df_k = -p^-k / F'(p).
    gradient[other : other + f.size - 1] = -slope_b / slope_f * pole ** -np.arange(1, f.size)
    return _distance(value, gradient @ L) < CANCELLED


def _distance(value: complex, moved: ComplexArray) -> float:
    """Return the p-value that a complex number is zero, given how it moves with unit-variance steps."""
    parts = np.stack([moved.real, moved.imag])
    V = parts @ parts.T
    x = np.array([value.real, value.imag])
    values, vectors = np.linalg.eigh(V)
    kept = values > 1e-10 * max(values[-1], np.finfo(float).tiny)
    projected = vectors[:, kept].T @ x
    return score.chi_squared(float(np.sum(projected**2 / values[kept])), int(kept.sum())).p_value
