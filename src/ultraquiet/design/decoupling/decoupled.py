"""Decoupled design: a constant transform splits the plant into small loops, each designed by itself, joined again."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar

import numpy as np
from scipy.sparse.csgraph import connected_components

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, real_array, rising_band
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import lookup, register
from ultraquiet._base.threads import single_threaded
from ultraquiet.analyse.plant_scale import EvenPlant, even_plant
from ultraquiet.design.hinf.band_attenuation import worst_attenuation_db
from ultraquiet.design.mean_channel import require_square
from ultraquiet.design.result import STABLE_WORDS, DesignResult, refused
from ultraquiet.design.robustness import WIDEST, StatedRobustness
from ultraquiet.design.structure_words import FULL, REPEATED
from ultraquiet.design.verification import judged
from ultraquiet.linalg import balance
from ultraquiet.linalg import common_axes as axes
from ultraquiet.values.door import takes_systems
from ultraquiet.values.interconnect import append, gain, series
from ultraquiet.values.state_space import StateSpace

POINTS = 60
NEGLIGIBLE = 1e-6  # Hankel values below this share of the largest leave a loop
TWICE = 1e-6  # relative difference below which two loops are one, used twice
# Times the margin of the whole that every block is to keep: its channels are combinations of the plant's, and what
# couples the blocks takes its share.
MORE = (1.0, 1.5, 2.5, 4.0, 6.0)
Split = tuple[FloatArray, FloatArray, list[list[int]]]


@register("design", "decoupled")
@dataclass(frozen=True)
class Decoupled(StatedRobustness):
    """K = Tu diag(K1, K2, ...) Ty', each Ki designed for its own block of Ty' G Tu by any registered method.

    Blocks that take the plant as their measure are asked for one to six times `disk_margin`, until the whole keeps it;
    where it never does, a split found in the data is given up and the plant designed as one block.

    Args:
        transform: `threefold` (six struts in three alike pairs: heave, yaw, one 2x2 used twice), `data` (orthonormal,
            from the symmetric parts of G over the band, blocks as the data have them; where the plant's own units show
            none, of the plant with its channels evened out, and none where nothing splits), `svd` (of the real part
            nearest to that even plant in the middle of the band, all loops single), or a square orthonormal matrix, row
            by row.
        method: registered design for the blocks.
        settings: of that method, as a table.
        band_hz: where the transform is sought and the residue read, Hz; absent, the band in `settings`, else the
            plant's own.
        tolerance: share of G's size below which the coupling of two loops is neglected (`data` and matrices).

    >>> one = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> result = Decoupled(transform="data").design(append(one, one))
    >>> result.status.ok, [len(b) for b in result.details["blocks"]], result.details["residue"] < 1e-9
    (True, [1, 1], True)

    Skogestad and Postlethwaite 2005, section 10.6 (SVD controllers); Hovd, Braatz and Skogestad 1997,
    doi:10.1016/S0005-1098(96)00194-2 (when they are optimal).
    """

    square_plants: ClassVar[bool] = True  # `design` takes no others

    transform: str | tuple[tuple[float, ...], ...] = "data"
    method: str = "band-attenuation"
    settings: Mapping[str, Any] = field(default_factory=dict)
    band_hz: tuple[float, float] | None = None
    tolerance: float = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.band_hz is not None:
            rising_band("Decoupled", self.band_hz)
        between("Decoupled", "tolerance", self.tolerance, 0.0, 1.0)

    @takes_systems
    @single_threaded
    def design(self, plant: StateSpace) -> DesignResult:
        """Return the joined controller u = K y, judged with the whole plant.

        `details`: `transform` (Ty, Tu), `blocks` the channels of every loop, `residue` the largest norm of what the
        transform leaves outside the blocks over that of G in the band, `loops` the result of every block (a block equal
        to an earlier one shares its law), `attenuation_db` the worst direction with the whole plant.

        Raises:
            InputError: a plant that is not square or does not answer, a band above Nyquist, a matrix that does not fit.
        """
        require_square("Decoupled", plant)
        even = even_plant(plant, self.band_hz or self._settings().get("band_hz"), "Decoupled")
        G = np.moveaxis(plant.frequency_response(np.geomspace(*even.band_hz, POINTS)), 2, 0)
        if not np.all(np.any(G, axis=(1, 2))):
            low, high = even.band_hz
            raise InputError(
                f"Decoupled: the plant does not answer in {low:g}-{high:g} Hz; nothing can be turned there."
            )
        split = self._found(G, even)
        best = self._firmest(plant, even.band_hz, G, split)
        # coupling that upsets the blocks' laws is not to be neglected, however small a share it is of the plant
        upset = best.controller is not None and not best.status.ok and self.transform == "data" and len(split[2]) > 1
        if upset and _sought(best):
            whole = self._firmest(plant, even.band_hz, G, _unsplit(G.shape[1]))
            best = whole if _kept(whole) > _kept(best) else best
        return best

    def _firmest(self, plant: StateSpace, band_hz: tuple[float, float], G: ComplexArray, split: Split) -> DesignResult:
        """Return the joined controller that is ok, else the one that keeps most, of blocks asked for ever more."""
        best: DesignResult | None = None
        for ask in self._asked():
            result = self._joined(plant, band_hz, G, split, ask)
            if result.controller is None:
                return best or result
            best = result if best is None or _kept(result) > _kept(best) else best
            # numbers that are given ask for the same laws again, whatever margin is asked of a block
            if result.status.ok or not _sought(result):
                break
        assert best is not None
        return best

    def _asked(self) -> tuple[float | None, ...]:
        """Return the disk margins to ask of every block in turn; None leaves it to the settings of the method."""
        if "disk_margin" in self._settings() or not self.disk_margin:
            return (None,)
        return tuple(min(more * self.disk_margin, WIDEST) for more in MORE)

    def _joined(
        self, plant: StateSpace, band_hz: tuple[float, float], G: ComplexArray, split: Split, ask: float | None
    ) -> DesignResult:
        """Return the joined controller of blocks that each keep a margin by themselves, judged on the whole plant."""
        Ty, Tu, blocks = split
        H, whole = Ty.T @ G @ Tu, turned(plant, Ty, Tu)
        laws: list[StateSpace] = []
        loops: list[DesignResult] = []
        for block in blocks:
            part = portion(plant, Ty[:, block], Tu[:, block])
            known = next((i for i, b in enumerate(blocks[: len(laws)]) if _same(H, b, block)), None)
            result = loops[known] if known is not None else self._method(part, whole, ask).design(part)
            if result.controller is None:
                return refused(
                    f"Decoupled: the loop of channels {block} has no controller: {result.status.sentence}",
                    transform=(Ty, Tu),
                    blocks=blocks,
                    residue=residue(H, blocks),
                )
            laws.append(result.controller)
            loops.append(result)
        order = [i for b in blocks for i in b]
        law = series(series(gain(Ty[:, order].T, plant.rate_hz), append(*laws)), gain(Tu[:, order], plant.rate_hz))
        details = {
            "transform": (Ty, Tu),
            "blocks": blocks,
            "residue": residue(H, blocks),
            "loops": loops,
            "band_hz": band_hz,
            "attenuation_db": worst_attenuation_db(plant, law, band_hz),
        }
        nan = float("nan")
        return judged(plant, law, self, max((r.gamma for r in loops), default=nan), nan, {}, details)

    def _settings(self) -> Mapping[str, Any]:
        if not isinstance(self.settings, Mapping):
            raise InputError(f"Decoupled: 'settings' must be a table of names and values, got {self.settings!r}.")
        return self.settings

    def _method(self, part: StateSpace, whole: StateSpace, ask: float | None = None) -> Any:
        kind = lookup("design", self.method)
        known = [f.name for f in fields(kind)]
        wrong = [k for k in self.settings if k not in known]
        if wrong:
            raise InputError(f"Decoupled: '{self.method}' has no setting '{wrong[0]}', only {', '.join(known)}.")
        method = kind(**self.settings)
        method = method if ask is None or "disk_margin" not in known else replace(method, disk_margin=ask)
        # numbers that nobody gave are those of the plant, so that every block has the same
        method = method.settled(whole) if hasattr(method, "settled") else method
        # one law repeated on all channels is meant for the whole plant: here every loop has its own
        several = part.D.shape[0] > 1 and getattr(method, "structure", FULL) == REPEATED
        return replace(method, structure=FULL) if several and kind.__name__ == "BandAttenuation" else method

    def _found(self, G: ComplexArray, even: EvenPlant) -> Split:
        n = G.shape[1]
        if self.transform == "threefold":
            if n != 6:
                raise InputError(f"Decoupled: 'threefold' is for six struts, the plant has {n} channels.")
            T = threefold()
            return T, T, [[0], [1], [2, 3], [4, 5]]
        # channels in units of many kinds weigh alike in the even plant
        scaled = G * even.outputs[:, None] * even.inputs
        if self.transform == "svd":
            U, _, Vt = np.linalg.svd(nearest_real(scaled[len(G) // 2]))
            return even.outputs[:, None] * U, even.inputs[:, None] * Vt.T, [[k] for k in range(n)]
        if self.transform == "data":
            T = common_axes(G)
            blocks = _blocks(T.T @ G @ T, self.tolerance)
            # a symmetry shows in common units alone; what is left out must be small in even units too
            outside = T @ _outside(T.T @ G @ T, blocks) @ T.T * even.outputs[:, None] * even.inputs
            if len(blocks) > 1 and _share(outside, scaled) <= self.tolerance:
                return T, T, blocks
            T = common_axes(scaled)
            blocks = _blocks(T.T @ scaled @ T, self.tolerance)
            # where nothing is split, turned channels gain nothing, and a margin kept in them is not one of the plant's
            if len(blocks) == 1:
                return _unsplit(n)
            return even.outputs[:, None] * T, even.inputs[:, None] * T, blocks
        if isinstance(self.transform, str):
            raise InputError(
                f"Decoupled: 'transform' must be 'threefold', 'data', 'svd' or a matrix, got {self.transform!r}."
            )
        T = real_array("Decoupled", "transform", self.transform, 2)
        if T.shape != (n, n) or not np.allclose(T.T @ T, np.eye(n), atol=1e-6):
            raise InputError(f"Decoupled: the matrix must be ({n}, {n}) and orthonormal, got shape {T.shape}.")
        return T, T, _blocks(T.T @ G @ T, self.tolerance)


def _unsplit(n: int) -> Split:
    """Return the plant as it is, in one block."""
    return np.eye(n), np.eye(n), [list(range(n))]


def _sought(result: DesignResult) -> bool:
    """Return whether the gain of every block was sought for its margin."""
    return all("gain" in r.details for r in result.details["loops"])


def _kept(result: DesignResult) -> float:
    """Return the smaller disk margin of a loop, below zero for one that is unstable."""
    if result.status.word not in STABLE_WORDS:
        return -1.0
    return min(float(end.disk_all) for end in result.margins.values())


def threefold() -> FloatArray:
    """Return the orthonormal transform of six struts in three alike pairs, mirror symmetry included, in columns.

    Heave (1, 1, 1, 1, 1, 1), yaw (1, -1, 1, -1, 1, -1), then twice the two of one 2x2: the sum of a pair over the
    cosine and its difference over the sine of the pair's angle, and the same a quarter turn on.

    >>> bool(np.allclose(threefold().T @ threefold(), np.eye(6)))
    True
    """
    angle = 2 * np.pi * np.arange(3) / 3
    both, apart = np.array([1.0, 1.0]), np.array([1.0, -1.0])
    columns = [
        np.kron(np.ones(3), both),
        np.kron(np.ones(3), apart),
        np.kron(np.cos(angle), both),
        np.kron(np.sin(angle), apart),
        np.kron(np.sin(angle), both),
        np.kron(-np.cos(angle), apart),
    ]
    return np.column_stack([c / np.linalg.norm(c) for c in columns])


def common_axes(G: ComplexArray) -> FloatArray:
    """Return the orthonormal matrix that comes nearest to diagonalising every G(f), from `(frequency, n, n)`.

    Eigenvectors of the symmetric part of the mean of all G: each G(f) is turned to its nearest real matrix first, so
    that one constant matrix stands for all. Where eigenvalues coincide, G itself over the band fixes the axes.
    """
    unit = G / np.maximum(np.linalg.norm(G, axis=(1, 2)), 1e-300)[:, None, None]
    turned = np.array([nearest_real(g) for g in unit])
    # signs follow the first, for a real matrix is known up to it
    signs = np.sign(np.einsum("fij,ij->f", turned, turned[0]))
    mean = np.einsum("f,fij->ij", np.where(signs == 0, 1.0, signs), turned)
    return axes.common_axes((mean + mean.T) / 2, np.concatenate([unit.real, unit.imag]))


def nearest_real(g: ComplexArray) -> FloatArray:
    """Return Re(e^-ja g) with the angle that leaves the least imaginary part."""
    angle = np.angle(np.sum(g * g)) / 2
    return np.real(g * np.exp(-1j * angle))


def residue(H: ComplexArray, blocks: list[list[int]]) -> float:
    """Return the largest norm outside the blocks over the norm of the whole, over `(frequency, n, n)`."""
    return _share(_outside(H, blocks), H)


def _outside(H: ComplexArray, blocks: list[list[int]]) -> ComplexArray:
    inside = np.zeros(H.shape[1:], dtype=bool)
    for block in blocks:
        inside[np.ix_(block, block)] = True
    return np.where(inside, 0.0, H)


def _share(part: ComplexArray, whole: ComplexArray) -> float:
    return float(np.max(np.linalg.norm(part, 2, axis=(1, 2)) / np.linalg.norm(whole, 2, axis=(1, 2))))


def turned(plant: StateSpace, left: FloatArray, right: FloatArray) -> StateSpace:
    """Return left' G right."""
    return StateSpace(plant.A, plant.B @ right, left.T @ plant.C, left.T @ plant.D @ right, plant.rate_hz)


def portion(plant: StateSpace, left: FloatArray, right: FloatArray) -> StateSpace:
    """Return left' G right without the states that it neither sees nor moves, be they unstable."""
    whole = turned(plant, left, right)
    without = balance.without_faint if plant.is_stable() else balance.without_hidden
    M = without((whole.A, whole.B, whole.C, whole.D), NEGLIGIBLE, discrete=plant.rate_hz is not None)
    return StateSpace(*M, rate_hz=plant.rate_hz)


def _blocks(H: ComplexArray, tolerance: float) -> list[list[int]]:
    """Return groups of channels that are coupled by more than a share of the whole."""
    size = np.linalg.norm(H, 2, axis=(1, 2))[:, None, None]
    near = np.max(np.abs(H) / size, axis=0) > tolerance
    _, label = connected_components(near | near.T, directed=False)
    return [np.flatnonzero(label == k).tolist() for k in range(label.max() + 1)]


def _same(H: ComplexArray, one: list[int], other: list[int]) -> bool:
    if len(one) != len(other):
        return False
    a, b = H[:, one][:, :, one], H[:, other][:, :, other]
    return bool(np.linalg.norm(a - b) <= TWICE * np.linalg.norm(a))
