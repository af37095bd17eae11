"""Rational approximation of sampled matrix responses with common poles: vector fitting in z.

H(z) = sum_k R_k / (z - p_k) is fitted to samples by turns: with the poles fixed, a scalar
sigma(z) = d + sum_k c_k / (z - p_k) is sought such that sigma H has the poles p_k as well; its zeros are the next
poles. Gustavsen & Semlyen 1999
(doi:10.1109/61.772353), relaxed as Gustavsen 2006 (doi:10.1109/TPWRD.2005.860281), channel by channel compressed as
Deschrijver et al. 2008 (doi:10.1109/LMWC.2008.922585).
"""

from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray

# A pole on the unit circle makes its own basis function infinite at a sample; this is as near as one may come.
NEAREST_TO_CIRCLE = 1e-7
# A pair p + jd, p - jd with d this share of its distance to the nearest sample: (z - p)^2 + d^2 is (z - p)^2 at every
# sample but for rounding, while 1 / (z - p - jd) - 1 / (z - p + jd) keeps half of all digits.
DOUBLE = float(np.sqrt(np.finfo(float).eps))


class PoleResidueFit(NamedTuple):
    """Poles in the order of the basis (reals, then conjugate pairs), residues `(ny, nu, poles)`, weighted RMS error."""

    poles: ComplexArray
    residues: ComplexArray
    error: float


def fit(
    z: ComplexArray,
    H: ComplexArray,
    weight: FloatArray,
    poles: ComplexArray,
    iterations: int,
    zeros_at_one: int = 0,
    slowest: float = 0.0,
) -> PoleResidueFit:
    """Return the stable rational matrix of common poles nearest to samples in the weighted RMS.

    Args:
        z: `(nf,)` points on the unit circle.
        H: `(ny, nu, nf)` samples.
        weight: `(nf,)` positive; the error counted is weight * (fit - H).
        poles: starting poles inside the circle, complex ones with their conjugates.
        iterations: relocations; the best of all poles met is returned.
        zeros_at_one: zeros that every channel is known to have at z = 1.
        slowest: least |ln p| of a pole; slower ones are moved there. Samples say nothing of what lies below the lowest
            of them, and a pole that is free to go there cancels noise now and upsets a loop later.
    """
    p = paired(_doubles_parted(z, poles))
    best = residues(z, H, weight, p, zeros_at_one)
    for _ in range(iterations):
        p = _quickened(relocated(z, H, weight, p, zeros_at_one), slowest)
        trial = residues(z, H, weight, p, zeros_at_one)
        if trial.error < best.error:
            best = trial
    return best


def residues(
    z: ComplexArray, H: ComplexArray, weight: FloatArray, poles: ComplexArray, zeros_at_one: int = 0
) -> PoleResidueFit:
    """Return the least-squares residues for fixed poles (`paired`)."""
    ny, nu, nf = H.shape
    wanted = _real((weight * H).reshape(ny * nu, nf).T)
    phi = _real(weight[:, None] * basis(z, poles))
    size = np.linalg.norm(phi, axis=0)
    free = _vanishing(poles, size, zeros_at_one)
    x = free @ np.linalg.lstsq(phi / size @ free, wanted, rcond=None)[0]
    error = np.linalg.norm(phi / size @ x - wanted) / np.sqrt(nf * ny * nu)
    x = x / size[:, None]
    R = np.zeros((ny * nu, poles.size), dtype=np.complex128)
    k = 0
    while k < poles.size:
        if poles[k].imag == 0:
            R[:, k] = x[k]
            k += 1
        else:
            R[:, k] = x[k] + 1j * x[k + 1]
            R[:, k + 1] = R[:, k].conj()
            k += 2
    return PoleResidueFit(poles, R.reshape(ny, nu, -1), float(error))


def relocated(
    z: ComplexArray, H: ComplexArray, weight: FloatArray, poles: ComplexArray, zeros_at_one: int = 0
) -> ComplexArray:
    """Return the zeros of sigma, reflected into the unit circle where they lie outside."""
    phi = basis(z, poles)
    own = _real(weight[:, None] * phi)
    size = np.linalg.norm(own, axis=0)
    common, _ = np.linalg.qr(own / size @ _vanishing(poles, size, zeros_at_one))
    rows = [_compressed(weight * h, phi, common) for h in H.reshape(-1, z.size)]
    return paired(_doubles_parted(z, _inside(_zeros_of_sigma(rows, weight * H, phi, poles))))


def relocated_in_s(
    s: ComplexArray, H: ComplexArray, weight: FloatArray, poles: ComplexArray, constant: bool
) -> ComplexArray:
    """Return the zeros of sigma on the imaginary axis `s`, reflected into the left half-plane.

    `weight` is `(ny, nu, nf)`: each channel its own; `constant` gives every channel a direct part.
    """
    phi = basis(s, poles)
    mine = np.asarray(np.hstack([phi, np.ones((s.size, 1))]) if constant else phi, dtype=np.complex128)
    rows: list[FloatArray] = []
    for h, w in zip(H.reshape(-1, s.size), weight.reshape(-1, s.size), strict=True):
        own = _real(np.asarray(w[:, None] * mine, dtype=np.complex128))
        size = np.linalg.norm(own, axis=0)
        if not size.all():
            continue  # a channel without a single line that weighs anything
        common, _ = np.linalg.qr(own / size)
        rows.append(_compressed(w * h, phi, common))
    zeros = _zeros_of_sigma(rows, weight * H, phi, poles)
    return paired(_doubles_parted(s, np.asarray(-np.abs(zeros.real) + 1j * zeros.imag, dtype=np.complex128)))


