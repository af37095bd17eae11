"""Several records, or several channels that physics ties together, in one fit."""

from collections.abc import Hashable, Sequence
from dataclasses import asdict

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import same_rate
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet.identify.joint.fit import fit_parts
from ultraquiet.identify.joint.search import Part
from ultraquiet.identify.joint.ties import Ties, same
from ultraquiet.identify.prediction_error.fit import Fit
from ultraquiet.identify.prediction_error.initial_models import ChannelData
from ultraquiet.identify.prediction_error.order_choice import told, with_order
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.race import Search
from ultraquiet.identify.prediction_error.result import MatrixResult, assemble, columns, excited, gather
from ultraquiet.identify.prediction_error.settings import PolynomialSettings
from ultraquiet.identify.result import Result
from ultraquiet.values import Channel, PolynomialMatrix, Record
from ultraquiet.values.handed_over.kinds import takes_values

Tying = str | Sequence[str] | ArrayLike | None


@takes_values
def identify_joint(
    method: PolynomialSettings,
    records: Sequence[Record],
    ties: Tying = None,
    workers: int | None = None,
    *,
    share: Tying = None,
) -> Result:
    """Fit one model to several experiments, each with its own past and constant, channels tied as `ties` says.

    The coefficients minimise sum_i N_i log(1/N_i sum_r e_ir'e_ir) over outputs i and records r, the likelihood of
    Gaussian innovations whose variance differs from output to output. What the plant remembers from before each record
    is fitted per record. `focus` of `BoxJenkins` is always the prediction here.

    Args:
        method: settings of a polynomial structure.
        records: experiments with the same inputs and outputs at one rate, of any lengths.
        ties: what the channels have in common, one name or several, or a table `(ny, nu)` of whole numbers in which
            channels of one number are one function:
            "threefold": a hexapod of three like pairs of struts, G unchanged when every strut takes the place of the
            one 120 degrees further, and when the struts of each pair change places: 6 functions instead of 36;
            "rotation": the turn alone, 12 functions; "symmetric": G = G';
            "poles": one F for all channels; "poles-by-input", "poles-by-output": one for each input or output;
            "noise": one C and D for all outputs.
        workers: threads; as many as processors when absent.
        share: the older name of `ties`.

    Returns:
        `Result`; each output's statistics are over all records, its covariance that of the joint fit.

    Raises:
        InputError: no records, unlike channels, units that differ within a tie, too few samples, a constant channel.
        RateError: records of different rates.

    >>> import numpy as np, ultraquiet as uq
    >>> rng = np.random.default_rng(0)
    >>> lag = uq.PolynomialModel(b=[[0.0, 1.0]], f=[[1.0, -0.9]], rate_hz=100.0)
    >>> def record(n):
    ...     u = rng.standard_normal((1, n))
    ...     return uq.Record(u, lag.state_space().simulate(u) + 0.1 * rng.standard_normal((1, n)), 100.0)
    >>> result = uq.identify.identify_joint(uq.identify.OutputError(order=1), [record(300), record(500)])
    >>> result.model.rows[0][0].f[0].round(2).tolist()
    [1.0, -0.9]

    Reference: Ljung, System Identification, 2nd ed., section 14.3 (merging data sets).
    """
    polynomial("identify_joint", method)
    ties = same("identify_joint", ties, share)
    _alike(method if method.given_order else method.at_order(1), records)
    method, words = with_order(method, records)
    for record in records:
        method.check(record)
    ny, nu = len(records[0].sensors), len(records[0].actuators)
    parameterisation = method.parameterisation(nu)
    tied = Ties.of(ties, ny, nu)
    tied.check("identify_joint", records[0].sensors, records[0].actuators)
    _one_denominator(parameterisation, tied)
    how = _search(method)
    parts = [
        _part(ChannelData.of(record, i), parameterisation, how, i, tied.keys(i, range(nu), parameterisation))
        for i in range(ny)
        for record in records
    ]
    fits = fit_parts(parts, how, records[0].rate_hz, workers)
    provenance = _provenance(method, records, ties)
    wires = records[0].actuators, records[0].sensors
    model = PolynomialMatrix([[fits[i].model] for i in range(ny)], *wires, provenance)
    return told(gather(model, [fits[i] for i in range(ny)], provenance), method, words)


def polynomial(who: str, method: object) -> None:
    """Refuse a method that is not of a polynomial structure: only those are fitted channel by channel."""
    if not isinstance(method, PolynomialSettings):
        raise InputError(
            f"{who}: 'method' must be the settings of a polynomial structure, BoxJenkins(order=5) for instance, got "
            f"{type(method).__name__}."
        )


