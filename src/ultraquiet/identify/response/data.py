"""What a weighted rational fit is made from: a response with a variance, a record, or the mean of its periods."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import gammainccinv, gammaincinv

from ultraquiet._base.constraints import ComplexArray, FloatArray, positive
from ultraquiet._base.errors import InputError
from ultraquiet.linalg.sections import search as sections
from ultraquiet.spectra import best_linear, local_polynomial
from ultraquiet.values import Channel, FrequencyResponse, Record

WHO = "WeightedRational"
# Noise below this share of its channel's largest is rounding; a weight from it would hold the fit at one line.
FAINTEST = 1e-12
ENOUGH = 40  # complex differences that tell the power of a line to a fifth by their median
BY_CHANCE = 1e-4  # chance of a line's own power that is believed instead


def told_by_lines(who: str, name: str, delay_s: float, f_hz: FloatArray) -> None:
    """Refuse a delay by which the phase turns once or more from each line to the next: such lines say nothing of it."""
    spacing = float(np.diff(np.unique(f_hz)).min(initial=np.inf))
    if delay_s * spacing >= 1.0:
        raise InputError(
            f"{who}: '{name}' is {delay_s:g} s, lines {spacing:g} Hz apart tell delays below {1.0 / spacing:g} s; "
            f"lower it, or take longer records, segments or periods."
        )


class Data(NamedTuple):
    """Samples to fit, and the responses with weights that starts are drawn from, `(ny, nu, nf)` each."""

    samples: sections.FrequencySamples
    H: ComplexArray
    weight: FloatArray
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]
    parents: tuple[str, ...]

    @property
    def rows(self) -> int:
        """Number of real equations."""
        return 2 * int(np.count_nonzero(self.samples.w))

    @property
    def slowest(self) -> float:
        """The lowest line: of what lies below samples say nothing, and a pole there upsets simulation and loop."""
        low = self.samples.f_rad[0]
        rate_hz = self.samples.rate_hz
        return float(low / self.samples.scale if rate_hz is None else np.tan(low / rate_hz / 2))

    def late(self, delay_s: float) -> "Data":
        """Return the data with inputs late by a delay; leakage, the last drive of a record, knows no delay."""
        if delay_s == 0.0:
            return self
        turn = np.exp(-1j * self.samples.f_rad * delay_s)
        V = self.samples.V.copy()
        V[:, : self.H.shape[1]] *= turn
        return self._replace(samples=replace(self.samples, V=V), H=self.H / turn)


def from_response(response: FrequencyResponse, rate_hz: float | None, floor: float) -> Data:
    """Return a response's lines, 0 Hz left out; a gain without noise figure weighs nothing."""
    f, G, variance = response.f_hz, response.values, response.variance
    if rate_hz is not None and f.size and f[-1] > positive(WHO, "rate_hz", rate_hz, "Hz") / 2:
        raise InputError(
            f"{WHO}: lines up to {f[-1]:g} Hz contradict a rate of {rate_hz:g} Hz; half of it is the limit."
        )
    if variance is None:
        raise InputError(
            f"{WHO}: the response has no variance to weigh its lines by; measure it with spectra.best_linear, "
            f"local_polynomial or frf, add one by with_coherence_variance, or use Rational."
        )
    variance = variance + (floor * np.abs(G)) ** 2
    known = np.isfinite(variance) & (variance > 0) & np.isfinite(G)
    keep = known.any(axis=(0, 1)) & (f > 0)
    if rate_hz is not None:
        keep &= f < rate_hz / 2
    if not keep.any():
        raise InputError(
            f"{WHO}: no line above 0 Hz has a finite variance above zero; without noise set 'floor', or measure more "
            f"than two periods."
        )
    ny, nu = G.shape[:2]
    f, G = f[keep], np.where(known, G, 0.0)[:, :, keep]
    deviation = np.sqrt(np.where(known, variance, np.inf)[:, :, keep])
    drive = np.ones((1, 1, f.size), dtype=np.complex128)
    samples = _samples(f, rate_hz, drive, G.reshape(ny * nu, -1), deviation.reshape(ny * nu, -1) ** 2)
    return Data(samples, G, 1.0 / deviation, response.actuators, response.sensors, response.provenance.parents)


