"""Which structure and order: all of them on all channels in one call, ranked on data none of them has seen."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, one_of
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import lookup
from ultraquiet._base.threads import in_threads
from ultraquiet.identify.polynomial.methods import PolynomialMethod
from ultraquiet.identify.prediction_error.fit import Fit
from ultraquiet.identify.prediction_error.initial_models import ChannelData
from ultraquiet.identify.prediction_error.order_choice import FITTED_SHARE, WORTH
from ultraquiet.identify.prediction_error.result import MatrixResult, columns, whole
from ultraquiet.linalg import information, prediction
from ultraquiet.values import PolynomialMatrix, Record, StatusWord
from ultraquiet.values.handed_over.kinds import takes_values

STRUCTURES = ("arx", "armax", "output-error", "box-jenkins")
ORDERS = range(2, 8)


@dataclass(frozen=True, eq=False)
class Candidate:
    """One structure and order on all channels.

    Attributes:
        method: the settings, ready to `identify`.
        held_out_fit: `(ny, nu)` simulated fit in percent on held-out data.
        held_out_loss: `(ny, nu)` mean squared one-step residual there.
        fit_percent, loss: the same on the fitted data.
        words: `(ny, nu)` verdicts.
        seconds: processor seconds of all channels' fits.
        fits: `(ny, nu)` the channels' fits.
        samples: of each fitted record (the shortest).
    """

    method: PolynomialMethod
    held_out_fit: FloatArray
    held_out_loss: FloatArray
    fit_percent: FloatArray
    loss: FloatArray
    words: np.ndarray[Any, np.dtype[np.str_]]
    seconds: float
    fits: np.ndarray[Any, np.dtype[np.object_]]
    samples: int

    @property
    def models(self) -> np.ndarray[Any, np.dtype[np.object_]]:
        """The fitted models, `(ny, nu)`."""
        models = np.empty(self.fits.shape, dtype=np.object_)
        for place, fit in np.ndenumerate(self.fits):
            models[place] = fit.model
        return models

    def criteria(self) -> information.Criteria:
        """Return FPE, AIC, AICc, BIC and MDL of every channel on the fitted data, `(ny, nu)` each."""
        past = np.array([[fit.past for fit in row] for row in self.fits])
        return information.criteria(self.loss, self.samples, self.method.structure().parameters(1), past)


@dataclass(frozen=True, eq=False)
class Sweep:
    """All candidates, best first, and the one to take.

    `preferred` is the smallest order of the best structure whose score lies within 2 % of the best one's.
    """

    candidates: tuple[Candidate, ...]
    preferred: Candidate
    rank_by: str
    records: tuple[Record, ...]

    def of(self, method: PolynomialMethod) -> Candidate | None:
        """Return the candidate of these settings; None where they were not among them."""
        return next((candidate for candidate in self.candidates if candidate.method == method), None)

    def result(self, candidate: Candidate) -> MatrixResult:
        """Return what `identify_matrix` would of these records with a candidate's settings."""
        return whole(candidate.method, candidate.fits.tolist(), self.records)

    def by_channel(self) -> tuple[PolynomialMatrix, tuple[tuple[PolynomialMethod, ...], ...], tuple[str, ...]]:
        """Return the matrix in which every channel has the model that its own held-out record prefers.

        A structure and order for all channels alike keeps, in some of them, a search that ended badly; here such a
        channel falls to its neighbour in order. Returned are the matrix, the settings `(ny, nu)` chosen, and the
        verdicts of all channels, row by row.
        """
        ny, nu = self.preferred.held_out_loss.shape
        chosen = [[self._for_channel(i, k) for k in range(nu)] for i in range(ny)]
        rows = [[c.fits[i, k].model for k, c in enumerate(row)] for i, row in enumerate(chosen)]
        words = tuple(str(c.words[i, k]) for i, row in enumerate(chosen) for k, c in enumerate(row))
        return PolynomialMatrix(rows), tuple(tuple(c.method for c in row) for row in chosen), words

    def _for_channel(self, i: int, k: int) -> Candidate:
        converged = [c for c in self.candidates if c.words[i, k] != StatusWord.NOT_CONVERGED] or list(self.candidates)
        scores = [100.0 - c.held_out_fit[i, k] if self.rank_by == "fit" else c.held_out_loss[i, k] for c in converged]
        return converged[_smallest_worth(converged, [float(v) for v in scores])]

    def table(self) -> list[dict[str, Any]]:
        """Return one plain row per candidate: structure, order, fits in percent, loss, criteria (medians), seconds."""
        return [
            {
                "structure": c.method.name,
                "order": c.method.whole_order,
                "median_fit_percent": float(np.median(c.held_out_fit)),
                "worst_fit_percent": float(np.min(c.held_out_fit)),
                "median_loss": float(np.median(c.held_out_loss)),
                **{name: float(np.median(value)) for name, value in c.criteria()._asdict().items()},
                "ok": int(np.count_nonzero(c.words == StatusWord.OK)),
                "seconds": c.seconds,
            }
            for c in self.candidates
        ]


