"""Sensitivities of benches that are slow to rest, never do, or rest elsewhere: what is told as resolved is true."""

import numpy as np
import pytest

import ultraquiet as uq

RATE_HZ = 200.0
EXACT_DB, NOISY_DB, DEVIATIONS = 0.1, 0.5, 5.0


def modes(*pairs):
    """Return A of modes (Hz, modulus)."""
    A = np.zeros((2 * len(pairs), 2 * len(pairs)))
    for k, (f_hz, modulus) in enumerate(pairs):
        w = 2 * np.pi * f_hz / RATE_HZ
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = modulus * np.array([[np.cos(w), -np.sin(w)], [np.sin(w), np.cos(w)]])
    return A


class Stranger:
    """A bench of one actuator: x+ = A x + B v, readings C x, with noise, an offset and a converter."""

    def __init__(self, A, B, C, noise=0.0, offset=0.0, step=0.0):
        self.A, self.B, self.C = np.atleast_2d(A), np.asarray(B, float), np.atleast_2d(C)
        self.noise, self.offset, self.step = noise, offset, step

    def bench(self):
        x, rng, told = np.zeros(len(self.A)), None, None

        def reset(run):
            nonlocal rng, told
            x[:] = 0.0
            rng, told = np.random.default_rng((7, run)), []

        def step(u, d):
            nonlocal told
            if self.noise and not told:
                told = list(self.noise * rng.standard_normal((4096, len(self.C))))
            y = self.C @ x + self.offset + (told.pop() if self.noise else 0.0)
            x[:] = self.A @ x + self.B * (u[0] + d[0])
            return np.round(y / self.step) * self.step if self.step else y

        return uq.bench.Wrapped(step, reset, RATE_HZ, ["force"], [f"reading {k}" for k in range(len(self.C))])

    def sizes(self, law, f_hz):
        """Return the size of S for disturbances that the actuator makes, a command acting one sample late."""
        z = np.exp(2j * np.pi * f_hz / RATE_HZ)
        G = np.stack([self.C @ np.linalg.solve(each * np.eye(len(self.A)) - self.A, self.B) for each in z])
        K = law.frequency_response(f_hz)[0].T
        return 1 / np.abs(1 - np.sum(K * G, axis=1) / z)


def law(gain):
    return uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[gain]], RATE_HZ)


TIP = [[1.0, 0.3]]
REST = {
    "decays in 50 s": (Stranger(modes((8, 0.9999)), [0.01, 0.05], TIP), law(-0.4)),
    "two near ones": (
        Stranger(modes((8, 0.9999), (8.02, 0.9998)), [0.01, 0.05, 0.02, 0.03], [[1.0, 0.3, -0.5, 0.2]]),
        law(-0.3),
    ),
    "integrates": (Stranger([[1.0]], [1 / RATE_HZ], [[1.0]]), law(-20.0)),
    "a free body": (
        Stranger([[1, 1 / RATE_HZ], [0, 1]], [0.5 / RATE_HZ**2, 1 / RATE_HZ], [[1.0, 0.0]]),
        uq.StateSpace([[0.6]], [[1.0]], [[160.0]], [[-420.0]], RATE_HZ),
    ),
}


@pytest.mark.gate("integrates")
@pytest.mark.parametrize("name", REST)
def test_what_is_slow_to_rest_or_never_does_is_measured_as_it_is(name):
    plant, controller = REST[name]
    found = uq.simulate.measure_sensitivity(plant.bench(), controller)
    true_db = 20 * np.log10(plant.sizes(controller, found.f_hz))
    error = np.abs(-found.worst_direction_db() - true_db)[~found.hidden]
    fine = np.geomspace(found.f_hz[0], found.f_hz[-1], 40000)
    peak_db = 20 * np.log10(plant.sizes(controller, fine).max())
    print(
        f"{name}: {found.f_hz.size} lines to {found.f_hz[-1]:.3g} Hz, {found.hidden.sum()} hidden, largest error "
        f"{error.max():.3f} dB, peak {found.peak_amplification_db():.2f}, true {peak_db:.2f}; {found.unresolved()}"
    )
    assert found.f_hz[-1] > 80
    assert error.max() < EXACT_DB
    assert found.peak_amplification_db() == pytest.approx(peak_db, abs=2 * EXACT_DB)


@pytest.mark.slow
@pytest.mark.parametrize(("offset", "step"), [(0.3, 0.0), (0.3, 0.005), (2.0, 0.0)])
def test_an_offset_or_a_converter_hides_nothing_that_noise_does_not(offset, step):
    """The sensor has no range: what it rests at uses none up."""
    found = {}
    for each in (0.0, offset):
        plant = Stranger([[0.98]], [-0.3], [[1.0]], 1e-3, each, step)
        found[each] = uq.simulate.measure_sensitivity(plant.bench(), law(0.5))
        error = np.abs(1 / 10 ** (found[each].worst_direction_db() / 20) - plant.sizes(law(0.5), found[each].f_hz))
        off = (error / found[each].deviation).max()
        print(
            f"offset {each}, step {step}: {found[each].f_hz.size} lines to {found[each].f_hz[-1]:.3g} Hz, largest "
            f"error {off:.2g} deviations, peak {found[each].peak_amplification_db():.2f} dB"
        )
        assert off < DEVIATIONS
    if not step:  # a converter rounds otherwise elsewhere on its scale
        assert found[offset].f_hz[-1] > 0.9 * found[0.0].f_hz[-1]
    assert found[offset].peak_amplification_db() == pytest.approx(found[0.0].peak_amplification_db(), abs=NOISY_DB)


@pytest.mark.slow
def test_what_is_not_heard_is_told():
    plant = Stranger(modes((8, 0.999)), [0.01, 0.05], TIP, noise=1e-3)
    found = uq.simulate.measure_sensitivity(plant.bench(), law(-0.4))
    print(found.unresolved())
    assert found.f_hz[-1] < 50
    assert f"not heard above {found.f_hz[-1]:.3g} Hz" in found.unresolved()
    assert "not heard" not in found.unresolved(2.0, 5.0)
