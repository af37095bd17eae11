"""Whether a simulated error follows the inputs somewhere, told at the resolution of the whole record.

Around a mode that a model misses, its error obeys D(z) E = b U + t + D(z) V at neighbouring lines of the record's
spectrum: D a polynomial of second degree, t the transient, V the noise. So over windows of lines of many widths the
span of E, r E, r^2 E is held against the inputs, smooth transients taken out of both (canonical correlations). Nothing
of the model enters: a mode that it has not cannot hide for having no pole there.

Noise of any colour alarms no more often than the level says: where the inputs' spectrum is level over a window, and a
filter common to all signals levels it, they point from noise of any shape in any direction alike.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.identify.result import SIGNIFICANCE
from ultraquiet.values import Status, StatusWord

# Of an output's RMS, that may be missed though it follows the inputs: right modes, estimated from a response that
# leakage and loud noise have touched, leave 0.06 of it.
MISSED = 0.1
NARROWEST, SPARE = 16, 3  # lines of the narrowest window, at least; lines it has for each unknown
WIDEST = 1024  # lines of the widest one, but for those that begin at the lowest line
DEGREE = 2  # of D: one mode, its mirror image below 0 Hz or a second mode beside it
TRANSIENT = 2  # coefficients of the transient
LEVELLING = 16  # samples of the autoregression that levels the inputs' spectra
SILENT = 1e-9  # of an input's largest line: what is below is rounding
RIDGE = 1e-12
BLOCKS = 64  # parts of a record, by which it is told how evenly an input acts
BATCH = 2_000_000


class Following(NamedTuple):
    """What of an error follows the inputs.

    Attributes:
        p_value: that nothing does; small: something does.
        share: of the error's power that plainly does.
        f: cycles per sample where that is most.
    """

    p_value: float
    share: float
    f: float


def unless_followed(
    status: Status, error: FloatArray, output: FloatArray, inputs: FloatArray, rate_hz: float, limit: float
) -> Status:
    """Return the verdict on one output, no longer `ok` where more than a share of it is missed and follows the inputs.

    Args:
        status: the verdict so far.
        error: `(n,)` what the simulated output misses, the unknown past taken out.
        output: `(n,)`.
        inputs: `(nu, n)`.
        rate_hz: sampling rate.
        limit: RMS over that of the output which may be missed.
    """
    size = float(output.std())
    if not status.ok or error.std() <= limit * size:
        return status
    left = following(error, inputs)
    missed = np.sqrt(left.share) * float(error.std()) / size if size > 0 else np.inf
    if left.p_value >= SIGNIFICANCE or missed <= limit:
        return status
    return Status(
        StatusWord.POOR_FIT,
        f"The simulated output misses {100 * missed:.0f} % that follow the inputs, most near {left.f * rate_hz:.3g} "
        f"Hz: a mode is missing or off its place; raise the order, record for longer, fit a periodic response, or "
        f"take 'subspace'.",
    )


class _Window(NamedTuple):
    first: np.ndarray  # lines
    width: int
    p_value: FloatArray
    squared: FloatArray  # largest canonical correlation, squared


def following(error: FloatArray, inputs: FloatArray) -> Following:
    """Return what of an error `(n,)` follows the inputs `(nu, n)`; an error that is not finite follows them whole."""
    if not np.all(np.isfinite(error)):
        return Following(0.0, 1.0, 0.0)
    moving = inputs[np.ptp(inputs, axis=1) > 0]
    nu = len(moving)
    if nu == 0 or np.ptp(error) == 0:
        return Following(1.0, 0.0, 0.0)
    alike = _lines_alike(moving)
    narrowest = int(np.ceil(alike * max(NARROWEST, SPARE * (DEGREE + 1 + TRANSIENT + nu))))
    if (error.size - LEVELLING - 1) // 2 < narrowest:
        return Following(1.0, 0.0, 0.0)
    u = (moving - moving.mean(axis=1, keepdims=True)) / moving.std(axis=1, keepdims=True)
    e = error - error.mean()
    E, U = (_spectra(_filtered(x, _levelling(u))) for x in (e[None], u))
    power = np.abs(_spectra(e[None, LEVELLING:])[0]) ** 2
    windows = [_tested(E[0], U, first, width, alike) for first, width in _windows(power.size, narrowest)]
    count = sum(w.first.size for w in windows)
    level = SIGNIFICANCE / count
    followed = power * np.max([_followed(w, power.size, level, alike, nu) for w in windows], axis=0)
    at = int(np.argmax(followed)) + 1
    return Following(
        min(1.0, count * min(float(w.p_value.min()) for w in windows)),
        float(followed.sum() / power.sum()),
        at / (e.size - LEVELLING),
    )


def _lines_alike(inputs: FloatArray) -> float:
    """Return how many neighbouring lines of an input's spectrum are one: a burst's is smooth, and so is a transient's.

    A record's length over that of even power which holds as much information.
    """
    n = inputs.shape[1]
    blocks = inputs[:, : n // BLOCKS * BLOCKS].reshape(len(inputs), BLOCKS, -1) if n >= BLOCKS else inputs[:, :, None]
    power = np.mean((blocks - inputs.mean(axis=1)[:, None, None]) ** 2, axis=2)
    return float(np.max(np.mean(power**2, axis=1) / np.mean(power, axis=1) ** 2))


def _levelling(u: FloatArray) -> FloatArray:
    """Return 1, a_1 .. of the autoregression that the inputs have in common."""
    from scipy.linalg import solve_toeplitz

    n = u.shape[1]
    r = np.array([float(np.sum(u[:, k:] * u[:, : n - k])) for k in range(LEVELLING + 1)]) / u.size
    r[0] *= 1.0 + 1e-9
    return np.concatenate([[1.0], -np.asarray(solve_toeplitz(r[:-1], r[1:]))])


def _filtered(x: FloatArray, a: FloatArray) -> FloatArray:
    from scipy.signal import lfilter

    return np.asarray(lfilter(a, [1.0], x, axis=1))[:, LEVELLING:]


def _spectra(x: FloatArray) -> ComplexArray:
    """Return the lines between 0 Hz and half the rate, `(channels, lines)`."""
    return np.asarray(np.fft.rfft(x, axis=1)[:, 1 : (x.shape[1] + 1) // 2], dtype=np.complex128)


def _windows(lines: int, narrowest: int) -> Iterator[tuple[np.ndarray, int]]:
    """Yield first lines and widths; neighbours of one width overlap by half."""
    width = narrowest
    while width <= lines:
        wide = width > WIDEST
        yield (np.zeros(1, dtype=np.int64) if wide else np.arange(0, lines - width + 1, width // 2)), width
        width *= 2


def _tested(E: ComplexArray, U: ComplexArray, first: np.ndarray, width: int, alike: float) -> _Window:
    step = max(1, BATCH // width)
    parts = [_correlated(E, U, first[k : k + step], width) for k in range(0, first.size, step)]
    statistic, squared = (np.concatenate(x) for x in zip(*parts, strict=True))
    p = _by_chance(statistic, int(width / alike) - TRANSIENT, DEGREE + 1, len(U))
    return _Window(first, width, p, squared)


def _correlated(E: ComplexArray, U: ComplexArray, first: np.ndarray, width: int) -> tuple[FloatArray, FloatArray]:
    """Return -ln of Wilks' statistic, and the largest canonical correlations squared."""
    at = first[:, None] + np.arange(width)
    r = np.linspace(-1.0, 1.0, width)
    smooth = np.broadcast_to(r[:, None] ** np.arange(TRANSIENT), (first.size, width, TRANSIENT))
    Q, _ = np.linalg.qr(smooth[0].astype(np.complex128))
    floor = SILENT * np.abs(U).max(axis=1)
    u = np.moveaxis(np.where(np.abs(U) > floor[:, None], U, 0.0)[:, at], 0, 2)
    e = E[at][:, :, None] * r[:, None] ** np.arange(DEGREE + 1)
    u, e = (_evened(x - Q @ (Q.conj().T @ x)) for x in (u, e))
    uu, ee, eu = (np.conj(np.swapaxes(a, 1, 2)) @ b for a, b in ((u, u), (e, e), (e, u)))
    uu, ee = (x + RIDGE * np.eye(x.shape[1]) for x in (uu, ee))
    L = np.linalg.inv(np.linalg.cholesky(ee))
    known = L @ eu @ np.linalg.solve(uu, np.conj(np.swapaxes(eu, 1, 2))) @ np.conj(np.swapaxes(L, 1, 2))
    squared = np.clip(np.linalg.eigvalsh(known), 0.0, 1.0 - RIDGE)
    return np.asarray(-np.log1p(-squared).sum(axis=1), dtype=np.float64), np.asarray(squared[:, -1], dtype=np.float64)


