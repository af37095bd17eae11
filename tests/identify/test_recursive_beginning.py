"""Recursions with filters that begin from nothing: where a batch fit is, whatever the draw."""

import numpy as np
import pytest
from scipy.signal import lfilter

import ultraquiet as uq
from ultraquiet.identify.record_checks import SAMPLES_PER_PARAMETER
from ultraquiet.identify.recursive import beginning
from ultraquiet.identify.recursive.beginning import LONGEST

PLANT = np.array([1.0, -1.6, 0.8]), np.array([0.0, 1.0, 0.5])
FAR = 4.0  # standard deviations from the batch estimate; half the record and all of it differ by one
CASES = {
    "ARMAX": (uq.identify.Armax, uq.identify.RecursiveArmax, [1.0, 0.7, 0.2], PLANT[0], 0.3),
    # 1/C - 1/2 is not positive real: nothing assures that extended least squares converges.
    "ARMAX, resonant C": (uq.identify.Armax, uq.identify.RecursiveArmax, [1.0, -1.5, 0.81], PLANT[0], 0.6),
    "BJ": (uq.identify.BoxJenkins, uq.identify.RecursiveBoxJenkins, [1.0, 0.7, 0.2], [1.0, -0.9, 0.3], 0.8),
    "OE": (uq.identify.OutputError, uq.identify.RecursiveOutputError, [1.0], [1.0], 1.0),
}


def drawn(rng, c, d, size, n=4000):
    a, b = PLANT
    u, e = rng.standard_normal((2, n))
    return uq.Record(u, 3.0 + lfilter(b, a, u) + lfilter(c, d, size * e), 100.0)


def coefficients(m):
    parts = [m.a[1:]]
    for b, f in zip(m.b, m.f, strict=True):
        parts += [b[1:], f[1:]]
    return np.concatenate([*parts, m.c[1:], m.d[1:]])


@pytest.mark.gate("BJ")
@pytest.mark.parametrize("case", CASES)
def test_from_nothing_every_draw_ends_at_the_batch_estimate(seed, case):
    batch_type, recursive_type, *noise = CASES[case]
    pulls = []
    for k in range(5):
        record = drawn(np.random.default_rng([seed, k]), *noise)
        batch = batch_type(order=2).identify(record)
        found = recursive_type(order=2, start_samples=0).identify(record)
        moved = coefficients(found.model.rows[0][0]) - coefficients(batch.model.rows[0][0])
        pulls.append(np.abs(moved / np.sqrt(np.diag(batch.covariance[0]))).max())
    print(f"\n{case} from nothing: at most {', '.join(f'{x:.2f}' for x in pulls)} sigma from batch")
    assert max(pulls) < FAR


def test_from_nothing_samples_one_by_one_give_the_same_as_blocks(rng):
    record = drawn(rng, *CASES["BJ"][2:], n=1500)
    method = uq.identify.RecursiveBoxJenkins(order=2)
    runs = [method.recursion(100.0, [1.0], 5.0) for _ in range(2)]
    whole = runs[0].update(record.inputs, record.outputs)
    single = [runs[1].update(record.inputs[:, [t]], record.outputs[:, [t]])[0] for t in range(record.samples)]
    assert np.array_equal(whole, single)
    assert np.array_equal(runs[0].coefficients, runs[1].coefficients)


def test_silence_before_the_excitation_is_waited_out(rng):
    record = drawn(rng, *CASES["OE"][2:])
    running = uq.identify.RecursiveOutputError(order=2).recursion(100.0, [1.0], 5.0)
    quiet = 3 * LONGEST
    running.update(np.zeros((1, quiet)), 3.0 + rng.standard_normal((1, quiet)))
    assert np.all(running.coefficients == 0.0)
    assert np.all(np.isinf(running.deviation))
    running.update(record.inputs, record.outputs)
    batch = uq.identify.OutputError(order=2).identify(record)
    moved = coefficients(running.model) - coefficients(batch.model.rows[0][0])
    pulls = np.abs(moved / np.sqrt(np.diag(batch.covariance[0])))
    print(f"\nafter {quiet} samples of silence: at most {pulls.max():.2f} sigma from batch")
    assert running.samples == quiet + record.samples
    assert pulls.max() < FAR


def test_a_plant_that_moved_in_the_beginning_is_not_averaged_over_more_than_the_memory(rng):
    """The gain doubles at 10 s; a memory of 2 s must have it 20 s later, from nothing as from a start."""
    u, e = rng.standard_normal((2, 3000))
    a, b = PLANT
    gain = np.where(np.arange(u.size) < 1000, 1.0, 2.0)
    record = uq.Record(u, gain * lfilter(b, a, u) + 0.3 * e, 100.0)
    found = uq.identify.RecursiveOutputError(order=2, start_samples=0, memory_s=2.0).identify(record)
    assert found.model.rows[0][0].b[0][1] == pytest.approx(2.0, abs=0.1)
    assert found.details["trajectory"][0].coefficients[1, 0] == pytest.approx(1.0, abs=0.1)


def test_a_record_that_the_first_model_uses_up_is_refused(rng):
    for _, recursive_type, *noise in CASES.values():
        record = drawn(rng, *noise)
        method = recursive_type(order=2, start_samples=0)
        first = SAMPLES_PER_PARAMETER * (len(method.identify(record).covariance[0]) + 1)
        with pytest.raises(uq.errors.InputError, match="none is left to judge it by"):
            method.identify(record.part(0, first))
        found = method.identify(record.part(0, first + 1))
        assert np.any(found.details["trajectory"][0].coefficients[-1] != 0.0)


def test_a_fit_that_fails_leaves_the_model_as_it_was(rng, monkeypatch):
    record = drawn(rng, *CASES["OE"][2:])
    running = uq.identify.RecursiveOutputError(order=2).recursion(100.0, [1.0], 5.0)
    running.update(record.inputs[:, :100], record.outputs[:, :100])

    def refuse(*_):
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(beginning, "fit_channel", refuse)
    running.update(record.inputs[:, 100:], record.outputs[:, 100:])
    assert running.samples == record.samples
    a, b = PLANT
    assert running.model.b[0] == pytest.approx(b, abs=0.2)
    assert running.model.f[0] == pytest.approx(a, abs=0.05)
