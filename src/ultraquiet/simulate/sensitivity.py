"""The sensitivity matrix as the bench shows it, from which every direction and band can be read."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet._base.progress import task
from ultraquiet.bench import Bench
from ultraquiet.simulate.loop import disturb
from ultraquiet.values import FrequencyResponse, StateSpace
from ultraquiet.values.controller import Controller

# Seconds a period lasts, and so lines a Hz there can be: isolation modes of 6 Hz and 1 % damping are 0.12 Hz wide.
PERIOD_S = 4
# Every line up to the first, every whole Hz up to the second, then lines one per cent apart, up to this share of the
# Nyquist frequency.
FINE_TO_HZ, DENSE_TO_HZ = 20, 130
SPACING = 1.01
HIGHEST_SHARE = 0.97
# Amplitudes in volts of the dense and of the sparse lines, before the whole is scaled; the lowest are raised as a
# geophone's response falls, with the square of frequency below its corner, up to a limit.
DENSE_V, SPARSE_V = 0.2, 0.05
RAISED_BELOW_HZ, RAISED_TO_V = 15.0, 1.5
# Largest share of a sensor's range, and largest disturbance in volts, that the open loop may use.
USED_RANGE, LARGEST_V = 0.6, 25.0
SETTLE_PERIODS, MEASURED_PERIODS = 2, 3
# A line is kept when noise moves its largest singular value by less than this share: 1.2 dB.
TRUSTED = 0.15


@dataclass(frozen=True)
class MeasuredSensitivity:
    """S = Y closed Y open^-1 at each line, `(ny, ny, nf)`, and the responses from disturbance to sensors behind it.

    The largest singular value of S is the amplification in the worst direction, whatever direction the disturbance
    takes; S is measured with as many runs as there are actuators.
    """

    S: FrequencyResponse
    opened: ComplexArray
    closed: ComplexArray

    @property
    def f_hz(self) -> FloatArray:
        """Lines in Hz."""
        return self.S.f_hz

    def worst_direction_db(self) -> FloatArray:
        """Reduction in dB of the worst direction at each line, `(nf,)`; negative where it is amplified."""
        return -20 * np.log10(np.linalg.svd(self.S.values.transpose(2, 0, 1), compute_uv=False)[:, 0])

    def worst_in_band_db(self, low_hz: float, high_hz: float) -> float:
        """Smallest worst-direction reduction over a band, in dB."""
        return float(self.worst_direction_db()[self._band(low_hz, high_hz)].min())

    def peak_amplification_db(self) -> float:
        """Largest amplification of any direction at any line, in dB."""
        return float(-self.worst_direction_db().min())

    def mean_log_db(self) -> float:
        """Return the mean over frequency of 20 log10 |det S| / ny: what quiet bands are paid with elsewhere.

        For a stable loop with a stable controller and at least one sample of delay the mean over 0 to Nyquist is zero:
        every decibel gained over a hertz is lost over another (Bode's integral in discrete time; Sung and Hara 1988,
        doi:10.1080/00207178808906305).
        """
        size = np.abs(np.linalg.det(np.moveaxis(self.S.values, 2, 0)))
        level = 20 * np.log10(size) / self.S.values.shape[0]
        return float(np.trapezoid(level, self.f_hz) / (self.f_hz[-1] - self.f_hz[0]))

    def broadband_db(self, low_hz: float, high_hz: float) -> float:
        """Reduction of the RMS of the worst sensor under equal, independent disturbances over a band, in dB."""
        band = self._band(low_hz, high_hz)
        width = np.gradient(self.f_hz)[band]
        power = [np.sum(np.abs(y[:, :, band]) ** 2 * width, axis=(1, 2)) for y in (self.opened, self.closed)]
        return float(10 * np.log10(np.min(power[0] / power[1])))

    def _band(self, low_hz: float, high_hz: float) -> np.ndarray:
        band = (self.f_hz >= low_hz) & (self.f_hz <= high_hz)
        if not band.any():
            raise InputError(f"MeasuredSensitivity: no line lies between {low_hz:g} and {high_hz:g} Hz.")
        return band


def measure_sensitivity(bench: Bench, controller: StateSpace | Controller, seed: int = 0) -> MeasuredSensitivity:
    """Measure S on the bench with a multisine disturbance on one actuator after the other, open and closed loop.

    Periods of four seconds; the first two settle the loop, the next three are averaged. Lines: every quarter Hz to
    20 Hz, every Hz to 130 Hz, then 1 % apart. The level is chosen so that the open loop uses at most 60 % of the
    sensors' range. Lines at which the scatter of the periods would move the worst direction by more than 1.2 dB are
    left out: the lowest, where a geophone hears nothing.

    Args:
        bench: any bench with as many sensors as actuators (S must be square to be inverted).
        controller: acts as u = K y.
        seed: of the multisine's phases.

    Raises:
        InputError: the bench is not square.
    """
    nu, ny = len(bench.actuators), len(bench.sensors)
    if nu != ny:
        raise InputError(f"measure_sensitivity: {nu} actuators and {ny} sensors; S needs equal numbers.")
    lines = _lines(bench.rate_hz)
    wave = _wave(lines, bench.rate_hz, seed)
    wave *= _level(bench, wave)
    d = np.tile(wave, SETTLE_PERIODS + MEASURED_PERIODS)
    responses = np.zeros((2, ny, nu, lines.size), dtype=np.complex128)
    scatter = np.zeros(lines.size)
    with task("sensitivity on the bench", 2 * nu) as progress:
        for j in range(nu):
            disturbance = np.zeros((nu, d.size))
            disturbance[j] = d
            for k, law in enumerate((None, controller)):
                record = disturb(bench, disturbance, law)
                responses[k, :, j], variance = _at_lines(record.outputs, wave, lines)
                scatter += variance if law is None else 0.0
                progress.advance(note=f"actuator {j + 1}")
    opened, closed = responses
    S = np.linalg.solve(opened.transpose(2, 1, 0), closed.transpose(2, 1, 0)).transpose(2, 1, 0).astype(np.complex128)
    trusted = _trusted(S, opened, scatter)
    if not trusted.any():
        raise NumericalError(
            "measure_sensitivity: noise hides every line; raise the sensors' gain or lower their noise."
        )
    text = f"disturbance to sensors, multisine, {MEASURED_PERIODS} periods of {PERIOD_S} s"
    response = FrequencyResponse(lines[trusted], S[:, :, trusted], estimator=text)
    return MeasuredSensitivity(response, opened[:, :, trusted], closed[:, :, trusted])


def _trusted(S: ComplexArray, opened: ComplexArray, scatter: FloatArray) -> np.ndarray:
    """Return at which lines `(nf,)` noise, S + dS = (Y closed + e) (Y open + e)^-1, leaves the worst direction be.

    The noise is that of the open loop: scatter of the closed one may be a mode that rings on, which must be shown.
    """
    worst = np.linalg.svd(np.moveaxis(S, 2, 0), compute_uv=False)[:, 0]
    weakest = np.linalg.svd(np.moveaxis(opened, 2, 0), compute_uv=False)[:, -1]
    return np.sqrt((1 + worst**2) * scatter) < TRUSTED * worst * weakest


def _lines(rate_hz: float) -> FloatArray:
    """Return multiples of the period's frequency in Hz."""
    top = HIGHEST_SHARE * rate_hz / 2
    fine = np.arange(1, min(FINE_TO_HZ, top) * PERIOD_S) / PERIOD_S
    dense = np.arange(FINE_TO_HZ, min(DENSE_TO_HZ, top) + 1)
    count = max(0, int(np.log(top / DENSE_TO_HZ) / np.log(SPACING)))
    sparse = np.round(DENSE_TO_HZ * SPACING ** np.arange(1, count + 1))
    return np.unique(np.concatenate([fine, dense, sparse]))


