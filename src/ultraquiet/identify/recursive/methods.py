"""Models that follow a plant while it drifts: recursive ARX, ARMAX and Box-Jenkins with forgetting."""

from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import one_of, positive, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet.files import LongRecord
from ultraquiet.identify.polynomial.methods import Armax, Arx, BoxJenkins, OutputError, PolynomialMethod
from ultraquiet.identify.prediction_error import race
from ultraquiet.identify.prediction_error.disk.long_record import simulated_fit
from ultraquiet.identify.prediction_error.initial_models import ChannelData
from ultraquiet.identify.prediction_error.order_choice import told, unasked
from ultraquiet.identify.prediction_error.settings import HIGHEST_ORDER, NOT_ASKED
from ultraquiet.identify.recursive.beginning import LONGEST, constant_at_output
from ultraquiet.identify.recursive.estimator import Recursion
from ultraquiet.identify.recursive.followed import Followed, LevelsOfSignals, blocks_of, starting_piece, with_evidence
from ultraquiet.identify.recursive.settings import FORGETTING, RecursionSettings
from ultraquiet.identify.recursive.trajectory import Trajectory
from ultraquiet.identify.result import Result, worst
from ultraquiet.linalg import prediction
from ultraquiet.linalg.lagged import Lagged
from ultraquiet.values import PolynomialMatrix, PolynomialModel, Record
from ultraquiet.values.handed_over.kinds import takes_values


