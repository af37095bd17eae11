"""The modes that ring on in a free response, each with its growth and how well that is known."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.simulate.frames import FOLD, OVERLAP, Frames

# A band rings when its amplitude is so many times that of the noise in it; a mode is visible likewise.
VISIBLE = 3.0
# Smallest share of the largest amplitude that double precision lets one see.
ROUNDING = 1e-12
MOST_MODES, MOST_BANDS = 40, 24
LARGEST = 1e12  # of ratios of powers
LEAKED = 1e-19  # of the power of the loudest line: what is less may have leaked from it through the window
# A line of the noise stands out when its power is so many times the median of so many lines to either side, which white
# noise never reaches; it is a tone when one of constant size has this share of its power: a mode that noise rings has
# less unless it is slow. How far a slow one stands out says nothing of it: others that noise rings stand around it.
STANDS_OUT, BROAD, COHERENT = 8.0, 16, 0.45
RISES = 3.0  # the noise above its surroundings, or the response above the noise: a line where a mode may hide
REFINEMENTS = 4
# Frames so many steps apart share next to nothing of a window this steep. A mode keeps this share of itself over so
# many steps; noise alone does not.
APART, LASTING = OVERLAP // 2, 0.5
# A mode that shrinks by this from frame to frame is none that rings, one that grows by this many e-folds within its
# record none that numbers hold.
DEAD, WILD = 1e-3, 600.0
# Two modes are one when they are nearer than this share of a line of the whole record, and their growths agree.
RESOLVED, CERTAIN = 10.0, 4.0
# An error may be as smooth as the modes themselves: a random walk of what noise feeds them, or a mode left out.
# A deviation is this share of the largest that an error of the size seen could make, whatever its shape.
ALIGNED = 0.5
# Lines on either side of a band's middle within which its modes count: where the band is the loudest of its
# neighbourhood, and where it is one beside it. There, a mode this share of a line from one that is known is the same.
WIDE, NARROW, OTHER = 1.1, 0.6, 0.25
# Whatever is this much smaller than the largest amplitude in its band is not resolved from it.
REAL = 1e-9  # of the rate; a pole nearer than this to the real axis lies on it, but for rounding
RESOLUTION = 1e-6


@dataclass(frozen=True)
class Mode:
    """One mode of a free response, c exp((growth + 2 pi i f) t): growth in 1/s, its standard deviation, Hz.

    `seen`: largest amplitude in the second half of the record over that of the noise in its band.
    """

    growth_per_s: float
    growth_std: float
    f_hz: float
    seen: float

    @property
    def grows(self) -> bool:
        """Whether noise alone would hardly feign this growth."""
        return self.growth_per_s > CERTAIN * self.growth_std

    @property
    def decays(self) -> bool:
        """Whether noise alone would hardly feign this decay."""
        return self.growth_per_s < -CERTAIN * self.growth_std


@dataclass(frozen=True)
class Ringing:
    """What is heard of a free response: `modes` visible in the second half of the record, slowest first.

    `tones_hz`: where the noise holds a tone that the response does not: a mode that the burst did not reach, or a tone
    from elsewhere. `hidden_hz`: where the noise rises above its surroundings, or the response a little above the
    noise, the tones among them: what becomes of a mode there nobody knows yet.
    """

    modes: tuple[Mode, ...]
    tones_hz: tuple[float, ...]
    hidden_hz: tuple[float, ...] = ()


def ringing(response: FloatArray, noise: FloatArray, rate_hz: float) -> Ringing:
    """Return the modes still visible in the second half of a free response.

    y_t = sum_i c_i z_i^t + noise. Bands whose power in the second half exceeds the noise's are taken one by one; in
    each the amplitude over time is a sum of few exponentials, found by the eigensystem realisation of its Hankel matrix
    (Juang and Pappa 1985, doi:10.2514/3.20031), its order from the noise's Hankel matrix, and refined by Gauss-Newton.

    Args:
        response: `(channels, samples)`, nothing driving it but noise.
        noise: the same loop's answer to noise alone, `(channels, samples)`: says what is visible, and how uncertain.
        rate_hz: samples per second.

    Returns:
        Modes with growth, its standard deviation (rounded up: the error may have the worst shape) and frequency; those
        hidden by noise are not returned.
    """
    frames = Frames(response.shape[1], rate_hz)
    scaled, level = _scaled(response, noise)
    if not scaled.size:
        return Ringing((), ())
    late = frames.count // 2
    floor = (ROUNDING * np.abs(scaled).max()) ** 2
    hum = np.maximum(frames.power(level, late), frames.power(level, 0))
    excess = frames.power(scaled, late) / np.maximum(hum, floor)
    modes: list[Mode] = []
    beside: list[int] = []
    for _ in range(MOST_BANDS):
        line = int(np.argmax(excess))
        if excess[line] < VISIBLE**2:
            break
        modes += _band_modes(frames, scaled, level, line, float(np.sqrt(floor)), WIDE)
        beside += [near for near in (line - 1, line + 1) if 0 <= near < excess.size and excess[near] >= VISIBLE**2]
        excess[max(0, line - 1) : line + 2] = 0.0
    # a mode that a much louder one hides in its band may stand alone in the next
    spacing = frames.line_hz(1)
    for line in dict.fromkeys(beside):
        for mode in _band_modes(frames, scaled, level, line, float(np.sqrt(floor)), NARROW):
            if all(abs(mode.f_hz - other.f_hz) > OTHER * spacing for other in modes):
                modes.append(mode)
    apart = rate_hz / (RESOLVED * frames.samples)
    settled = frames.power(scaled, _settled(frames.count))
    return Ringing(tuple(_each_once(modes, apart)), *_unheard(frames, level, settled, hum, floor))


def tones_hz(noise: FloatArray, rate_hz: float) -> tuple[float, ...]:
    """Return where a record `(channels, samples)` of noise holds tones of constant size, Hz, clearest first."""
    frames = Frames(noise.shape[1], rate_hz)
    _, level = _scaled(noise, noise)
    if not level.size:
        return ()
    hum = np.maximum(frames.power(level, frames.count // 2), frames.power(level, 0))
    return _unheard(frames, level, np.zeros_like(hum), hum, 0.0)[0]


def lasting_hz(response: FloatArray, noise: FloatArray, f_hz: Iterable[float], rate_hz: float) -> tuple[float, ...]:
    """Return at which frequencies noise keeps something going that a burst there is not heard above at first.

    What a mode is fed by noise wanders the slower the longer it rings, so that it is a tone as seldom as not; yet a
    twentieth of the record later most of it is there still, in the response as in the noise.
    """
    frames = Frames(response.shape[1], rate_hz)
    scaled, level = _scaled(response, noise)
    found = []
    for f in f_hz if level.size else ():
        line = round(f / frames.line_hz(1))
        b, e = (frames.band(x, line) for x in (scaled, level))
        late = b[:, frames.count // 2 :]
        at_first, later, noisy = (float(np.mean(np.sum(np.abs(x) ** 2, axis=0))) for x in (b[:, :1], late, e))
        if at_first < VISIBLE**2 * max(later, noisy) and (_lasts(e) or _lasts(b)):
            found.append(f)
    return tuple(found)


def _lasts(amplitude: ComplexArray) -> bool:
    """Return whether the loudest direction of a band `(channels, frames)` keeps its share over `APART` frames."""
    along = np.linalg.svd(amplitude, full_matrices=False)[0][:, 0].conj() @ amplitude
    later, before = along[APART:], along[:-APART]
    size = float(np.linalg.norm(later) * np.linalg.norm(before))
    return bool(np.abs(np.vdot(before, later)) > LASTING * size) if size > 0 else False


def _unheard(
    frames: Frames, noise: FloatArray, heard: FloatArray, hum: FloatArray, floor: float
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return where the noise holds a tone that the response does not, and where it may hide one, Hz, clearest first.

    Powers below `floor` are rounding's.
    """
    padded = np.pad(hum, BROAD, mode="reflect") if hum.size > BROAD else hum
    around = np.median(np.lib.stride_tricks.sliding_window_view(padded, padded.size - hum.size + 1), axis=1)
    noisy = np.flatnonzero((hum > max(LEAKED * hum.max(), floor)) & (heard < VISIBLE**2 * hum))
    rises = np.zeros(hum.size)
    rises[noisy] = np.maximum(hum[noisy] / np.maximum(around[noisy], hum[noisy] / LARGEST), heard[noisy] / hum[noisy])
    found = noisy[rises[noisy] > RISES]
    tones: list[float] = []
    hidden: list[float] = []
    for line in found[np.argsort(-rises[found], kind="stable")][:MOST_BANDS]:
        share, f_hz = _coherent(frames, noise, int(line))
        # a tone between two lines stands in both
        if any(abs(f_hz - other) <= OTHER * frames.line_hz(1) for other in hidden):
            continue
        hidden.append(f_hz)
        if share > COHERENT and hum[line] > STANDS_OUT * around[line]:
            tones.append(f_hz)
    return tuple(tones), tuple(hidden)


