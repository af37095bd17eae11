"""Where a search begins: a law of another design, cut down, in the form in which it is searched."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import UltraquietError
from ultraquiet.design.h2.lqg import Lqg
from ultraquiet.design.hinf.band_attenuation import BandAttenuation, common_mode
from ultraquiet.design.hinf.mixed_sensitivity import MixedSensitivity
from ultraquiet.design.law_structure.controller_structure import ControllerStructure, Placement
from ultraquiet.design.law_structure.damped_pairs import DampedPairs, Resonances, damped
from ultraquiet.design.law_structure.elements import Element, from_system
from ultraquiet.design.law_structure.plane import Plane, plane_of
from ultraquiet.design.peak_bounded.biquads import Biquads, in_series
from ultraquiet.design.result import DesignMethod
from ultraquiet.linalg import balance
from ultraquiet.linalg.ordered import Matrices
from ultraquiet.values.state_space import StateSpace

FLOOR = 0.03  # damping ratio of a law's poles: sharper ones would invert single modes of single units
OUTSIDE = 1.1  # corners of a rational weight lie a tenth outside the band
STEEP = 8  # states of the weight on a scalar function
# Of that weight's height, of the limit on K S, and where the weights on K S and T rise, over the band's upper edge.
ZETA, LITTLE = 0.3, 0.3  # of the sections of a law that hardly acts: damping, and its loop's gain at their centres
# Two shares of that limit: a search from the bolder law alone ends up to 5 dB short where a model is less smooth.
HEIGHT, SHARES, CONTROL_FROM, ROLL_OFF_FROM = 12.0, (0.6, 0.2), 4.0, 5.0


@dataclass(frozen=True, eq=False)
class Places:
    """Where laws of one kind stand: for each element its rows of the readings and its columns of the commands."""

    groups: tuple[tuple[FloatArray, ...], ...]  # per element, columns T such that K = sum T k T'

    @staticmethod
    def of(directions: FloatArray, groups: tuple[int, ...]) -> "Places":
        """Return places of scalar laws along orthonormal columns; columns of one number share a law."""
        kinds = sorted(set(groups))
        return Places(tuple(tuple(directions[:, [k]] for k, g in enumerate(groups) if g == kind) for kind in kinds))


def begun(
    plane: Plane, law: StateSpace, places: Places | None, states: int, tones_w: FloatArray, tone_zeta: float
) -> tuple[ControllerStructure, FloatArray] | None:
    """Return the structure of a search and the parameters of the law that it begins with.

    Args:
        plane: in which laws live.
        law: a scalar law for every place, or the whole law where there are no places.
        places: of scalar laws; None for one law from all readings to all commands.
        states: of each law.
        tones_w: of resonators beside it, places in the plane.
        tone_zeta: their damping.

    None where the law's modes cannot be told apart.
    """
    found = _element(plane, law, states)
    if found is None:
        return None
    (r, c), none = found[0].shape, np.zeros(0)
    kinds: list[tuple[Element, FloatArray]] = [found]
    if tones_w.size:
        tones = Resonances(tones_w, np.full(tones_w.size, tone_zeta), r, c)
        kinds.append((tones, np.zeros(tones.size)))
    elements: list[Element] = []
    placements: list[Placement] = []
    parts: list[FloatArray] = [none]
    for columns in ((None,),) if places is None else places.groups:
        for element, theta in kinds:
            for T in columns:
                left, right = (np.eye(r), np.eye(c)) if T is None else (T, T.T)
                placements.append(Placement(len(elements), left, right))
            elements.append(element)
            parts.append(theta)
    return ControllerStructure(tuple(elements), tuple(placements)), np.concatenate(parts)


def _element(plane: Plane, law: StateSpace, states: int) -> tuple[Biquads | DampedPairs, FloatArray] | None:
    """Return a law cut to some states as a tunable element."""
    M: Matrices = plane.to_plane(law)
    if law.states > states:
        P, Q = balance.gramians(*M[:3], discrete=False)
        left, right, _ = balance.balancing(P, Q, states)
        M = balance.truncate(M, left, right)
    M = _evenly(M, states)
    if law.D.shape == (1, 1) and states:
        return in_series(M, FLOOR)
    pairs = from_system(M)
    return None if pairs is None else damped(*pairs, FLOOR)


def _evenly(M: Matrices, states: int) -> Matrices:
    """Return a system with as many states as asked, by well damped ones that do nothing yet."""
    A, B, C, D = M
    missing = states - A.shape[0]
    if missing <= 0:
        return M
    size = np.abs(np.linalg.eigvals(A)) if A.size else np.ones(1)
    low, high = np.log(size.min()), np.log(size.max())
    # apart from one another and from what is there
    speeds = np.exp(np.linspace(low - 1, high + 1, missing + 2)[1:-1] + 0.01)
    gain = 1e-3 * max(float(np.abs(D).max(initial=0.0)), float(np.abs(C).max(initial=0.0)), 1e-12)
    b, c = np.sqrt(speeds)[:, None] * np.ones((1, B.shape[1])), gain * np.ones((C.shape[0], 1)) * np.sqrt(speeds)
    top = np.hstack([A, np.zeros((A.shape[0], missing))])
    low_rows = np.hstack([np.zeros((missing, A.shape[0])), -np.diag(speeds)])
    return np.vstack([top, low_rows]), np.vstack([B, b]), np.hstack([C, c]), D


def starts(plant: StateSpace, band_hz: tuple[float, float], limit: float, scalar: bool) -> list[StateSpace]:
    """Return stable laws to begin with, for a plant in the units of a search or for what its channels share.

    `BandAttenuation` with steep weights in numbers, whose corners are set by the band and whose price by `limit`, about
    the gain that K S may have; then designs that the plant itself measures. There may be none.
    """
    part = common_mode(plant) if scalar else plant
    low, high = band_hz[0] / OUTSIDE, OUTSIDE * band_hz[1]
    if plant.rate_hz is not None:
        high = min(high, 0.45 * plant.rate_hz)
    if part.D.shape == (1, 1):
        steep = [
            BandAttenuation(
                band_hz=(low, high),
                height=HEIGHT,
                order=STEEP,
                control_limit=share * limit,
                control_hz=CONTROL_FROM * band_hz[1],
                roll_off_hz=ROLL_OFF_FROM * band_hz[1],
            )
            for share in SHARES
        ]
        # the laws alone: their margins are of no account here
        found = [_made(lambda each=each: each.synthesis(part).controller) for each in steep]
        if any(law is not None for law in found):
            return [law for law in found if law is not None]
    tries: list[DesignMethod] = [BandAttenuation(band_hz=(low, high), order=2), Lqg(band_hz=(low, high))]
    return _designed(tries, part)


def unasked_starts(plant: StateSpace, disk_margin: float, scalar: bool) -> list[StateSpace]:
    """Return stable laws to begin with where no band is asked for: designs that make a plant's own response small."""
    part = common_mode(plant) if scalar else plant
    tries: list[DesignMethod] = [Lqg(disk_margin=disk_margin), MixedSensitivity(disk_margin=disk_margin)]
    return _designed(tries, part)


