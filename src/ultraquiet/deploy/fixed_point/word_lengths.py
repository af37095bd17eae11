"""What each word length and form would make of a controller: one table to choose by."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import one_of, positive
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.fixed_point.law import WORDS, FixedLaw
from ultraquiet.deploy.fixed_point.ranges import command_limits
from ultraquiet.deploy.fixed_point.scaling import fixed_law
from ultraquiet.deploy.law.coordinates import balanced
from ultraquiet.deploy.law.form_choice import TOLERANCE, error_of, loop_radius, sensitivities
from ultraquiet.deploy.law.kind import require_law
from ultraquiet.deploy.law.law import DTYPES, Law, require_plant
from ultraquiet.deploy.law.realisation import FORMS, realisation
from ultraquiet.deploy.law.rounding import rounded
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

PRECISIONS = ("float64", "float32", "q31", "q15")
FIXED_FORMS = (("modal", "l1"), ("delta", "l1"), ("modal", "l2"), ("delta", "l2"))
BEST_FIRST = (StatusWord.OK, StatusWord.INEXACT, StatusWord.UNSTABLE, StatusWord.REFUSED)


@dataclass(frozen=True)
class WordLength(Shown):
    """A controller in one precision and form.

    `error` is the largest relative change of the response, or of the loop's sensitivity when a plant was given;
    `degradation_db` how much louder the loop becomes where it loses most, in the worst direction, against the largest
    singular value of S before (None without a plant, infinite when the loop becomes unstable); `loop_radius` the
    largest pole of that loop. `overflow` is the proven bound on a state over its range (fixed point), or the largest
    coefficient over the largest number; `noise_v` the rms of rounding noise in the commands (None for floats).
    """

    precision: str
    form: str
    status: Status
    error: float | None = None
    degradation_db: float | None = None
    loop_radius: float | None = None
    overflow: float | None = None
    noise_v: float | None = None
    multiply_adds: int | None = None
    coefficient_bytes: int | None = None

    def __str__(self) -> str:
        figures = [self.error, self.degradation_db, self.overflow, self.noise_v, self.multiply_adds]
        cells = ["-" if value is None else f"{value:.3g}" for value in figures]
        return f"{self.precision:8} {self.form:11} {self.status.word:9} " + " ".join(f"{c:>10}" for c in cells)


def word_lengths(
    controller: StateSpace,
    plant: StateSpace | None = None,
    *,
    precisions: Sequence[str] = PRECISIONS,
    input_v: float | None = None,
    output_v: ArrayLike | None = None,
    tolerance: float = TOLERANCE,
) -> tuple[WordLength, ...]:
    """Return what rounding costs, for each precision and each form the law has; best first within a precision.

    Args:
        controller: discrete law from measurements to commands, u = K y.
        plant: G of the loop y = G u; when given the loop is judged, not the law alone.
        precisions: some of `float64`, `float32`, `q31`, `q15`.
        input_v: full range of a measurement in fixed point, in its unit; the largest of the law's own when absent.
        output_v: full range of a command there, or limits of each, as `generate_fixed` takes them; the smallest of the
            law's own channels when absent.
        tolerance: largest relative error, and largest rounding noise over the range, that counts as `ok`.

    Returns:
        Rows of status `ok`, `inexact`, `unstable` or `refused`, each with a sentence; fixed point is refused where
        nobody states a range.

    Raises:
        InputError: a law in continuous time, a loop that is not stable to begin with, ranges that are not positive.

    >>> law = StateSpace([[0.9, 0.1], [-0.1, 0.9]], [[0.1], [0.0]], [[1.0, 0.0]], [[0.0]], rate_hz=3500.0)
    >>> [(w.precision, w.status.word) for w in word_lengths(law, precisions=("float32", "q31"))[:1]]
    [('float32', 'ok')]
    """
    if not isinstance(controller, StateSpace) or controller.rate_hz is None:
        raise InputError("word_lengths: the controller must be a StateSpace in discrete time.")
    positive("word_lengths", "input_v", 1.0 if input_v is None else input_v)
    if output_v is not None:
        command_limits("word_lengths", controller, output_v)
    require_plant(plant)
    if not isinstance(precisions, Sequence):
        raise InputError(f"word_lengths: 'precisions' must list some of {', '.join(PRECISIONS)}, got {precisions!r}.")
    require_law(controller, plant)
    controller, plant = balanced(controller), None if plant is None else balanced(plant)
    before = 0.0 if plant is None else loop_radius(plant, controller)
    if before >= 1.0:
        raise InputError(
            f"word_lengths: the loop with the controller as it is has a pole of magnitude {before:.6f}, so there is no"
            " attenuation to lose; give the plant it was designed for."
        )
    judge = _Judge(controller, plant, tolerance)
    rows: list[WordLength] = []
    for precision in precisions:
        one_of("word_lengths", "precisions", precision, PRECISIONS)
        if precision in WORDS:
            each = [_fixed(judge, precision, form, s, input_v, output_v) for form, s in FIXED_FORMS]
        else:
            each = [_floating(judge, precision, form) for form in FORMS]
        rows += sorted(each, key=_order)
    return tuple(rows)


class _Judge:
    """Judges rounded laws against one controller, in one loop or alone."""

    def __init__(self, controller: StateSpace, plant: StateSpace | None, tolerance: float) -> None:
        self.controller, self.plant, self.tolerance = controller, plant, tolerance
        self.rate_hz = float(controller.rate_hz or 0.0)

    def row(self, precision: str, form: str, rounded: StateSpace, noise: float, **figures: Any) -> WordLength:
        """Return the row of a rounded law; `noise` is its share of the range."""
        error = error_of(rounded, self.controller, self.plant)
        loss = radius = None
        if self.plant is not None:
            radius = loop_radius(self.plant, rounded)
            loss = np.inf if radius >= 1.0 else degradation_db(rounded, self.controller, self.plant)
        return WordLength(precision, form, self._status(rounded, error, noise, loss), error, loss, radius, **figures)

    def _status(self, rounded: StateSpace, error: float, noise: float, loss: float | None) -> Status:
        if not np.isfinite(error) or (self.controller.is_stable() and not rounded.is_stable()):
            return Status(StatusWord.UNSTABLE, f"The {'law' if loss is None else 'loop'} is no longer stable.")
        what = "response" if loss is None else "sensitivity"
        more = "" if loss is None else f", the loop by at most {loss:.1e} dB"
        sentence = f"The {what} changes by {error:.1e} of its size{more}; noise takes {noise:.1e} of the range."
        return Status(StatusWord.OK if max(error, noise) <= self.tolerance else StatusWord.INEXACT, sentence)


def degradation_db(rounded: StateSpace, controller: StateSpace, plant: StateSpace) -> float:
    """Return max over frequency of 20 log10 (||S_r|| / ||S||), spectral norms, S = (I - G K)^-1."""
    before, after = sensitivities(controller, rounded, plant)
    return float(20.0 * np.log10(np.linalg.norm(after, 2, axis=(1, 2)) / np.linalg.norm(before, 2, axis=(1, 2))).max())


def _floating(judge: _Judge, precision: str, form: str) -> WordLength:
    limits = np.tile([-np.inf, np.inf], (judge.controller.D.shape[0], 1))
    try:
        parts = realisation(judge.controller, form)
        order = judge.controller.states
        law = rounded(parts, None, limits, precision, rate_hz=judge.rate_hz, order=order)
    except InputError as refusal:
        return WordLength(precision, form, Status(StatusWord.REFUSED, str(refusal)))
    largest = max((float(np.abs(m).max(initial=0.0)) for m in (*law.blocks, law.B, law.C, law.D)), default=0.0)
    return judge.row(
        precision,
        form,
        law.state_space(),
        0.0,
        overflow=largest / float(np.finfo(DTYPES[precision]).max),
        multiply_adds=multiply_adds(law),
        coefficient_bytes=multiply_adds(law) * np.dtype(law.dtype).itemsize,
    )


def multiply_adds(law: Law) -> int:
    """Return the multiply-adds of a step without anti-windup, each with its own coefficient."""
    gains = law.B.size + law.C.size + law.D.size
    if law.channels:
        turns = sum(T.size for T in (law.turn_in, law.turn_out) if T is not None)
        gains = 2 * law.states + len(law.channels) + turns
    return sum(block.size for block in law.blocks) + gains


def _fixed(
    judge: _Judge, word: str, form: str, scaling: str, input_v: float | None, output_v: ArrayLike | None
) -> WordLength:
    name = form if scaling == "l1" else f"{form} {scaling}"
    try:
        law: FixedLaw = fixed_law(judge.controller, word, form, scaling=scaling, input_v=input_v, output_v=output_v)
    except InputError as refusal:
        return WordLength(word, name, Status(StatusWord.REFUSED, str(refusal)))
    noise = float(law.noise_v.max())
    return judge.row(
        word,
        name,
        law.state_space(),
        noise / law.output_v,
        overflow=law.peak,
        noise_v=noise,
        multiply_adds=law.multiply_adds,
        coefficient_bytes=law.coefficient_bytes,
    )


def _order(row: WordLength) -> tuple[bool, int, float]:
    rank = BEST_FIRST.index(row.status.word)
    return rank > 0, rank, float(row.multiply_adds or 0) if rank == 0 else row.error or 0.0