def _wave(lines: FloatArray, rate_hz: float, seed: int) -> FloatArray:
    period = round(PERIOD_S * rate_hz)
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, lines.size)
    raised = np.minimum(DENSE_V * (RAISED_BELOW_HZ / np.minimum(lines, RAISED_BELOW_HZ)) ** 2, RAISED_TO_V)
    amplitude = np.where(lines <= DENSE_TO_HZ, raised, SPARSE_V)
    spectrum = np.zeros(period // 2 + 1, dtype=np.complex128)
    spectrum[np.rint(lines * PERIOD_S).astype(int)] = amplitude * np.exp(1j * phases) * period / 2
    return np.fft.irfft(spectrum, period)


def _level(bench: Bench, wave: FloatArray) -> float:
    d = np.zeros((len(bench.actuators), wave.size))
    d[0] = wave
    used = np.abs(disturb(bench, d).outputs).max(axis=1)
    ranges = np.array([min(abs(c.low), abs(c.high)) for c in bench.sensors])
    loudest = LARGEST_V / np.abs(wave).max()
    return float(min(loudest, np.min(USED_RANGE * ranges / np.maximum(used, np.finfo(float).tiny))))


def _at_lines(outputs: FloatArray, wave: FloatArray, lines: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """Return sensor volts per disturbance volt at the lines `(ny, nf)`; variance of their mean, summed `(nf,)`."""
    periods = outputs[:, -MEASURED_PERIODS * wave.size :].reshape(outputs.shape[0], MEASURED_PERIODS, wave.size)
    bins = np.rint(lines * PERIOD_S).astype(int)
    gains = np.fft.rfft(periods, axis=2)[:, :, bins] / np.fft.rfft(wave)[bins]
    return gains.mean(axis=1), gains.var(axis=1, ddof=1).sum(axis=0) / MEASURED_PERIODS
