"""Confidence bands of a state-space model's response, from the record that it was identified from."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, frequency_array, frozen
from ultraquiet._base.errors import InputError
from ultraquiet.linalg import balance
from ultraquiet.linalg.response import points
from ultraquiet.validate.bands import DB, LEVELS, ResponseBand
from ultraquiet.values import Record, StateSpace

LINES_AT_ONCE = 128
# Directions of the information below this share of the largest are those that change no response (each mode's states
# may be scaled and turned), or that the record says nothing of.
CUTOFF = 1e-10
MEMORY, RIDGE = 20, 1e-9  # samples of the autoregressions of the simulated errors


def state_space_band(model: StateSpace, record: Record, f_hz: ArrayLike, level: float = 0.95) -> ResponseBand:
    """Return the response of a model of least simulated error and the band in which the truth lies with `level`.

    theta holds the modes' poles, B, C, and D where it is not zero. With S(f) = d y / d theta at a line of the record,
    W the inverse covariance of the simulated errors v and Phi their spectrum,

        M = sum_f Re S' W S,   Q = sum_f Re S' W Phi W S,   cov theta = M^+ Q M^+,

    and the band follows from the gradient of the response. Phi comes from an autoregression of each output's v. Bands
    say what chance did to this record; not what the order left out, which the residual tests tell, nor how far a
    subspace without a search (`refine=True`) stayed from the least error.

    Args:
        model: stable, discrete, diagonalisable: of `Subspace(refine=True)`.
        record: that it was identified from.
        f_hz: `(nf,)` lines in Hz.
        level: probability at each line on its own.

    Raises:
        InputError: another rate or other channels than the record's, an unstable model, fewer samples than parameters.

    >>> import numpy as np, ultraquiet as uq
    >>> u, e = np.random.default_rng(1).standard_normal((2, 1, 2000))
    >>> lag = uq.StateSpace([[0.5]], [[0.5]], [[1.0]], [[0.0]], rate_hz=10.0)
    >>> record = uq.Record(u, lag.simulate(u) + 0.1 * e, 10.0)
    >>> found = uq.identify.Subspace(order=1, feedthrough=False, refine=True).identify(record).model
    >>> bool(0.1 < state_space_band(found, record, [1.0]).percent[0, 0, 0] < 1.0)
    True

    Reference: Ljung, System Identification, 2nd ed., section 9.4; McKelvey, Helmersson, Ribarits 2004 (coordinates
    that are more than needed), doi:10.1016/j.automatica.2004.04.017.
    """
    from scipy.special import ndtri

    who = "state_space_band"
    between(who, "level", level, *LEVELS)
    f = frequency_array(who, f_hz)
    _checked(who, model, record)
    sensitivities = _Sensitivities(model)
    root = _root(sensitivities, model, record)
    G = model.frequency_response(f)
    moved = _moved(sensitivities, points(f, record.rate_hz), root)
    parts = np.stack([moved.real, moved.imag], axis=-2)
    z = float(ndtri(0.5 + level / 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        gain, phase = DB * np.log(np.abs(G)), np.degrees(np.unwrap(np.angle(G), axis=-1))
        relative = moved / G[..., None]
    wide = z * DB * np.linalg.norm(relative.real, axis=-1)
    turn = z * np.degrees(np.linalg.norm(relative.imag, axis=-1))
    sides = gain, gain - wide, gain + wide, phase, phase - turn, phase + turn
    return ResponseBand(frozen(f), G, parts @ np.swapaxes(parts, -1, -2), *sides, level=level, method="linearised")


def _checked(who: str, model: StateSpace, record: Record) -> None:
    if model.rate_hz != record.rate_hz:
        raise InputError(f"{who}: the model's rate is {model.rate_hz} Hz, the record's {record.rate_hz:g} Hz.")
    shape, wires = model.D.shape, (len(record.sensors), len(record.actuators))
    if shape != wires:
        raise InputError(f"{who}: the model has {shape[0]} outputs and {shape[1]} inputs, the record {wires}.")
    if not model.is_stable():
        raise InputError(f"{who}: the model is unstable and has no simulated error; bands are drawn for stable ones.")
    if record.samples < 2 * model.states * sum(wires):
        raise InputError(
            f"{who}: {record.samples} samples are too few for {model.states} states, {wires[0]} outputs and {wires[1]} "
            f"inputs; record longer."
        )


class _Sensitivities:
    """Derivatives of C (z - A)^-1 B + D by pole pairs, B, C and D, in modal blocks with inputs and outputs scaled."""

    def __init__(self, model: StateSpace) -> None:
        form = balance.modal(model.A, model.B, model.C)
        self.A, self.B, self.C, self.blocks = form.A, form.B, form.C, form.blocks
        self.D = model.D if np.any(model.D) else None

    def bends(self) -> Iterator[FloatArray]:
        """Give dA for each parameter of each block: along its decay and its turn."""
        at = 0
        for states in self.blocks:
            rows = slice(at, at + states)
            at += states
            for part in [np.eye(states)] if states == 1 else [np.eye(2), np.array([[0.0, 1.0], [-1.0, 0.0]])]:
                dA = np.zeros_like(self.A)
                dA[rows, rows] = part * max(1e-12, float(1.0 - np.abs(np.linalg.eigvals(self.A[rows, rows])).max()))
                yield dA

    def of(self, z: ComplexArray, u: ComplexArray) -> ComplexArray:
        """Return d y / d theta `(nf, ny, p)` for input spectra `(nf, nu)`."""
        (ny, n), nu, nf = self.C.shape, self.B.shape[1], z.size
        inverse = np.linalg.inv(z[:, None, None] * np.eye(n) - self.A)
        x = np.einsum("fab,bj,fj->fa", inverse, self.B, u, optimize=True)
        out = self.C @ inverse
        by_A = np.stack([np.einsum("fia,ab,fb->fi", out, dA, x, optimize=True) for dA in self.bends()], axis=2)
        by_B = (out[..., None] * u[:, None, None]).reshape(nf, ny, n * nu)
        by_C = np.einsum("ik,fa->fika", np.eye(ny), x).reshape(nf, ny, ny * n)
        parts = [by_A, by_B, by_C]
        if self.D is not None:
            parts.append(np.einsum("ik,fj->fikj", np.eye(ny), u).reshape(nf, ny, ny * nu))
        return np.concatenate(parts, axis=2)


def _root(sensitivities: _Sensitivities, model: StateSpace, record: Record) -> FloatArray:
    """Return a factor of the covariance of theta."""
    v = record.outputs - model.simulate(record.inputs)
    v = v - v.mean(axis=1, keepdims=True)
    freedom = max(1.0, v.shape[1] - model.states * (1 + record.inputs.shape[0] / v.shape[0]))
    V = v @ v.T / freedom
    W = np.linalg.inv(V)
    lines = np.arange(1, (record.samples + 1) // 2)
    z = np.exp(2j * np.pi * lines / record.samples)
    U = np.fft.rfft(record.inputs, axis=1)[:, lines].T
    spectrum = _spectrum(v, z)
    M, Q = np.zeros((2, 1, 1))
    for k in range(0, lines.size, LINES_AT_ONCE):
        some = slice(k, k + LINES_AT_ONCE)
        S = sensitivities.of(z[some], U[some])
        WS = W @ S
        level = np.sqrt(spectrum[some])
        phi = V * level[:, :, None] * level[:, None]
        M = M + 2 * np.einsum("fip,fiq->pq", S.conj(), WS, optimize=True).real
        Q = Q + 2 * np.einsum("fip,fiq->pq", WS.conj(), phi @ WS, optimize=True).real
    size = np.sqrt(np.maximum(np.diag(M), np.finfo(float).tiny))
    scale = np.outer(size, size)
    inverse = np.linalg.pinv(M / scale, rcond=CUTOFF, hermitian=True)
    values, vectors = np.linalg.eigh(Q / scale)
    return (inverse @ (vectors * np.sqrt(np.maximum(values, 0.0)))) * (np.sqrt(record.samples) / size)[:, None]


def _spectrum(v: FloatArray, z: ComplexArray) -> FloatArray:
    """Return the errors' spectra `(nf, ny)`, of mean one, each from an autoregression of `MEMORY` samples."""
    from scipy.linalg import solve_toeplitz

    n, lags = v.shape[1], min(MEMORY, v.shape[1] // 10)
    out = np.empty((z.size, len(v)))
    for i, one in enumerate(v):
        r = np.array([one[k:] @ one[: n - k] for k in range(lags + 1)]) / n
        r[0] = max(r[0], np.finfo(float).tiny) * (1.0 + RIDGE)
        a = np.asarray(solve_toeplitz(r[:-1], r[1:]), dtype=np.float64)
        power = z[:, None] ** -np.arange(1, lags + 1)
        out[:, i] = max(r[0] - a @ r[1:], RIDGE * r[0]) / np.abs(1.0 - power @ a) ** 2 / r[0]
    return out


def _moved(sensitivities: _Sensitivities, z: ComplexArray, root: FloatArray) -> ComplexArray:
    """Return the gradient of the response times the factor, `(ny, nu, nf, p)`."""
    nu = sensitivities.B.shape[1]
    columns = [sensitivities.of(z, np.tile(np.eye(nu)[j], (z.size, 1)).astype(np.complex128)) @ root for j in range(nu)]
    return np.stack(columns).transpose(2, 0, 1, 3)
