"""Filtered-x LMS with the base's geophone as reference: broadband and tonal; its bound, where it may not be used."""

import numpy as np
import pytest
from tone_runs import band_rms, run

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.design import FilteredXLms
from ultraquiet.values import StateSpace

STRUTS = tuple(range(6))
BASE_Z, BASE_SHAKER = 8, 6


def shaken(rng, duration_s, kind, rate_hz=3500.0):
    """Return the proof mass of the base driven by noise over 20 to 60 Hz, or by a tone, `(8, n)`."""
    n = round(duration_s * rate_hz)
    d = np.zeros((8, n))
    if kind == "tone":
        f = rng.uniform(22, 30)
        d[BASE_SHAKER] = 8.0 * np.sin(2 * np.pi * f * np.arange(n) / rate_hz + rng.uniform(0, 6))
        return d, (f - 2, f + 2)
    f = np.fft.rfftfreq(n, 1 / rate_hz)
    spectrum = np.where((f > 20) & (f < 60), np.exp(2j * np.pi * rng.uniform(size=f.size)), 0)
    x = np.fft.irfft(spectrum, n)
    d[BASE_SHAKER] = np.clip(x / x.std() * 3.0, -10, 10)
    return d, (20, 60)


@pytest.fixture(scope="module")
def designs():
    made = {}
    for unit in ("ground", "flight"):
        plant = uq.bench.Hexapod(unit=unit, instruments="all").linear_model()
        made[unit] = FilteredXLms(reference=(BASE_Z,), errors=STRUTS, drives=STRUTS).design(plant)
    return made


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "wanted_db"), [("broadband", 6.0), ("tone", 25.0)])
@pytest.mark.parametrize("unit", ["ground", "flight"])
def test_base_vibration_is_cancelled(designs, unit, kind, wanted_db, seed, rng):
    bench = uq.bench.Hexapod(unit=unit, instruments="all", seed=seed)
    result = designs[unit]
    d, band = shaken(rng, 8.0, kind)
    opened, closed = run(bench, d), run(bench, d, result.law)
    got = [20 * np.log10(band_rms(opened, p, band) / band_rms(closed, p, band)) for p in ((0, 1), (6, 8))]
    print(
        f"{unit}, {kind} {band[0]:.0f}-{band[1]:.0f} Hz: {got[0]:.1f} dB in the first second, {got[1]:.1f} dB at last"
    )
    print(f"  condition {result.details['condition']:.0f}, commands to {np.abs(closed.inputs).max():.2f} V")
    assert result.law.status.ok
    assert got[1] >= wanted_db
    assert not closed.inputs[6:].any()


def wrapped(plant, references):
    """Return a bench of a plant with two inputs, d of the first on its reference, v on its errors one sample late."""
    x = np.zeros(plant.states)

    def reset():
        x[:] = 0

    def step(u, d):
        y = plant.C @ x
        x[:] = plant.A @ x + plant.B @ (u + d)
        return np.append(y, d[:references])

    names = [f"out {k}" for k in range(plant.D.shape[0] + references)]
    return uq.bench.Wrapped(step, reset, plant.rate_hz, [f"in {k}" for k in range(plant.D.shape[1])], names)


def two_by_two(rng):
    """Return a plant of two lags, its directions 50 to 1 apart, and with a reference that it does not reach."""
    U, V = (np.linalg.qr(rng.standard_normal((2, 2)))[0] for _ in range(2))
    A, B = np.diag([0.8, 0.6]), U @ np.diag([1.0, 0.02])
    truth = StateSpace(A, B, V, np.zeros((2, 2)), 1000.0)
    late = np.block([[A, B], [np.zeros((2, 4))]])
    model = StateSpace(
        late, np.vstack([np.zeros((2, 2)), np.eye(2)]), np.pad(V, ((0, 2), (0, 2))), np.zeros((4, 2)), 1000.0
    )
    return truth, model


def kept_of_a_tone(truth, f_hz, step, taps):
    """Return what a sample leaves of the slowest error of a tone, its sine and cosine the two references.

    The filtered references of a sample are F = Re(v z^t), v of one complex row for each error, so that of all weights
    four directions count, and from sample to sample the rows turn in them: F(t) = F R^t. Seen by the rows, the error of
    the weights goes on by M = R (1 - step F' (F F' + ridge)^-1 F), and what a sample keeps is the radius of M. Rows of
    two errors that one strong drive fills span its sine and cosine by themselves; of the weak drive each sample then
    holds what its phases differ by, and the more nearly 1 - step is -1, the longer the rest only swings.
    """
    z = np.exp(2j * np.pi * f_hz / truth.rate_hz)
    G = truth.frequency_response(np.array([f_hz]))[:, :, 0]
    v = np.stack([np.kron(row, np.kron([-1j, 1.0], z ** -np.arange(taps))) for row in G])
    rows, turned = np.vstack([v.real, v.imag]), np.vstack([(v * z).real, (v * z).imag])
    basis = np.linalg.svd(rows, full_matrices=False)[2].T
    R = np.linalg.solve(rows @ basis, turned @ basis)
    F = (rows @ basis)[:2]
    ridge = 1e-3 * np.trace(F @ F.T) / 2
    M = R @ (np.eye(4) - step * F.T @ np.linalg.solve(F @ F.T + ridge * np.eye(2), F))
    return np.abs(np.linalg.eigvals(M)).max()


