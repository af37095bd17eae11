"""Base to payload on two masses whose transmissibility is known."""

import numpy as np
import pytest
from scipy.stats import f

from ultraquiet._base.errors import InputError, RateError
from ultraquiet.linalg.discretize import zero_order_hold
from ultraquiet.spectra import transmissibility
from ultraquiet.values import Record, StateSpace

RATE = 500.0
# Resolution 0.19 Hz: narrow beside modes that are 2 Hz wide, so that leakage is no part of the error.
SEGMENT = 4000
BASE, PAYLOAD = ["base x", "base y", "base z"], ["payload x", "payload y", "payload z"]
# Base and payload in kg, soft mounts of the base to the floor, suspension: 12 Hz and 8 % in x, stiffer in y and z.
BASE_KG, PAYLOAD_KG, FLOOR_HZ, ZETA = 20.0, 6.0, 2.0, 0.08
STAGE_HZ = np.array([12.0, 18.0, 25.0])
# The axes of the payload's sensor are turned against those of the suspension.
TURN = np.linalg.qr(np.array([[1.0, 0.2, 0.1], [-0.2, 1.0, 0.3], [0.1, -0.3, 1.0]]))[0]


def two_masses():
    """Forces on the base (3) to velocities of base and payload (6), sampled."""
    k, c = PAYLOAD_KG * (2 * np.pi * STAGE_HZ) ** 2, 2 * ZETA * PAYLOAD_KG * 2 * np.pi * STAGE_HZ
    K, C = TURN @ np.diag(k) @ TURN.T, TURN @ np.diag(c) @ TURN.T
    floor, damp = BASE_KG * (2 * np.pi * FLOOR_HZ) ** 2, 2 * 0.2 * BASE_KG * 2 * np.pi * FLOOR_HZ
    eye, zero = np.eye(3), np.zeros((3, 3))
    weight = np.diag(np.repeat([1 / BASE_KG, 1 / PAYLOAD_KG], 3))
    stiff = -weight @ np.block([[K + floor * eye, -K], [-K, K]])
    lossy = -weight @ np.block([[C + damp * eye, -C], [-C, C]])
    push = weight @ np.vstack([eye, zero])
    A = np.block([[np.zeros((6, 6)), np.eye(6)], [stiff, lossy]])
    B = np.vstack([np.zeros((6, 3)), push])
    Ad, Bd, Cd, Dd = zero_order_hold(A, B, np.eye(12)[6:], np.zeros((6, 3)), 1 / RATE)
    return StateSpace(Ad, Bd, Cd, Dd, RATE)


def truth(plant, f_hz):
    G = np.moveaxis(plant.frequency_response(f_hz), -1, 0)
    return np.moveaxis(G[:, 3:] @ np.linalg.inv(G[:, :3]), 0, -1)


def measured(rng, force, noise=0.0):
    plant = two_masses()
    y = plant.simulate(force)
    y = y + noise * np.std(y) * rng.standard_normal(y.shape)
    return Record(force, y, RATE, sensors=[*BASE, *PAYLOAD])


def test_the_sampled_system_is_the_textbook_one():
    f_hz = np.linspace(3, 60, 50)
    s = 2j * np.pi * f_hz
    k, c = (2 * np.pi * STAGE_HZ[:, None]) ** 2, 4 * np.pi * ZETA * STAGE_HZ[:, None]
    modes = (c * s + k) / (s**2 + c * s + k)
    textbook = np.einsum("ij,jf,kj->ikf", TURN, modes, TURN)
    off = np.abs(truth(two_masses(), f_hz) - textbook).max()
    peak = np.abs(textbook).max()
    print(f"sampled against continuous: {off:.3f} at most, of gains up to {peak:.2f}")
    assert off < 0.02 * peak  # the hold alone parts them; the truth used below is the sampled one


def test_three_directions_at_once_lie_within_their_confidence(rng):
    """Noise at the payload alone: H1 is unbiased and its intervals hold the truth in 95 of 100 lines."""
    held, strong = [], []
    for _ in range(6):
        record = measured(rng, rng.standard_normal((3, 2**16)))
        y = record.outputs.copy()
        y[3:] += 0.05 * y[:3].std() * rng.standard_normal((3, y.shape[1]))
        found = transmissibility(Record(record.inputs, y, RATE, sensors=record.sensors), BASE, PAYLOAD, SEGMENT)
        shown = (found.f_hz > 3) & (found.f_hz < 60)
        true_db = 20 * np.log10(np.abs(truth(two_masses(), found.f_hz[shown])))
        low, high = (side[:, :, shown] for side in found.interval_db())
        held.append((low < true_db) & (true_db < high))
        strong.append(np.median(np.abs(found.db[:, :, shown] - true_db)[true_db > 0]))
    share = np.mean(held)
    print(
        f"{100 * share:.1f} % inside the 95 % interval, median error where it amplifies {np.median(strong):.2f} dB; "
        f"{found.estimator}"
    )
    assert 0.93 < share < 0.97
    assert np.median(strong) < 0.5