@dataclass(frozen=True)
class RecursiveMethod:
    """Settings all recursive methods share.

    Every sample moves the coefficients by a Gauss-Newton step R theta = z, where R'R gathers the gradients' products
    with the weight exp(-(t - s) / memory): the recursive prediction-error method. R is kept triangular by rotations.

    Args:
        order: number of free coefficients of every polynomial.
        delay: samples from an input to its first effect.
        memory_s: time constant of forgetting; None forgets nothing, and the last model is that of the whole record.
        forgetting: "exponential" forgets all alike, but never below a hundredth of the most that was ever known, so
            that a plant at rest cannot wind the gain up; "directional" forgets only what the new sample tells again.
        reset_s: time between resets of the information to a hundredth of the most that was known; None never.
        start_samples: length of the piece at the record's beginning whose batch fit the recursion starts from, half of
            the record at most; 0 starts from nothing, and the record is read once: ARX learns from the first sample on,
            the others begin from a batch fit of the first ten samples a parameter, which is repeated each time the
            samples have doubled, up to 2048, the memory or half of the record.
        every: samples between points of the trajectory.
        offset: whether a constant at the output is followed too. The levels about which the signals of the start move
            are then left out of what is followed: filters that begin at rest would take them for a step.

    Returns of `identify`: the last model. `loss` is the mean squared error of the predictions as they were made, after
    the start; whiteness and correlation are those of the same errors. `fit_percent` simulates the whole record with the
    last model. `details["trajectory"]` holds one `Trajectory` per output.

    From nothing, 40 draws each of ARMAX, ARMAX with a resonant C, Box-Jenkins and output error, of order 2 and 4000
    samples, end 0.2 standard deviations from the batch estimate in the median and at most 0.8. A recursion from zero
    coefficients that forgets its first steps ended beyond 4 in 16 of the 160: gradients of a wrong model pass through
    its C and F, and a pseudo-linear regression is sure to find the way only where 1/C - 1/2 is positive real.

    Reference: Ljung, System Identification, 2nd ed., sections 11.2 to 11.6; Cao and Schwartz 2000,
    doi:10.1016/S0005-1098(99)00174-0 (directional); Ljung 1977, doi:10.1109/TAC.1977.1101552 (positive real C).
    """

    name: ClassVar[str]
    batch_type: ClassVar[type[PolynomialMethod]]

    order: int = NOT_ASKED
    delay: int = 1
    memory_s: float | None = None
    forgetting: str = "exponential"
    reset_s: float | None = None
    start_samples: int = 4096
    every: int = 350
    offset: bool = True

    def __post_init__(self) -> None:
        who = type(self).__name__
        whole(who, "order", self.order, 1, HIGHEST_ORDER)
        self.batch()  # refuses delays, and orders of its own
        one_of(who, "forgetting", self.forgetting, FORGETTING)
        for name in ("memory_s", "reset_s"):
            if getattr(self, name) is not None:
                positive(who, name, getattr(self, name), "s")
        whole(who, "start_samples", self.start_samples, 0)
        whole(who, "every", self.every, 1)

    def batch(self) -> PolynomialMethod:
        """Return the method that fits the same structure to a whole record."""
        return self.batch_type(order=self.order, delay=self.delay, offset=self.offset)

    @takes_values
    def identify(self, record: Record | LongRecord) -> Result:
        """Return the last model of a record, one per output, and the way there.

        Raises:
            InputError: too few samples for the order, a constant input or output.
        """
        piece = starting_piece(record, min(record.samples // 2, self.start_samples))
        self.batch().check(record if isinstance(record, Record) else piece)
        provenance = Provenance(self.name, asdict(self), parents=(record.hash,), versions=versions())
        followed = [self._follow(record, i, piece) for i in range(len(record.sensors))]
        model = PolynomialMatrix([[f.model] for f in followed], record.actuators, record.sensors, provenance)
        found = Result(
            model=model,
            status=worst([f.status for f in followed]),
            fit_percent=np.array([f.fit_percent for f in followed]),
            loss=np.array([f.model.noise_variance for f in followed]),
            covariance=np.stack([f.covariance for f in followed]),
            whiteness_p=np.array([f.whiteness_p for f in followed]),
            correlation_p=np.array([f.correlation_p for f in followed]),
            iterations=np.zeros(len(followed), dtype=np.int64),
            statuses=tuple(f.status for f in followed),
            provenance=provenance,
            details={
                "trajectory": tuple(f.trajectory for f in followed),
                "held_steps": tuple(f.steps_cut_short for f in followed),
            },
        )
        return told(found, self.batch(), unasked(self.order))

    def recursion(
        self, rate_hz: float, input_size: ArrayLike, output_size: float, start: PolynomialModel | None = None
    ) -> Recursion:
        """Return the running estimator of one output, for samples as they come.

        Args:
            rate_hz: samples per second.
            input_size: `(nu,)` typical sizes of the inputs, in their units.
            output_size: the same of the output.
            start: the model to begin from; none begins from nothing, as `start_samples=0` does: the samples that
                complete one of the first fits take as long as it.

        >>> import numpy as np, ultraquiet as uq
        >>> method = uq.identify.RecursiveArx(order=1, start_samples=0, offset=False)
        >>> running = method.recursion(rate_hz=100.0, input_size=[1.0], output_size=1.0)
        >>> u, y = np.random.default_rng(0).standard_normal(50), 0.0
        >>> for t in range(1, 50):
        ...     y = 0.8 * y + 0.5 * u[t - 1]
        ...     error = running.update([[u[t]]], [[y]])
        >>> running.model.a.round(6).tolist()
        [1.0, -0.8]
        """
        sizes = np.atleast_1d(np.asarray(input_size, dtype=float)), output_size
        return Recursion(self.recursion_settings(), rate_hz, *sizes, start)

    def recursion_settings(self) -> RecursionSettings:
        """Return what the running estimator needs of the method."""
        batch = self.batch()
        return RecursionSettings(
            batch.structure(), batch.search(), self.offset, self.memory_s, self.forgetting, self.reset_s
        )

    def _follow(self, record: Record | LongRecord, output: int, piece: Record) -> "Followed":
        """Follow one output through the record."""
        start, constant, start_samples = None, 0.0, 0
        about = LevelsOfSignals.of(piece, output) if self.offset else LevelsOfSignals.none(len(record.actuators))
        if self.start_samples:
            start = self.batch().fit(ChannelData.of(piece, output), record.rate_hz).model
            u, y = about.left(piece.inputs, piece.outputs[output])
            constant = constant_at_output(start, u, y) if self.offset else 0.0
            start_samples = piece.samples
        sizes = piece.inputs.std(axis=1), float(piece.outputs[output].std())
        longest = min(LONGEST, record.samples // 2)
        running = Recursion(self.recursion_settings(), record.rate_hz, *sizes, start, start_samples, constant, longest)
        if record.samples <= running.judged_from:
            raise InputError(
                f"{type(self).__name__}: all {record.samples} samples of the record go into the first model, and none "
                f"is left to judge it by; record more than {running.judged_from}, or lower the order."
            )
        lags = min(race.TEST_LAGS, (record.samples - running.judged_from) // 10)
        sums, points = Lagged(2 + len(record.actuators), lags), []
        title = f"{self.name} of {record.sensors[output].name}"
        with task(title, record.samples) as progress:
            for u, y in (about.left(*block) for block in blocks_of(record, output, self.every)):
                before = running.samples
                e = running.update(u, y)
                judged = max(0, running.judged_from - before)
                sums.add(np.vstack([e, u, y])[:, judged:])
                points.append((running.samples / record.rate_hz, running.coefficients, running.deviation))
                progress.advance(u.shape[1])
        time_s, coefficients, deviation = (np.array(x) for x in zip(*points, strict=True))
        inputs = len(record.actuators)
        trajectory = Trajectory(time_s, coefficients, deviation, running.structure, inputs, record.rate_hz)
        return with_evidence(running, trajectory, sums, _fit_percent(self, record, output, running.model))


@register("identify", "recursive-arx")
@dataclass(frozen=True)
class RecursiveArx(RecursiveMethod):
    """A y = B u + e by recursive least squares: without forgetting, after every sample the batch estimate itself.

    >>> import numpy as np, ultraquiet as uq
    >>> u = np.sign(np.sin(0.7 * np.arange(400) ** 1.2))
    >>> y = np.zeros(400)
    >>> for t in range(1, 400):
    ...     y[t] = 0.8 * y[t - 1] + (0.5 if t < 200 else 1.0) * u[t - 1]
    >>> method = uq.identify.RecursiveArx(order=1, memory_s=0.2, every=100)
    >>> trajectory = method.identify(uq.Record(u, y, rate_hz=100.0)).details["trajectory"][0]
    >>> trajectory.coefficients[[1, 3], 1].round(2).tolist()
    [0.5, 1.0]

    Reference: Ljung, System Identification, 2nd ed., section 11.2.
    """

    name: ClassVar[str] = "recursive-arx"
    batch_type: ClassVar[type[PolynomialMethod]] = Arx

    start_samples: int = 0


@register("identify", "recursive-armax")
@dataclass(frozen=True)
class RecursiveArmax(RecursiveMethod):
    """A y = B u + C e by the recursive prediction-error method (recursive maximum likelihood), C kept invertible.

    Reference: Ljung, System Identification, 2nd ed., section 11.4.
    """

    name: ClassVar[str] = "recursive-armax"
    batch_type: ClassVar[type[PolynomialMethod]] = Armax


@register("identify", "recursive-box-jenkins")
@dataclass(frozen=True)
class RecursiveBoxJenkins(RecursiveMethod):
    """y = B/F u + C/D e by the recursive prediction-error method; F, C and D stay stable at every sample.

    `c_order` and `d_order` are the numbers of coefficients of C and D (the order when absent). Keep them no higher than
    the noise needs: a noise model with poles to spare takes what a moving resonance leaves, and the resonance is lost;
    so it is when it moves by more than its half-width within the memory. The verdict then says `not white`; shorten the
    memory, or take `RecursiveOutputError`.

    Reference: Ljung, System Identification, 2nd ed., section 11.4.
    """

    name: ClassVar[str] = "recursive-box-jenkins"
    batch_type: ClassVar[type[PolynomialMethod]] = BoxJenkins

    c_order: int | None = None
    d_order: int | None = None

    def batch(self) -> PolynomialMethod:
        """Return the method that fits the same structure to a whole record."""
        return BoxJenkins(
            order=self.order, delay=self.delay, offset=self.offset, c_order=self.c_order, d_order=self.d_order
        )


@register("identify", "recursive-output-error")
@dataclass(frozen=True)
class RecursiveOutputError(RecursiveMethod):
    """y = B/F u + e by the recursive prediction-error method; F stays stable at every sample.

    The sturdiest in tracking a resonance: it has no noise model that could take its movement for noise.

    Reference: Ljung, System Identification, 2nd ed., section 11.4.
    """

    name: ClassVar[str] = "recursive-output-error"
    batch_type: ClassVar[type[PolynomialMethod]] = OutputError


def _fit_percent(method: RecursiveMethod, record: Record | LongRecord, output: int, model: PolynomialModel) -> float:
    """Return the simulated fit of the last model on the whole record."""
    if isinstance(record, LongRecord):
        return simulated_fit(record, output, model, method.offset)
    denominators = [model.denominator(j) for j in range(len(model.b))]
    y = record.outputs[output]
    return prediction.fit_percent(y, prediction.simulate(record.inputs, y, model.b, denominators, offset=method.offset))
