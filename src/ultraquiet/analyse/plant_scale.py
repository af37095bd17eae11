"""What a plant says of itself: the band in which it answers, and the units in which its channels weigh alike."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray, frozen, rising_band
from ultraquiet._base.provenance import ByContents
from ultraquiet.analyse.margins import bounded_grid, bounded_response
from ultraquiet.analyse.peaks import response_at
from ultraquiet.linalg.even import evened
from ultraquiet.values.interconnect import gain, series
from ultraquiet.values.state_space import StateSpace

HIGHEST = 0.4  # of the sampling rate; nearer to Nyquist a corner has no room to rise
WITHIN = 0.1  # of the largest gain, 20 dB: where a plant counts as answering
# The band depends on the scales and they on it. It stands still after two, but where a mode at its edge is within 20 dB
# by the scales of a band without it and beyond by those of one with it: after these it only grows.
ROUNDS = 4
LINES = 200  # over a given band, besides those of the poles
FEW = 16  # lines on which a channel that answers is heard
COUPLING = 0.1  # of the largest gain of its row and of its column: what is less joins no channels
SWEEPS = 60  # of rows and columns in turn; what is not zero in a matrix converges geometrically


@dataclass(frozen=True, eq=False)
class EvenPlant:
    """A plant in units of its own: Ge = diag(outputs) G diag(inputs), rows and columns of mean square one.

    Attributes:
        plant: Ge.
        inputs: `(nu,)` what one unit of each input of Ge is in the plant's.
        outputs: `(ny,)` what one unit of each output of the plant is in those of Ge.
        band_hz: the plant's own band.
        f_hz: lines inside it.
        from_rest: whether the plant's own band has no lower edge: it is as loud at rest as anywhere.
    """

    plant: StateSpace
    inputs: FloatArray
    outputs: FloatArray
    band_hz: tuple[float, float]
    f_hz: FloatArray
    from_rest: bool = False

    @property
    def loudness(self) -> float:
        """Typical gain of the plant over its band, output units per input unit: root mean square, geometric mean.

        Channels without any response say nothing of it.
        """
        G = np.abs(response_at(self.plant)(self.f_hz[:: max(1, self.f_hz.size // FEW)]))
        heard, moving = self.outputs[G.any(axis=(1, 2))], self.inputs[G.any(axis=(0, 2))]
        if not heard.size:
            return 1.0
        return float(np.exp(-np.mean(np.log(heard)) - np.mean(np.log(moving))))

    def law(self, even: StateSpace) -> StateSpace:
        """Return the controller of the plant from one of Ge: K = diag(inputs) Ke diag(outputs)."""
        return StateSpace(
            even.A,
            even.B * self.outputs,
            even.C * self.inputs[:, None],
            even.D * self.outputs * self.inputs[:, None],
            even.rate_hz,
        )

    def even_law(self, law: StateSpace) -> StateSpace:
        """Return the controller of Ge from one of the plant, the inverse of `law`."""
        u, y = self.inputs[:, None], self.outputs
        return StateSpace(law.A, law.B / y, law.C / u, law.D / y / u, law.rate_hz)

    def weights(self, performance: StateSpace, control: StateSpace) -> dict[str, StateSpace]:
        """Return weights of Ge's signals as weights of the plant's."""
        rate = self.plant.rate_hz
        return {
            "performance": series(gain(np.diag(self.outputs), rate), performance),
            "control": series(gain(np.diag(1 / self.inputs), rate), control),
        }

    def rms_reduction_db(self, even: StateSpace) -> float:
        """Return by how much a law of Ge lowers the RMS of G under white disturbances at its inputs, over the band.

        -20 log10 of the RMS of S G over that of G, Frobenius norm, all in the units of Ge.
        """
        G, K = (np.moveaxis(response_at(s)(self.f_hz), 2, 0) for s in (self.plant, even))
        closed = np.linalg.solve(np.eye(G.shape[1]) - G @ K, G)
        widths = _widths(self.f_hz)
        left, had = (float(np.sum(np.abs(g) ** 2 * widths[:, None, None])) for g in (closed, G))
        return -10 * float(np.log10(left / had)) if left > 0 and had > 0 else 0.0


def even_plant(plant: StateSpace, band_hz: tuple[float, float] | None = None, who: str = "even_plant") -> EvenPlant:
    """Return a plant with its channels evened out over its own band.

    The band reaches from the first to the last frequency at which the largest singular value of Ge is within 20 dB of
    its maximum, at 0.4 of the rate at most; there the mean square of every row and of every column of Ge is one,
    what is zero throughout left out. Both are sought in turn. Other units of an input, an output or a state give the
    same Ge and the same band.

    Args:
        plant: G, continuous or discrete. A channel without any response keeps its unit.
        band_hz: a band in place of the plant's own.
        who: asks, for the sentence of a refusal.

    A pole on the stability boundary, where the gain has no bound, is passed on a small circle (`bounded_response`):
    without it there would be neither a mean nor a band.

    Sinkhorn 1964, doi:10.1214/aoms/1177703591 (rows and columns in turn).
    """
    asked = None if band_hz is None else rising_band(who, band_hz, plant.rate_hz)
    return _even(ByContents(plant, plant.hash), asked)


# A design asks for its plant's scales before its search and for its verdict, its reduction and its report ask again.
@lru_cache(maxsize=16)
def _even(asked: ByContents[StateSpace], band_hz: tuple[float, float] | None) -> EvenPlant:
    plant = asked.value
    f = bounded_grid(plant)
    f = f[(f > 0) & (f <= below_nyquist(np.inf, plant.rate_hz))]
    if band_hz is not None:
        low, high = band_hz
        f = np.unique(np.concatenate([f[(f > low) & (f < high)], np.geomspace(low, high, LINES)]))
    G = np.moveaxis(bounded_response(plant)(f), 2, 0)
    power, widths = np.abs(G) ** 2, _widths(f)
    # powers of squares of units many decades apart: the largest of each row and column first
    y, u = unit_peaks(power)
    inside, rounds, still = np.ones(f.size, dtype=bool), 0, False
    while rounds < ROUNDS or not still:
        share = inside * widths / np.sum(inside * widths)
        mean = np.einsum("f,fij->ij", share, power * (y**2)[:, None] * u**2)
        rows, columns = _sinkhorn(mean)
        y, u, rounds = y * rows, u * columns, rounds + 1
        found = inside if band_hz is not None else _answering(G * y[:, None] * u)
        if rounds > ROUNDS:
            found |= inside
        inside, still = found, np.array_equal(found, inside)
    lines = f[inside]
    states = evened(plant.A, plant.B * u, plant.C * y[:, None])
    even = StateSpace(*states, plant.D * u * y[:, None], plant.rate_hz)
    from_rest = band_hz is None and bool(inside[0])
    return EvenPlant(even, frozen(u), frozen(y), (float(lines[0]), float(lines[-1])), frozen(lines), from_rest)


def _answering(G: ComplexArray) -> NDArray[np.bool_]:
    """Return which lines of a response `(f, ny, nu)` lie between the first and the last within 20 dB of the largest."""
    sizes = np.linalg.norm(G, 2, axis=(1, 2))
    near, k = np.flatnonzero(sizes >= WITHIN * sizes.max(initial=0.0)), np.arange(sizes.size)
    return (k >= near[0]) & (k <= near[-1])


def below_nyquist(corner_hz: float, rate_hz: float | None) -> float:
    """Return a corner that something discrete can have: at most 0.4 of the rate."""
    return corner_hz if rate_hz is None else min(corner_hz, HIGHEST * rate_hz)


def _widths(f: FloatArray) -> FloatArray:
    return np.asarray(np.gradient(f), dtype=np.float64) if f.size > 1 else np.ones(f.size)


def unit_peaks(power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return scales of rows, then of columns, that bring the largest entry of each to one."""
    rows = _inverse_root(power.max(axis=(0, 2), initial=0.0))
    columns = _inverse_root((power * (rows**2)[:, None]).max(axis=(0, 1), initial=0.0))
    return rows, columns


