"""Polynomial models by minimising the one-step prediction error: ARX, ARMAX, output error, Box-Jenkins."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from ultraquiet._base.constraints import one_of, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet.files import LongRecord
from ultraquiet.identify.prediction_error.fit import Fit, Search, fit_channel
from ultraquiet.identify.prediction_error.initial_models import Channel, starting_models
from ultraquiet.identify.prediction_error.parameterisation import Layout, check_known, each, laid_out
from ultraquiet.identify.prediction_error.simulation_focus import FOCUSES, fit_focused
from ultraquiet.identify.prediction_error.structure import Structure
from ultraquiet.identify.record_checks import exciting, usable
from ultraquiet.identify.result import Result, worst
from ultraquiet.values import PolynomialMatrix, Record, StateSpace

HIGHEST_ORDER = 30
LONGEST_DELAY = 1000
# Block rows of the starting subspaces. 40 alone finds the minimum of the 3.5 kHz reference truth in 98 of 100 records;
# on records of the simulated hexapod no single one does in more than 3 of 4 channels, these six together in 79 of 84.
HORIZONS = (40, 20, 10, 30, 60, 80)


@dataclass(frozen=True)
class PolynomialMethod:
    """Settings all polynomial structures share.

    The coefficients minimise V = 1/n sum_t e(t)^2, e = (D/C)(A y - sum_j B_j / F_j u_j), by Levenberg-Marquardt on the
    filtered gradient. C, D and F keep their roots inside the unit circle at every accepted step.

    Args:
        order: number of free coefficients of every polynomial.
        delay: samples from an input to its first effect (1: no direct feedthrough), one for all inputs or one for each.
        b_order: number of coefficients of B when it differs from `order`; likewise.
        horizons: block rows of the subspace models that the search starts from, the most trusted first. A longer one
            sees slower modes, a shorter one is steadier.
        initial: "estimate" fits the past before the first sample, "rest" takes it as zero. Zero inflates the loss 2 to
            183 times at 3.5 kHz when the noise had begun before the record.
        offset: whether a constant at the output is fitted too.
        max_iterations: accepted steps before the search gives up.
        repair: whether readings at a sensor's limits (`Channel.low`, `Channel.high`) are taken for what they are: the
            truth lies further out. They are replaced by the model's own output, in rounds. `details["repaired"]` counts
            them; `fit_percent` is then judged on the model's output cut at the same limits.
        zeros_at_dc: known zeros at z = 1, B = (1 - q^-1)^k B': a geophone does not see what stands still. They count
            among the coefficients of B.
        known_poles: poles in z that every denominator is known to have, in conjugate pairs.
        fixed: whole polynomials that are known, {"c": [1.0, -0.9]} for instance, by the letters a, b, c, d, f.
    """

    name: ClassVar[str]

    order: int = 5
    delay: int | Sequence[int] = 1
    b_order: int | Sequence[int] | None = None
    horizons: tuple[int, ...] = HORIZONS
    initial: str = "estimate"
    offset: bool = True
    max_iterations: int = 100
    repair: bool = True
    zeros_at_dc: int = 0
    known_poles: Sequence[complex] = ()
    fixed: Mapping[str, Sequence[float]] | None = None

    def __post_init__(self) -> None:
        who = type(self).__name__
        whole(who, "order", self.order, 1, HIGHEST_ORDER)
        for delay in each(self.delay):
            whole(who, "delay", delay, 0, LONGEST_DELAY)
        for name in ("b_order", "c_order", "d_order", "f_order"):
            for value in each(getattr(self, name, None)):
                whole(who, name, value, 1 if name == "b_order" else 0, HIGHEST_ORDER)
        for rows in self.horizons:
            whole(who, "horizons", rows, 2)
        one_of(who, "initial", self.initial, ("estimate", "rest"))
        whole(who, "max_iterations", self.max_iterations, 1)
        check_known(self)

    def structure(self) -> Structure:
        """Return the numbers of coefficients."""
        raise NotImplementedError

    @property
    def informed(self) -> bool:
        """Whether inputs differ in order or delay, or parts of the polynomials are known."""
        settings = (self.delay, self.b_order, getattr(self, "f_order", None))
        return bool(
            any(isinstance(s, Sequence) for s in settings) or self.zeros_at_dc or len(self.known_poles) or self.fixed
        )

    def layout(self, inputs: int) -> Layout:
        """Return what is free and what is known of the polynomials of an output with so many inputs."""
        return laid_out(self, inputs)

    def for_input(self, j: int) -> Self:
        """Return the settings for input j alone."""
        given: dict[str, Any] = {name: getattr(self, name, None) for name in ("delay", "b_order", "f_order")}
        return replace(self, **{name: v[j] for name, v in given.items() if isinstance(v, Sequence)})

    def identify(
        self, record: Record | LongRecord | Sequence[Record], start: PolynomialMatrix | StateSpace | None = None
    ) -> Result:
        """Return one model per output of the record, driven by all its inputs.

        Several records of one plant go into one fit, each with its own past and constant; see `identify_joint`.
        A `files.LongRecord` is read from its file in blocks, one pass an iteration; see `identify_long`.
        With `start`, the model of an earlier record, each search begins from it and tries no other start unless it
        fails to converge: a refit takes a fraction of the steps. Its orders may be smaller than the method's.

        Raises:
            InputError: too few samples for the order, a constant input or output; a start that does not fit, or that
                is given for several records, a long one or known parts.
        """
        if start is not None and (self.informed or not isinstance(record, Record)):
            raise InputError(
                f"{type(self).__name__}: start is taken for one record in memory and unknown polynomials of one order; "
                f"leave it out for several records, a long one or known parts."
            )
        if isinstance(record, LongRecord):
            if self.informed:
                raise InputError(
                    f"{type(self).__name__}: known parts and settings per input need the record in memory; read it "
                    f"with its method `part`, or leave them out."
                )
            from ultraquiet.identify.prediction_error.long_record import identify_long

            return identify_long(self, record)
        if not isinstance(record, Record):
            from ultraquiet.identify.joint.identify import identify_joint

            return identify_joint(self, record)
        self.check(record)
        first = starting_models(start, len(record.sensors), 1, record.rate_hz)
        fits = [self.fit(Channel.of(record, i, row[0]), record.rate_hz) for i, row in enumerate(first)]
        made = Provenance(self.name, asdict(self), parents=(record.hash,), versions=versions())
        model = PolynomialMatrix([[f.model] for f in fits], record.actuators, record.sensors, made)
        return gather(model, fits, made)

    def check(self, record: Record) -> None:
        """Refuse a record that cannot carry this structure."""
        structure = self.structure()
        memory = structure.delay + structure.a + structure.d
        usable(type(self).__name__, record, structure.parameters(record.inputs.shape[0]), memory)
        exciting(type(self).__name__, record, structure.a + structure.b + structure.f)

    def fit(self, data: Channel, rate_hz: float) -> Fit:
        """Return the model of one output."""
        if self.informed:
            from ultraquiet.identify.joint.identify import fit_alone

            return fit_alone(self, data, rate_hz)
        return fit_channel(data, self.structure(), self.search(), rate_hz)

    def search(self) -> Search:
        """Return how the minimum is looked for."""
        return Search(self.horizons, self.initial == "estimate", self.offset, self.max_iterations, self.repair)

    def _b(self) -> int:
        return self.order if self.b_order is None else max(each(self.b_order))

    def _delay(self) -> int:
        return min(each(self.delay))


def gather(model: PolynomialMatrix, fits: list[Fit], made: Provenance) -> Result:
    """Put the fits of several outputs into one result."""
    return Result(
        model=model,
        status=worst([f.status for f in fits]),
        fit_percent=np.array([f.fit_percent for f in fits]),
        loss=np.array([f.loss for f in fits]),
        covariance=np.stack([f.covariance for f in fits]),
        whiteness_p=np.array([f.whiteness_p for f in fits]),
        correlation_p=np.array([f.correlation_p for f in fits]),
        iterations=np.array([f.iterations for f in fits]),
        statuses=tuple(f.status for f in fits),
        provenance=made,
        details={"starts": tuple(f.starts for f in fits), "repaired": tuple(f.repaired for f in fits)},
    )


@register("identify", "arx")
@dataclass(frozen=True)
class Arx(PolynomialMethod):
    """A y = B u + e, a linear least-squares problem.

    The noise is tied to the poles of the plant: with noise at the sensor the poles are biased, at 3.5 kHz beyond use.

    >>> import numpy as np, ultraquiet as uq
    >>> u = np.sign(np.sin(0.7 * np.arange(400) ** 1.2))
    >>> y = np.zeros(400)
    >>> for t in range(1, 400):
    ...     y[t] = 0.8 * y[t - 1] + 0.5 * u[t - 1]
    >>> result = uq.identify.Arx(order=1).identify(uq.Record(u, y, rate_hz=100.0))
    >>> result.model.rows[0][0].b[0].round(6).tolist(), result.model.rows[0][0].a.round(6).tolist()
    ([0.0, 0.5], [1.0, -0.8])

    Reference: Ljung, System Identification, 2nd ed., section 4.2.
    """

    name: ClassVar[str] = "arx"

    def structure(self) -> Structure:
        """Return the numbers of coefficients."""
        return Structure(self.order, self._b(), 0, 0, 0, self._delay())


@register("identify", "armax")
@dataclass(frozen=True)
class Armax(PolynomialMethod):
    """A y = B u + C e.

    `c_order` is the number of coefficients of C (the order when absent).

    Reference: Ljung, System Identification, 2nd ed., section 4.2.
    """

    name: ClassVar[str] = "armax"

    c_order: int | None = None

    def structure(self) -> Structure:
        """Return the numbers of coefficients."""
        c = self.order if self.c_order is None else self.c_order
        return Structure(self.order, self._b(), c, 0, 0, self._delay())


@register("identify", "output-error")
@dataclass(frozen=True)
class OutputError(PolynomialMethod):
    """y = B/F u + e: the model whose simulated output is nearest to the record.

    Reference: Ljung, System Identification, 2nd ed., section 4.2.
    """

    name: ClassVar[str] = "output-error"

    def structure(self) -> Structure:
        """Return the numbers of coefficients."""
        return Structure(0, self._b(), 0, 0, self.order, self._delay())


@register("identify", "box-jenkins")
@dataclass(frozen=True)
class BoxJenkins(PolynomialMethod):
    """y = B/F u + C/D e: plant and noise share nothing. The structure the paper settled on, at order five.

    `c_order`, `d_order`, `f_order` are the numbers of coefficients of C, D and F (the order when absent).
    `focus` is "prediction" (the one-step error alone), "simulation" (B and F by the simulated error, C and D by the
    one-step error of what remains; `covariance` is then NaN) or "auto": simulation for those outputs whose residual is
    not white and whose simulated fit gains by it, as happens on records of plants that no such model holds.

    Reference: section 3.2 of the paper; Ljung, System Identification, 2nd ed., section 4.2 and 10.3.
    """

    name: ClassVar[str] = "box-jenkins"

    c_order: int | None = None
    d_order: int | None = None
    f_order: int | Sequence[int] | None = None
    focus: str = "auto"

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("BoxJenkins", "focus", self.focus, FOCUSES)

    def fit(self, data: Channel, rate_hz: float) -> Fit:
        """Return the model of one output, for the wanted focus."""
        if self.informed:
            return super().fit(data, rate_hz)
        return fit_focused(data, self.structure(), self.search(), rate_hz, self.focus)

    def structure(self) -> Structure:
        """Return the numbers of coefficients."""
        c, d, f = (self.order if k is None else max(each(k)) for k in (self.c_order, self.d_order, self.f_order))
        return Structure(0, self._b(), c, d, f, self._delay())