def test_one_source_after_another_gives_the_same_matrix(rng):
    records = []
    for j in range(3):
        force = np.zeros((3, 2**15))
        force[j] = rng.standard_normal(2**15)
        records.append(measured(rng, force, 1e-4))
    found = transmissibility(records, BASE, PAYLOAD, SEGMENT)
    shown = (found.f_hz > 3) & (found.f_hz < 60)
    real = truth(two_masses(), found.f_hz[shown])
    error = np.linalg.norm(found.response.values[:, :, shown] - real) / np.linalg.norm(real)
    print(f"whole matrix off by {100 * error:.2f} % in the mean square, 3 to 60 Hz, by leakage of 15 segments a record")
    assert error < 0.02
    with pytest.raises(InputError, match="2 moving actuators cannot refer 3 base directions"):
        transmissibility(records[:2], BASE, PAYLOAD, SEGMENT, estimator="reference")


def test_references_take_away_the_bias_of_noisy_base_sensors(rng):
    record = measured(rng, rng.standard_normal((3, 2**17)), noise=0.7)
    off = {}
    for estimator in ("H1", "reference"):
        found = transmissibility(record, BASE, PAYLOAD, SEGMENT, estimator=estimator)
        band = (found.f_hz > 4) & (found.f_hz < 10)
        real = truth(two_masses(), found.f_hz[band])
        off[estimator] = np.mean([np.real(found.response.values[i, i, band] / real[i, i]).mean() for i in range(3)])
    print(f"mean gain over truth, 4 to 10 Hz: {off}")
    assert off["H1"] < 0.8
    assert off["reference"] == pytest.approx(1.0, abs=0.1)


def test_references_cover(rng):
    held = []
    for _ in range(6):
        found = transmissibility(
            measured(rng, rng.standard_normal((3, 2**15)), 0.2), BASE, PAYLOAD, SEGMENT, estimator="reference"
        )
        shown = (found.f_hz > 3) & (found.f_hz < 60)
        error = np.abs(found.response.values[:, :, shown] - truth(two_masses(), found.f_hz[shown])) ** 2
        disc = f.ppf(0.95, 2, 2 * found.degrees)
        held.append(error < disc * found.response.variance[:, :, shown])
    print(f"{100 * np.mean(held):.1f} % of the discs of 95 % hold the truth")
    assert 0.92 < np.mean(held) < 0.98


def test_the_scalar_version(rng):
    force = np.zeros((3, 2**15))
    force[2] = rng.standard_normal(2**15)
    record = measured(rng, force)
    found = transmissibility(record, ["base z"], ["payload z"], SEGMENT)
    y = np.abs(two_masses().frequency_response(found.f_hz)[:, 2])
    expected = 20 * np.log10(y[5] / y[2])
    shown = (found.f_hz > 4) & (found.f_hz < 60)
    off = np.abs(found.db[0, 0] - expected)[shown].max()
    print(
        f"scalar off by {off:.2f} dB at most, ratio of powers by {np.abs(found.overall_db - expected)[shown].max():.2f}"
    )
    assert off < 1.5
    assert "H1" in found.estimator
    assert found.overall_db[shown] == pytest.approx(expected[shown], abs=1.5)


def bad_cases():
    rng = np.random.default_rng(0)
    y = rng.standard_normal((6, 4000))
    y[2] = 0.5 * y[0]
    dead = y.copy()
    dead[4] = 0.0
    names = [*BASE, *PAYLOAD]
    good, still = (Record(np.zeros(4000), x, RATE, sensors=names) for x in (y, dead))
    return [
        (lambda: transmissibility(good, BASE, PAYLOAD, 500), "'base x' and 'base z' move alike"),
        (lambda: transmissibility(still, ["base x"], PAYLOAD, 500), "'payload y' never moves"),
        (lambda: transmissibility(good, ["floor"], PAYLOAD), "names sensor 'floor'; known are base x"),
        (lambda: transmissibility(good, [7], PAYLOAD), "names sensor 7"),
        (lambda: transmissibility(good, [0.5], [1]), r"names sensor 0.5"),
        (lambda: transmissibility(good, 7, PAYLOAD), "names sensor 7"),
        (lambda: transmissibility(good, [], PAYLOAD), "at least one sensor"),
        (lambda: transmissibility([], BASE, PAYLOAD), "at least one record"),
        (lambda: transmissibility(good, BASE, PAYLOAD, estimator="H4"), "'reference', got 'H4'"),
        (lambda: transmissibility(good, BASE, PAYLOAD, 5000), "does not fit into 4000"),
        (lambda: transmissibility([good, Record([0.0, 1.0], [[0.0, 1.0]] * 6, 9.0)], [0], [3]), "sampled at 9 Hz"),
    ]


@pytest.mark.parametrize("case", bad_cases(), ids=lambda c: c[1])
def test_bad_input_is_a_sentence(case):
    call, words = case
    with pytest.raises((InputError, RateError)) as caught:
        call()
    assert words in str(caught.value)


def test_one_sensor_may_be_named_without_a_list(rng):
    record = Record(rng.standard_normal((1, 2000)), rng.standard_normal((2, 2000)), 100.0, sensors=["base z", "top"])
    one, listed = transmissibility(record, "base z", "top"), transmissibility(record, ["base z"], ["top"])
    assert np.array_equal(one.response.values, listed.response.values)
