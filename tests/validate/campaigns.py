"""Campaigns over fresh draws of the known truths, shared by tests and benchmarks."""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

import ultraquiet as uq

sys.path.insert(0, str(Path(__file__).parents[1] / "identify"))
from truths import draw

F_HZ = np.geomspace(2.0, 1500.0, 80)


class Campaign(NamedTuple):
    """Errors over draws and lines, `(draws, nf)`."""

    squared: np.ndarray
    bound: np.ndarray
    gain_held: np.ndarray
    phase_held: np.ndarray
    both_held: np.ndarray
    ok: np.ndarray


def cramer_rao(truth: uq.PolynomialModel, u: np.ndarray, f_hz: np.ndarray) -> np.ndarray:
    """Least mean squared error `(nf,)` of an unbiased estimate of B/F from this input, C and D unknown too.

    The truth's own information matrix: open loop, so that plant and noise filter are told apart without loss, the
    state before the first sample known. Columns in the delta basis, which is the same space, better conditioned.
    """
    from scipy.signal import lfilter

    b, f, c, d = truth.b[0], truth.f[0], truth.c, truth.d
    w = np.exp(-2j * np.pi * f_hz / truth.rate_hz)
    driven = lfilter(d, c, lfilter([1.0], f, u))
    out = -lfilter(b, f, driven)
    response = truth.frequency_response(f_hz)[0, 0] / np.polynomial.polynomial.polyval(w, f)
    columns, gradient = [], []
    for x, g, count in (
        (driven, 1 / np.polynomial.polynomial.polyval(w, f), b.size - 1),
        (out, -response, f.size - 1),
    ):
        basis = np.array([0.0, 1.0])
        for _ in range(count):
            columns.append(lfilter(basis, [1.0], x))
            gradient.append(np.polynomial.polynomial.polyval(w, basis) * g)
            basis = np.convolve(basis, [1.0, -1.0])
    X, g = np.stack(columns, axis=1), np.stack(gradient)
    size = np.linalg.norm(X, axis=0)
    R = np.linalg.qr(X / size, mode="r")
    moved = np.linalg.solve(R.T, g / size[:, None])
    return truth.noise_variance * np.sum(np.abs(moved) ** 2, axis=0)


def campaign(rng: np.random.Generator, draws: int) -> Campaign:
    """Fit fresh records of the truth by the structure and order that made them."""
    rows = []
    for _ in range(draws):
        drawn = draw("suite_rate", rng)
        record, truth = drawn.record, drawn.model
        true = truth.frequency_response(F_HZ)
        result = uq.identify.BoxJenkins(order=5).identify(record)
        band = uq.validate.response_band(result, F_HZ)
        gain = 20 * np.log10(np.abs(true))
        turn = np.abs(np.angle(true / band.values, deg=True))
        rows.append(
            (
                np.abs(band.values - true)[0, 0] ** 2,
                cramer_rao(truth, record.inputs[0], F_HZ),
                ((gain >= band.gain_low_db) & (gain <= band.gain_high_db))[0, 0],
                (turn <= band.phase_high_deg - band.phase_deg)[0, 0],
                # 5.991: 95 % point of chi-squared with two degrees of freedom
                band.distance(true)[0, 0] <= 5.991,
                result.status.ok,
            )
        )
    return Campaign(*(np.array(x) for x in zip(*rows, strict=True)))


def pooled(held: np.ndarray) -> tuple[float, float]:
    """Coverage in percent over draws and lines, and its standard error from the spread between draws."""
    share = 100 * held.mean(axis=1)
    return float(share.mean()), float(share.std() / np.sqrt(share.size))
