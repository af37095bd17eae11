"""Polynomial models by minimising the one-step prediction error: ARX, ARMAX, output error, Box-Jenkins."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import ClassVar

from ultraquiet._base.constraints import one_of
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet.files import LongRecord
from ultraquiet.identify.joint.identify import fit_alone, identify_joint
from ultraquiet.identify.prediction_error.disk.long_record import identify_long
from ultraquiet.identify.prediction_error.fit import FOCUSES, Fit, fit_channel, fit_focused
from ultraquiet.identify.prediction_error.initial_models import ChannelData, starting_models
from ultraquiet.identify.prediction_error.order_choice import told, with_order
from ultraquiet.identify.prediction_error.parameterisation import each
from ultraquiet.identify.prediction_error.result import gather
from ultraquiet.identify.prediction_error.settings import PolynomialSettings
from ultraquiet.identify.prediction_error.structure import Structure
from ultraquiet.identify.result import Result
from ultraquiet.values import PolynomialMatrix, Record, StateSpace
from ultraquiet.values.handed_over.kinds import takes_values


@dataclass(frozen=True)
class PolynomialMethod(PolynomialSettings):
    """A polynomial structure that is identified by its one-step prediction error."""

    @takes_values
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
            return identify_long(self, record)
        if not isinstance(record, Record):
            return identify_joint(self, record)
        first = starting_models(start, len(record.sensors), 1, record.rate_hz)
        method, words = with_order(self, [record])
        method.check(record)
        fits = [method.fit(ChannelData.of(record, i, row[0]), record.rate_hz) for i, row in enumerate(first)]
        provenance = Provenance(method.name, asdict(method), parents=(record.hash,), versions=versions())
        model = PolynomialMatrix([[f.model] for f in fits], record.actuators, record.sensors, provenance)
        return told(gather(model, fits, provenance), method, words)

    def fit(self, data: ChannelData, rate_hz: float) -> Fit:
        """Return the model of one output."""
        if self.informed:
            return fit_alone(self, data, rate_hz)
        return fit_channel(data, self.structure(), self.search(), rate_hz)


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
        return Structure(self.whole_order, self._b(), 0, 0, 0, self._delay())


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
        c = self.whole_order if self.c_order is None else self.c_order
        return Structure(self.whole_order, self._b(), c, 0, 0, self._delay())


@register("identify", "output-error")
@dataclass(frozen=True)
class OutputError(PolynomialMethod):
    """y = B/F u + e: the model whose simulated output is nearest to the record.

    Reference: Ljung, System Identification, 2nd ed., section 4.2.
    """

    name: ClassVar[str] = "output-error"

    def structure(self) -> Structure:
        """Return the numbers of coefficients."""
        return Structure(0, self._b(), 0, 0, self.whole_order, self._delay())


@register("identify", "box-jenkins")
@dataclass(frozen=True)
class BoxJenkins(PolynomialMethod):
    """y = B/F u + C/D e: plant and noise share nothing. The structure of the paper on SUITE, there of order five.

    `c_order`, `d_order`, `f_order` are the numbers of coefficients of C, D and F (the order when absent).
    `focus` is "prediction" (the one-step error alone), "simulation" (B and F by the simulated error, C and D by the
    one-step error of what remains) or "auto": simulation for those outputs whose residual is
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

    def fit(self, data: ChannelData, rate_hz: float) -> Fit:
        """Return the model of one output, for the wanted focus."""
        if self.informed:
            return super().fit(data, rate_hz)
        return fit_focused(data, self.structure(), self.search(), rate_hz, self.focus)

    def structure(self) -> Structure:
        """Return the numbers of coefficients."""
        given = (self.c_order, self.d_order, self.f_order)
        c, d, f = (self.whole_order if k is None else max(each(k)) for k in given)
        return Structure(0, self._b(), c, d, f, self._delay())
