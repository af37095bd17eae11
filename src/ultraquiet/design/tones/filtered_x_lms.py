"""Multi-error filtered-x LMS: feedforward from a reference that hears the disturbance before the errors do."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, positive, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import formerly, register
from ultraquiet._base.threads import single_threaded
from ultraquiet.design.result import STABLE_WORDS, DesignResult
from ultraquiet.design.robustness import StatedRobustness
from ultraquiet.design.tones.adaptive_law import (
    GRID,
    AdaptiveLaw,
    adapting,
    contiguous,
    largest_regressor,
    limits_of,
    without_faint_states,
)
from ultraquiet.design.tones.inner_loop import Around, Inner, inner_loop
from ultraquiet.design.verification import judged
from ultraquiet.linalg.response import principal_gains
from ultraquiet.values.door import takes_systems
from ultraquiet.values.interconnect import gain
from ultraquiet.values.state_space import StateSpace

QUIETEST = 1e-5  # filtered references below this share of the largest carry nothing to learn from
FAINTEST = 1e-16  # of the largest gain: what rounding leaves of a direction that is not there


@register("design", "filtered-x")
@formerly(limit_v="limit")
@dataclass(frozen=True)
class FilteredXLms(StatedRobustness):
    """Feedforward through adaptive filters W from reference readings x: u = W x, leaky, normalised, all errors at once.

    w+ = (1 - leak) w - step F' (F F' + floor)^-1 e, e = y0 + F w: F holds the references filtered by the plant, one
    window for each error, y0 the errors without the law. Normalised by the matrix F F', the step converges in the mean
    for 0 < step < 2 on the true model, in every direction that a sample's errors tell as fast as in the strongest. Of a
    single tone that one strong actuator answers, they tell little of a weak one: that waits, longest near 0 and 2. What
    the commands do to the references is taken out by the model.

    differs from the textbook: the references are filtered by the identified state space itself, balanced, because a
    finite response of a lightly damped structure would need thousands of taps; the error is the modified one, y0 + F w,
    which frees the step from the plant's delay.

    Args:
        reference: which readings are references, counted from 0; negative from the end. Empty means that the last one
            of several is; the only reading of a plant is its own reference and error.
        errors: which readings are to be quiet; all others when empty.
        drives: which actuators are used; all when empty.
        taps: length of each filter, samples.
        step: share of the error that goes in each sample, below 2.
        leak: share of the weights forgotten per second.
        limit: largest command per actuator, in its unit; its own when absent.
        around: K0, a `StateSpace` or the name of a design method.

    >>> plant = StateSpace([[0.9]], [[0.1]], [[1.0], [0.0]], [[0.0], [0.0]], rate_hz=1000.0)
    >>> result = FilteredXLms(reference=(1,), taps=8, limit=5.0).design(plant)
    >>> result.details["step_bound"], result.law.step([0.0, 1.0]).tolist()
    (2.0, [0.0])

    Elliott, Stothers and Nelson 1987, doi:10.1109/TASSP.1987.1165044; Elliott 2001, Signal Processing for Active
    Control, sections 5.3 to 5.5.
    """

    reference: tuple[int, ...] = ()
    errors: tuple[int, ...] = ()
    drives: tuple[int, ...] = ()
    taps: int = 256
    step: float = 0.02
    leak: float = 0.01
    limit: float | tuple[float, ...] | None = None
    around: Around = None

    asks_limit: ClassVar[bool] = True  # a study gives it what it knows

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("FilteredXLms", "taps", self.taps, 2)
        between("FilteredXLms", "leak", self.leak, 0.0, 1e3)
        if not positive("FilteredXLms", "step", self.step) < STEP_BOUND:
            raise InputError(f"FilteredXLms: 'step' must be below 2 to converge, got {self.step:g}.")

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the law of a discrete plant, whose outputs are errors and references: `law` adapts.

        `controller` is the law at rest, K0 or zero. `details`: `errors`, `references`, `drives` as indices,
        `step_bound`, above which the mean of the weights diverges, `condition`, the largest ratio of the plant's
        singular values over frequency, by which a law with one step for all directions would be slower, `model_states`.

        Raises:
            InputError: no such reading or actuator, none left to be quiet, an unstable plant, no gain to the errors, an
                actuator without a limit.
        """
        who = "FilteredXLms"
        inner = inner_loop(who, plant, self.around)
        ny, nu = plant.D.shape
        references, errors, drives = self._channels(ny, nu)
        rows = [*errors, *references]
        G = inner.seen
        assert G.rate_hz is not None
        part = StateSpace(G.A, G.B[:, drives], G.C[rows], G.D[np.ix_(rows, drives)], G.rate_hz)
        f_hz = np.linspace(0, G.rate_hz / 2, GRID + 2)[1:-1]
        gains = principal_gains(part.frequency_response(f_hz)[: len(errors)])
        if not gains.max() > 0:
            raise InputError(f"{who}: the actuators do not reach readings {errors}; nothing can be cancelled.")
        limit = limits_of(who, self.limit, plant.actuators)
        model = without_faint_states(part)
        details: dict[str, Any] = {
            "errors": errors,
            "references": references,
            "drives": drives,
            "step_bound": STEP_BOUND,
            # directions within rounding of the largest gain are none
            "condition": float((gains[0] / np.maximum(gains[-1], FAINTEST * gains[0].max())).max()),
            "model_states": model.states,
        }
        rest = inner.joined(gain(np.zeros((nu, ny)), G.rate_hz))
        result = judged(plant, rest, self, float("nan"), float("nan"), {}, details)
        if result.controller is None or result.status.word not in STABLE_WORDS:
            return result
        law = FilteredXLaw(self, inner, model, (errors, references, drives), limit, result.controller)
        return adapting(result, law)

    def _channels(self, ny: int, nu: int) -> tuple[list[int], list[int], list[int]]:
        references = _indices("reference", self.reference, ny) or [ny - 1]
        others = [k for k in range(ny) if k not in references]
        if not others and not self.reference:
            others = [ny - 1]
        errors = _indices("errors", self.errors, ny) or others
        if not errors:
            raise InputError(f"FilteredXLms: all {ny} readings are references, so none is left to be quiet.")
        return references, errors, _indices("drives", self.drives, nu) or list(range(nu))


