"""Rational functions as sums of second-order sections, fitted to samples by maximum likelihood.

G(f) = exp(-s tau) [ D + sum_k (c_k x + d_k) / (e2 + e^alpha_k e1 + e^beta_k e0) ],

in continuous time x = s, (e2, e1, e0) = (s^2, s, 1); in discrete time x = z - 1 and
(e2, e1, e0) = ((z-1)^2, (z-1)(z+1), (z+1)^2), the same section seen through the bilinear map. Whatever alpha and beta
are, the poles are stable, and two real ones become a pair without a kink. Numerators enter linearly and are projected
out (Golub and Pereyra 1973, doi:10.1137/0710036; Kaufman 1975, doi:10.1007/BF01932995), so that the search moves the
poles alone.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

# Coefficients stay between these powers of e: a pole nearer to the border of stability than 1e-11 is on it in floating
# point, one further out than 1e11 does nothing.
FURTHEST = 25.0
# Largest change of the logarithm of a coefficient in one step.
LONGEST_STEP = 1.5
# The search ends when a step promises to lower the sum of squares by less than this many mean squared residuals: the
# estimate then stands within 3 % of its standard deviation of the minimum.
TOLERANCE = 1e-3
DAMPING, EASED, STIFFENED, STIFFEST, LEAST_DAMPING = 1e-3, 0.2, 5.0, 1e10, 1e-12
# A coefficient this near to its limit stands at it.
AT_LIMIT = 1e-9
# Directions of the numerators weaker than this share of the strongest are left out.
CUTOFF = 1e-13
# Two poles nearer to each other than this share of their size are spread to it: sums of residues lose no more.
APART = 1e-6
# A start keeps this relative distance from the border of stability.
NEAREST = 1e-6


@dataclass(frozen=True, eq=False)
class FrequencySamples:
    """What is fitted: sum over drives q of V_q G_q, near Y with weight w.

    Attributes:
        f_rad: `(nf,)` 2 pi f, rad/s.
        rate_hz: None for continuous time.
        scale: rad/s; continuous time is measured in it, so that numbers stay near one.
        V: `(channels or 1, drives, nf)`; ones for a fit to a response.
        Y: `(channels, nf)`.
        w: `(channels, nf)`, sqrt(2) over the noise's deviation: real and imaginary residual are then of variance one.
    """

    f_rad: FloatArray
    rate_hz: float | None
    scale: float
    V: ComplexArray
    Y: ComplexArray
    w: FloatArray


@dataclass(frozen=True)
class SectionShape:
    """Number of poles, whether there is a direct part, whether the delay is free."""

    order: int
    direct: bool
    delay: bool

    @property
    def nonlinear(self) -> int:
        """Number of parameters that are searched."""
        return self.order + int(self.delay)

    @property
    def linear(self) -> int:
        """Number of numerator coefficients of one drive in one channel."""
        return self.order + int(self.direct)


class SectionFit(NamedTuple):
    """The fit for given poles.

    `theta` holds alpha, beta of each pair, alpha of a single section, tau in seconds; `rho` `(channels, drives,
    linear)`; `cost` the sum of squares; `normal` and `gradient` of the projected problem; `blocks` what the covariance
    needs, one channel after another: the triangle's inverse and its product with the projected gradient.
    """

    theta: FloatArray
    rho: FloatArray
    cost: float
    residual: FloatArray
    normal: FloatArray
    gradient: FloatArray
    inverse: FloatArray
    slope: FloatArray


class SectionBasis(NamedTuple):
    """Denominators `(sections, nf)` with their derivatives, and numerator functions `(nf, linear)`."""

    phi: ComplexArray
    per_theta: tuple[ComplexArray, ...]


def functions(samples: FrequencySamples, shape: SectionShape, theta: FloatArray) -> SectionBasis:
    """Return the numerator functions, and for each alpha and beta the factor -(d den) / den of its own section."""
    x, e2, e1, e0, r1, r0 = _parts(samples.f_rad, samples.rate_hz, samples.scale)
    turn = np.exp(-1j * samples.f_rad * theta[-1]) if shape.delay else np.ones(x.size)
    columns, factors = [], []
    with np.errstate(over="ignore"):
        for k in range(shape.order // 2):
            a, b = np.exp(theta[2 * k]) * e1, np.exp(theta[2 * k + 1]) * e0
            den = e2 + a + b
            columns += [turn * x / den, turn / den]
            factors += [-a / den, -b / den]
        if shape.order % 2:
            a = np.exp(theta[shape.order - 1]) * r0
            columns.append(turn / (r1 + a))
            factors.append(-a / (r1 + a))
    if shape.direct:
        columns.append(turn * np.ones(x.size))
    return SectionBasis(np.stack(columns, axis=1).astype(np.complex128), tuple(factors))


def _parts(f_rad: FloatArray, rate_hz: float | None, scale: float) -> tuple[ComplexArray, ...]:
    if rate_hz is None:
        s = np.asarray(1j * f_rad / scale, dtype=np.complex128)
        one = np.ones_like(s)
        return s, s * s, s, one, s, one
    z = np.asarray(np.exp(1j * f_rad / rate_hz), dtype=np.complex128)
    return z - 1, (z - 1) ** 2, (z - 1) * (z + 1), (z + 1) ** 2, z - 1, z + 1


def evaluate(samples: FrequencySamples, shape: SectionShape, theta: FloatArray) -> SectionFit:
    """Return numerators, cost and the projected normal equations at given poles."""
    own = functions(samples, shape, theta)
    channels, nf = samples.Y.shape
    phi = samples.V[:, :, :, None] * own.phi  # (channels or 1, drives, nf, linear)
    drives, m = phi.shape[1], phi.shape[3]
    A = np.moveaxis(phi, 1, 2).reshape(-1, nf, drives * m) * samples.w[:, :, None]
    A = np.concatenate([A.real, A.imag], axis=1)
    y = samples.w * samples.Y
    y = np.concatenate([y.real, y.imag], axis=1)
    size = np.linalg.norm(A, axis=1)
    size = np.where(size > 0, size, 1.0)
    Q, R = np.linalg.qr(A / size[:, None, :])
    inverse = np.linalg.pinv(R, rcond=CUTOFF) / size[:, :, None]
    projected = np.einsum("cnk,cn->ck", Q, y)
    residual = y - np.einsum("cnk,ck->cn", Q, projected)
    rho = np.einsum("cjk,ck->cj", inverse, projected).reshape(channels, drives, m)
    J = _gradients(samples, shape, own, rho)
    J = np.concatenate([J.real, J.imag], axis=1)
    slope = np.swapaxes(Q, 1, 2) @ J
    J = J - Q @ slope
    return SectionFit(
        theta,
        rho,
        float(np.sum(residual**2)),
        residual,
        np.einsum("cna,cnb->ab", J, J),
        np.einsum("cna,cn->a", J, residual),
        inverse,
        inverse @ slope,
    )


def _gradients(samples: FrequencySamples, shape: SectionShape, own: SectionBasis, rho: FloatArray) -> ComplexArray:
    """Return the weighted derivative of the model by theta, `(channels, nf, nonlinear)`."""
    channels, nf = samples.Y.shape
    J = np.zeros((channels, nf, shape.nonlinear), dtype=np.complex128)
    terms = np.zeros((channels, nf, rho.shape[2]), dtype=np.complex128)
    for q in range(rho.shape[1]):
        terms += own.phi * (samples.V[:, q, :, None] * rho[:, q, None, :])
    for k in range(shape.order // 2):
        both = terms[:, :, 2 * k] + terms[:, :, 2 * k + 1]
        J[:, :, 2 * k] = both * own.per_theta[2 * k]
        J[:, :, 2 * k + 1] = both * own.per_theta[2 * k + 1]
    if shape.order % 2:
        J[:, :, shape.order - 1] = terms[:, :, shape.order - 1] * own.per_theta[-1]
    if shape.delay:
        J[:, :, -1] = -1j * samples.f_rad * terms.sum(axis=2)
    J *= samples.w[:, :, None]
    return J


def search(
    samples: FrequencySamples, shape: SectionShape, theta: FloatArray, steps: int, slowest: float = 0.0
) -> tuple[SectionFit, int, bool]:
    """Return the minimum that Levenberg-Marquardt reaches, the accepted steps, and whether it got there.

    No pole becomes slower than `slowest` (modulus in s over the scale, or in w = (z - 1) / (z + 1)).
    """
    here, damping, accepted = evaluate(samples, shape, within(theta, shape, slowest)), DAMPING, 0
    rows = max(2 * np.count_nonzero(samples.w), 1)
    while accepted < steps:
        enough = TOLERANCE * here.cost / rows
        free = _free(here, shape, slowest)
        size = np.sqrt(np.maximum(np.diag(here.normal)[free], np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(here.normal[np.ix_(free, free)] / np.outer(size, size))
        values = np.maximum(values, 0.0)
        along = vectors.T @ (here.gradient[free] / size)
        moved = False
        while damping < STIFFEST:
            if float(np.sum(along**2 / (values + damping))) < enough:
                return here, accepted, True
            step = np.zeros(shape.nonlinear)
            step[free] = vectors @ (along / (values + damping)) / size
            step *= min(1.0, LONGEST_STEP / max(np.abs(step[: shape.order]).max(initial=0.0), 1e-300))
            there = evaluate(samples, shape, within(here.theta + step, shape, slowest))
            if there.cost < here.cost:
                settled = here.cost - there.cost < enough and damping < DAMPING
                here, moved = there, True
                damping = max(damping * EASED, LEAST_DAMPING)
                if settled:
                    return here, accepted + 1, True
                break
            damping *= STIFFENED
        accepted += 1
        if not moved:
            return here, accepted, False
    return here, accepted, False


def within(theta: FloatArray, shape: SectionShape, slowest: float) -> FloatArray:
    """Return theta with coefficients in range and no pole slower than `slowest`."""
    out = theta.copy()
    low, high = _limits(out, shape, slowest)
    out[: shape.order] = np.clip(out[: shape.order], low, high)
    # The limit of a damping follows from the stiffness beside it, which may just have moved.
    low, high = _limits(out, shape, slowest)
    out[: shape.order] = np.clip(out[: shape.order], low, high)
    return out


def _limits(theta: FloatArray, shape: SectionShape, slowest: float) -> tuple[FloatArray, FloatArray]:
    low, high = np.full(shape.order, -FURTHEST), np.full(shape.order, FURTHEST)
    if slowest > 0:
        pairs = shape.order - shape.order % 2
        low[1:pairs:2] = 2 * np.log(slowest)
        # Both real poles of w^2 + a w + b lie beyond w0 when a < w0 + b / w0.
        high[0:pairs:2] = np.log(slowest + np.exp(theta[1:pairs:2]) / slowest)
        low[pairs:] = np.log(slowest)
    return low, high


def _free(here: SectionFit, shape: SectionShape, slowest: float) -> np.ndarray:
    """Return which parameters do not stand at a limit that they press against."""
    low, high = _limits(here.theta, shape, slowest)
    theta, g = here.theta[: shape.order], here.gradient[: shape.order]
    at_limit = ((theta <= low + AT_LIMIT) & (g < 0)) | ((theta >= high - AT_LIMIT) & (g > 0))
    return np.flatnonzero(np.append(~at_limit, np.ones(shape.nonlinear - shape.order, dtype=bool)))


def from_axis_poles(poles: ComplexArray) -> FloatArray:
    """Return alpha and beta of sections with the given poles, in s over the scale or in w = (z - 1) / (z + 1).

    Real ones share sections, two by two.
    """
    p = -np.maximum(np.abs(poles.real), NEAREST * np.abs(poles)) + 1j * poles.imag
    real = np.sort(p[p.imag == 0].real)
    theta: list[float] = []
    for q in p[p.imag > 0]:
        theta += [np.log(-2 * q.real), 2 * np.log(np.abs(q))]
    for k in range(0, real.size - 1, 2):
        theta += [np.log(-real[k] - real[k + 1]), np.log(real[k] * real[k + 1])]
    if real.size % 2:
        theta.append(np.log(-real[-1]))
    return np.array(theta, dtype=np.float64)


def to_poles(
    theta: FloatArray, shape: SectionShape, rate_hz: float | None, scale: float
) -> tuple[ComplexArray, ComplexArray]:
    """Return poles (rad/s or in z) and, for each, what its section's numerator at the pole is divided by."""
    poles, slopes = np.zeros(shape.order, dtype=np.complex128), np.zeros(shape.order, dtype=np.complex128)
    for k in range(shape.order // 2):
        a, b = np.exp(theta[2 * k]), np.exp(theta[2 * k + 1])
        w = _pair(float(a), float(b))
        lead = 1.0 if rate_hz is None else 1 + a + b
        p = w if rate_hz is None else (1 + w) / (1 - w)
        poles[2 * k : 2 * k + 2] = p
        slopes[2 * k : 2 * k + 2] = lead * np.array([p[0] - p[1], p[1] - p[0]])
    if shape.order % 2:
        a = np.exp(theta[shape.order - 1])
        poles[-1], slopes[-1] = (-a, 1.0) if rate_hz is None else ((1 - a) / (1 + a), 1 + a)
    return (poles * scale if rate_hz is None else poles), slopes


def _pair(a: float, b: float) -> ComplexArray:
    """Return the roots of w^2 + a w + b, never equal: a double pole has no residues, one a hair apart has."""
    gap = a * a / 4 - b
    if abs(gap) < (APART * APART) * b:
        gap = -(APART * APART) * b
    if gap < 0:
        return np.array([complex(-a / 2, np.sqrt(-gap)), complex(-a / 2, -np.sqrt(-gap))])
    far = -a / 2 - np.sqrt(gap)
    return np.array([far, b / far], dtype=np.complex128)


def sensitivities(
    samples: FrequencySamples, shape: SectionShape, theta: FloatArray, rho: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Return the numerator functions `(nf, linear)` and the gains' derivatives by theta `(channels, nf, nonlinear)`."""
    own = functions(samples, shape, theta)
    return own.phi, _gradients(samples, shape, own, rho)