@takes_values
def sweep(
    records: Sequence[Record],
    held_out: Sequence[Record] | None = None,
    structures: Iterable[str | PolynomialMethod] = STRUCTURES,
    orders: Iterable[int] = ORDERS,
    rank_by: str = "loss",
    workers: int | None = None,
) -> Sweep:
    """Fit every structure at every order to every channel and rank them on held-out data.

    Args:
        records: one record per actuator, as `identify_matrix` takes them.
        held_out: as many others for the ranking; when absent the last third of each record is kept back.
        structures: registered names, or settings whose order is varied.
        orders: whole numbers.
        rank_by: "loss" (geometric mean over channels of the one-step loss, which weighs every channel alike) or "fit"
            (median simulated fit).
        workers: threads; as many as processors when absent.

    Raises:
        InputError: as `identify_matrix`; held-out records that do not match the others.

    >>> import numpy as np, ultraquiet as uq
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(1500)
    >>> lag = uq.PolynomialModel(b=[[0.0, 1.0, 0.4]], f=[[1.0, -1.2, 0.6]], rate_hz=100.0)
    >>> y = lag.state_space().simulate(u[None])[0] + 0.1 * rng.standard_normal(1500)
    >>> found = uq.identify.sweep([uq.Record(u, y, 100.0)], structures=["output-error"], orders=[1, 2, 3])
    >>> found.preferred.method.order
    2
    """
    one_of("sweep", "rank_by", rank_by, ("loss", "fit"))
    if not isinstance(orders, Iterable):
        raise InputError(f"sweep: 'orders' must be a list of whole numbers, got {orders!r}.")
    listed = [structures] if isinstance(structures, str | PolynomialMethod) else list(structures)
    tried = list(orders)
    methods = [_at_order(s, n) for s in listed for n in tried]
    if not methods:
        raise InputError("sweep: no structures or no orders were given.")
    if held_out is None:
        cuts = [int(FITTED_SHARE * r.samples) for r in records]
        held_out = [r.part(cut) for r, cut in zip(records, cuts, strict=True)]
        records = [r.part(0, cut) for r, cut in zip(records, cuts, strict=True)]
    largest = max(methods, key=lambda m: m.structure().parameters(1))
    fitted, kept = columns(largest, records), columns(largest, held_out)
    if len(fitted) != len(kept) or len(fitted[0].sensors) != len(kept[0].sensors):
        raise InputError("sweep: the held-out records must match the fitted ones, one per actuator, same sensors.")
    places = [(i, k) for k in range(len(fitted)) for i in range(len(fitted[0].sensors))]

    def one(place: tuple[int, int]) -> list[tuple[Fit, float, float, float]]:
        i, k = place
        data = ChannelData.of(fitted[k], i)
        return [_judged(method, data, kept[k], i) for method in methods]

    judged = in_threads("compare structures and orders", one, places, workers)
    shape = (len(fitted[0].sensors), len(fitted))
    shortest = min(r.samples for r in fitted)
    candidates = [_candidate(m, n, judged, shape, shortest) for n, m in enumerate(methods)]
    return _ranked(candidates, rank_by, tuple(records))


