"""What a maximum-likelihood fit of a response gives: model, verdict, and bands that its noise leaves."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, frequency_array
from ultraquiet.linalg.sections import search as sections
from ultraquiet.values import StateSpace, Status


@dataclass(frozen=True, eq=False)
class Band:
    """Model response over frequency and how far the truth may lie from it.

    Attributes:
        f_hz: `(nf,)`.
        values: `(ny, nu, nf)` the model's gains, delay included.
        low, high: `(ny, nu, nf)` limits of the modulus.
        phase_deg: `(ny, nu, nf)` half width of the phase band, degrees.
        real, imaginary: `(ny, nu, nf)` half widths of the bands of real and imaginary part.
        radius: `(ny, nu, nf)` of a disc that holds the complex gain with the level asked for: an additive uncertainty
            weight.
    """

    f_hz: FloatArray
    values: ComplexArray
    low: FloatArray
    high: FloatArray
    phase_deg: FloatArray
    real: FloatArray
    imaginary: FloatArray
    radius: FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class WeightedFit:
    """A system fitted to a response, weighted by its noise.

    Attributes:
        model: stable, without the delay in continuous time, with it in discrete time.
        status: `ok`, `not white` or `poor fit` (the model misses more than noise), or `not converged`.
        order: number of poles shared by all channels.
        delay_s: dead time beside the model's one sample, seconds.
        cost: sum of squares over its degrees of freedom: one when noise alone is left.
        whiteness_p: p-value that the residual is white over the lines.
        error: weighted RMS error relative to the noise, at the lines fitted; twice, as `ResponseFit` has it.
        errors_by_order: the criterion of every order tried, less the least.
        iterations: accepted steps of the search.
        pole_covariance: of the logarithms of the sections' coefficients and the delay, `(order + 1, order + 1)`.
        other_minima: coefficients and sum of squares of each fit that another delay gives, where the delay is free.
    """

    model: StateSpace
    status: Status
    order: int
    delay_s: float
    cost: float
    whiteness_p: float
    errors_by_order: Mapping[int, float]
    iterations: int
    point: sections.SectionFit
    shape: sections.SectionShape
    samples: sections.FrequencySamples
    outputs_inputs: tuple[int, int]
    held_delay_s: float
    other_minima: tuple[tuple[FloatArray, float], ...] = ()

    @property
    def error(self) -> tuple[float, float]:
        """RMS error in deviations of the noise."""
        return float(np.sqrt(self.cost)), float(np.sqrt(self.cost))

    @property
    def pole_covariance(self) -> FloatArray:
        """Covariance of what was searched: logarithms of the sections' coefficients, then the delay in seconds.

        A far zero and a little delay stand in for each other; where the data leave open which of two such fits is
        right, how far they are apart counts by the likelihood of the other one.
        """
        scale = max(1.0, self.cost)
        covariance = np.linalg.pinv(self.point.normal, hermitian=True) * scale
        odds = np.exp([(self.point.cost - cost) / (2 * scale) for _, cost in self.other_minima])
        for (theta, _), share in zip(self.other_minima, odds / (1.0 + odds.sum()), strict=True):
            covariance += share * np.outer(theta - self.point.theta, theta - self.point.theta)
        return covariance.astype(np.float64)

    def frequency_response(self, f_hz: ArrayLike) -> ComplexArray:
        """Return the model's gains with the delay, `(ny, nu, nf)`."""
        f = frequency_array("WeightedFit.frequency_response", f_hz)
        G = self.model.frequency_response(f)
        return G if self.samples.rate_hz is not None else G * np.exp(-2j * np.pi * f * self.delay_s)

    def band(self, f_hz: ArrayLike, level: float = 0.95) -> Band:
        """Return the confidence band of every gain, from the covariance of the estimate.

        Where the fit misses more than noise, the covariance is scaled by what it misses; a systematic error is still
        not in it.

        Args:
            f_hz: `(nf,)` Hz.
            level: probability that each single gain lies inside, at one line.
        """
        from scipy.special import ndtri

        p = between("WeightedFit.band", "level", level, 0.01, 0.9999)
        f = frequency_array("WeightedFit.band", f_hz)
        G = self.frequency_response(f)
        C = self._covariance(f)
        z = float(ndtri(0.5 + p / 2))
        size = np.maximum(np.abs(G), np.finfo(float).tiny)
        along = np.stack([G.real, G.imag], axis=-1) / size[..., None]
        across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        modulus = z * np.sqrt(np.einsum("...a,...ab,...b->...", along, C, along))
        turn = z * np.sqrt(np.einsum("...a,...ab,...b->...", across, C, across))
        largest = np.linalg.eigvalsh(C)[..., 1]
        return Band(
            f,
            G,
            np.maximum(np.abs(G) - modulus, 0.0),
            np.abs(G) + modulus,
            np.degrees(np.arctan(turn / size)),
            z * np.sqrt(C[..., 0, 0]),
            z * np.sqrt(C[..., 1, 1]),
            np.sqrt(-2.0 * np.log1p(-p) * largest),
        )

    def directions(self, f_hz: FloatArray) -> ComplexArray:
        """Return X `(ny, nu, nf, k)`: the response is off by X g, g of k independent numbers of unit variance."""
        own, searched = self._moved(f_hz)
        channels, _, k = own.shape
        values, vectors = np.linalg.eigh(np.linalg.pinv(self.point.normal, hermitian=True))
        common = searched @ (vectors * np.sqrt(np.maximum(values, 0.0)))
        apart = np.zeros((channels, f_hz.size, channels, k), dtype=np.complex128)
        apart[np.arange(channels), :, np.arange(channels)] = own
        X = np.concatenate([apart.reshape(channels, f_hz.size, -1), common], axis=2) * np.sqrt(max(1.0, self.cost))
        return X.reshape(*self.outputs_inputs, f_hz.size, -1)

    def _covariance(self, f_hz: FloatArray) -> FloatArray:
        """Return the covariance of real and imaginary part of each gain, `(ny, nu, nf, 2, 2)`."""
        ny, nu = self.outputs_inputs
        own, searched = self._moved(f_hz)
        N = np.linalg.pinv(self.point.normal, hermitian=True)
        rows_own, rows = (np.stack([x.real, x.imag], axis=2) for x in (own, searched))
        C = rows_own @ np.swapaxes(rows_own, 2, 3) + rows @ N @ np.swapaxes(rows, 2, 3)
        return np.asarray((C * max(1.0, self.cost)).reshape(ny, nu, f_hz.size, 2, 2), dtype=np.float64)

    def _moved(self, f_hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return by what each gain moves with its own numerator's numbers, `(ny nu, nf, k)`, and by theta."""
        ny, nu = self.outputs_inputs
        unit = np.ones((1, 1, f_hz.size), dtype=np.complex128)
        rho = self.point.rho.reshape(ny * nu, 1, -1)
        there = sections.FrequencySamples(
            2 * np.pi * f_hz,
            self.samples.rate_hz,
            self.samples.scale,
            unit,
            np.zeros((ny * nu, f_hz.size), dtype=np.complex128),
            np.ones((ny * nu, f_hz.size)),
        )
        phi, psi = sections.sensitivities(there, self.shape, self.point.theta, rho)
        inverse, slope = self._by_channel()
        searched = psi - np.einsum("fm,cmt->cft", phi, slope)
        own = np.einsum("fm,cmk->cfk", phi, inverse)
        turn = np.exp(-2j * np.pi * f_hz * self.held_delay_s)[None, :, None]
        return own * turn, searched * turn

    def _by_channel(self) -> tuple[FloatArray, FloatArray]:
        """Return the covariance roots of each gain's numerator `(ny nu, linear, k)` and their slopes by theta."""
        ny, nu = self.outputs_inputs
        m = self.shape.linear
        inverse, slope = self.point.inverse, self.point.slope
        if inverse.shape[1] == m:
            return inverse, slope
        drives = inverse.shape[1] // m
        cut = inverse.reshape(ny, drives, m, -1)[:, :nu].reshape(ny * nu, m, -1)
        return cut, slope.reshape(ny, drives, m, -1)[:, :nu].reshape(ny * nu, m, -1)
