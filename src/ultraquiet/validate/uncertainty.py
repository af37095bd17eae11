"""How far the plant may be from its model, as a weight that a robust design takes as it is.

A relative error at the plant's output, G_true = (1 + E) G with |E| <= |W|, is a weight on the complementary sensitivity
(`MixedSensitivity(form="skst", complementary=...)`); an additive one, G_true = G + E, a weight on K S (`control=...`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, frozen, one_of, some_lines, whole
from ultraquiet._base.errors import InputError
from ultraquiet.linalg import realize
from ultraquiet.linalg.even import to_unit_size
from ultraquiet.validate.bands import Identified, channels, moved_by, root, spread_of
from ultraquiet.validate.beyond import held, told
from ultraquiet.validate.compare import nearest_lines
from ultraquiet.validate.gradient import noise_gradient, response_gradient
from ultraquiet.validate.weight_fit import HIGHEST_ORDER, fitted_weight
from ultraquiet.values import FrequencyResponse, StateSpace, Status, StatusWord
from ultraquiet.values.confidence.response_spread import ResponseSpread
from ultraquiet.values.handed_over.kinds import answering
from ultraquiet.values.interconnect import append

KINDS = ("output", "input", "additive", "entry", "additive-entry")
CONFIDENCE = 0.95
DRAWS = 1000
# Above this relative error a robust design cannot use the plant at all: nothing is known of its phase.
UNKNOWN = 1.0
UNMOVED = 1e-9  # share of a row that lies beside all directions of the model, above which it is no rounding


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """A bound on the model's error over frequency.

    Attributes:
        f_hz: `(nf,)`.
        radius: what the error stays below: `(nf,)` a largest singular value (`output`, `input`, `additive`), or
            `(ny, nu, nf)` entry by entry (`entry`, `additive-entry`). Infinite where the error has a part in a
            direction that the model does not move at all.
        kind: `output`: of (G_true - G) G^-1; `input`: of G^-1 (G_true - G); `additive`: of G_true - G; `entry`:
            |G_true - G| / |G| of each entry; `additive-entry`: |G_true - G|.
        confidence: probability that the error stays below at all lines together; NaN for a spread, which is the largest
            deviation seen and promises nothing of the next.
        source: in words, what the bound was drawn from.
        measured: True where the lines are those of a measurement, outside of which only an assumption stands.
        outside_hz: `(k,)` frequencies below the lowest line and above the highest; none where nothing is assumed.
        outside: what the error is assumed to stay below there, `(k,)` or `(ny, nu, k)`: the absolute error goes on as
            over the nearest octave of lines, in relation to the model's largest gain. `weight` stays above it too.
    """

    f_hz: FloatArray
    radius: FloatArray
    kind: str
    confidence: float
    source: str
    measured: bool = False
    outside_hz: FloatArray = field(default_factory=lambda: np.zeros(0))
    outside: FloatArray = field(default_factory=lambda: np.zeros(0))

    def status(self) -> Status:
        """Say up to where the model can carry a robust design, and what is only assumed."""
        known = self._over_the_lines()
        return Status(known.word, known.sentence + told(self.measured, self.f_hz, self.outside_hz))

    def _over_the_lines(self) -> Status:
        if self.kind.startswith("additive"):
            return Status(StatusWord.OK, f"Additive bound over {self.f_hz[0]:g}-{self.f_hz[-1]:g} Hz, {self.source}.")
        worst = self.radius.reshape(-1, self.f_hz.size).max(axis=0)
        lost = self.f_hz[worst >= UNKNOWN]
        if lost.size == 0:
            return Status(StatusWord.OK, f"The relative error stays below {worst.max():.0%}, {self.source}.")
        share = lost.size / self.f_hz.size
        return Status(
            StatusWord.UNKNOWN_IN_PART,
            f"The relative error may pass 100 % at {share:.0%} of the lines, first at {lost[0]:g} Hz and last at "
            f"{lost[-1]:g} Hz ({self.source}): the loop must be quiet there, or the band excited better.",
        )

    def weight(
        self, rate_hz: float | None, order: int | None = None, channels: int | None = None
    ) -> "UncertaintyWeight":
        """Return a stable minimum-phase weight above the radius at every line.

        Args:
            rate_hz: of the design; None gives a weight in continuous time.
            order: states per channel; None takes the smallest within 1 dB of the best found.
            channels: copies on the diagonal; None gives `(1, 1)`, which `MixedSensitivity` spreads by itself. A bound
                by entry gives a full `(ny, nu)` matrix of weights.

        Raises:
            InputError: lines beyond Nyquist, a radius of zero, an order out of range.
        """
        return _weight(self, rate_hz, order, channels)


@dataclass(frozen=True, eq=False)
class UncertaintyWeight:
    """A weight |W| >= radius.

    Attributes:
        system: stable, minimum phase, invertible (its direct part too), at the rate asked for.
        excess_db: mean distance above the radius, dB; 0 would be the bound itself.
        worst_db: the largest one.
        uncertainty: the bound it covers.
        status: that of the bound.
    """

    system: StateSpace
    excess_db: float
    worst_db: float
    uncertainty: Uncertainty
    status: Status


def from_covariance(
    result: Identified,
    f_hz: ArrayLike,
    kind: str = "output",
    confidence: float = CONFIDENCE,
    draws: int = DRAWS,
    seed: int = 0,
) -> Uncertainty:
    """Bound the error that chance has left in an identified model, at all lines together.

    theta is drawn from N(theta, P); each draw's error, linearised, is scaled by its size at the line (root of the mean
    square over draws). The noise level that P rests on is drawn likewise. The `confidence` quantile of the largest
    scaled error over the lines is the factor by which the size is multiplied, so that one draw in twenty, not one line
    in twenty, passes a 95 % bound. What the structure left out is not in it: add the spread between records or benches.

    Args:
        result: of an identification that knows the covariance of its coefficients or the spread of its response.
        f_hz: lines in Hz, dense enough to show every resonance.
        kind: see `Uncertainty`.
        confidence: between 0.5 and 0.999.
        draws: of the coefficients.
        seed: of the draws.

    Raises:
        InputError: a result that knows no band, a model that is not square for `output` and `input`.

    >>> import numpy as np, ultraquiet as uq
    >>> u, e = np.random.default_rng(1).standard_normal((2, 2000))
    >>> lag = uq.PolynomialModel(b=[[0.0, 0.5]], f=[[1.0, -0.5]], rate_hz=10.0)
    >>> record = uq.Record(u, lag.state_space().simulate(u[None]) + 0.1 * e, 10.0)
    >>> result = uq.identify.OutputError(order=1).identify(record)
    >>> bound = uq.validate.from_covariance(result, np.linspace(0.1, 4.9, 50))
    >>> bound.status().ok and bool(bound.radius.max() < 0.1)
    True

    Reference: Skogestad and Postlethwaite 2005, section 7.4.
    """
    who = "from_covariance"
    one_of(who, "kind", kind, KINDS)
    between(who, "confidence", confidence, 0.5, 0.999)
    whole(who, "draws", draws, 100)
    whole(who, "seed", seed, 0)
    f = some_lines(who, f_hz)
    spread = spread_of(who, result)
    nominal = result.model.frequency_response(f)
    rng = np.random.default_rng(seed)
    errors = _drawn(who, result, f, draws, rng) if spread is None else _spread(who, spread, f, draws, rng)
    errors = errors.reshape(draws, *nominal.shape)
    sizes = _sizes(who, errors, nominal, kind)
    typical = np.sqrt(np.mean(sizes**2, axis=0))
    with np.errstate(invalid="ignore"):  # where the model says nothing, the error is without bound
        scaled = sizes / np.maximum(typical, np.finfo(float).tiny)
    known = np.isfinite(typical)
    factor = float(np.quantile(scaled[:, known].max(axis=1, initial=0.0), confidence))
    radius = np.where(known, factor * typical, np.inf)
    source = f"{confidence:.0%} bound from the covariance of the coefficients"
    return Uncertainty(frozen(f), frozen(radius), kind, confidence, source)


def _drawn(who: str, result: Identified, f: FloatArray, draws: int, rng: np.random.Generator) -> ComplexArray:
    """Return errors of every channel of a polynomial model, `(draws, channels, nf)`."""
    moved = []
    for m, P in channels(who, result):
        L = root(P)
        slopes = np.einsum("jpf,pq->qjf", response_gradient(m, f), L)
        steps = rng.standard_normal((draws, slopes.shape[0]))
        # P rests on a noise spectrum that is itself estimated: each draw's error grows with its noise at the line,
        # which is to these bounds what Student's t is to a normal quantile.
        louder = np.exp(rng.standard_normal(steps.shape) @ (L.T @ noise_gradient(m, f)).real)
        moved.append((steps @ slopes.reshape(slopes.shape[0], -1)).reshape(draws, -1, f.size) * louder[:, None])
    return np.concatenate(moved, axis=1)


def _spread(who: str, spread: ResponseSpread, f: FloatArray, draws: int, rng: np.random.Generator) -> ComplexArray:
    """Return errors of a response from its spread, `(draws, ny nu nf)`."""
    X = moved_by(who, spread, f)
    return rng.standard_normal((draws, X.shape[-1])) @ X.reshape(-1, X.shape[-1]).T


def from_spread(
    nominal: Any, others: Sequence[Any], f_hz: ArrayLike | None = None, kind: str = "output"
) -> Uncertainty:
    """Bound the error by the largest deviation among models or responses of other records, benches or units.

    Outside the lines of a measured response nothing is known; with a nominal model, the error is assumed to go on as
    over the nearest octave of lines (`Uncertainty.outside`), and the status says so.

    Args:
        nominal: the model the design will use: anything with `frequency_response(f_hz)`, or a `FrequencyResponse`.
        others: likewise; a measured one must have the lines.
        f_hz: lines in Hz; those of the first measured response when absent.
        kind: see `Uncertainty`.

    Raises:
        InputError: no others, unequal shapes, no lines.
    """
    who = "from_spread"
    one_of(who, "kind", kind, KINDS)
    nominal = answering(who, "nominal", nominal)
    if not isinstance(others, Sequence):
        raise InputError(f"{who}: 'others' must be a list of models or responses, got {type(others).__name__}.")
    others = [answering(who, "others", other) for other in others]
    if not others:
        raise InputError(f"{who}: the spread needs at least one other model beside the nominal one.")
    measured = [x for x in (nominal, *others) if isinstance(x, FrequencyResponse)]
    if f_hz is None and not measured:
        raise InputError(f"{who}: give 'f_hz', the lines in Hz; no measured response brings its own.")
    f = measured[0].f_hz if f_hz is None else some_lines(who, f_hz)
    G = _at(who, nominal, f)
    responses = [_at(who, x, f) for x in others]
    for k, x in enumerate(responses):
        if x.shape != G.shape:
            raise InputError(f"{who}: the nominal response is {G.shape}, that of other {k + 1} is {x.shape}.")
    errors = np.stack(responses) - G
    radius = _sizes(who, errors, G, kind).max(axis=0)
    source = f"largest deviation of {len(others)} others"
    bound = Uncertainty(frozen(f), frozen(radius), kind, float("nan"), source, measured=bool(measured))
    if not measured or not hasattr(nominal, "rate_hz"):
        return bound
    outside_hz, outside = held(f, errors, nominal, kind)
    return replace(bound, outside_hz=frozen(outside_hz), outside=frozen(outside))


def combined(parts: Sequence[Uncertainty]) -> Uncertainty:
    """Return the bound that covers all causes at once: the radii add, as the errors may.

    Raises:
        InputError: bounds of different kinds or lines.
    """
    if not parts:
        raise InputError("combined: no bounds were given.")
    first = parts[0]
    for part in parts[1:]:
        if part.kind != first.kind or not np.array_equal(part.f_hz, first.f_hz):
            raise InputError(f"combined: a bound '{part.kind}' and one '{first.kind}' must share kind and lines.")
    radius = np.sum([part.radius for part in parts], axis=0)
    known = [part.confidence for part in parts if np.isfinite(part.confidence)]
    # Bonferroni: each cause may fail on its own.
    confidence = max(0.0, 1.0 - sum(1.0 - c for c in known)) if known else float("nan")
    source = " + ".join(part.source for part in parts)
    # what one part assumes outside its lines, no other may have looked at: the largest stands for all
    outer = max(parts, key=lambda part: float(np.sum(part.outside)))
    return Uncertainty(
        first.f_hz,
        frozen(radius),
        first.kind,
        confidence,
        source,
        any(part.measured for part in parts),
        outer.outside_hz,
        outer.outside,
    )


def _at(who: str, system: Any, f: FloatArray) -> ComplexArray:
    if not isinstance(system, FrequencyResponse):
        return system.frequency_response(f)
    place = nearest_lines(system.f_hz, f)
    if place is None:
        raise InputError(f"{who}: a measured response has no line at some of the {f.size} frequencies.")
    return system.values[:, :, place]


@np.errstate(over="ignore")  # over nothing at all
def _sizes(who: str, errors: ComplexArray, nominal: ComplexArray, kind: str) -> FloatArray:
    """Return the size of each error `(draws, ny, nu, nf)`: `(draws, nf)`, or `(draws, ny, nu, nf)` by entry."""
    if kind == "additive-entry":
        return np.abs(errors)
    if kind == "entry":
        return np.abs(errors) / np.maximum(np.abs(nominal), np.finfo(float).tiny)
    E, G = np.moveaxis(errors, -1, 1), np.moveaxis(nominal, -1, 0)
    if kind != "additive":
        if G.shape[1] != G.shape[2]:
            raise InputError(
                f"{who}: a relative bound by direction needs as many inputs as outputs, the model is "
                f"{G.shape[1]} x {G.shape[2]}; take 'entry' or 'additive'."
            )
        return _relative(E, G) if kind == "output" else _relative(np.swapaxes(E, -1, -2), np.swapaxes(G, -1, -2))
    if E.shape[-1] == E.shape[-2] == 1:
        return np.abs(E[..., 0, 0])
    return np.asarray(np.linalg.svd(E, compute_uv=False)[..., 0], dtype=np.float64)


def _relative(E: ComplexArray, G: ComplexArray) -> FloatArray:
    """Return the largest singular value of X in E = X G, `(draws, nf)`; infinite where there is no X.

    A direction that the model does not move at all is known to no share of it. The inverse is that of G between
    channels of unit size: in units far apart a small one looks like none.
    """
    u = to_unit_size(np.linalg.norm(G, axis=1))[:, None, :]
    y = to_unit_size(np.linalg.norm(G * u, axis=2))[:, :, None]
    moved, errors = G * u * y, E * u * y
    X = errors @ np.linalg.pinv(moved)
    beside = np.linalg.norm(errors - X @ moved, axis=-1)
    size = np.maximum(np.linalg.norm(errors, axis=-1), np.linalg.norm(moved, axis=-1))
    gains = np.linalg.norm(X / y * np.swapaxes(y, -1, -2), 2, axis=(-2, -1))
    return np.where(np.any(beside > UNMOVED * size, axis=-1), np.inf, gains)


def _weight(bound: Uncertainty, rate_hz: float | None, order: int | None, count: int | None) -> UncertaintyWeight:
    who = "Uncertainty.weight"
    if order is not None:
        whole(who, "order", order, 0, HIGHEST_ORDER)
    if rate_hz is not None and bound.f_hz[-1] >= rate_hz / 2:
        raise InputError(f"{who}: the bound reaches {bound.f_hz[-1]:g} Hz, beyond Nyquist at {rate_hz / 2:g} Hz.")
    if not np.all(bound.radius > 0) or not np.all(np.isfinite(bound.radius)):
        raise InputError(f"{who}: the radius must be positive and finite at every line to have a weight.")
    rows = bound.radius if bound.radius.ndim == 3 else bound.radius[None, None]
    weights = [
        [_fitted(bound, r, o, rate_hz, order) for r, o in zip(row, outer, strict=True)]
        for row, outer in zip(rows, _outside(bound, rows.shape), strict=True)
    ]
    gains = np.array([[np.abs(w.frequency_response(bound.f_hz)[0, 0]) for w in row] for row in weights])
    over = 20 * np.log10(gains / rows)
    if bound.radius.ndim == 3:
        system = _grid(weights)
    else:
        system = append(*[weights[0][0]] * (count or 1))
    return UncertaintyWeight(system, float(over.mean()), float(over.max()), bound, bound.status())


def _outside(bound: Uncertainty, shape: tuple[int, ...]) -> FloatArray:
    return np.reshape(bound.outside, (*shape[:2], bound.outside_hz.size))


def _fitted(
    bound: Uncertainty, radius: FloatArray, outside: FloatArray, rate_hz: float | None, order: int | None
) -> StateSpace:
    """Return the weight of one entry, above the radius at the lines and above what is assumed outside them."""
    inside = (outside > 0) & (bound.outside_hz < (np.inf if rate_hz is None else rate_hz / 2))
    f = np.concatenate([bound.f_hz, bound.outside_hz[inside]])
    rising = np.argsort(f)
    return fitted_weight(f[rising], np.concatenate([radius, outside[inside]])[rising], rate_hz, order)


def _grid(entries: list[list[StateSpace]]) -> StateSpace:
    A, B, C, D = realize.grid([[(w.A, w.B, w.C, w.D) for w in row] for row in entries])
    return StateSpace(A, B, C, D, entries[0][0].rate_hz)
