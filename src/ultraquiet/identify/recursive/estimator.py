"""The running estimator behind the recursive methods: samples in, the present model out."""

from collections.abc import Iterator
from math import comb

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, signal_array
from ultraquiet._base.errors import InputError
from ultraquiet.identify.prediction_error.model_table import settled
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.structure import ROW_FIRST, Structure
from ultraquiet.identify.record_checks import SAMPLES_PER_PARAMETER
from ultraquiet.identify.recursive.beginning import LONGEST, Beginning
from ultraquiet.identify.recursive.settings import RecursionSettings
from ultraquiet.identify.recursive.trajectory import Trajectory
from ultraquiet.values import PolynomialModel

SLACK = 4096  # samples that are taken in before the filters' past is moved to the front
# A step changes the filters' past as well: with the new coefficients it is computed again over this many samples. Left
# as it was, the slow modes of a plant at 3.5 kHz (memory 1500 samples) cost a Box-Jenkins recursion 2 % in loss.
BEHIND = 2048
STRIDE = 64  # samples between the steps of a model with filters
# A recursion from a model without its samples knows this much of each scaled coefficient: next to nothing, yet enough
# to keep the first steps of C, D and F inside the unit circle.
COLD = 1e-2
NEVER = 1 << 62  # samples
SETTLING = 0.25  # share of the start's samples in which the filters settle before their gradient counts