def _coherent(frames: Frames, noise: FloatArray, line: int) -> tuple[float, float]:
    """Return the largest share of a band's power that one tone of constant size has, and its frequency in Hz."""
    b = frames.band(noise, line)
    late = b[:, _settled(b.shape[1]) :]
    steps = late.shape[1]
    powers = np.sum(np.abs(np.fft.fft(late, 4 * steps, axis=1)) ** 2, axis=0)
    most = int(np.argmax(powers))
    share = float(powers[most] / (steps * np.sum(np.abs(late) ** 2)))
    return share, hz_of(frames, line, np.exp(2j * np.pi * most / powers.size))


def _settled(frames: int) -> int:
    """Return the frame from which on a tone is looked for: what dies before has no part in it."""
    return frames // 4


def _each_once(modes: list[Mode], apart_hz: float) -> list[Mode]:
    """Return modes slowest first; of those that two bands share, the one that is known better."""
    kept: list[Mode] = []
    for mode in sorted(modes, key=lambda mode: mode.growth_std):
        if not any(
            abs(mode.f_hz - other.f_hz) < apart_hz
            and abs(mode.growth_per_s - other.growth_per_s) < CERTAIN * np.hypot(mode.growth_std, other.growth_std)
            for other in kept
        ):
            kept.append(mode)
    return sorted(kept, key=lambda mode: -mode.growth_per_s)