def _compressed(weighted: ComplexArray, phi: ComplexArray, common: FloatArray) -> FloatArray:
    """Return the triangle of one channel's rows for sigma, what its residues can explain taken off."""
    block = _real(weighted[:, None] * np.hstack([phi, np.ones((len(phi), 1))]))
    private = block - common @ (common.T @ block)
    return np.asarray(np.linalg.qr(private, mode="r"), dtype=np.float64)


def _zeros_of_sigma(
    rows: list[FloatArray], weighted: ComplexArray, phi: ComplexArray, poles: ComplexArray
) -> ComplexArray:
    nf, n = phi.shape
    # Relaxed normalisation: the real part of sigma adds up to the number of samples.
    scale = np.linalg.norm(weighted) / nf
    rows.append(np.asarray(scale * np.append(phi.real.sum(axis=0), nf)[None], dtype=np.float64))
    stacked = np.vstack(rows)
    size = np.linalg.norm(stacked, axis=0)
    wanted = np.zeros(len(stacked))
    wanted[-1] = scale * nf
    sigma = np.linalg.lstsq(stacked / size, wanted, rcond=None)[0] / size
    A, b = _sigma_states(poles)
    d = sigma[n] if abs(sigma[n]) > np.finfo(float).eps else np.finfo(float).eps
    return np.linalg.eigvals(A - np.outer(b, sigma[:n]) / d).astype(np.complex128)


def basis(z: ComplexArray, poles: ComplexArray) -> ComplexArray:
    """Return `(nf, n)` functions; with real factors they make all rational functions of these poles and real values."""
    columns: list[ComplexArray] = []
    k = 0
    while k < poles.size:
        one = 1.0 / (z - poles[k])
        if poles[k].imag == 0:
            columns.append(one)
            k += 1
        else:
            other = 1.0 / (z - poles[k].conjugate())
            columns += [one + other, 1j * (one - other)]
            k += 2
    return np.stack(columns, axis=1)


def _vanishing(poles: ComplexArray, size: FloatArray, zeros: int) -> FloatArray:
    """Return columns that span the scaled coefficients of functions with `zeros` zeros at z = 1."""
    n = poles.size
    if not zeros:
        return np.eye(n)
    rows = np.zeros((zeros, n))
    for m in range(zeros):
        at_one = (1.0 - poles) ** -(m + 1.0)
        rows[m] = at_one.real
        upper = np.flatnonzero(poles.imag > 0)
        rows[m, upper], rows[m, upper + 1] = 2 * at_one[upper].real, -2 * at_one[upper].imag
    rows /= size
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    return np.linalg.svd(rows)[2][zeros:].T


def paired(poles: ComplexArray) -> ComplexArray:
    """Return poles as reals first, then each complex one followed by its conjugate."""
    real = poles[poles.imag == 0]
    upper = poles[poles.imag > 0]
    return np.concatenate([np.sort(real.real), np.stack([upper, upper.conj()], axis=1).ravel()]).astype(np.complex128)


def _doubles_parted(z: ComplexArray, poles: ComplexArray) -> ComplexArray:
    """Return poles, the pairs that no sample tells from a double real pole as far apart as none tells them from it.

    Nearer ones have a second function of the basis that is rounding at every sample, or zero. Two equal real poles
    would have one function between them: sigma is then zero there whatever is fitted, and rounding alone moves one. Two
    real ones side by side have two that are nearly the same, where those of a pair, sum and difference, differ.
    """
    apart = DOUBLE * np.abs(z[:, None] - poles).min(axis=0)
    return poles.real + 1j * np.sign(poles.imag) * np.maximum(np.abs(poles.imag), apart)


def _real(M: ComplexArray) -> FloatArray:
    return np.concatenate([M.real, M.imag])


def _inside(poles: ComplexArray) -> ComplexArray:
    size = np.abs(poles)
    poles = np.where(size > 1, poles / np.maximum(size, 1.0) ** 2, poles)
    size = np.abs(poles)
    limit = 1 - NEAREST_TO_CIRCLE
    return np.where(size > limit, poles / np.maximum(size, limit) * limit, poles)


def _quickened(poles: ComplexArray, slowest: float) -> ComplexArray:
    """Return poles with |ln p| no less than `slowest`, their damping kept."""
    s = np.log(np.where(poles == 0, np.finfo(float).tiny, poles))
    size = np.abs(s)
    slow = size < slowest
    s = np.where(slow, s * slowest / np.where(slow, np.maximum(size, np.finfo(float).tiny), 1.0), s)
    moved = np.asarray(np.exp(s), dtype=np.complex128)
    return np.where(slow, np.where(poles.imag == 0, moved.real, moved), poles)


def _sigma_states(poles: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return A, b with sigma = d + c (z - A)^-1 b in the basis above."""
    n = poles.size
    A, b = np.zeros((n, n)), np.zeros(n)
    k = 0
    while k < n:
        if poles[k].imag == 0:
            A[k, k], b[k] = poles[k].real, 1.0
            k += 1
        else:
            re, im = poles[k].real, poles[k].imag
            A[k : k + 2, k : k + 2] = [[re, im], [-im, re]]
            b[k] = 2.0
            k += 2
    return A, b
