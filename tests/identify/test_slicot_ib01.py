"""SLICOT's example of IB01AD, IB01BD and IB01CD, to the four decimals it prints."""

from pathlib import Path

import numpy as np
import pytest

from ultraquiet.identify.subspace import hankel, modal_least_squares
from ultraquiet.identify.subspace.kernels import hankel_gram

SLICOT = Path(__file__).parents[1] / "data" / "slicot"
PRINTED = 5e-5  # half of the last digit
ROWS, ORDER, SAMPLES = 15, 4, 1000


def record(name, heading):
    numbers = [float(x) for line in (SLICOT / f"{name}.dat").read_text().splitlines()[heading:] for x in line.split()]
    return np.array(numbers[:SAMPLES])[None], np.array(numbers[SAMPLES : 2 * SAMPLES])[None]


def printed(name):
    """The matrices of a result file by the words before `is` or `are`."""
    blocks, key = {}, ""
    for line in (SLICOT / f"{name}.res").read_text().splitlines():
        words = line.split()
        try:
            row = [float(x) for x in words]
        except ValueError:
            key = " ".join(words)
            continue
        if row:
            blocks.setdefault(key, []).append(row)
    return {k: np.array(v, dtype=object if len({len(r) for r in v}) > 1 else float) for k, v in blocks.items()}


def uncentred(name, heading):
    """The factor of signals as they are: SLICOT takes no means off."""
    u, y = record(name, heading)
    return hankel.factored(hankel_gram(np.vstack([u, y]), 2 * ROWS), 1, 1, ROWS, SAMPLES)


def found():
    """Our model in SLICOT's coordinates: it does not scale the directions, whose signs are free."""
    held = uncentred("IB01BD", 3)
    basis, values = hankel.directions(held)
    made = hankel.realised(held, basis, values, ORDER)
    sign = np.sign(made.C * printed("IB01BD")["The system output matrix C is"])[0]
    return made, np.diag(sign * np.sqrt(values[:ORDER]))


def test_singular_values():
    values = hankel.directions(uncentred("IB01AD", 2))[1]
    told = np.concatenate([np.array(r, float) for r in printed("IB01AD")["The singular values are"]])
    error = np.abs(values - told).max()
    print(f"\nIB01AD: largest error of 15 singular values {error:.1e}")
    assert error < 1.01 * PRINTED


def test_model_noise_and_kalman_gain():
    told, (made, T) = printed("IB01BD"), found()
    back = np.linalg.inv(T)
    pairs = {
        "A": (T @ made.A @ back, told["The system state matrix A is"]),
        "C": (made.C @ back, told["The system output matrix C is"]),
        "B": (T @ made.B, told["The system input matrix B is"]),
        "D": (made.D, told["The system input-output matrix D is"]),
        "K": (T @ made.K, told["The Kalman gain matrix K is"]),
        "Q": (T @ made.Q @ T, told["The state covariance matrix Q is"]),
        "R": (made.R, told["The output covariance matrix Ry is"]),
        "S": (T @ made.S, told["The state-output cross-covariance matrix S is"]),
    }
    errors = {k: float(np.abs(a - b).max()) for k, (a, b) in pairs.items()}
    print("\nIB01BD, largest errors:", {k: f"{v:.1e}" for k, v in errors.items()})
    for name, error in errors.items():
        assert error < 2 * PRINTED, name
    ours = [(made.C @ np.linalg.matrix_power(made.A, k) @ made.K).item() for k in range(8)]
    A, C, K = (told[f"The {k} is"] for k in ("system state matrix A", "system output matrix C", "Kalman gain matrix K"))
    theirs = [(C @ np.linalg.matrix_power(A, k) @ K).item() for k in range(8)]
    assert ours == pytest.approx(theirs, abs=2e-3)


def test_inputs_and_initial_state_by_simulation():
    u, y = record("IB01CD", 3)
    told, (made, T) = printed("IB01CD"), found()
    poles, vectors = np.linalg.eig(made.A)
    kept = poles.imag >= 0
    poles = poles[kept].astype(complex)
    bank = modal_least_squares.FilterBank(poles, u, y, feedthrough=True, offset=False)
    modes = bank.fit_b((made.C @ vectors)[:, kept].astype(complex))
    V = vectors[:, kept]
    B, x0 = V @ modes.b[:, :-1], V @ modes.b[:, -1:]
    errors = [
        np.abs(T @ B.real - told["The system input matrix B is"]).max(),
        np.abs(modes.D - told["The system input-output matrix D is"]).max(),
        np.abs((T @ x0.real).T - told["The initial state vector x0 is"]).max(),
    ]
    print(f"\nIB01CD: largest errors of B {errors[0]:.1e}, D {errors[1]:.1e}, x0 {errors[2]:.1e}")
    assert max(errors) < 2 * PRINTED
