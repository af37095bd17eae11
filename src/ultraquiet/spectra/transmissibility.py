"""Transmissibility from base to payload, from readings alone."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, frozen, one_of, positive, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet.spectra import estimators
from ultraquiet.spectra.averaging import Averaging, segments
from ultraquiet.spectra.cross import CrossSpectra, cross_spectra
from ultraquiet.spectra.excited import Group, alive_lines
from ultraquiet.values import FrequencyResponse, Record
from ultraquiet.values.handed_over.kinds import takes_values

WHO = "transmissibility"
ESTIMATORS = ("H1", "H2", "Hv", "reference")
Choice = Sequence[int | str] | int | str


@dataclass(frozen=True, eq=False)
class Transmissibility:
    """Payload per base motion: `response` `(payload, base, nf)` with multiple coherence `(payload, nf)` and variance.

    `overall` `(nf,)` is the scalar version: root of the payload's whole power over the base's, noise included.
    `degrees` are the independent segments behind the variance.
    """

    response: FrequencyResponse
    overall: FloatArray
    averaging: Averaging
    degrees: float

    @property
    def f_hz(self) -> FloatArray:
        """The lines in Hz, `(nf,)`."""
        return self.response.f_hz

    @property
    def db(self) -> FloatArray:
        """20 log10 |T|, `(payload, base, nf)`."""
        return self.response.magnitude_db

    @property
    def overall_db(self) -> FloatArray:
        """The scalar version in dB, `(nf,)`."""
        return 20.0 * np.log10(self.overall)

    @property
    def estimator(self) -> str:
        """Estimator, window, averages, overlap and resolution."""
        return self.response.estimator

    def interval_db(self, level: float = 0.95) -> tuple[FloatArray, FloatArray]:
        """Return the confidence interval of `db`, two arrays `(payload, base, nf)`; minus infinity where it holds zero.

        | |T| - true | < t(p, 2 degrees) sqrt(variance / 2): half of the complex variance lies along T.
        """
        reach = magnitude_error(self.response, self.degrees, level)
        size = np.abs(self.response.values)
        with np.errstate(divide="ignore"):
            return 20.0 * np.log10(np.maximum(size - reach, 0.0)), 20.0 * np.log10(size + reach)


@takes_values
def magnitude_error(response: FrequencyResponse, degrees: float, level: float = 0.95) -> FloatArray:
    """Return half the width of the confidence interval of |G|, `(ny, nu, nf)`, from its variance."""
    from scipy.stats import t

    if response.variance is None:
        raise InputError("magnitude_error: the response carries no variance; estimate it with spectra.frf.")
    positive("magnitude_error", "degrees", degrees)
    p = 1.0 - between("magnitude_error", "level", level, 0.01, 0.9999)
    return float(t.ppf(1 - p / 2, 2.0 * degrees)) * np.sqrt(response.variance / 2.0)


@takes_values
def transmissibility(
    records: Record | CrossSpectra | Sequence[Record],
    base: Choice,
    payload: Choice,
    segment_samples: int | None = None,
    overlap: float = 0.5,
    window: str = "hann",
    estimator: str = "H1",
    detrend: str = "constant",
) -> Transmissibility:
    """Return T = S_pb S_bb^-1, the payload's motion per motion of the base, with every base direction at once.

    Args:
        records: a record or several, in which the base moves in as many independent ways as it has directions: by the
            floor, by several sources at once or by one source a record (all segments are then pooled).
        base: sensors on the base, names or indices from 0, for instance x, y, z.
        payload: sensors on the payload; one on each side gives the scalar transmissibility.
        segment_samples: length of a segment; by default an eighth of the shortest record.
        overlap: shared part of neighbouring segments, 0 to 0.95.
        window: any window name of scipy.signal.
        estimator: "H1" (noise at the payload), "H2" (noise at the base), "Hv" (both), or "reference": both are related
            to the moving actuators, so that noise of either sensor averages out,
            T = S_pu S_uu^-1 S_ub (S_bu S_uu^-1 S_ub)^-1.
        detrend: what is removed from every segment: "constant", "linear" or "none".

    Raises:
        InputError: unknown or dead sensors, base directions that move alike, too few segments; "reference" with fewer
            moving actuators than base directions.

    >>> b = np.random.default_rng(0).standard_normal(8192)
    >>> record = Record(np.zeros(8192), [b, 0.1 * b], rate_hz=1000.0, sensors=["base z", "payload z"])
    >>> result = transmissibility(record, ["base z"], ["payload z"])
    >>> float(result.db.mean().round(6)), float(result.overall_db.mean().round(6))
    (-20.0, -20.0)

    Reference: A. M. R. Ribeiro, J. M. M. Silva, N. M. M. Maia, Mech. Syst. Signal Process. 14 (2000) 29-35,
    doi:10.1006/mssp.1999.1268; Pintelon and Schoukens 2012, section 2.6, doi:10.1002/9781118287422.
    """
    one_of(WHO, "estimator", estimator, ESTIMATORS)
    cross = _pooled(records, segment_samples, overlap, window, detrend)
    b, p = _rows(cross, "base", base), _rows(cross, "payload", payload)
    still = sorted({*b, *p} - set(cross.moving((*b, *p))))
    if still:
        raise InputError(f"{WHO}: sensor '{cross.channels[still[0]].name}' never moves; leave it out or mend its wire.")
    alive = alive_lines(WHO, cross, b)
    drives = cross.moving(range(len(cross.actuators)))
    group = Group(cross, tuple(b))
    if estimator == "reference":
        if len(drives) < len(b):
            raise InputError(
                f"{WHO}: {len(drives)} moving actuators cannot refer {len(b)} base directions; take 'H1' or 'Hv'."
            )
        alive &= alive_lines(WHO, cross, drives)
    s = group.blocks(b, p, alive)
    T, variance, degrees = _gains(group, s, drives, p, alive, estimator)
    own = cross.power[:, alive]
    coherence = np.broadcast_to(estimators.multiple(s)[:, :, np.newaxis], T.shape)
    response = FrequencyResponse(
        cross.f_hz[alive],
        np.moveaxis(T, 0, -1),
        np.moveaxis(coherence, 0, -1),
        f"{estimator}, {cross.averaging.text}, {'multiple ' if len(b) > 1 else ''}coherence",
        [cross.channels[i] for i in b],
        [cross.channels[i] for i in p],
        Provenance("spectra.transmissibility", {"estimator": estimator}, parents=cross.hashes),
        np.moveaxis(variance, 0, -1),
    )
    return Transmissibility(
        response, frozen(np.sqrt(own[p].sum(axis=0) / own[b].sum(axis=0))), cross.averaging, degrees
    )


def _pooled(
    records: Record | CrossSpectra | Sequence[Record], length: int | None, overlap: float, window: str, detrend: str
) -> CrossSpectra:
    if isinstance(records, CrossSpectra):
        return records
    many = [records] if isinstance(records, Record) else list(records)
    if not many:
        raise InputError(f"{WHO}: it needs at least one record, got none.")
    for record in many:
        same_rate(WHO, "the first record", many[0].rate_hz, "another", record.rate_hz)
    samples = segments(WHO, min(r.samples for r in many), length, overlap)[0]
    for record in many:
        for sensor, y in zip(record.sensors, record.outputs, strict=True):
            if len(many) == 1 and np.ptp(y) == 0:
                raise InputError(f"{WHO}: sensor '{sensor.name}' never moves; leave it out or mend its wire.")
    return reduce(add, (cross_spectra(r, samples, overlap, window, detrend) for r in many))


def _rows(cross: CrossSpectra, side: str, chosen: Choice) -> list[int]:
    """Return the rows of sensors given by name or index."""
    names = [c.name for c in cross.sensors]
    rows: list[int] = []
    listed = [chosen] if isinstance(chosen, str) or not isinstance(chosen, Iterable) else list(chosen)
    for one in listed:
        k = names.index(one) if isinstance(one, str) and one in names else one
        if isinstance(k, bool) or not isinstance(k, int | np.integer) or not 0 <= k < len(names):
            raise InputError(f"{WHO}: '{side}' names sensor {one!r}; known are {', '.join(names)}.")
        rows.append(len(cross.actuators) + int(k))
    if not rows or len(set(rows)) < len(rows):
        raise InputError(f"{WHO}: '{side}' must name at least one sensor, each once, got {listed}.")
    return rows


def _gains(
    group: Group, s: estimators.Spectra, drives: Sequence[int], p: Sequence[int], alive: np.ndarray, estimator: str
) -> tuple[ComplexArray, FloatArray, float]:
    """Return T and its variance `(nf, payload, base)`, and the independent segments behind it."""
    if estimator != "reference":
        find = {"H1": estimators.h1, "H2": estimators.h2, "Hv": estimators.hv}[estimator]
        return *find(s), s.degrees
    b = group.inputs
    S_uu, S_bu, S_pu = (group.cross.block(rows, drives)[alive] for rows in (drives, b, p))
    return *estimators.instrumental(s, S_uu, S_bu, S_pu), max(s.independent - len(drives), 0.0)