def _designed(tries: list[DesignMethod], part: StateSpace) -> list[StateSpace]:
    """Return the laws of those designs that give a stable one."""
    made = [_made(lambda each=each: each.design(part).controller) for each in tries]
    return [law for law in made if law is not None]


def _made(law: Callable[[], StateSpace | None]) -> StateSpace | None:
    """Return a law where there is a stable one."""
    try:
        found = law()
    except (UltraquietError, np.linalg.LinAlgError):
        return None
    return found if found is not None and found.is_stable() else None


def hardly(plant: StateSpace, band_hz: tuple[float, float], states: int, scalar: bool) -> StateSpace:
    """Return a law that hardly acts: sections over the band, each turning one direction of the plant back a little.

    At the frequency w of section i, K = -e v u' / sigma with the plant's singular vectors there: it attenuates that
    direction, and leaves every bound room. It needs a stable plant.
    """
    part = common_mode(plant) if scalar else plant
    ny, nu = part.D.shape
    m = states // 2
    f = np.geomspace(*band_hz, m + 2)[1:-1]
    plane = plane_of(plant)
    A, B, C = np.zeros((2 * m, 2 * m)), np.zeros((2 * m, ny)), np.zeros((nu, 2 * m))
    G = np.moveaxis(part.frequency_response(f), 2, 0)
    U, sigma, Vh = np.linalg.svd(G, full_matrices=False)
    strong = sigma.max(initial=0.0) or 1.0  # nothing to turn back: any size does
    for i, w in enumerate(plane.of_hz(f)):
        k = i % sigma.shape[1]
        here = slice(2 * i, 2 * i + 2)
        A[here, here] = [[0.0, w], [-w, -2 * ZETA * w]]
        u: ComplexArray = U[i, :, k].astype(np.complex128)
        v: ComplexArray = Vh[i, k].conj().astype(np.complex128)
        e = -LITTLE / max(float(sigma[i, k]), 1e-3 * float(strong))
        root = np.sqrt(w)
        # at w, C (s - A)^-1 B = (c1 + j c2) (b2 + j b1)' / (2 j zeta w) but for what is small with zeta
        B[here] = root * np.array([-u.imag, u.real])
        C[:, here] = root * e * 2 * ZETA * np.column_stack([-v.imag, v.real])
    return plane.from_plane((A, B, C, np.zeros((nu, ny))))
