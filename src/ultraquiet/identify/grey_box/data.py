"""What a grey-box model is fitted to: lines of a response, or the spectrum of a record with its transient."""

from dataclasses import dataclass, replace

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.linalg.response import points
from ultraquiet.values import FrequencyResponse, Record

# Noise of a record is read off its residual, smoothed over this share of the lines, at least so many.
SMOOTHED_SHARE = 0.1
SMOOTHED_LINES = 25
# Lines of a record that hold less than this share of the strongest tell nothing of the plant.
EXCITED_SHARE = 1e-6


@dataclass(frozen=True, eq=False)
class SpectralLines:
    """One channel: y = G u + transient + noise at some frequencies.

    Attributes:
        f_hz: `(nf,)`.
        u, y: `(nf,)` spectra; u is one where y is a measured response.
        deviation: `(nf,)` standard deviation of y's noise, complex; all one when not known yet.
        transient: whether what the plant remembers from before the first sample (less what it still knows after the
            last) is in y.
        rate_hz: of the samples.
    """

    f_hz: FloatArray
    u: ComplexArray
    y: ComplexArray
    deviation: FloatArray
    transient: bool
    rate_hz: float

    def scaled(self, value: ComplexArray) -> FloatArray:
        """Return real and imaginary parts in units of their own deviation, `(2 nf, ...)`."""
        w = np.sqrt(2.0) / self.deviation
        v = (value.T * w).T
        return np.concatenate([v.real, v.imag])

    def memory(self, poles: ComplexArray, delay: int) -> FloatArray:
        """Return an orthonormal basis of the scaled transients of a plant with these poles in z, `(2 nf, k)`."""
        if not self.transient:
            return np.zeros((2 * self.f_hz.size, 0))
        z = points(self.f_hz, self.rate_hz)
        upper = poles[poles.imag >= 0]
        one = 1.0 / (z[:, None] - upper)
        other = 1.0 / (z[:, None] - upper.conj())
        paired = upper.imag > 0
        columns = np.hstack([one + other, 1j * (one - other)[:, paired], z[:, None] ** -np.arange(delay)])
        scaled = self.scaled(columns)
        size = np.linalg.norm(scaled, axis=0)
        return np.asarray(np.linalg.qr(scaled / np.maximum(size, np.finfo(float).tiny))[0], dtype=np.float64)

    def without_memory(self, error: ComplexArray, poles: ComplexArray, delay: int) -> ComplexArray:
        """Return an error `(nf,)` less the transients that explain it best."""
        n = self.f_hz.size
        Q, r = self.memory(poles, delay), self.scaled(error)
        r = r - Q @ (Q.T @ r)
        return (r[:n] + 1j * r[n:]) * self.deviation / np.sqrt(2.0)

    def with_noise_of(self, error: ComplexArray, parameters: int) -> "SpectralLines":
        """Return the lines with the deviation that a residual `(nf,)` shows, smoothed over neighbours."""
        n = self.f_hz.size
        width = min(n, max(SMOOTHED_LINES, round(SMOOTHED_SHARE * n)))
        power = (
            smoothed(np.abs(error) ** 2, width) * n / max(1.0, n - parameters / 2)
        )  # each complex line settles two parameters
        return replace(self, deviation=np.sqrt(np.maximum(power, np.finfo(float).tiny)))


