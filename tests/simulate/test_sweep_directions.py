"""Directions of sweeps: each moves one of the sensors' alone, on any processor, and weak ones are heard like strong."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import UnheardError
from ultraquiet.bench import Wrapped
from ultraquiet.simulate.sweeps.clock import SweepClock
from ultraquiet.simulate.sweeps.directions import WEAKEST, Directions, _basis, directions
from ultraquiet.simulate.sweeps.sharper import sharper
from ultraquiet.values import Channel, StateSpace

RATE_HZ, BAND_HZ = 1600.0, (20.0, 90.0)


@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (6, 6), (4, 3), (3, 5), (1, 4)])
def test_each_moves_one_direction_alone_or_none(rng, ny, nu):
    u, s, vh = np.linalg.svd(np.exp(rng.normal(size=(30, ny, nu)) + 2j * np.pi * rng.random((30, ny, nu))))
    s = np.maximum(s, 2 * WEAKEST * s[:, :1])  # weaker ones are driven no more strongly, and move others too
    G = (u[:, :, : s.shape[1]] * s[:, None]) @ vh[:, : s.shape[1]]
    w, heard = directions(G), min(ny, nu)
    assert w.shape == (30, nu, nu)
    assert np.linalg.norm(w, axis=1) == pytest.approx(1.0)
    moved = G @ w
    if nu >= ny:
        one = moved[:, :, :ny] / np.linalg.norm(moved[:, :, :ny], axis=1, keepdims=True)
        assert np.abs(one) == pytest.approx(np.broadcast_to(np.eye(ny), one.shape), abs=1e-9)
        assert np.abs(moved[:, :, ny:]) == pytest.approx(0.0, abs=1e-9 * np.abs(G).max())
    inner = np.sum(np.conj(w[1:, :, :heard]) * w[:-1, :, :heard], axis=1)
    assert np.abs(np.angle(inner)) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("size", "rank"), [(5, 2), (6, 3), (4, 4), (3, 0)])
def test_a_basis_is_its_span_s_and_not_that_it_was_given_by(rng, size, rank):
    def unitary(n, columns):
        return np.linalg.qr(rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n)))[0][:, :columns]

    given = unitary(size, rank)
    found, turned = _basis(given), _basis(given @ unitary(rank, rank))
    assert turned == pytest.approx(found, abs=1e-12)
    assert np.conj(found.T) @ found == pytest.approx(np.eye(rank), abs=1e-12)
    assert found @ np.conj(found.T) == pytest.approx(given @ np.conj(given.T), abs=1e-12)
    assert _basis(np.eye(size)[:, :rank].astype(complex)) == pytest.approx(np.eye(size)[:, :rank])


def wide(rng, noise):
    """Return a bench of 3 accelerometers and 5 coils whose directions differ, without ranges, and its model."""
    f_hz, damping = np.array([22.0, 35.0, 58.0, 83.0]), 0.03
    angle, radius = 2 * np.pi * f_hz / RATE_HZ, np.exp(-damping * 2 * np.pi * f_hz / RATE_HZ)
    A = np.zeros((8, 8))
    for k, (r, a) in enumerate(zip(radius, angle, strict=True)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = r * np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    u, v = (np.linalg.qr(rng.normal(size=(n, n)))[0] for n in (3, 5))
    B = rng.normal(size=(8, 5))
    C = u @ np.diag([1.0, 0.3, 0.1]) @ rng.normal(size=(3, 8)) * 0.05
    B = B @ v
    state, drawn = np.zeros(8), np.random.default_rng(7)

    def step(command, disturbance):
        nonlocal state
        y = C @ state + noise * drawn.standard_normal(3)
        state = A @ state + B @ (command + disturbance)
        return y

    def reset():
        nonlocal state
        state = np.zeros(8)

    sensors = [Channel(f"acc {k}", "um/s^2") for k in range(3)]
    return Wrapped(step, reset, RATE_HZ, [f"coil {k}" for k in range(5)], sensors), StateSpace(
        A, B, C, np.zeros((3, 5)), RATE_HZ
    )


def turned_in_time(sweep, ways, k):
    """Return the signal whose direction turns with the time at which the sweep passes a frequency."""
    d = np.zeros((len(ways.vectors), sweep.samples))
    d[:, : sweep.swept] = np.real(ways.at(k, sweep.f_hz) * sweep.carrier)
    return d


@pytest.mark.slow
def test_a_sweep_moves_one_direction_alone_however_long_the_plant_rings(rng):
    sweep, grid = SweepClock(6400, RATE_HZ, 20.0, 700.0, 4), np.geomspace(20.0, 700.0, 92)
    inside = (sweep.lines_hz > 1.02 * 20.0) & (sweep.lines_hz < 100.0)
    beside = {"by spectrum": [], "by time": []}
    for _ in range(8):
        G = wide(rng, 0.0)[1].frequency_response(sweep.lines_hz)
        ways = Directions.of(sweep.lines_hz, G)
        for k in range(3):
            sent = sweep.signal(ways, k, grid, np.ones(grid.size)), turned_in_time(sweep, ways, k)
            for name, d in zip(beside, sent, strict=True):
                moved = np.abs(np.einsum("ijl,jl->il", G, sweep.transform(d)))[:, inside]
                beside[name].append(np.delete(moved, k, axis=0).max(axis=0) / moved[k])
    found = {name: np.median(share) for name, share in beside.items()}
    print("moved beside one direction: " + ", ".join(f"{share:.3f} {name}" for name, share in found.items()))
    assert found["by spectrum"] < 0.06
    assert found["by spectrum"] < 0.3 * found["by time"]


def test_what_is_not_known_takes_its_directions_from_known_lines(rng):
    sweep = SweepClock(1600, RATE_HZ, 20.0, 90.0, 2)
    G = wide(rng, 0.0)[1].frequency_response(sweep.lines_hz)
    lost = (sweep.lines_hz > 60.0) & (sweep.lines_hz < 62.0)
    noisy = np.where(lost, 1e3 * rng.normal(size=G.shape), G)
    found, exact = sharper(sweep.lines_hz, noisy, ~lost), Directions.of(sweep.lines_hz, G)
    across = np.abs(np.sum(np.conj(found.vectors[:, :3]) * exact.vectors[:, :3], axis=0))
    assert across.min() > 0.9


@pytest.mark.slow
def test_weak_directions_of_a_wide_plant_are_heard(rng):
    bench, plant = wide(rng, 2e-5)
    G = plant.frequency_response(np.geomspace(*BAND_HZ, 50))
    sizes = np.linalg.svd(np.moveaxis(G, 2, 0), compute_uv=False)
    law = StateSpace(
        np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((5, 0)), 0.2 * np.linalg.pinv(G[:, :, 20].real), RATE_HZ
    )
    size = 0.3 / max(np.linalg.svd(g @ law.D, compute_uv=False)[0] for g in np.moveaxis(G, 2, 0))
    law = StateSpace(law.A, law.B, law.C, size * law.D, RATE_HZ)
    found = uq.simulate.measure_sensitivity(bench, law)
    inside = (found.f_hz > BAND_HZ[0]) & (found.f_hz < BAND_HZ[1])
    f = found.f_hz[inside]
    z = np.exp(2j * np.pi * f / RATE_HZ)
    loop = np.einsum("ijf,jk->fik", plant.frequency_response(f), law.D) / z[:, None, None]
    truth = -20 * np.log10(np.linalg.svd(np.linalg.inv(np.eye(3) - loop), compute_uv=False)[:, 0])
    heard = ~found.hidden[inside]
    error = np.abs(found.worst_direction_db()[inside] - truth)[heard].max()
    apart = sizes[:, 0].max() / sizes[:, 2].min()
    print(f"directions {apart:.0f} apart: {heard.sum()} of {f.size} lines heard, {error:.3f} dB from the truth")
    assert f.min() < 1.02 * BAND_HZ[0]
    assert f.max() > BAND_HZ[1] / 1.02
    assert heard.all()
    assert error < 0.5


def test_where_nothing_is_heard_a_range_is_asked_for(rng):
    bench = Wrapped(lambda u, d: 1e3 * rng.standard_normal(1) + u + d, lambda: None, 200.0, ["coil"], ["gap"])
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-0.1]], 200.0)
    with pytest.raises(UnheardError, match="give each channel its low and high"):
        uq.simulate.measure_sensitivity(bench, law)