def _scaled(response: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return both in units of each channel's noise, without channels in which nothing is heard."""
    size = np.abs(response).max(axis=1)
    unit = np.maximum(np.sqrt(np.mean(noise**2, axis=1)), ROUNDING * size)
    heard = size > 0
    return response[heard] / unit[heard, None], noise[heard] / unit[heard, None]


def _band_modes(
    frames: Frames, signal: FloatArray, noise: FloatArray, line: int, floor: float, within: float
) -> list[Mode]:
    """Return the modes heard in one band, those `within` so many lines of its middle."""
    skipped = frames.count // 8  # what dies at once is no slow mode
    b, e = (frames.band(x, line)[:, skipped:] for x in (signal, noise))
    directions, sizes, _ = np.linalg.svd(b, full_matrices=False)
    kept = directions[:, sizes > max(1e-9 * sizes[0], floor)][:, :6]
    b, e = kept.conj().T @ b, kept.conj().T @ e
    z = _realised(b, e, floor)
    if not z.size:
        return []
    floor = max(floor, RESOLUTION * float(np.abs(b).max()))
    if z.size < MOST_MODES:
        z, c, deviation = _refined(z, b, e, floor)
    else:  # there are more than can be told apart in a record so short
        c, deviation = _fitted(z, b, np.arange(b.shape[1]))[0], np.full(z.size, np.inf)
    step = np.arange(b.shape[1])
    rest = b - c @ _powers(z, step)
    found = [(_mode(frames, line, z[i], c[:, i], deviation[i], (e, rest), floor), z[i]) for i in range(z.size)]
    # what is further away than this many lines the next band has, and better
    return [mode for mode, pole in found if mode is not None and abs(turned(frames, line, pole)) <= within * np.pi / 2]


def turned(frames: Frames, line: int, z: complex) -> float:
    """Return by how much a mode turns from frame to frame against the middle of its band; a line is a quarter turn."""
    return float(np.angle(z * np.exp(-2j * np.pi * line * FOLD / frames.length * frames.hop)))


def hz_of(frames: Frames, line: int, z: complex) -> float:
    """Return the frequency of a mode near the middle of a band, folded into 0..Nyquist."""
    f_hz = frames.line_hz(line) + turned(frames, line, z) * frames.rate_hz / (2 * np.pi * frames.hop)
    folded = abs((float(f_hz) + frames.rate_hz / 2) % frames.rate_hz - frames.rate_hz / 2)
    return 0.0 if folded < REAL * frames.rate_hz else folded


def _realised(b: ComplexArray, e: ComplexArray, floor: float) -> ComplexArray:
    """Return the poles of a band's amplitude per frame, `(modes,)`."""
    left, sizes, _ = np.linalg.svd(_hankel(b), full_matrices=False)
    hidden = max(1.5 * np.linalg.norm(_hankel(e), 2), 1e-9 * sizes[0], floor)
    order = min(int(np.count_nonzero(sizes > hidden)), MOST_MODES)
    if not order:
        return np.zeros(0, dtype=np.complex128)
    u = left[:, :order]
    q = b.shape[0]
    z = np.linalg.eigvals(np.linalg.lstsq(u[:-q], u[q:])[0]).astype(np.complex128)
    return z[(np.abs(z) > DEAD) & _tame(z, b.shape[1])]


def _tame(z: ComplexArray, frames: int) -> NDArray[np.bool_]:
    """Return of each pole whether its powers over so many frames are numbers."""
    return np.log(np.maximum(np.abs(z), DEAD)) * frames < WILD


def _hankel(b: ComplexArray) -> ComplexArray:
    q, count = b.shape
    rows = count // 2
    view = np.lib.stride_tricks.sliding_window_view(b, count - rows + 1, axis=1)  # (q, rows, columns)
    return view.transpose(1, 0, 2).reshape(rows * q, -1)


def _powers(z: ComplexArray, step: np.ndarray) -> ComplexArray:
    return np.exp(np.log(z)[:, None] * step)


def _refined(
    z: ComplexArray, b: ComplexArray, e: ComplexArray, floor: float
) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Return poles, coefficients `(q, modes)` and the poles' standard deviations, by Gauss-Newton on log z."""
    step = np.arange(b.shape[1])
    c, error = _fitted(z, b, step)
    for _ in range(REFINEMENTS):
        change = np.linalg.lstsq(_jacobian(z, c, step), (b - c @ _powers(z, step)).reshape(-1))[0][: z.size]
        if not np.abs(change).max() < 1.0:
            break
        tried = z * np.exp(change)
        if not _tame(tried, step.size).all():
            break
        c_tried, error_tried = _fitted(tried, b, step)
        if not error_tried < error:
            break
        z, c, error = tried, c_tried, error_tried
    sensitivity = np.linalg.norm(np.linalg.pinv(_jacobian(z, c, step), rcond=1e-14)[: z.size], axis=1)
    size = np.sqrt((np.sum(np.abs(e) ** 2) + error**2) / len(b) + step.size * floor**2)
    return z, c, ALIGNED * size * sensitivity


def _fitted(z: ComplexArray, b: ComplexArray, step: np.ndarray) -> tuple[ComplexArray, float]:
    basis = _powers(z, step)
    scale = np.abs(basis).max(axis=1)
    c = np.linalg.lstsq((basis / scale[:, None]).T, b.T)[0].T / scale
    return c.astype(np.complex128), float(np.linalg.norm(b - c @ basis))


def _jacobian(z: ComplexArray, c: ComplexArray, step: np.ndarray) -> ComplexArray:
    """Return the derivative of c z^k by log z, beside that by c scaled to one, `(q steps, modes + q modes)`."""
    basis = _powers(z, step)
    by_pole = (c[:, None, :] * (step[:, None] * basis.T)).reshape(-1, z.size)
    scaled = basis / np.abs(basis).max(axis=1)[:, None]
    return np.hstack([by_pole, np.kron(np.eye(len(c)), scaled.T)])


def _mode(
    frames: Frames,
    line: int,
    z: complex,
    c: ComplexArray,
    deviation: float,
    errors: tuple[ComplexArray, ComplexArray],
    floor: float,
) -> Mode | None:
    """Return a mode in the units of the caller; None where noise hides it."""
    size, steps = float(np.linalg.norm(c)), errors[0].shape[1]
    if size == 0.0:
        return None
    toward = (c / size).conj()
    power = sum(float(np.mean(np.abs(toward @ error) ** 2)) for error in errors)
    hidden = np.sqrt(power) + floor
    rate = float(np.log(np.abs(z)))
    seen = size * max(np.exp(rate * (steps - 1)), np.exp(rate * (steps // 2))) / hidden
    if seen < VISIBLE:
        return None
    per_s = frames.rate_hz / frames.hop
    return Mode(rate * per_s, float(deviation * per_s), hz_of(frames, line, z), float(seen))
