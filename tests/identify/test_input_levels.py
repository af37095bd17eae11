"""The level about which inputs move says no more than other initial states and another constant at the outputs do."""

import numpy as np
import pytest

import ultraquiet as uq

METHODS = {
    "subspace": uq.identify.Subspace(order=4),
    "subspace refined": uq.identify.Subspace(order=4, refine=True),
    "subspace auto": uq.identify.Subspace(),
    "predictor": uq.identify.PredictorSubspace(order=4),
    "recursive output error": uq.identify.RecursiveOutputError(order=4, start_samples=1000),
    "recursive from nothing": uq.identify.RecursiveOutputError(order=4, start_samples=0),
}


def recorded(rng, ny, nu, samples=3000):
    """Two modes, the slower one's ringing a good part of the record, outputs in units far from the inputs'."""
    poles = np.exp(2 * np.pi * np.array([20.0, 90.0]) / 1000.0 * (-0.01 + 1j))
    A = np.kron(np.diag(poles.real), np.eye(2)) + np.kron(np.diag(poles.imag), np.array([[0.0, 1.0], [-1.0, 0.0]]))
    B, C = rng.standard_normal((4, nu)), 1e-6 * rng.standard_normal((ny, 4))
    plant = uq.StateSpace(A, B, C, np.zeros((ny, nu)), 1000.0)
    u = rng.standard_normal((nu, samples))
    y = plant.simulate(u)
    return u, y + 0.05 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)


@pytest.mark.gate(*(f"{name}-shape{k}-100000.0" for k, name in enumerate([*METHODS, "subspace"])))
@pytest.mark.parametrize("level", [10.0, 1e3, 1e5])
@pytest.mark.parametrize(("method", "shape"), [*((name, (1, 1)) for name in METHODS), ("subspace", (3, 2))])
def test_the_level_of_the_inputs_changes_no_model(method, shape, level, rng):
    u, y = recorded(rng, *shape)
    levels = level * np.array([1.0, -2.0])[: len(u), None]
    without, beside = (METHODS[method].identify(uq.Record(x, y, 1000.0)) for x in (u, u + levels))
    f = np.linspace(1.0, 490.0, 200)
    G, H = (found.state_space().frequency_response(f) for found in (without, beside))
    print(without.status, beside.status, np.abs(G - H).max() / np.abs(G).max())
    assert beside.status.word == without.status.word
    assert np.abs(G - H).max() < 1e-3 * np.abs(G).max()


def test_a_level_in_a_file_changes_no_model(rng, tmp_path):
    u, y = recorded(rng, 1, 1, samples=20_000)
    found = []
    for k, level in enumerate((0.0, 1e4)):
        path = tmp_path / f"{k}.h5"
        with uq.files.LongWriter(path, 1000.0, ["coil"], ["plate"]) as writer:
            writer.append(u + level, y)
        found.append(uq.identify.Subspace(order=4).identify(uq.files.LongRecord(path)))
    f = np.linspace(1.0, 490.0, 200)
    G, H = (one.state_space().frequency_response(f) for one in found)
    assert np.abs(G - H).max() < 1e-3 * np.abs(G).max()