def of_response(
    who: str,
    response: FrequencyResponse,
    rate_hz: float,
    band_hz: tuple[float, float],
    floor: float,
    smooth_lines: int,
) -> list[list[SpectralLines]]:
    """Return the channels of a response within the band, `[output][input]`.

    Args:
        who: refuses.
        response: its `variance` is the noise; without it every line counts by its own size.
        rate_hz: of the system wanted.
        band_hz: lines outside are left out.
        floor: share of the response that is added to the deviation, as what no model of the kind catches.
        smooth_lines: variances are averaged over so many neighbouring lines: from a few realisations they scatter,
            and a line that happens to look quiet would be believed too much.
    """
    f = response.f_hz
    if f.size and f[-1] > rate_hz / 2:
        raise InputError(
            f"{who}: lines up to {f[-1]:g} Hz contradict a rate of {rate_hz:g} Hz; half of it is the limit."
        )
    keep = (f >= band_hz[0]) & (f <= band_hz[1]) & (f > 0) & (f < rate_hz / 2)
    if not keep.any():
        raise InputError(
            f"{who}: no line of the response lies between {band_hz[0]:g} and {band_hz[1]:g} Hz; it holds "
            f"{f.size} lines" + (f" from {f[0]:g} to {f[-1]:g} Hz." if f.size else ".")
        )
    G = response.values[:, :, keep]
    if not np.all(np.isfinite(G)):
        raise InputError(f"{who}: the response has NaN or infinite values; leave those lines out.")
    if not np.any(G, axis=2).all():
        i, j = np.argwhere(~np.any(G, axis=2))[0]
        raise InputError(f"{who}: the response from input {j + 1} to output {i + 1} is zero at every line.")
    noise = np.zeros(G.shape) if response.variance is None else smoothed(response.variance[:, :, keep], smooth_lines)
    size = np.abs(G)
    if response.variance is None:
        deviation = size
    else:
        least = np.finfo(float).eps * size.max(axis=2, keepdims=True)
        deviation = np.sqrt(np.maximum(noise, 0.0) + (floor * size) ** 2 + least**2)
    f, one = f[keep], np.ones(np.count_nonzero(keep), dtype=np.complex128)

    def channel(i: int, j: int) -> SpectralLines:
        return SpectralLines(f, one, G[i, j], deviation[i, j], False, rate_hz)

    return [[channel(i, j) for j in range(G.shape[1])] for i in range(G.shape[0])]


def smoothed(variance: FloatArray, width: int) -> FloatArray:
    """Return a running mean along the last axis, shorter at its ends.

    >>> smoothed(np.array([1.0, 1.0, 4.0]), 3).tolist()
    [1.0, 2.0, 2.5]
    """
    n = variance.shape[-1]
    kernel = np.ones(min(width, n))
    weight = np.convolve(np.ones(n), kernel, "same")
    rows = [np.convolve(row, kernel, "same") / weight for row in variance.reshape(-1, n)]
    return np.array(rows).reshape(variance.shape)


def of_record(
    who: str, record: Record, band_hz: tuple[float, float], outputs: FloatArray | None = None
) -> list[SpectralLines]:
    """Return the channels from the one input that moves, one an output, at the excited lines within the band.

    Args:
        who: refuses.
        record: one input moves.
        band_hz: lines outside are left out.
        outputs: `(ny, n)` in place of those of the record, clipped readings mended for instance.
    """
    n, rate = record.samples, record.rate_hz
    moving = [j for j, u in enumerate(record.inputs) if np.ptp(u) > 0.0]
    if len(moving) != 1:
        raise InputError(
            f"{who}: {len(moving)} inputs of the record move; it takes one at a time. Pick one with record.pick, or "
            f"measure the response first with spectra.best_linear and fit that."
        )
    y = record.outputs if outputs is None else outputs
    U = np.fft.rfft(record.inputs[moving[0]]) / np.sqrt(n)
    Y = np.fft.rfft(y, axis=1) / np.sqrt(n)
    f = np.fft.rfftfreq(n, 1.0 / rate)
    excited = np.abs(U) > EXCITED_SHARE * np.abs(U[1:]).max()
    keep = (f >= band_hz[0]) & (f <= band_hz[1]) & (f > 0) & (f < rate / 2) & excited
    if not keep.any():
        raise InputError(f"{who}: no line of the record's input lies between {band_hz[0]:g} and {band_hz[1]:g} Hz.")
    lines, one = np.asarray(f[keep], dtype=np.float64), np.ones(np.count_nonzero(keep))
    return [SpectralLines(lines, U[keep], row[keep], one, True, rate) for row in Y]


def parents(source: FrequencyResponse | Record) -> tuple[str, ...]:
    """Return the content hashes of what a model is drawn from."""
    return (source.hash,) if isinstance(source, Record) else source.provenance.parents