def _at_order(structure: str | PolynomialMethod, order: int) -> PolynomialMethod:
    if isinstance(structure, PolynomialMethod):
        return replace(structure, order=order)
    method = lookup("identify", structure) if isinstance(structure, str) else type(structure)
    if not issubclass(method, PolynomialMethod):
        raise InputError(f"sweep: '{method.__name__}' is no polynomial structure; known are {', '.join(STRUCTURES)}.")
    return method(order=order)


def _judged(method: PolynomialMethod, data: ChannelData, kept: Record, i: int) -> tuple[Fit, float, float, float]:
    """Return the fit of one channel, its simulated fit and one-step loss on the kept record, and its seconds."""
    begun = time.thread_time()
    fit = method.fit(data, kept.rate_hz)
    seconds = time.thread_time() - begun
    y, m = kept.outputs[i], fit.model
    simulated = prediction.simulate(kept.inputs, y, m.b, [m.denominator(j) for j in range(len(m.b))])
    low, high = kept.sensors[i].low, kept.sensors[i].high
    loss = _one_step_loss(prediction.repaired(y, simulated, low, high), kept.inputs, fit)
    return fit, prediction.fit_percent(y, np.clip(simulated, low, high)), loss, seconds


def _one_step_loss(y: FloatArray, u: FloatArray, fit: Fit) -> float:
    m = fit.model
    return float(np.mean(prediction.innovations(u, y, m.a, m.b, m.f, m.c, m.d) ** 2))


def _candidate(
    method: PolynomialMethod, n: int, found: dict[Any, Any], shape: tuple[int, int], samples: int
) -> Candidate:
    def table(pick: Callable[[Any], Any]) -> Any:
        return np.array([[pick(found[(i, k)][n]) for k in range(shape[1])] for i in range(shape[0])])

    fits = np.empty(shape, dtype=np.object_)
    for i, k in np.ndindex(*shape):
        fits[i, k] = found[(i, k)][n][0]
    return Candidate(
        method,
        table(lambda x: x[1]),
        table(lambda x: x[2]),
        table(lambda x: x[0].fit_percent),
        table(lambda x: x[0].loss),
        table(lambda x: x[0].status.word),
        float(np.sum(table(lambda x: x[3]))),
        fits,
        samples,
    )


def _ranked(candidates: list[Candidate], rank_by: str, records: tuple[Record, ...]) -> Sweep:
    """Order by score, least first; prefer the smallest order of the best structure that scores nearly as well."""
    scores = [_score(c, rank_by) for c in candidates]
    order = sorted(range(len(candidates)), key=lambda k: scores[k])
    preferred = candidates[_smallest_worth(candidates, scores)]
    return Sweep(tuple(candidates[k] for k in order), preferred, rank_by, records)


def _smallest_worth(candidates: Sequence[Candidate], scores: Sequence[float]) -> int:
    """Return the index of the smallest order, of the structure that scores best, that scores nearly as well."""
    best = int(np.argmin(scores))
    near = [
        k
        for k, c in enumerate(candidates)
        if c.method.name == candidates[best].method.name and scores[k] <= (1.0 + WORTH) * scores[best]
    ]
    return min(near, key=lambda k: candidates[k].method.whole_order)


def _score(candidate: Candidate, rank_by: str) -> float:
    """Return what is to be small: the geometric mean of the losses, or the fit's distance from 100 percent."""
    if rank_by == "fit":
        return float(100.0 - np.median(candidate.held_out_fit))
    return float(np.exp(np.mean(np.log(candidate.held_out_loss))))