def _groups(mean: FloatArray) -> NDArray[np.intp]:
    """Return to which group each row, then each column, belongs: they fall apart where weak powers are left out.

    Weak is what is far below the largest of its row and of its column. That is looked at where the logarithms of rows
    and columns have mean zero, which weighs all of them alike and hangs on no unit that the plant is given in.
    """
    known = mean > 0
    log = np.log(np.where(known, mean, 1.0))
    counts = [np.maximum(known.sum(axis=axis, keepdims=True), 1) for axis in (1, 0)]
    for _ in range(SWEEPS):
        for axis, count in zip((1, 0), counts, strict=True):
            log -= known * (np.sum(log * known, axis=axis, keepdims=True) / count)
    weak = known & _is_weak(np.where(known, np.exp(log - log.max(initial=0.0)), 0.0))
    if not weak.any():  # as on most plants: nothing falls apart, and nothing is loaded to find that out
        return np.zeros(sum(mean.shape), dtype=np.intp)
    from scipy.sparse import bmat, csr_array
    from scipy.sparse.csgraph import connected_components

    strong = csr_array(known & ~weak)
    found: NDArray[np.intp] = connected_components(bmat([[None, strong], [strong.T, None]]), directed=False)[1]
    return found


def _is_weak(power: FloatArray) -> NDArray[np.bool_]:
    """Return which powers are far below the largest of their row and of their column."""
    largest = np.minimum(power.max(axis=1, initial=0.0)[:, None], power.max(axis=0, initial=0.0))
    return power < COUPLING**2 * largest


