"""Frequency response functions from records."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np

from ultraquiet._base.constraints import FloatArray, one_of, real_array, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet.spectra import estimators
from ultraquiet.spectra.averaging import segments
from ultraquiet.spectra.cross import CrossSpectra, cross_spectra
from ultraquiet.spectra.excited import Group, alive_lines, excited_together, refuse_dead_outputs
from ultraquiet.values import FrequencyResponse, Record
from ultraquiet.values.handed_over.kinds import takes_values

ESTIMATORS = ("H1", "H2", "Hv")


@dataclass(frozen=True)
class _Choice:
    """How gains are estimated."""

    estimator: str
    noise: FloatArray | None


@takes_values
def frf(
    records: Record | CrossSpectra | Sequence[Record],
    segment_samples: int | None = None,
    overlap: float = 0.5,
    window: str = "hann",
    estimator: str = "H1",
    detrend: str = "constant",
    noise: Sequence[float] | None = None,
) -> FrequencyResponse:
    """Return the response of the inputs that move, with its coherence and its variance.

    H1 = S_yu S_uu^-1,  H2 = S_yy S_uy^-1,  Hv by total least squares of each output.

    Args:
        records: one record; several of one bench, of which those that excite the same inputs are averaged and the
            others set side by side; or cross spectra, whose averaging then stands (`cross_spectra` reads blocks).
        segment_samples: length of a segment; by default an eighth of the shortest record.
        overlap: shared part of neighbouring segments, 0 to 0.95.
        window: any window name of scipy.signal.
        estimator: "H1" where noise sits at the outputs, "H2" where it sits on the inputs, "Hv" for both.
        detrend: what is removed from every segment: its mean ("constant"), a line ("linear") or nothing ("none").
        noise: for Hv, noise densities of inputs then outputs, `(nu + ny,)`, up to a factor; by default in proportion
            to each channel's power.

    Returns:
        The response `(ny, excited inputs, nf)`. Frequencies at which an input carries no power are left out.
        The coherence is the ordinary one where a record excites one input; where it excites several at once it is the
        multiple coherence, repeated for each input. The variance is that of the complex gain, random error alone:
        about two thirds of the truth lie within its root in magnitude, leakage and bias not counted.

    Raises:
        InputError: no input moves, an output that never moves, inputs that move alike, records of different rates or
            channels, fewer segments than inputs excited together, H2 of unequal numbers of inputs and outputs.

    >>> u = np.random.default_rng(0).standard_normal(4096)
    >>> g = frf(Record([u], [2.0 * u], rate_hz=1000.0))
    >>> bool(np.allclose(g.values, 2.0)), g.estimator[:2]
    (True, 'H1')

    Reference: J. S. Bendat, A. G. Piersol, Random Data (2010), chapters 6, 7 and 9, doi:10.1002/9781118032428.
    """
    one_of("frf", "estimator", estimator, ESTIMATORS)
    many = [records] if isinstance(records, Record | CrossSpectra) else list(records)
    nu, ny = _channels(many)
    choice = _Choice(estimator, None if noise is None else _noise(noise, nu, ny))
    if isinstance(many[0], CrossSpectra):
        cross = many[0]
        groups = [Group(cross, cross.moving(range(nu)))]
    else:
        recorded = [r for r in many if isinstance(r, Record)]
        length = segments("frf", min(r.samples for r in recorded), segment_samples, overlap)[0]
        parts = excited_together(recorded)
        groups = [
            Group(reduce(add, (cross_spectra(r, length, overlap, window, detrend) for r in members)), inputs)
            for members, inputs in parts
        ]
    return _side_by_side(groups, choice)


def _channels(many: Sequence[Record | CrossSpectra]) -> tuple[int, int]:
    """Return the numbers of inputs and outputs, after checking that the records fit together."""
    if not many:
        raise InputError("frf: it needs at least one record, got none.")
    first = many[0]
    for other in many:
        if isinstance(first, Record) and isinstance(other, Record):
            same_rate("frf", "the first record", first.rate_hz, "another", other.rate_hz)
        if len(other.sensors) != len(first.sensors) or len(other.actuators) != len(first.actuators):
            raise InputError("frf: all records must have the same actuators and sensors.")
    return len(first.actuators), len(first.sensors)


def _noise(noise: Sequence[float], nu: int, ny: int) -> FloatArray:
    densities = real_array("frf", "noise", noise, 1)
    if densities.size != nu + ny or (densities <= 0).any():
        raise InputError(f"frf: 'noise' must be {nu + ny} densities above zero, inputs then outputs, got {densities}.")
    return densities


def _side_by_side(groups: Sequence[Group], choice: _Choice) -> FrequencyResponse:
    """Return the columns of all groups at the lines where all their inputs carry power."""
    refuse_dead_outputs("frf", groups)
    alive = np.logical_and.reduce([alive_lines("frf", g.cross, g.inputs) for g in groups])
    columns = [_columns(g, alive, choice) for g in groups]
    first = groups[0].cross
    kind = "coherence" if all(len(g.inputs) == 1 for g in groups) else "multiple coherence"
    return FrequencyResponse(
        first.f_hz[alive],
        np.concatenate([c[0] for c in columns], axis=1),
        np.concatenate([c[1] for c in columns], axis=1),
        f"{choice.estimator}, {first.averaging.text}, {kind}",
        [first.actuators[i] for g in groups for i in g.inputs],
        first.sensors,
        Provenance(
            "spectra.frf",
            {"estimator": choice.estimator, "averaging": first.averaging.text},
            parents=tuple(h for g in groups for h in g.cross.hashes),
        ),
        np.concatenate([c[2] for c in columns], axis=1),
    )


def _columns(group: Group, alive: np.ndarray, choice: _Choice) -> tuple[np.ndarray, FloatArray, FloatArray]:
    """Return gains, coherence and variance `(ny, inputs, nf)` of one group."""
    nu, ny = len(group.cross.actuators), len(group.cross.sensors)
    s = group.blocks(group.inputs, range(nu, nu + ny), alive)
    if choice.estimator == "H1":
        G, variance = estimators.h1(s)
    elif choice.estimator == "H2":
        G, variance = estimators.h2(s)
    else:
        rows = [*group.inputs, *range(nu, nu + ny)]
        G, variance = estimators.hv(s, None if choice.noise is None else choice.noise[rows])
    coherence = np.broadcast_to(estimators.multiple(s)[:, :, np.newaxis], G.shape)
    return np.moveaxis(G, 0, -1), np.moveaxis(coherence, 0, -1), np.moveaxis(variance, 0, -1)
