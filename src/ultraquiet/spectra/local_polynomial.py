"""Frequency responses by local polynomials: what a record owes to its beginning and end is fitted and removed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, frozen, same_rate, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.threads import single_threaded
from ultraquiet.spectra.periodic import inverse_of_inputs
from ultraquiet.values import FrequencyResponse, Record
from ultraquiet.values.handed_over.kinds import takes_values

WHO = "local_polynomial"
# So many complex numbers are factored at a time: 64 MB.
BATCH = 4_000_000
# Inputs whose spectra differ by less than this share over a whole window cannot be told apart there.
APART = 1e-8


@dataclass(frozen=True, eq=False)
class LocalPolynomial:
    """A response with what the fit tells beside it.

    Attributes:
        response: gains, with their `variance` from the noise in the window.
        noise: `(ny, ny, nf)` covariance of the outputs' noise as a one-sided density, squared units per Hz.
        transient: `(records, ny, nf)` leakage removed from the outputs, amplitude of a line as `rfft / samples`.
    """

    response: FrequencyResponse
    noise: ComplexArray
    transient: ComplexArray


@single_threaded
@takes_values
def local_polynomial(
    records: Record | Sequence[Record],
    order: int = 2,
    degrees: int | None = None,
    period_samples: int | None = None,
) -> LocalPolynomial:
    """Return the response of the inputs that move, free of leakage, and the noise at the outputs.

    Y(k+r) = (G + g_1 r + g_2 r^2 ..) U(k+r) + T + t_1 r + t_2 r^2 .. + V,  |r| <= n

    by least squares at every line k: response G and leakage T are smooth, the spectrum of the excitation is not. The
    error of G falls as (n/N)^(order + 1) with the number of samples N; that of H1 with a Hann window as 1/N at best.

    Args:
        records: one record, or several of the same inputs and outputs, all of one length: they are fitted together, and
            each has its own leakage. Inputs excited one at a time take one record each.
        order: of the polynomials; even ones suit the middle of a window.
        degrees: residual degrees of freedom, which the noise is estimated from: more give steadier variances and wider
            windows; by default twice the number of outputs plus 10, at least.
        period_samples: period of the excitation when the records are whole periods of one. Leakage is then read at the
            lines between the excited ones, and G only at these; transients need not have died, one or two periods will
            do.

    Raises:
        InputError: no input moves, too few lines for order and degrees, inputs that move alike, a period that does not
            divide the record.

    >>> import ultraquiet as uq
    >>> u = np.random.default_rng(0).standard_normal(1000)
    >>> y = np.convolve(u, [0.0, 1.0, 0.5])[:1000]
    >>> result = local_polynomial(uq.Record(u, y, 100.0))
    >>> g, f = result.response.values[0, 0], result.response.f_hz
    >>> bool(np.abs(g - np.exp(-2j * np.pi * f / 100) - 0.5 * np.exp(-4j * np.pi * f / 100)).max() < 1e-3)
    True

    Reference: R. Pintelon, J. Schoukens, G. Vandersteen, K. Barbe, Mech. Syst. Signal Process. 24 (2010) 573-595,
    doi:10.1016/j.ymssp.2009.08.009, and 596-616, doi:10.1016/j.ymssp.2009.08.010 for periodic excitation.
    """
    many = [records] if isinstance(records, Record) else list(records)
    inputs = _checked(many)
    R = whole(WHO, "order", order, 0, 8)
    dof = max(2 * len(many[0].sensors) + 10, 1) if degrees is None else whole(WHO, "degrees", degrees, 1)
    U = np.stack([np.fft.rfft(r.inputs[inputs], axis=1) for r in many])
    Y = np.stack([np.fft.rfft(r.outputs, axis=1) for r in many])
    if period_samples is None:
        lines = np.arange(1, (many[0].samples + 1) // 2)
        G, variance, noise, T = _arbitrary(U, Y, lines, R, dof)
    else:
        period = whole(WHO, "period_samples", period_samples, 2)
        lines, G, variance, noise, T = _periodic(U, Y, many[0], period, R, dof)
    first, n = many[0], many[0].samples
    text = f"local polynomials of order {R}, {dof} degrees of freedom, {len(many)} records of {n} samples"
    response = FrequencyResponse(
        lines * first.rate_hz / n,
        np.moveaxis(G, 0, 2),
        estimator=text if period_samples is None else f"{text}, period {period_samples}",
        actuators=[first.actuators[j] for j in inputs],
        sensors=first.sensors,
        provenance=Provenance("spectra.local_polynomial", {"order": R, "degrees": dof}, parents=_hashes(many)),
        variance=np.moveaxis(variance, 0, 2),
    )
    density = 2.0 / (n * first.rate_hz)
    return LocalPolynomial(response, frozen(np.moveaxis(noise, 0, 2) * density), frozen(np.moveaxis(T, 0, 2) / n))


def _hashes(many: Sequence[Record]) -> tuple[str, ...]:
    return tuple(r.hash for r in many)


def _checked(many: Sequence[Record]) -> list[int]:
    """Return which inputs move."""
    if not many:
        raise InputError(f"{WHO}: it needs at least one record, got none.")
    first = many[0]
    for r in many:
        same_rate(WHO, "the first record", first.rate_hz, "another", r.rate_hz)
        if (r.samples, len(r.actuators), len(r.sensors)) != (
            first.samples,
            len(first.actuators),
            len(first.sensors),
        ):
            raise InputError(f"{WHO}: all records must have the same channels and length; cut them with Record.part.")
    inputs = [j for j in range(len(first.actuators)) if any(np.ptp(r.inputs[j]) > 0 for r in many)]
    if not inputs:
        raise InputError(f"{WHO}: no input moves; a constant excites nothing.")
    return inputs


def _half_width(unknowns: int, dof: int, rows: int, available: int) -> int:
    """Return n of the window of 2 n + 1 lines that leaves `dof` degrees of freedom, `rows` equations a line."""
    n = -(-(-(-(unknowns + dof) // rows) - 1) // 2)
    if 2 * n + 1 > available:
        raise InputError(
            f"{WHO}: {unknowns} unknowns and {dof} degrees of freedom take windows of {2 * n + 1} lines, the records "
            f"have {available}; record longer or lower 'order' or 'degrees'."
        )
    return n


def _arbitrary(
    U: ComplexArray, Y: ComplexArray, lines: np.ndarray, order: int, dof: int
) -> tuple[ComplexArray, FloatArray, ComplexArray, ComplexArray]:
    """Return G `(nf, ny, nu)`, its variance, the noise covariance `(nf, ny, ny)` and T `(nf, records, ny)`."""
    M, nu = U.shape[:2]
    ny, nf = Y.shape[1], lines.size
    unknowns = (order + 1) * (nu + M)
    n = _half_width(unknowns, dof, M, nf)
    width = 2 * n + 1
    first_line = np.clip(np.arange(nf) - n, 0, nf - width)
    G, variance = np.empty((nf, ny, nu), dtype=np.complex128), np.empty((nf, ny, nu))
    noise, T = np.empty((nf, ny, ny), dtype=np.complex128), np.empty((nf, M, ny), dtype=np.complex128)
    step = max(1, BATCH // (M * width * unknowns))
    for start in range(0, nf, step):
        part = slice(start, min(start + step, nf))
        at = first_line[part, None] + np.arange(width)
        r = (at - np.arange(nf)[part, None]) / max(n, 1)
        powers = r[:, :, None] ** np.arange(order + 1)
        K = _regressors(U[:, :, lines[at]], powers)
        outputs = np.moveaxis(Y[:, :, lines[at]], 2, 0).swapaxes(2, 3).reshape(len(at), M * width, ny)
        x, spread, residual = _solved(K, outputs)
        G[part] = np.swapaxes(x[:, :nu], 1, 2)
        T[part] = x[:, nu : nu + M]
        free = M * width - unknowns
        noise[part] = np.einsum("fri,frj->fij", residual, residual.conj()) / free
        own = np.einsum("fii->fi", noise[part]).real
        variance[part] = own[:, :, None] * spread[:, None, :nu]
    return G, variance, noise, T


def scatter_about_smooth(U: ComplexArray, Y: ComplexArray, order: int = 2, dof: int = 10) -> FloatArray | None:
    """Return the variance of gains that their scatter about local polynomials tells, `(ny, nu, nf)`; None if too few.

    U is `(experiments, nu, nf)`, Y `(experiments, ny, nf)` at the excited lines, without leakage. The variance is that
    of the single line's gain, not of the smoothed one.
    """
    M, nu, nf = U.shape
    unknowns = (order + 1) * nu
    n = -(-(-(-(unknowns + dof) // M) - 1) // 2)
    width = 2 * n + 1
    if width > nf:
        return None
    at = np.clip(np.arange(nf) - n, 0, nf - width)[:, None] + np.arange(width)
    powers = ((at - np.arange(nf)[:, None]) / n)[:, :, None] ** np.arange(order + 1)
    K = np.moveaxis(U[:, :, at], (2, 0), (0, 1)).swapaxes(2, 3)  # (nf, M, width, nu)
    K = (K[:, :, :, None, :] * powers[:, None, :, :, None]).reshape(nf, M * width, unknowns)
    outputs = np.moveaxis(Y[:, :, at], (2, 0), (0, 1)).swapaxes(2, 3).reshape(nf, M * width, -1)
    _, _, residual = _solved(K, outputs)
    power = np.sum(np.abs(residual) ** 2, axis=1) / (M * width - unknowns)  # (nf, ny)
    share = np.sum(np.abs(inverse_of_inputs(np.moveaxis(U, 2, 0).swapaxes(1, 2))) ** 2, axis=1)  # (nf, nu)
    return np.moveaxis(power[:, :, None] * share[:, None, :], 0, 2)


def _regressors(U: ComplexArray, powers: FloatArray) -> ComplexArray:
    """Return K `(nf, records * width, unknowns)`: gains and leakages at r = 0 first, then those of r, r^2, ..

    U is `(records, nu, nf, width)`, `powers` `(nf, width, order + 1)`.
    """
    M, nu, nf, width = U.shape
    order = powers.shape[2] - 1
    K = np.zeros((nf, M, width, order + 1, nu + M), dtype=np.complex128)
    for m in range(M):
        K[:, m, :, :, :nu] = np.moveaxis(U[m], 0, 2)[:, :, None, :] * powers[:, :, :, None]
        K[:, m, :, :, nu + m] = powers
    return K.reshape(nf, M * width, (order + 1) * (nu + M))


def _solved(K: ComplexArray, outputs: ComplexArray) -> tuple[ComplexArray, FloatArray, ComplexArray]:
    """Return the least-squares solutions, the diagonals of (K^H K)^-1, and the residuals."""
    size = np.linalg.norm(K, axis=1)
    Q, S = np.linalg.qr(K / np.where(size > 0, size, 1.0)[:, None, :])
    diagonal = np.abs(np.einsum("fii->fi", S))
    if diagonal.min(axis=1).max() < APART:
        raise InputError(f"{WHO}: the inputs move alike and cannot be told apart; excite them by independent signals.")
    inner = np.linalg.pinv(S, rcond=APART) if diagonal.min() < APART else np.linalg.inv(S)
    projected = np.conj(np.swapaxes(Q, 1, 2)) @ outputs
    scale = np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), 0.0)
    x = (inner @ projected) * scale[:, :, None]
    spread = np.sum(np.abs(inner) ** 2, axis=2) * scale**2
    return x, spread, outputs - Q @ projected


def _periodic(
    U: ComplexArray, Y: ComplexArray, first: Record, period: int, order: int, dof: int
) -> tuple[np.ndarray, ComplexArray, FloatArray, ComplexArray, ComplexArray]:
    """Return the excited lines and what `_arbitrary` returns, leakage and noise read between these lines."""
    P, rest = divmod(first.samples, period)
    if rest or P < 2:
        raise InputError(
            f"{WHO}: {first.samples} samples are no two or more whole periods of {period}; cut the record with part."
        )
    M, nu, ny = U.shape[0], U.shape[1], Y.shape[1]
    if nu > M:
        raise InputError(f"{WHO}: {nu} inputs of one period need {nu} records of different phases, got {M}.")
    _repeating(U, P, first)
    level = np.abs(U[:, :, ::P]).max(axis=0)
    floor = np.abs(U).max(axis=(0, 2)) * 1e-6
    harmonics = np.flatnonzero((level > floor[:, None]).all(axis=0))
    lines = P * harmonics[(harmonics > 0) & (harmonics < period / 2)]
    between = np.setdiff1d(np.arange(1, (first.samples + 1) // 2), np.arange(0, first.samples, P))
    count = order + 1 + dof
    if between.size < count or not lines.size:
        raise InputError(f"{WHO}: {between.size} lines lie between excited ones, {count} are needed; record longer.")
    at = np.clip(np.searchsorted(between, lines) - count // 2, 0, between.size - count)[:, None] + np.arange(count)
    r = (between[at] - lines[:, None]).astype(float)
    reach = np.abs(r).max()
    K = ((r / reach)[:, :, None] ** np.arange(order + 1)).astype(np.complex128)
    # The records lie side by side as further outputs: their windows are the same.
    x, spread, residual = _solved(K, np.moveaxis(Y.reshape(M * ny, -1)[:, between[at]], 0, 2))
    T = x[:, 0].reshape(lines.size, M, ny)
    residual = residual.reshape(lines.size, count, M, ny)
    noise = np.einsum("frmi,frmj->fij", residual, residual.conj()) / (dof * M)
    inverse = inverse_of_inputs(np.moveaxis(U[:, :, lines], 2, 0).swapaxes(1, 2))  # (nf, records, nu)
    clean = np.moveaxis(Y[:, :, lines], 2, 0) - T
    G = np.swapaxes(clean, 1, 2) @ inverse
    own = np.einsum("fii->fi", noise).real * (1.0 + spread[:, :1])
    variance = own[:, :, None] * np.sum(np.abs(inverse) ** 2, axis=1)[:, None, :]
    return lines, G, variance, noise, T


def _repeating(U: ComplexArray, P: int, first: Record) -> None:
    """Refuse inputs with power between the lines of their period."""
    power = np.abs(U[:, :, 1:]) ** 2
    on = power[:, :, P - 1 :: P].sum(axis=(0, 2))
    off = power.sum(axis=(0, 2)) - on
    for j, (inside, outside) in enumerate(zip(on, off, strict=True)):
        if outside > 0.1 * inside:
            raise InputError(
                f"{WHO}: input {j + 1} holds {outside / (inside + outside):.0%} of its power between the lines of its "
                f"period; give the right period, or none for a signal that does not repeat."
            )