def _sinkhorn(mean: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return scales at which the mean of the powers that are not zero is one in every row and column.

    Two sensors on one axis and one on another ask for another sum of rows than of columns. Couplings of 1e-4 between
    these axes give both what they ask for, at scales 1e4 apart, as large as the axes and there for a law to rely on.
    Where that happens, couplings are left out like zeros, and the units of either group are those in which what couples
    them is alike in both directions.
    """
    rows, columns = _swept(mean)
    row_of, column_of = np.split(_groups(mean), [len(mean)])
    couples = (mean > 0) & (row_of[:, None] != column_of)
    if not (couples & ~_is_weak(mean * (rows**2)[:, None] * columns**2)).any():
        return rows, columns
    rows, columns = _swept(np.where(couples, 0.0, mean))
    i, j = np.nonzero(couples)
    log = np.log(mean[i, j]) / 2 + np.log(rows[i]) + np.log(columns[j])
    moves = np.zeros((i.size, 1 + max(row_of.max(), column_of.max())))
    np.add.at(moves, (np.arange(i.size), row_of[i]), 1.0)
    np.add.at(moves, (np.arange(i.size), column_of[j]), -1.0)
    # scales of whole groups, and one level for all couplings, that leave least between them
    by = np.linalg.lstsq(np.hstack([moves, -np.ones((i.size, 1))]), -log)[0]
    return rows * np.exp(by[row_of]), columns * np.exp(-by[column_of])


def _swept(mean: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the scales that rows and columns in turn lead to.

    Zeros counted, there need be none: the rows of a plant with a dead sensor ask for another sum than its columns, and
    every sweep would carry the scales further away.
    """
    rows, columns = np.ones(mean.shape[0]), np.ones(mean.shape[1])
    across, along = (np.maximum(np.count_nonzero(mean, axis=axis), 1) for axis in (1, 0))
    for _ in range(SWEEPS):
        rows = _inverse_root((mean * columns**2).sum(axis=1) / across)
        columns = _inverse_root((mean * (rows**2)[:, None]).sum(axis=0) / along)
    return rows, columns


def _inverse_root(power: FloatArray) -> FloatArray:
    root = np.sqrt(power)
    return np.divide(1.0, root, out=np.ones_like(root), where=root > 0)