STEP_BOUND = 2.0  # of a projection: |1 - step| < 1


class FilteredXLaw(AdaptiveLaw):
    """The law that runs; `weights` are the filters now, `(drives, references, taps)`, newest sample first."""

    def __init__(
        self,
        settings: FilteredXLms,
        inner: Inner,
        model: StateSpace,
        channels: tuple[list[int], list[int], list[int]],
        limit: FloatArray,
        law: StateSpace,
    ) -> None:
        errors, references, drives = channels
        rate = inner.seen.rate_hz
        assert rate is not None
        self._system, self._taps = contiguous(model), settings.taps
        self._channels = np.array(errors, dtype=np.int64), np.array(references, dtype=np.int64)
        self._drives = np.array(drives, dtype=np.int64)
        lead = int(np.any(model.D))
        tuning = np.array(
            [settings.step, settings.leak / rate, (QUIETEST * largest_regressor(model, limit[drives])) ** 2]
        )
        self._design = np.ascontiguousarray(limit[drives]), tuning, lead
        super().__init__("FilteredXLms", inner, law, limit)

    @property
    def weights(self) -> FloatArray:
        """The filters now."""
        return self._weights.reshape(self._drives.size, self._channels[1].size, self._taps).copy()

    def _start(self) -> None:
        ne, nr, nu = self._channels[0].size, self._channels[1].size, self._drives.size
        n, taps = self._system[0].shape[0], self._taps
        self._weights = np.zeros((nu * nr, taps))
        self._state = (
            (np.zeros((n, nu * nr + 1)), np.zeros((n, nu * nr + 1)), np.zeros((ne + nr, nu * nr + 1))),
            (np.zeros((nr, 2 * taps)), np.zeros((ne, nu * nr, 2 * taps)), np.zeros((ne, ne))),
            self._weights,
            np.zeros(1, dtype=np.int64),
        )
        self._commands, self._quiet = np.zeros(nu), np.zeros(ne)

    def _adapt(self, y: FloatArray) -> int:
        from ultraquiet.design.tones.kernels import filtered_x_step

        met = filtered_x_step(y, self._system, self._channels, self._design, self._state, self._commands, self._quiet)
        self._v[self._drives] = self._commands
        return met


def _indices(name: str, channels: tuple[int, ...], count: int) -> list[int]:
    wanted = [
        whole("FilteredXLms", name, k, -count, count - 1) % count
        for k in (channels if isinstance(channels, tuple | list) else (channels,))
    ]
    if len(set(wanted)) < len(wanted):
        raise InputError(f"FilteredXLms: '{name}' names a channel twice: {wanted}.")
    return wanted