def identify_tied_matrix(
    method: PolynomialSettings,
    records: Sequence[Record | Sequence[Record]],
    ties: Tying = None,
    workers: int | None = None,
) -> MatrixResult:
    """Return what `identify_matrix` does when channels are tied, or an actuator has several records."""
    method, words = with_order(method, *_asked(method, records))
    runs = _runs(method, records)
    ny, nu = len(runs[0][0].sensors), len(runs)
    tied = Ties.of(ties, ny, nu)
    tied.check("identify_matrix", runs[0][0].sensors, [r[0].actuators[0] for r in runs])
    how = _search(method)
    parts: list[Part] = []
    for k, column in enumerate(runs):
        parameterisation = method.for_input(k).parameterisation(1)
        for i in range(ny):
            keys = tied.keys(i, [k], parameterisation)
            parts += [_part(ChannelData.of(record, i), parameterisation, how, i * nu + k, keys) for record in column]
    fits = fit_parts(parts, how, runs[0][0].rate_hz, workers)
    provenance = _provenance(method, [r for column in runs for r in column], ties)
    grid = [[fits[i * nu + k] for k in range(nu)] for i in range(ny)]
    return told(assemble(grid, [column[0] for column in runs], provenance), method, words)


def _asked(method: PolynomialSettings, records: Sequence[Record | Sequence[Record]]) -> tuple[list[Record], list[int]]:
    """Return the records that say an order which is left to them, and of each the actuator it excites."""
    runs = [] if method.given_order else _runs(method.at_order(1), records)
    return [record for column in runs for record in column], [k for k, column in enumerate(runs) for _ in column]


def fit_alone(method: PolynomialSettings, data: ChannelData, rate_hz: float) -> Fit:
    """Return the model of one output whose polynomials are partly known."""
    nu = data.u.shape[0]
    parameterisation, how = method.parameterisation(nu), _search(method)
    keys = Ties.of(None, 1, nu).keys(0, range(nu), parameterisation)
    return fit_parts([_part(data, parameterisation, how, 0, keys)], how, rate_hz, 1)[0]


def _search(method: PolynomialSettings) -> Search:
    if getattr(method, "focus", None) == "simulation":
        raise InputError(
            f"{type(method).__name__}: records in one fit, ties and known parts go with the one-step error alone; set "
            f"'focus' to 'prediction'."
        )
    return method.search()


def _part(
    data: ChannelData, parameterisation: Parameterisation, how: Search, group: int, keys: tuple[Hashable, ...]
) -> Part:
    return Part(data, parameterisation, group, keys, parameterisation.states(how.estimate, how.offset))


def _provenance(method: PolynomialSettings, records: Sequence[Record], ties: Tying) -> Provenance:
    labels = None if ties is None else np.asarray(ties).tolist()
    return Provenance(
        method.name, {**asdict(method), "ties": labels}, parents=tuple(r.hash for r in records), versions=versions()
    )


def _runs(method: PolynomialSettings, records: Sequence[Record | Sequence[Record]]) -> list[list[Record]]:
    """Return the records of each actuator, its input alone, after checking that they form one matrix."""
    grouped = [[r] if isinstance(r, Record) else list(r) for r in records]
    for k, column in enumerate(grouped):
        if not column:
            raise InputError(f"identify_matrix: actuator {k + 1} has no records; give at least one.")
    heads = columns(method, [column[0] for column in grouped])
    out: list[list[Record]] = []
    for k, column in enumerate(grouped):
        picked = [heads[k], *(excited(k, r, len(grouped)) for r in column[1:])]
        _alike(method, picked)
        out.append(picked)
    return out


def _alike(method: PolynomialSettings, records: Sequence[Record]) -> None:
    """Refuse records that are not experiments on one plant, or that cannot carry the structure."""
    who = type(method).__name__
    if not records:
        raise InputError(f"{who}: no records were given; at least one is needed.")
    first = records[0]
    for k, record in enumerate(records[1:], start=2):
        same_rate(who, "record 1", first.rate_hz, f"record {k}", record.rate_hz)
        for kind, mine, others in (
            ("input", first.actuators, record.actuators),
            ("output", first.sensors, record.sensors),
        ):
            if len(mine) != len(others):
                raise InputError(
                    f"{who}: record 1 has {len(mine)} {kind}s but record {k} has {len(others)}; experiments of one fit "
                    f"share their channels, pick them with record.pick."
                )
            for a, b in zip(mine, others, strict=True):
                if (a.name, a.unit) != (b.name, b.unit):
                    raise InputError(
                        f"{who}: {kind} {_named(a)} of record 1 meets {_named(b)} of record {k}; "
                        "experiments of one fit share their channels, in one order."
                    )
    for record in records:
        method.check(record)


def _named(channel: Channel) -> str:
    unit = f"'{channel.unit}'" if channel.unit else "no unit"
    return f"'{channel.name}' in {unit}"


def _one_denominator(parameterisation: Parameterisation, ties: Ties) -> None:
    tied = np.unique(ties.functions).size < ties.functions.size
    if tied and parameterisation.a and parameterisation.inputs > 1:
        raise InputError(
            "ties: ARX and ARMAX give all inputs of an output one denominator, so single channels cannot be tied; "
            "take OutputError or BoxJenkins, or one record per actuator with identify_matrix."
        )