def from_record(record: Record, floor: float) -> Data:
    """Return the record's own spectra, what its ends leave being the response to one more drive.

    That leakage is z times a numerator of the sections' kind over the same poles.
    """
    local = local_polynomial(record)
    f, n = local.response.f_hz, record.samples
    variance = _known(local.response)
    power = np.einsum("iif->if", local.noise).real * n * record.rate_hz / 2
    lines = np.rint(f * n / record.rate_hz).astype(int)
    U, Y = np.fft.rfft(record.inputs, axis=1)[:, lines], np.fft.rfft(record.outputs, axis=1)[:, lines]
    end = np.sqrt(np.mean(np.abs(U) ** 2)) * np.exp(2j * np.pi * f[np.newaxis] / record.rate_hz)
    samples = _samples(f, record.rate_hz, np.concatenate([U, end])[np.newaxis], Y, power + (floor * np.abs(Y)) ** 2)
    # What rounding hides is the noise of an output. The gains' own largest variance is that of a line at which no input
    # moves: measured by that, all other lines would weigh alike, and no mode would stand above their noise.
    raised = (_not_faint(power) - power)[:, np.newaxis]
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = np.where(raised > 0, variance + raised / np.abs(U[np.newaxis]) ** 2, variance)
    weight = 1.0 / np.sqrt(variance)
    return Data(samples, local.response.values, weight, record.actuators, record.sensors, (record.hash,))


def from_periods(record: Record, period: int, floor: float, weigh: str) -> Data:
    """Return the spectra of the mean period at the lines its inputs excite."""
    estimate = best_linear(record, period, settle_periods=1)
    f, G, told = estimate.response.f_hz, estimate.response.values, estimate.detection
    # Without lines that show distortion it is what gains scatter about a smooth response: at a resonance its own
    # curvature, which would weigh least the lines that know it best.
    by_periods = told is None or not told.odd_hz.size
    variance = estimate.noise if by_periods else _known(estimate.response)
    lines = np.rint(f * period / record.rate_hz).astype(int)
    whole = record.samples // period * period
    U, Y = (
        np.fft.rfft(x[:, period:whole].reshape(len(x), -1, period).mean(axis=1), axis=1)[:, lines]
        for x in (record.inputs, record.outputs)
    )
    # One record excites one input, so the variance of each gain is that of its output.
    level = variance[:, 0] * np.abs(U[0]) ** 2
    if by_periods:
        level = _lent_by_neighbours(level, max(whole // period - 2, 1))
    power = level if weigh == "noise" else np.broadcast_to(level.mean(axis=1, keepdims=True), level.shape)
    samples = _samples(f, record.rate_hz, U[np.newaxis], Y, power + (floor * np.abs(Y)) ** 2)
    weight = np.abs(U[np.newaxis]) / np.sqrt(_not_faint(power))[:, np.newaxis]
    return Data(samples, G, weight, record.actuators, record.sensors, (record.hash,))


def _lent_by_neighbours(power: FloatArray, freedom: int) -> FloatArray:
    """Return the power of noise `(ny, nf)` from few periods, each line's told by those about it.

    Of `freedom` complex differences the power of a line is a mean of so many exponential variates: of two, one line in
    sixty shows a tenth of the truth or less, outweighs ten others and is given a mode of its own. Noise is smooth over
    a few lines: the median of so many that they have `ENOUGH` differences stands for it,
    and a line's own power where that is more than chance makes of it, as at a hum.
    """
    reach = ENOUGH // (2 * freedom)
    lines = power.shape[1]
    if reach < 1 or lines <= 2:
        return power
    known = np.where(np.isfinite(power), power, np.nan)
    padded = np.pad(known, ((0, 0), (reach, reach)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=1)
    told = np.isfinite(windows).any(axis=2)
    level = np.full(power.shape, np.nan)
    level[told] = np.nanmedian(windows[told], axis=1) * freedom / gammaincinv(freedom, 0.5)
    beyond = known > level * gammainccinv(freedom, BY_CHANCE) / freedom
    return np.where(beyond | ~told, power, level)


def _samples(
    f: FloatArray, rate_hz: float | None, drives: ComplexArray, Y: ComplexArray, power: FloatArray
) -> sections.FrequencySamples:
    """Return samples weighted by the power of the noise `(channels, nf)`."""
    scale = 2 * np.pi * float(np.sqrt(f[0] * f[-1]))
    return sections.FrequencySamples(2 * np.pi * f, rate_hz, scale, drives, Y, np.sqrt(2.0 / _not_faint(power)))


def _known(response: FrequencyResponse) -> FloatArray:
    assert response.variance is not None
    return response.variance


def _not_faint(power: FloatArray) -> FloatArray:
    """Return power `(..., nf)`, raised where rounding hides it; of a channel without noise the others tell how far."""
    known = np.isfinite(power)
    own = power.max(axis=-1, where=known, initial=0.0, keepdims=True)
    return np.maximum(power, FAINTEST * np.where(own > 0, own, power.max(where=known, initial=0.0)))
