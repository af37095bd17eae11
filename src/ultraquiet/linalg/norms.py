"""The peak gain of state-space matrices over frequency, exactly."""

from collections.abc import Callable

import numpy as np

from ultraquiet.linalg.balance import Coordinates, even_blocks, modal
from ultraquiet.linalg.discretize import bilinear_to_continuous
from ultraquiet.linalg.even import connected, even_states
from ultraquiet.linalg.modal_response import Residues, split
from ultraquiet.linalg.ordered import Array
from ultraquiet.linalg.response import refined_gain

ROUNDS = 30
# An eigenvalue counts as imaginary when its real part is below this share of its modulus: generous, because each
# candidate is then judged by the gain it stands for and not by its place: rounding of poles that are nearly repeated
# sends a crossing further off the axis than its damping, and any point of an interval above the level raises it.
AXIS_SHARE = 1e-2
# First guesses closer than 2 % are one, but for resonances sharper than that.
DISTINCT = 0.02
SHARP = 0.05
# A fan of points around a peak, narrowed in four steps, finds its place to 1e-7.
FAN = np.linspace(-1, 1, 30)
FANS = (2e-2, 1e-3, 5e-5, 2.5e-6)
INNER = 9  # points between the neighbours of a peak
NARROWINGS = 8  # at most, by a factor of four each
RIVALS = 3  # resonances beside a peak that are looked at
RIVAL = 0.9  # of the peak, from which on they are
DISAGREE = 1e-7  # the relative accuracy of a norm, unless less is asked for
LEVEL = DISAGREE / 10  # a peak whose neighbours are as high but for that share is found
FEW = 5  # points likewise where each is dear: a round narrows by a factor of two, for two new ones
PARABOLAS = 6
GAINED = 1e-10  # what a parabola that was worth its while adds to the peak
# Where the response itself is uncertain by more than the accuracy of a norm, as in loops whose gain is the same at all
# frequencies and whose states are decades apart, that many of the highest places are looked at with refinement.
HIGHEST = 40
EXACTLY = 150  # states, up to which that is done
MOVED = 1e-2  # of the accuracy, from which on rounding may move a peak
# A response off by no more than that share is believed about where it is lower than the peak by so many times as much.
CREDIBLE, BELIEVED = 1e-4, 10.0
PLACES = 4  # of a plateau where that is asked
DOUBLINGS = 30  # of a step away from a peak, until the response says that it is off the peak
A_DECADE = 16  # frequencies that a flat response is looked at
DECADES = 12  # at most
EARLIEST = 1e-300  # stands for a pole at z = 0, which has decayed before the first sample


def peak_gain(
    A: Array,
    B: Array,
    C: Array,
    D: Array,
    discrete: bool,
    tolerance: float = 1e-7,
    exact: Callable[[complex], float] | None = None,
) -> tuple[float, float]:
    """Return the largest singular value over frequency and where: rad/s, or radians per sample when discrete.

    Bruinsma and Steinbuch 1990 (doi:10.1016/0167-6911(90)90049-Z): imaginary eigenvalues of a Hamiltonian say whether
    and between which frequencies the gain exceeds a level; the level climbs to the peak. Discrete systems go through
    the bilinear map, which keeps every gain. An unstable system gives infinity at its fastest growing mode. Units of
    states, powers of two at least, do not count. `exact` gives the gain at s or z better than these matrices do, which
    are then an ill-conditioned form of it: what they tell wrong is told by it.
    """
    A, B, C, _ = even_states(A, B, C)
    poles = np.linalg.eigvals(A)
    if poles.size and (np.abs(poles).max() >= 1 if discrete else poles.real.max() >= 0):
        return np.inf, least_damped(poles, discrete)
    A, B, C = connected(A, B, C)
    if len(A) < len(poles):  # round-off of what leads nowhere is no part of the response
        poles = np.linalg.eigvals(A)
    gain, w = _mapped_peak(A, B, C, D, poles, tolerance) if discrete else _peak(modal(A, B, C), D, (A, B, C), tolerance)
    gain_at = exact or (lambda z: refined_gain(A, B, C, D, z))
    told = _Known(lambda w: np.array([gain_at(z) for z in (np.exp(1j * w) if discrete else 1j * w)]), exact is not None)
    gain, w = _refined(A, B, C, D, discrete, poles, gain, w, max(tolerance, DISAGREE), told)
    return (told.one(w) if np.isfinite(w) else gain), w


