"""The structured singular value: how small a perturbation of a given structure may upset a loop."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array, frozen
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import ByContents
from ultraquiet.analyse.margins import default_grid, grid_given
from ultraquiet.analyse.peaks import ends, refined, response_at
from ultraquiet.analyse.scalings.largest import LargestBound
from ultraquiet.analyse.scalings.lower import lower_bound
from ultraquiet.analyse.scalings.upper import Upper, balanced_norm, upper_bound
from ultraquiet.analyse.structure import BlockStructure, PerturbationBlock, structure
from ultraquiet.values.frequency_response import FrequencyResponse
from ultraquiet.values.state_space import StateSpace

QUICK_ROUNDS = 3  # of narrowing with the quick bound, before the close one narrows as far as a peak is ever narrowed
Blocks = Sequence[int | tuple[int, int] | PerturbationBlock]


@dataclass(frozen=True, eq=False)
class MuBounds:
    """Bounds of mu over frequency, with what proves each of them.

    Attributes:
        upper, lower: `(nf,)` lower <= mu <= upper.
        D: `(nz, nz, nf)` scaling of the outputs; without real blocks the largest singular value of D M D_in^-1 is
            `upper`. The last block's part has size one.
        D_in: `(nw, nw, nf)` scaling of the inputs: for a full block the same number, for others the same matrix.
        G: `(nw, nz, nf)` scaling of real blocks, zero without them:
            upper^2 D_in' D_in - M' D' D M - j (G M - M' G') >= 0.
        perturbation: `(nw, nz, nf)` Delta of the structure, of size 1 / lower, with det(I - M Delta) = 0; NaN where
            lower is zero.
        f_hz: `(nf,)` Hz; NaN when M came without frequencies.
        blocks: the structure.
        stable: False when M was a system that is unstable, of which no perturbation can be stood.
    """

    upper: FloatArray
    lower: FloatArray
    D: ComplexArray
    D_in: ComplexArray
    G: ComplexArray
    perturbation: ComplexArray
    f_hz: FloatArray
    blocks: tuple[PerturbationBlock, ...]
    stable: bool = True
    _peak: tuple[float, float] = field(default=(np.nan, np.nan), repr=False)

    @property
    def peak(self) -> tuple[float, float]:
        """Largest upper bound and its frequency in Hz, refined between the lines when M was a system."""
        return self._peak

    @property
    def levels(self) -> FloatArray:
        """Size of D block by block, `(blocks, nf)`; the last one's is one: what a D-K iteration fits."""
        return _sizes(np.moveaxis(self.D, 2, 0), BlockStructure(self.blocks))

    @property
    def gap(self) -> FloatArray:
        """1 - lower / upper, `(nf,)`: what is not known of mu; zero where mu is zero."""
        return np.where(self.upper > 0, 1 - self.lower / np.where(self.upper > 0, self.upper, 1.0), 0.0)


