"""Known truths drawn afresh: see tests/data/known_truths.json."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

import ultraquiet as uq

DATA = Path(__file__).parents[1] / "data"
SETTLE = 20_000  # samples that bring the noise filter to its steady state


class Draw(NamedTuple):
    record: uq.Record
    clean: np.ndarray
    innovations: np.ndarray
    model: uq.PolynomialModel


def polynomial(spec, rate_hz):
    roots = [np.exp(-2 * np.pi * f / rate_hz) for f in spec["reals"]]
    for f, zeta in spec["modes"]:
        s = 2 * np.pi * f * (-zeta + 1j * np.sqrt(1 - zeta**2))
        roots += [np.exp(s / rate_hz), np.exp(np.conj(s) / rate_hz)]
    return np.real(np.poly(roots))


def known(name):
    return json.loads((DATA / "known_truths.json").read_text())[name]


def draw(name, rng, samples=None, u=None):
    """One record of a Box-Jenkins truth: white unit input, plant at rest, noise in steady state."""
    spec = known(name)
    rate_hz = spec["rate_hz"]
    F, B, C, D = (polynomial(spec[k], rate_hz) for k in "FBCD")
    pulse = np.eye(1, 200_000)[0]
    B = np.concatenate([[0.0], B])
    B = B / np.linalg.norm(lfilter(B, F, pulse))
    size = 10 ** (-spec["snr_db"] / 20) / np.linalg.norm(lfilter(C, D, pulse))
    n = samples or spec["samples"]
    u = rng.standard_normal(n) if u is None else u
    e = size * rng.standard_normal(n + SETTLE)
    noise = lfilter(C, D, e)[SETTLE:]
    clean = lfilter(B, F, u)
    model = uq.PolynomialModel([B], [F], rate_hz, c=C, d=D, noise_variance=size**2)
    return Draw(uq.Record(u, clean + noise, rate_hz), clean, e[SETTLE:], model)


def modal_truth(rng, samples=24_000, snr_db=30.0, shape=(6, 6), modes=15, units=(1.0, 1.0)):
    """A 6 x 6 system of 15 modes and a record of it, as `modal_6x6` says; or others of their kind, in other units."""
    rate_hz, (ny, nu), (volts, metres) = 3500.0, shape, units
    f = np.geomspace(8, 350, modes) * np.exp(0.05 * rng.standard_normal(modes))
    zeta = rng.uniform(0.005, 0.03, modes)
    A, B, C = np.zeros((2 * modes, 2 * modes)), np.zeros((2 * modes, nu)), np.zeros((ny, 2 * modes))
    for k in range(modes):
        p = np.exp(2 * np.pi * f[k] * (-zeta[k] + 1j * np.sqrt(1 - zeta[k] ** 2)) / rate_hz)
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
        B[2 * k + 1] = rng.standard_normal(nu) * np.sqrt(1 - abs(p) ** 2)
        C[:, 2 * k] = rng.standard_normal(ny)
    plant = uq.StateSpace(A, B / volts, metres * C, np.zeros((ny, nu)), rate_hz)
    u = volts * rng.standard_normal((nu, samples))
    clean = plant.simulate(u)
    noise = 10 ** (-snr_db / 20) * clean.std(axis=1, keepdims=True) * rng.standard_normal(clean.shape)
    return plant, uq.Record(u, clean + noise, rate_hz), clean