class Recursion:
    """The running estimator of one output: what `RecursiveMethod.recursion` returns; `update` changes it."""

    def __init__(
        self,
        settings: RecursionSettings,
        rate_hz: float,
        input_size: FloatArray,
        output_size: float,
        start: PolynomialModel | None,
        start_samples: int = 0,
        constant: float = 0.0,
        longest: int = LONGEST,
    ) -> None:
        from ultraquiet.identify.recursive.kernels import DIRECTIONAL, EXPONENTIAL

        self.structure: Structure = settings.structure
        self.rate_hz, self.input_size, self.output_size = rate_hz, input_size, output_size
        nu = input_size.size
        parameterisation = Parameterisation.alike(self.structure, nu)
        self._degree, self._lag = parameterisation.degree(), parameterisation.lag()
        self._offset = settings.offset
        count = int(self._degree[[0, 1, 2, *range(ROW_FIRST, ROW_FIRST + 2 * nu)]].sum())
        p = count + int(settings.offset)
        self._base, self._theta = parameterisation.empty(), np.zeros(p)
        self._table = self._base.copy()
        self._to_shift = self._expansion(p)
        # ARX leaves out the samples whose past it does not know, as the batch fit does.
        linear = settings.linear
        quiet = int(parameterisation.states(True, False)[1]) if linear else int(SETTLING * start_samples)
        self.frozen_until = max(quiet, start_samples)
        cold = start is None
        self._beginning = Beginning(settings, rate_hz, nu, p, longest) if cold and not linear else None
        # Errors count from here on: a start from nothing first has to find the plant.
        if self._beginning is not None:
            self.judged_from = self._beginning.last
        else:
            self.judged_from = self.frozen_until + (SAMPLES_PER_PARAMETER * p if cold else 0)
        known = 0.0 if cold or linear or start_samples else COLD
        self._R, self._z, self._best = known * np.eye(p), np.zeros(p), np.zeros((p, p))
        head = int(self._lag.max() + self._degree.max()) + 1
        self._head, self._work = head, np.zeros((4 * nu + self._degree.size + 6, head + BEHIND + SLACK))
        if start is not None:
            self._begin(start, constant)
        keep = settings.remembered(rate_hz)
        mode = DIRECTIONAL if settings.forgetting == "directional" else EXPONENTIAL
        # Without filters every sample moves the coefficients, and there is no past to mend.
        pace = (1, 0) if linear else (STRIDE, BEHIND)
        self._options = (quiet, self.frozen_until, keep, mode, settings.reset_samples(rate_hz), *pace)
        if self._beginning is not None:
            # Nothing is learned before there is a model whose gradient means something.
            self._options = (NEVER, NEVER, *self._options[2:])
        self._count = np.array([0, 0, head, 0], dtype=np.int64)
        self._share = 1.0 - keep * keep
        self._squares, self._weight = 0.0, 0.0

    @property
    def samples(self) -> int:
        """Samples taken in so far."""
        return int(self._count[0])

    @property
    def held(self) -> int:
        """Steps cut short at the edge of stability."""
        return int(self._count[1])

    def update(self, inputs: ArrayLike, outputs: ArrayLike) -> FloatArray:
        """Take in samples, `(nu, m)` and `(1, m)`; return the errors of the predictions made before each, `(m,)`."""
        u = signal_array("Recursion.update", "inputs", inputs)
        y = signal_array("Recursion.update", "outputs", outputs)
        if u.shape[0] != self.input_size.size or y.shape != (1, u.shape[1]):
            raise InputError(
                f"Recursion.update: got inputs {u.shape} and outputs {y.shape}; it follows one output of "
                f"{self.input_size.size} inputs, samples together."
            )
        e = np.empty(u.shape[1])
        at = 0
        while at < e.size:
            end = e.size if self._beginning is None else min(e.size, at + self._beginning.missing)
            new = slice(at, end)
            e[new] = self._take(u[:, new], y[0, new])
            if self._beginning is not None:
                self._begin_with(self._beginning, u[:, new], y[0, new])
            at = end
        return e * self.output_size

    def _take(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """Take in samples, `(nu, m)` and `(m,)`; return the scaled errors of the predictions."""
        from ultraquiet.identify.recursive.kernels import recurse

        e = np.empty(y.size)
        recurse(
            np.ascontiguousarray(u / self.input_size[:, None]), y / self.output_size, self._table, self._base,
            self._degree, self._lag, self._offset, self._theta, self._R, self._z, self._best, self._work, self._head,
            self._count, self._options, e,
        )  # fmt: skip
        # The errors' mean square over the same memory as the information.
        new = e[max(0, e.size - max(0, self.samples - self._options[0])) :]
        if new.size:
            fade = (1.0 - self._share) ** new.size
            self._squares = fade * self._squares + float(new @ new)
            self._weight = fade * self._weight + new.size
        return e

    def _begin_with(self, beginning: Beginning, u: FloatArray, y: FloatArray) -> None:
        """Keep the first samples; once they are enough, begin again from their batch fit."""
        beginning.take(u, y)
        if beginning.missing:
            return
        start = beginning.fit()
        if start is None:
            beginning.forget_silence()
        else:
            self._begin_again(*start, *beginning.samples)
        if beginning.over:
            self._beginning = None

    def _begin_again(self, start: PolynomialModel, constant: float, u: FloatArray, y: FloatArray) -> None:
        """Forget all, take over a model and learn from it the samples it was fitted to, `(nu, m)` and `(m,)`."""
        samples = self.samples
        for array in (self._R, self._z, self._best, self._work):
            array[:] = 0.0
        self._squares, self._weight = 0.0, 0.0
        self._begin(start, constant)
        # Steps cut short on the way to a model that is dropped say nothing of the next one.
        self._count[:] = 0, 0, self._head, 0
        self._options = (int(SETTLING * y.size), y.size, *self._options[2:])
        self._take(u, y)
        self._count[[0, 3]] = samples  # with the silence that was waited out

    @property
    def noise_variance(self) -> float:
        """Mean squared prediction error over the memory, squared output units."""
        return self._squares / max(self._weight, 1.0) * self.output_size**2

    @property
    def coefficients(self) -> FloatArray:
        """Present coefficients `(p,)` in the order a, b_1, f_1, ..., c, d, units of the record."""
        return self._to_shift @ self._theta

    @property
    def deviation(self) -> FloatArray:
        """Their standard deviations; infinite while nothing is known of one."""
        from ultraquiet.identify.recursive.kernels import deviations

        with np.errstate(invalid="ignore"):
            spread = deviations(self._R, self._to_shift) * np.sqrt(self._squares / max(self._weight, 1.0))
        return np.where(np.isnan(spread), np.inf, spread)

    @property
    def covariance(self) -> FloatArray:
        """Covariance `(p, p)` of the coefficients."""
        root = self._to_shift @ np.linalg.pinv(self._R)
        return self._squares / max(self._weight, 1.0) * root @ root.T

    @property
    def model(self) -> PolynomialModel:
        """The present model."""
        now = Trajectory(
            np.zeros(1), self.coefficients[None], self.deviation[None], self.structure, self.input_size.size,
            self.rate_hz,
        )  # fmt: skip
        m = now.model()
        f, c, d = [settled(x) for x in m.f], settled(m.c), settled(m.d)
        return PolynomialModel(m.b, f, self.rate_hz, m.a, c, d, self.noise_variance)

    def _expansion(self, p: int) -> FloatArray:
        """Return the matrix from the delta basis, scaled, to powers of q^-1 in units of the record."""
        out, at = np.zeros((p - int(self._offset), p)), 0
        for row in self._rows():
            n = int(self._degree[row])
            j = (row - ROW_FIRST) // 2
            is_b = row >= ROW_FIRST and (row - ROW_FIRST) % 2 == 0
            scale = self.output_size / self.input_size[j] if is_b else 1.0
            for k in range(n):
                for m in range(k + 1):
                    out[at + m, at + k] = scale * (-1.0) ** m * comb(k, m)
            at += n
        return out

    def _rows(self) -> Iterator[int]:
        yield 0
        yield from range(ROW_FIRST, self._degree.size)
        yield from (1, 2)

    def _begin(self, start: PolynomialModel, constant: float) -> None:
        """Take over a model of the same structure, and the constant at the output."""
        from ultraquiet.identify.recursive.kernels import table_of

        parts = [start.a[1:]]
        for j, (b, f) in enumerate(zip(start.b, start.f, strict=True)):
            first = int(self._lag[ROW_FIRST + 2 * j])
            parts += [b[first:], f[1:]]
        parts += [start.c[1:], start.d[1:]]
        wanted = [int(self._degree[row]) for row in self._rows()]
        if [x.size for x in parts] != wanted:
            raise InputError(
                f"Recursion: the start has {[x.size for x in parts]} coefficients in a, b, f, ..., c, d, the method "
                f"{wanted}; start from a model of the same orders."
            )
        p = len(self._to_shift)
        self._theta[:p] = np.linalg.solve(self._to_shift[:, :p], np.concatenate(parts))
        if self._offset:
            self._theta[-1] = self._work[-1, 0] = constant / self.output_size
        table_of(self._theta, self._base, self._degree, self._table)
        self._z[:] = self._R @ self._theta