@pytest.mark.gate("1.0")
@pytest.mark.parametrize("step", [0.1, 1.0, 1.9])
def test_steps_below_the_bound_converge_in_weak_directions_too(step, rng):
    """At the rate that follows from plant, tone and step; so long a run as that rate takes to a twentieth is made."""
    truth, model = two_by_two(rng)
    bench = wrapped(truth, 2)
    f = rng.uniform(30, 80)
    law = FilteredXLms(reference=(2, 3), taps=8, step=step, leak=0.0, limit=100.0).design(model).law

    def largest_by_second(samples, law=None):
        t = np.arange(samples) / 1000
        d = np.stack([np.sin(2 * np.pi * f * t), np.cos(2 * np.pi * f * t)])
        return np.abs(run(bench, d, law).outputs[:2]).max(axis=0).reshape(-1, 1000).max(axis=1)

    opened, kept = largest_by_second(2000).max(), kept_of_a_tone(truth, f, step, 8)
    assert law.status.ok
    assert kept < 1
    slow = 1.1 * largest_by_second(2000, law)[1] / opened  # a second after the start the slowest error is what is left
    seconds = max(12, 2 + int(np.ceil(np.log(0.05 / slow) / np.log(kept) / 1000)))
    left = largest_by_second(1000 * seconds, law)[-1] / opened
    expected = slow * kept ** (1000 * (seconds - 2))
    print(f"step {step}: {left:.2e} left after {seconds} s, below {expected:.2e}; directions 50 to 1")
    assert left <= max(expected, 1e-9)
    assert left < 0.05


def test_feedback_from_the_commands_to_the_reference_is_taken_out(rng):
    """A reference that hears the actuators would make an unstable loop of a law that did not know."""
    A, B = np.diag([0.9, 0.5]), np.array([[1.0], [1.0]])
    truth = StateSpace(A, B, [[0.1, 0.0], [0.0, 0.8]], [[0.0], [0.0]], 1000.0)
    x, held = np.zeros(2), np.zeros(1)
    law = FilteredXLms(reference=(1,), taps=32, step=0.1, limit=10.0).design(truth).law
    noise = rng.standard_normal(20000)
    louder = np.empty((2, noise.size))
    for k in range(noise.size):
        filtered = 0.3 * noise[max(k - 3, 0)]
        y = truth.C @ x + [filtered, noise[k]]
        louder[:, k] = y[0], filtered
        held = law.step(y)
        x = A @ x + B @ held
    got = -20 * np.log10(louder[0, -4000:].std() / louder[1, -4000:].std())
    print(f"white noise that comes three samples after its reference: {got:.1f} dB")
    assert got > 12


def test_direct_parts_are_minded(rng):
    plant = StateSpace([[0.5]], [[0.5]], [[1.0], [0.3]], [[0.4], [0.2]], 1000.0)
    law = FilteredXLms(reference=(1,), taps=16, step=0.2, limit=10.0).design(plant).law
    x, u, errors = np.zeros(1), np.zeros(1), []
    for k in range(5000):
        d = np.sin(0.2 * k)
        u = law.step(plant.C @ x + plant.D @ u + [d, d])
        x = plant.A @ x + plant.B @ u
        errors.append((plant.C @ x)[0])
    assert np.isfinite(errors).all()
    assert law.status.ok


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"step": 2.0}, "below 2"),
        ({"taps": 1}, "taps"),
        ({"reference": (5,)}, "between -2 and 1"),
        ({"reference": (0, 1)}, "none is left"),
        ({"reference": (1, 1)}, "twice"),
        ({"drives": (3,)}, "drives"),
        ({"errors": (0.5,)}, "errors"),
    ],
)
def test_impossible_settings_are_refused(settings, sentence):
    plant = StateSpace([[0.9]], [[0.1]], [[1.0], [0.0]], [[0.0], [0.0]], 1000.0)
    with pytest.raises(InputError, match=sentence):
        FilteredXLms(**settings).design(plant)


def test_actuators_that_do_not_reach_the_errors_are_refused():
    plant = StateSpace([[0.9]], [[0.1]], [[0.0], [1.0]], [[0.0], [0.0]], 1000.0)
    with pytest.raises(InputError, match="do not reach"):
        FilteredXLms(reference=(1,)).design(plant)
