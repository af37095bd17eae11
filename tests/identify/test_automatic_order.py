"""The order that a record chooses by itself: near that of lightly damped truths, and no worse on data never seen."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import lfilter

import ultraquiet as uq
from table_of_accelerometers import NOISE, delayed, drawn_table
from ultraquiet.identify.subspace.order_selection import WORTH, HeldOutError

RATE_HZ = 1000.0
SHAPES = [(1, 1, 3, 4000), (4, 3, 6, 6000), (6, 6, 8, 8000), (20, 4, 8, 6000)]  # outputs, inputs, modes, samples
NOISE_DB = (10, 20, 30, 40)
SPREAD = 1.2  # of the truth's order
BATCHES = 20
HEARD = 4 * WORTH  # a mode without which the error grows by less, in logarithms, need not be found


def drawn(rng, ny, nu, modes):
    """Modes spread evenly from 8 to 350 Hz, damped by 0.5 to 3 %, random shapes."""
    f = np.geomspace(8, 350, modes) * np.exp(0.05 * rng.standard_normal(modes))
    zeta = rng.uniform(0.005, 0.03, modes)
    A, B, C = np.zeros((2 * modes, 2 * modes)), np.zeros((2 * modes, nu)), np.zeros((ny, 2 * modes))
    for k, p in enumerate(np.exp(2 * np.pi * f / RATE_HZ * (-zeta + 1j * np.sqrt(1 - zeta**2)))):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
        B[2 * k + 1] = rng.standard_normal(nu) * np.sqrt(1 - abs(p) ** 2)
        C[:, 2 * k] = rng.standard_normal(ny)
    return uq.StateSpace(A, B, C, np.zeros((ny, nu)), RATE_HZ)


def heard(plant, size):
    """Return how many modes stand out of noise of this standard deviation, `(ny, 1)`, on inputs of unit variance."""
    modes = (slice(k, k + 2) for k in range(0, plant.states, 2))
    states = ((plant.C[:, k], solve_discrete_lyapunov(plant.A[k, k], plant.B[k] @ plant.B[k].T)) for k in modes)
    powers = (np.diag(C @ P @ C.T)[:, None] for C, P in states)
    return sum(np.mean(np.log1p(power / size**2)) / 2 > HEARD for power in powers)


def held_out(model, record):
    """Mean square of the simulated error, in output variances, and its standard error from means of batches."""
    y = record.outputs / record.outputs.std(axis=1, keepdims=True)
    said = model.simulate(record.inputs) / record.outputs.std(axis=1, keepdims=True)
    batches = [part.mean() for part in np.array_split(np.mean((y - said) ** 2, axis=0), BATCHES)]
    return np.mean(batches), np.std(batches, ddof=1) / np.sqrt(BATCHES)


def recorded(rng, plant, size, samples):
    u = rng.standard_normal((plant.D.shape[1], samples))
    y = plant.simulate(u)
    return uq.Record(u, y + size * rng.standard_normal(y.shape), RATE_HZ)


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_the_standard_error_is_the_spread_of_the_difference(memory):
    """Of two errors that share a part and are coloured, over fresh draws: what one draw says of itself."""
    differences, unsure = [], []
    for k in range(200):
        rng = np.random.default_rng(k)
        both, own, other = (
            np.asarray(lfilter([1.0], [1.0, -memory], rng.standard_normal((3, 4000)))) for _ in range(3)
        )
        a, b = HeldOutError.of(both + 0.3 * own), HeldOutError.of(both + 0.3 * other)
        differences.append(a.size - b.size)
        unsure.append(a.unsure(b))
    ratio = np.mean(unsure) / np.std(differences)
    print(f"memory {memory}: standard error {np.mean(unsure):.2e}, spread {np.std(differences):.2e}, ratio {ratio:.2f}")
    assert 0.85 < ratio < 1.15


@pytest.mark.slow
@pytest.mark.parametrize("draw", [1, 2])
def test_the_order_of_a_record_of_one_band(draw):
    """20 sensors of poles above the band, 4 actuators, driven from 2 to 600 Hz of 1000: no fixed order is better.

    By `WORTH` of the error, that is, which is no reason for a larger order, and its standard error.
    """
    plant = uq.values.Decimation(4).plant(delayed(drawn_table(draw)[0]))
    record, unseen = (of_one_band(plant, 8192, draw), of_one_band(plant, 4096, draw + 50))
    chosen = uq.identify.Subspace(order=None).identify(record)
    own, unsure = held_out(chosen.model, unseen)
    print(f"\ndraw {draw}: order {chosen.details['order']}, unseen error {own:.4e} +- {unsure:.1e}")
    for order in (26, 34, 42, 46, 60):
        known, _ = held_out(uq.identify.Subspace(order=order).identify(record).model, unseen)
        print(f"   order {order}: {known:.4e}")
        assert own <= known * (1 + WORTH) ** 2 + unsure


def of_one_band(plant, samples, seed):
    signal = uq.signals.BandLimitedNoise(start_hz=2.0, stop_hz=600.0, peak_v=10.0)
    u = np.stack([signal.generate(samples=samples, rate_hz=plant.rate_hz, seed=10 * seed + k) for k in range(4)])
    y = plant.simulate(u)
    noise = NOISE * 0.7 * np.random.default_rng([7, seed]).standard_normal(y.shape)
    return uq.Record(u, y + noise, plant.rate_hz)


@pytest.mark.slow
@pytest.mark.parametrize(("ny", "nu", "modes", "samples"), SHAPES)
def test_the_order_of_lightly_damped_truths_is_found(ny, nu, modes, samples, rng):
    print()
    for noise_db in NOISE_DB:
        plant = drawn(rng, ny, nu, modes)
        size = 10 ** (-noise_db / 20) * plant.simulate(rng.standard_normal((nu, samples))).std(axis=1, keepdims=True)
        record, unseen = (recorded(rng, plant, size, samples) for _ in range(2))
        chosen = uq.identify.Subspace(order=None).identify(record)
        known = uq.identify.Subspace(order=2 * modes).identify(record)
        (own, _), (best, unsure) = held_out(chosen.model, unseen), held_out(known.model, unseen)
        order, least = chosen.details["order"], 2 * heard(plant, size)
        print(
            f"{ny} x {nu}, {noise_db} dB: order {order} of {2 * modes}, {least} of them heard, unseen error {own:.4e} "
            f"chosen, {best:.4e} with the truth's order, unsure by {unsure:.1e}"
        )
        assert least <= order <= SPREAD * 2 * modes
        assert own <= best + unsure  # the rule of one standard error: Breiman et al. 1984, section 3.4.3