def mu_bounds(
    M: StateSpace | FrequencyResponse | ComplexArray, blocks: Blocks | None = None, f_hz: ArrayLike | None = None
) -> MuBounds:
    """Return bounds of the structured singular value, with scalings and the perturbation that prove them.

    mu(M) = 1 / min { |Delta| : det(I - M Delta) = 0, Delta of the structure }, |.| the largest singular value.

    Args:
        M: what the perturbation sees: a system, a response, or an array `(nz, nw, nf)` (two dimensions: one frequency).
        blocks: of Delta along its diagonal: a number k is any complex k x k matrix, a pair any one that takes (outputs,
            inputs) of M, a `PerturbationBlock` a repeated or a real number. One complex number a channel when absent.
        f_hz: lines in Hz; for a system log-spaced up to Nyquist when absent, for an array names of its lines only.

    Returns:
        `MuBounds`. A loop stands every perturbation smaller than 1 / upper at all frequencies, and is upset by one of
        size 1 / lower. Both bounds meet for up to three full blocks; for more, gaps of a few per cent are common.
        Real blocks: the lower bound is zero where no real eigenvalue was found.

    Raises:
        InputError: blocks that do not fit M, lines that do not fit the array or on which M has a pole, no line at all.

    >>> bounds = mu_bounds(np.array([[0.0, 10.0], [0.1, 0.0]]))
    >>> float(bounds.upper[0].round(6)), float(bounds.lower[0].round(6)), bounds.levels[:, 0].round(6).tolist()
    (1.0, 1.0, [0.1, 1.0])

    Packard and Doyle 1993, doi:10.1016/0005-1098(93)90175-S; real blocks:
    Fan, Tits and Doyle 1991, doi:10.1109/9.62265.
    """
    values, f, stable = _response(M, f_hz)
    if not f.size:
        raise InputError("mu_bounds: M has no line; give one frequency at least.")
    infinite = ~np.isfinite(values).all(axis=(0, 1))
    if infinite.any():
        raise InputError(
            f"mu_bounds: M is infinite at {f[infinite][0]:g} Hz, where it has a pole; leave that line out."
        )
    block_structure = structure("mu_bounds", blocks, values.shape[:2])
    stack = np.moveaxis(values, 2, 0)
    # sizes far from one would overflow in their squares
    size = np.abs(stack).max(axis=(1, 2), initial=0.0)
    size[size == 0] = 1.0
    unit = stack / size[:, None, None]
    upper = upper_bound(unit, block_structure)
    lower, Q = lower_bound(unit, block_structure, upper)
    perturbation = np.full(Q.shape, np.nan, dtype=np.complex128)
    destabilised = lower > 0
    perturbation[destabilised] = Q[destabilised] / (lower * size)[destabilised, None, None]
    # both stand to rounding only: where they meet, the larger is the upper one
    top = np.maximum(upper.value, lower) * size
    beside = ends(M.rate_hz) if isinstance(M, StateSpace) and f_hz is None else None
    peak = _peak(M, f, (top, upper), block_structure, beside) if stable else (np.inf, np.nan)
    D, D_in, G = _normalised(upper, block_structure)
    arrays = (D, D_in, G * size[:, None, None], perturbation)
    return MuBounds(
        frozen(top),
        frozen(lower * size),
        *(frozen(np.moveaxis(a, 0, 2)) for a in arrays),
        f_hz=frozen(f),
        blocks=block_structure.blocks,
        stable=stable,
        _peak=peak,
    )


def mu_upper_bound(M: ComplexArray) -> FloatArray:
    """Return the smallest scaled norm inf over diagonal D > 0 of the largest singular value of D M D^-1, per frequency.

    Args:
        M: square response `(n, n, nf)`.

    Returns:
        `(nf,)`, never below the structured singular value for n independent complex perturbations, and equal to it for
        n up to 3. Its inverse is the size of perturbation, one on each channel, that the loop is sure to stand.

    >>> float(mu_upper_bound(np.array([[[0.0], [10.0]], [[0.1], [0.0]]], dtype=complex))[0].round(6))
    1.0

    Packard and Doyle 1993, doi:10.1016/0005-1098(93)90175-S.
    """
    values = _response(M, None)[0]
    return upper_bound(np.moveaxis(values, 2, 0), structure("mu_upper_bound", None, values.shape[:2])).value


def mu_peak(M: StateSpace, blocks: Blocks | None = None, f_hz: ArrayLike | None = None) -> tuple[float, float]:
    """Return the largest upper bound of mu over frequency and where, refined between the lines.

    Much less work than `mu_bounds`: only lines that may hold the peak are bounded closely.

    Args:
        M: stable system; infinity at NaN Hz for an unstable one.
        blocks: as in `mu_bounds`.
        f_hz: lines, Hz; log-spaced up to Nyquist when absent.

    >>> lag = StateSpace([[-1.0]], [[1.0]], [[2.0]], [[0.0]])
    >>> round(mu_peak(lag)[0], 3)
    2.0
    """
    block_structure = structure("mu_peak", blocks, M.D.shape)
    if not M.is_stable():
        return np.inf, np.nan
    if f_hz is None:
        return _peak_of(ByContents(M, M.hash), block_structure.blocks)
    return _peak(M, grid_given("mu_peak", f_hz), None, block_structure, None)


