"""How a state-space response moves with its parameters, over a record that is no period."""

import numpy as np
import pytest

from ultraquiet.linalg import response
from ultraquiet.linalg.modes.modal_spread import ModalSensitivities, RecordEnd

STEP = 1e-6


def ringing(rng, ny, nu):
    """Two modes that ring for longer than the record, and a real pole."""
    A = np.zeros((5, 5))
    for k, p in enumerate(0.999 * np.exp(1j * rng.uniform(0.1, 2.0, 2))):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
    A[4, 4] = 0.8
    return A, rng.standard_normal((5, nu)), rng.standard_normal((ny, 5)), rng.standard_normal((ny, nu))


@pytest.mark.parametrize("began", [0.0, 3.0])
@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (2, 3)])
def test_sensitivities_are_those_of_a_record_from_rest_and_from_any_state(rng, ny, nu, began):
    """Each column against the difference of two simulations, transformed; steady ones are not near it."""
    n = 200
    at = ModalSensitivities(*ringing(rng, ny, nu), direct=nu)
    u = rng.standard_normal((nu, n))
    lines = np.arange(1, n // 2)
    z = np.exp(2j * np.pi * lines / n)

    def spectrum(A, B, C, D, x0):
        return np.fft.rfft(response.simulate(A, B, C, D, u, x0), axis=1)[:, lines].T

    rest, x0 = np.zeros(5), began * rng.standard_normal(5)
    moves = [(dA, 0 * at.B, 0 * at.C, 0 * at.D, rest) for dA in at.bends()]
    for k, M in enumerate((at.B, at.C, at.D, rest)):
        for one in np.eye(M.size).reshape(-1, *M.shape):
            moves.append(tuple(one if i == k + 1 else 0 * M for i, M in enumerate((at.A, at.B, at.C, at.D, rest))))
    base = (at.A, at.B, at.C, at.D, x0)
    expected = np.stack(
        [
            (spectrum(*(b + STEP * m for b, m in zip(base, move, strict=True)))
             - spectrum(*(b - STEP * m for b, m in zip(base, move, strict=True)))) / (2 * STEP)
            for move in moves
        ],
        axis=2,
    )  # fmt: skip
    U = np.fft.rfft(u, axis=1)[:, lines].T
    found = at.of(z, U, RecordEnd.of(at.A, at.B, at.blocks, u, x0))
    assert found.shape == expected.shape
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
    steady = at.of(z, U)
    assert np.abs(steady - expected[:, :, : steady.shape[2]]).max() > 0.1 * np.abs(expected).max()