def _evened(x: ComplexArray) -> ComplexArray:
    size = np.linalg.norm(x, axis=1, keepdims=True)
    return x / np.where(size > 0, size, 1.0)


def _by_chance(statistic: FloatArray, lines: int, p: int, q: int) -> FloatArray:
    """Return how often -ln of Wilks' statistic of complex normal vectors is as large: a gamma of its two moments.

    It is a sum of p independent -ln Beta(lines - q - i, q), i = 0 .. p - 1 (Goodman 1963, doi:10.1214/aoms/1177704250).
    """
    from scipy.special import digamma, gammaincc, polygamma

    a = lines - q - np.arange(p)
    mean = float(np.sum(digamma(a + q) - digamma(a)))
    variance = float(np.sum(polygamma(1, a) - polygamma(1, a + q)))
    return np.asarray(gammaincc(mean**2 / variance, statistic * mean / variance))


def _followed(windows: _Window, lines: int, level: float, alike: float, nu: int) -> FloatArray:
    """Return the share of each line's power that plainly follows the inputs, told by windows of one width."""
    followed = np.zeros(lines)
    plain = np.flatnonzero(windows.p_value < level)
    unknowns = (DEGREE + nu) * alike
    told = 1.0 - (1.0 - windows.squared[plain]) / (1.0 - unknowns / (windows.width - TRANSIENT * alike))
    share = np.where(told[:, None] > _masked(np.linspace(-1.0, 1.0, windows.width)), told[:, None], 0.0)
    np.maximum.at(followed, windows.first[plain, None] + np.arange(windows.width), share)
    return followed


def _masked(r: FloatArray) -> FloatArray:
    """Return the squared correlation that inputs may have with D E though a loud line of noise at r does not follow.

    D takes it out with a root at r; what the model misses of a level gain, however little, is then followed by as much
    as polynomials with that root come near to one (Christoffel's function of Legendre's polynomials).
    """
    from numpy.polynomial.legendre import legvander

    kernel = legvander(r, DEGREE) ** 2 @ (2 * np.arange(DEGREE + 1) + 1)
    return np.asarray(1.0 - 1.0 / kernel, dtype=np.float64)