def least_damped(poles: Array, discrete: bool) -> float:
    """Return where the pole is that grows fastest, or decays most slowly: rad/s, or radians per sample."""
    worst = poles[np.argmax(np.abs(poles) if discrete else poles.real)]
    return float(abs(np.angle(worst)) if discrete else abs(worst.imag))


def largest_gains(M: Array) -> Array:
    """Return the largest singular value of each matrix `(nf, ny, nu)`, by eigenvalues of the smaller of two products.

    To rounding, as the singular values themselves have it, in a third of the time.
    """
    largest = np.abs(M).max(axis=(1, 2), initial=0.0)
    unit = M / np.where(largest > 0, largest, 1.0)[:, None, None]
    turned = unit.conj().swapaxes(1, 2)
    product = turned @ unit if M.shape[2] <= M.shape[1] else unit @ turned
    return largest * np.sqrt(np.maximum(np.linalg.eigvalsh(product)[:, -1], 0.0))


def _refined(
    A: Array,
    B: Array,
    C: Array,
    D: Array,
    discrete: bool,
    poles: Array,
    gain: float,
    w: float,
    accuracy: float,
    exact: "_Known",
) -> tuple[float, float]:
    """Return a peak found in modal coordinates as it is in the coordinates given.

    Modal blocks know a pole to the round-off of A times the condition of the modes, which is much of the damping of a
    light one. Near a resonance 1 / gain^2 is a parabola over frequency: three points of it lead to its bottom.
    Resonances that come near the peak are looked at as well. Where the two disagree on the peak itself, as delays and
    repeated poles make them, the modal form is left aside and the peak sought anew.
    """
    if not (np.isfinite(w) and poles.size and gain > 0):
        return gain, w

    def direct(w: Array) -> Array:
        z = np.exp(1j * w) if discrete else 1j * w
        try:
            return largest_gains(C @ np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, B) + D)
        except np.linalg.LinAlgError:  # a pole on the axis, but for round-off
            return np.concatenate([direct(w[[k]]) for k in range(w.size)]) if w.size > 1 else np.array([np.inf])

    at = _Known(direct)

    # as rates of decay and frequencies, in both times the same
    places = _rates(poles) if discrete else poles
    sharp: Array = places[(places.imag > 0) & (np.abs(places.real) < SHARP * np.abs(places))]
    rivals = sharp.imag[np.argsort(np.abs(sharp.imag - w))[:RIVALS]]
    rivals = rivals[at(rivals) > RIVAL * gain]
    best, where = at.one(w), w
    if not np.isfinite(best):
        return gain, w
    last = np.pi if discrete else np.inf
    looks = np.concatenate([[w], _guesses(places), _between(places) if len(A) <= EXACTLY else []])
    if abs(best / gain - 1) > accuracy:
        best, where = _sought(at, looks[looks <= last], last)
    for start in [w, *rivals] if where > 0 else []:
        near = places[np.argmin(np.abs(places - 1j * start))]
        top, x = _parabola(at, start, abs(float(near.real)))
        if top > best:
            best, where = top, x
    # two forms may agree by luck: whether the response is known so well, the exact one says
    looked = _where_told(places, where, 1.0 if discrete else float(np.abs(poles).max()), accuracy)
    if exact.of_others and len(A) <= EXACTLY:
        looked = np.concatenate([looked, _as_high(at, looks[looks <= last], best * (1 - BELIEVED * accuracy), PLACES)])
    off = float(np.abs(at(looked) / exact(looked) - 1).max())
    if not off > accuracy or len(A) > EXACTLY:
        return best, where
    looks = np.concatenate([[where], looks, np.abs(places), np.abs(places.imag)])
    looks = looks[looks <= last]
    if off > CREDIBLE:
        return _sought(exact, _highest(at, looks, HIGHEST), last)
    level = best * (1 - BELIEVED * off)
    highest = _highest(at, looks, HIGHEST // 2)
    places = np.concatenate([highest[at(highest) >= level], _as_high(at, looks, level, HIGHEST // 2)])
    return _told_apart(at, exact, np.unique(places), off, (float(looks[looks > 0].min(initial=last)), last))


def _where_told(places: Array, w: float, size: float, accuracy: float) -> Array:
    """Return where the exact response says how well a peak is known, also beside it where rounding of A may move it."""
    decay = float(np.abs(places[np.argmin(np.abs(places - 1j * w))].real))
    moved = np.finfo(float).eps * size > MOVED * accuracy * decay
    return np.abs(w + np.sqrt(accuracy) * decay * np.array([-1.0, 0.0, 1.0] if moved else [0.0]))


def _as_high(at: "_Known", places: Array, level: float, count: int) -> Array:
    """Return some of the places above a level, its first and last among them: a plateau peaks where errors say."""
    gains = at(places)
    above = np.unique(places[np.isfinite(gains) & (gains >= level)])
    return above[np.unique(np.linspace(0, above.size - 1, count).astype(int))] if above.size else above


class _Known:
    """A gain over frequency that is evaluated for many frequencies at once, and once only for each.

    `of_others` says that it is that of other matrices: it then differs from the one at hand by a curve, which may be
    zero at the peak, and not by what rounding takes at each frequency anew.
    """

    def __init__(self, of: Callable[[Array], Array], of_others: bool = False) -> None:
        self._of = of
        self.of_others = of_others
        self._known: dict[float, float] = {}

    def __call__(self, w: Array) -> Array:
        asked = [float(x) for x in w]
        new = np.array(sorted({x for x in asked if x not in self._known}))
        if new.size:
            self._known.update(zip(new.tolist(), self._of(new).tolist(), strict=True))
        return np.array([self._known[x] for x in asked])

    def one(self, w: float) -> float:
        return float(self(np.array([w]))[0])


def _highest(at: _Known, places: Array, count: int) -> Array:
    """Return the places where a gain known to a few digits is highest."""
    w = np.unique(places)
    gains = at(w)
    return w[np.argsort(-np.where(np.isfinite(gains), gains, 0.0), kind="stable")[:count]]


def _told_apart(at: _Known, exact: _Known, places: Array, off: float, ends: tuple[float, float]) -> tuple[float, float]:
    """Return the exact peak among places that a response off by a share does not tell apart.

    What that response can tell is not asked again: it bounds where each peak may lie, and the exact one, many times as
    dear, decides only there.
    """
    gains = exact(places)
    best, where = float(gains.max()), float(places[np.argmax(gains)])
    least, last = ends
    for start in places[np.argsort(-gains, kind="stable")][:RIVALS]:
        level, step = at.one(start) * (1 - BELIEVED * off), DISAGREE * max(float(start), least)
        low, high = (_fallen(at, float(start), level, turn * step, last) for turn in (-1, 1))
        top, x = _narrowed(exact, np.linspace(low, high, FEW), 2 * NARROWINGS, FEW)
        if top > best:
            best, where = top, x
    return best, where


def _fallen(at: _Known, start: float, level: float, step: float, last: float) -> float:
    """Return how far from a peak a response is below a level, or an end of the axis; steps are doubled."""
    x = start
    for _ in range(DOUBLINGS):
        x = float(np.clip(start + step, 0.0, last))
        if x in (0.0, last) or at.one(x) < level:
            break
        step *= 2
    return x


def _sought(at: _Known, places: Array, last: float) -> tuple[float, float]:
    """Return the largest gain at some places, narrowed in on between the neighbours of the first few peaks."""
    w = np.unique(places)
    gains = at(w)
    gains[~np.isfinite(gains)] = 0.0
    best, where = float(gains.max()), float(w[np.argmax(gains)])
    padded = np.concatenate([[0.0], gains, [0.0]])
    tops = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]))
    for k in tops[np.argsort(-gains[tops], kind="stable")[:RIVALS]]:
        low, high = float(w[max(k - 1, 0)]), min(float(w[min(k + 1, w.size - 1)]), last)
        # close to the peak as well, however far its neighbours are
        around = w[k] * (1 + FANS[0] * FAN)
        inner = np.concatenate([around[(around > low) & (around < high)], np.linspace(low, high, INNER)])
        top, x = _narrowed(at, inner)
        if top > best:
            best, where = top, x
    return best, where


def _narrowed(at: _Known, places: Array, rounds: int = NARROWINGS, points: int = INNER) -> tuple[float, float]:
    """Return the largest gain inside some places, between the neighbours of the best one again and again."""
    top, x = 0.0, float(places[0])
    for _ in range(rounds):
        w = np.unique(places)
        gains = at(w)
        gains[~np.isfinite(gains)] = 0.0
        k = int(np.argmax(gains))
        top, x = (float(gains[k]), float(w[k])) if gains[k] > top else (top, x)
        low, high = max(k - 1, 0), min(k + 1, w.size - 1)
        if min(gains[low], gains[high]) >= gains[k] * (1 - LEVEL):  # what is left to find is beyond the accuracy
            break
        places = np.linspace(w[low], w[high], points)
    return top, x


def _rates(poles: Array) -> Array:
    return np.log(np.where(poles == 0, EARLIEST, poles).astype(np.complex128))


def _parabola(at: _Known, w: float, width: float) -> tuple[float, float]:
    best, where, h, in_vain = at.one(w), w, width / 2, 0
    for _ in range(PARABOLAS):
        if not 0 < h < where or in_vain == 2:  # a parabola over less than a sixteenth of the width finds no more
            break
        left, middle, right = 1 / at(np.array([where - h, where, where + h])) ** 2
        bend = left - 2 * middle + right
        move = h * (left - right) / (2 * bend) if bend > 0 else (h if right < left else -h)
        new = where + float(np.clip(move, -4 * h, 4 * h))
        higher = at.one(new) if new > 0 else 0.0
        in_vain = 0 if higher > best * (1 + GAINED) else in_vain + 1
        if higher <= best:
            h /= 8
            continue
        best, where = higher, new
    return best, where


def _mapped_peak(A: Array, B: Array, C: Array, D: Array, poles: Array, tolerance: float) -> tuple[float, float]:
    """Return the peak of a discrete system, and where in radians per sample, by the bilinear map."""
    form = modal(A, B, C)
    # z -> -z keeps every gain and turns the spectrum round: no pole is then near the point that goes to infinity
    turned = poles.size and np.abs(poles + 1).min() < np.abs(poles - 1).min()
    turn = -1.0 if turned else 1.0
    given = bilinear_to_continuous(turn * A, turn * B, C, D)
    a, b, c, d = bilinear_to_continuous(turn * form.A, turn * form.B, form.C, D)
    gain, w = _peak(form._replace(A=a, B=b, C=c), d, given[:3], tolerance)
    angle = float(2 * np.arctan(w))
    return gain, np.pi - angle if turned else angle


def _peak(form: Coordinates, D: Array, given: tuple[Array, Array, Array], tolerance: float) -> tuple[float, float]:
    """Return the peak of a continuous system in modal coordinates; `given` is the same one in others."""
    direct = float(np.linalg.norm(D, 2)) if D.size else 0.0
    if not (form.A.size and np.any(form.B) and np.any(form.C)):
        return direct, 0.0
    form = even_blocks(form)
    gain = _Gain(split(form, D))
    best, at = gain.climb(_guesses(np.linalg.eigvals(form.A)), direct, np.inf)
    if best == 0:
        return 0.0, 0.0
    # coordinates round differently: that nothing is higher counts once both say so
    forms = [(form.A, form.B, form.C), even_states(*given)[:3]]
    agreed = 0
    for _ in range(ROUNDS):
        best, at = gain.polish(best, at) if not agreed else (best, at)
        level = best * (1 + 2 * tolerance)
        best, at = gain.climb(_between_crossings(*forms[agreed], D, level), best, at)
        agreed = agreed + 1 if best <= level else 0
        if agreed == len(forms):
            break
    return best, at


def _between_crossings(A: Array, B: Array, C: Array, D: Array, level: float) -> Array:
    """Return the frequencies at which a singular value may equal `level`, and those between them."""
    crossings = _crossings(A, B, C, D, level)
    return np.concatenate([crossings, np.sqrt(crossings[:-1] * crossings[1:])])


def _guesses(poles: Array) -> Array:
    """Return frequencies near which a peak is likely: resonances and corner frequencies, some between, and zero."""
    w = np.concatenate([np.abs(poles.imag), np.abs(poles)])
    w = w[w > 0]
    if not w.size:
        return np.zeros(1)
    apart = np.exp(np.unique(np.round(np.log(w) / DISTINCT)) * DISTINCT)
    resonances = np.abs(poles.imag[np.abs(poles.real) < SHARP * np.abs(poles)])
    return np.concatenate([[0.0], apart, np.unique(resonances), [10 * w.max()]])


def _between(poles: Array) -> Array:
    """Return frequencies from the slowest pole to the fastest: a response that is nearly flat peaks anywhere."""
    w = np.abs(poles[poles != 0])
    decades = float(np.log10(w.max() / w.min())) if w.size else 0.0
    return np.geomspace(w.min(), w.max(), 2 + int(A_DECADE * min(decades, DECADES))) if w.size else w


class _Gain:
    """The largest singular value over frequency, and the climb to its peak."""

    def __init__(self, terms: Residues) -> None:
        self._terms = terms

    def climb(self, w: Array, best: float, at: float) -> tuple[float, float]:
        """Return the larger of the best gain so far and those at `w`, and its place."""
        if w.size == 0:
            return best, at
        with np.errstate(divide="ignore", invalid="ignore"):  # 0 Hz on a pole that rounding puts there
            gains = np.linalg.norm(np.moveaxis(self._terms.at(1j * w), 2, 0), 2, axis=(1, 2))
        gains = np.where(np.isnan(gains), 0.0, gains)  # its shoulders say as much
        k = int(np.argmax(gains))
        return (float(gains[k]), float(w[k])) if gains[k] > best else (best, at)

    def polish(self, best: float, at: float) -> tuple[float, float]:
        """Narrow in on the local peak by fans of points around the best one."""
        if not np.isfinite(at) or at == 0:
            return best, at
        for spread in FANS:
            best, at = self.climb(at * (1 + spread * FAN), best, at)
        return best, at


def _crossings(A: Array, B: Array, C: Array, D: Array, level: float) -> Array:
    """Return the frequencies at which a singular value may equal `level`, sorted."""
    b, c, d = B / np.sqrt(level), C / np.sqrt(level), D / level
    R = np.eye(d.shape[1]) - d.T @ d
    RDC = np.linalg.solve(R, np.hstack([d.T @ c, b.T]))
    n = A.shape[0]
    a = A + b @ RDC[:, :n]
    H = np.block([[a, b @ RDC[:, n:]], [-c.T @ (c + d @ RDC[:, :n]), -a.T]])
    values = np.linalg.eigvals(H)
    return np.unique(np.abs(values.imag[np.abs(values.real) <= AXIS_SHARE * np.abs(values)]))