# A design, its reduction and its report ask for the margins of the same loop.
@lru_cache(maxsize=64)
def _peak_of(M: ByContents[StateSpace], blocks: tuple[PerturbationBlock, ...]) -> tuple[float, float]:
    G = M.value
    return _peak(G, default_grid(G), None, structure("mu_peak", blocks, G.D.shape), ends(G.rate_hz))


def _peak(
    M: StateSpace | FrequencyResponse | ComplexArray,
    f: FloatArray,
    known: tuple[FloatArray, Upper] | None,
    blocks: BlockStructure,
    beside: FloatArray | None,
) -> tuple[float, float]:
    """Return the largest upper bound and where; `known` are bounds at all lines with their scalings."""
    if not isinstance(M, StateSpace):
        assert known is not None
        k = int(np.argmax(known[0])) if f.size else 0
        return (float(known[0][k]), float(f[k])) if f.size else (0.0, np.nan)
    response, visited, norms = response_at(M), list[FloatArray](), list[FloatArray]()
    bound = LargestBound(blocks)

    def stack(lines: FloatArray) -> ComplexArray:
        return np.ascontiguousarray(np.moveaxis(response(lines), 2, 0))

    def quick(lines: FloatArray) -> FloatArray:
        visited.append(lines)
        norms.append(balanced_norm(stack(lines), blocks))
        return norms[-1]

    def close(lines: FloatArray) -> FloatArray:
        return bound(lines, stack(lines))

    grid = np.sort(f)
    if known is not None:
        bound.learn(f, known[1], known[0])
        largest, at = refined(close, grid, known[0][np.argsort(f)], beside)
        return max(largest, bound.highest), at
    # the quick bound leads to the peaks, where the close one then has little way to go
    refined(quick, grid, quick(grid), rounds=QUICK_ROUNDS)
    lines, first = np.unique(np.concatenate(visited), return_index=True)
    found = bound(lines, stack(lines), np.concatenate(norms)[first])
    largest, at = refined(close, lines, found, beside)
    return max(largest, bound.highest), at


def _response(
    M: StateSpace | FrequencyResponse | ComplexArray, f_hz: ArrayLike | None
) -> tuple[ComplexArray, FloatArray, bool]:
    """Return values `(nz, nw, nf)`, their frequencies, and whether they belong to a stable system."""
    if isinstance(M, StateSpace):
        f = default_grid(M) if f_hz is None else frequency_array("mu", f_hz)
        with np.errstate(divide="ignore", invalid="ignore"):  # a pole on a line, refused by name
            return M.frequency_response(f), f, M.is_stable()
    if isinstance(M, FrequencyResponse):
        return M.values, np.array(M.f_hz), True
    values = np.asarray(M, dtype=np.complex128)
    if values.ndim == 2:
        values = values[:, :, None]
    if values.ndim != 3 or not np.isfinite(values).all():
        raise InputError(
            f"mu: M must be a finite array (nz, nw, nf), a response or a system, got shape {values.shape}."
        )
    f = np.full(values.shape[2], np.nan) if f_hz is None else frequency_array("mu", f_hz)
    if f.size != values.shape[2]:
        raise InputError(f"mu: M has {values.shape[2]} lines, 'f_hz' has {f.size}.")
    return values, f, True


def _normalised(upper: Upper, blocks: BlockStructure) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return roots of D and G with the last block at one."""
    D, D_in = (np.linalg.cholesky(D).conj().swapaxes(1, 2) for D in (upper.out, upper.into))
    unit = _sizes(D, blocks)[-1]
    return D / unit[:, None, None], D_in / unit[:, None, None], upper.G / unit[:, None, None] ** 2


def _sizes(D: ComplexArray, blocks: BlockStructure) -> FloatArray:
    """Return the root mean square of D over each block, `(blocks, nf)`, from `(nf, nz, nz)`."""
    power = np.abs(D) ** 2
    return np.array([np.sqrt(power[:, p, p].sum(axis=(1, 2)) / (p.stop - p.start)) for p in blocks.outputs])
