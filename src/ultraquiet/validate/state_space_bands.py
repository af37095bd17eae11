"""Confidence bands of a state-space model's response, from the record that it was identified from."""

from numpy.typing import ArrayLike

from ultraquiet._base.constraints import between, some_lines
from ultraquiet._base.errors import InputError
from ultraquiet.validate.bands import LEVELS, ResponseBand, drawn_band
from ultraquiet.values import Record, StateSpace
from ultraquiet.values.confidence.response_spread import SimulatedSpread
from ultraquiet.values.door import takes_systems
from ultraquiet.values.handed_over.kinds import takes_values


@takes_values
@takes_systems
def state_space_band(model: StateSpace, record: Record, f_hz: ArrayLike, level: float = 0.95) -> ResponseBand:
    """Return the response of a model of least simulated error and the band in which the truth lies with `level`.

    theta holds the modes' poles, B, C, and D where it is not zero. With S(f) = d y / d theta at a line of the record,
    W the inverse covariance of the simulated errors v and Phi their spectrum,

        M = sum_f Re S' W S,   Q = sum_f Re S' W Phi W S,   cov theta = M^+ Q M^+,

    and the band follows from the gradient of the response. Phi comes from an autoregression of each output's v. Bands
    say what chance did to this record; not what the order left out, which the residual tests tell, nor how far a
    subspace without a search (`refine=True`) stayed from the least error.

    Args:
        model: stable, discrete, diagonalisable: of `Subspace(refine=True)`.
        record: that it was identified from.
        f_hz: `(nf,)` lines in Hz.
        level: probability at each line on its own.

    Raises:
        InputError: another rate or other channels than the record's, an unstable model, fewer samples than parameters.

    >>> import numpy as np, ultraquiet as uq
    >>> u, e = np.random.default_rng(1).standard_normal((2, 1, 2000))
    >>> lag = uq.StateSpace([[0.5]], [[0.5]], [[1.0]], [[0.0]], rate_hz=10.0)
    >>> record = uq.Record(u, lag.simulate(u) + 0.1 * e, 10.0)
    >>> found = uq.identify.Subspace(order=1, feedthrough=False, refine=True).identify(record).model
    >>> bool(0.1 < state_space_band(found, record, [1.0]).percent[0, 0, 0] < 1.0)
    True

    Reference: Ljung, System Identification, 2nd ed., section 9.4; McKelvey, Helmersson, Ribarits 2004 (coordinates
    that are more than needed), doi:10.1016/j.automatica.2004.04.017.
    """
    who = "state_space_band"
    between(who, "level", level, *LEVELS)
    f = some_lines(who, f_hz)
    _checked(who, model, record)
    return drawn_band(who, model.frequency_response(f), SimulatedSpread(model, record), f, level)


def _checked(who: str, model: StateSpace, record: Record) -> None:
    if model.rate_hz != record.rate_hz:
        raise InputError(f"{who}: the model's rate is {model.rate_hz} Hz, the record's {record.rate_hz:g} Hz.")
    shape, wires = model.D.shape, (len(record.sensors), len(record.actuators))
    if shape != wires:
        raise InputError(f"{who}: the model has {shape[0]} outputs and {shape[1]} inputs, the record {wires}.")
    if not model.is_stable():
        raise InputError(f"{who}: the model is unstable and has no simulated error; bands are drawn for stable ones.")
    if record.samples < 2 * model.states * sum(wires):
        raise InputError(
            f"{who}: {record.samples} samples are too few for {model.states} states, {wires[0]} outputs and {wires[1]} "
            f"inputs; record longer."
        )
