"""Every registered identification, on records that can carry no model: a refusal or a verdict, never `ok`."""

import numpy as np
import pytest
from scipy.signal import lfilter

import ultraquiet as uq
from ultraquiet._base import registry
from ultraquiet._base.errors import InputError
from ultraquiet.testing import problems

SAMPLES = 2000
METHODS = sorted(registry.methods("identify"))
# The physical fits search for seconds on every record, good or bad.
LONG = {"structured", "structured-modal"}
PARAMETERS = [pytest.param(n, marks=pytest.mark.slow) if n in LONG else n for n in METHODS]
# A response off by this share of its own size over 5-200 Hz is wrong.
WRONG = 0.3


def good(rng):
    return problems.two_modes(int(rng.integers(2**31)), SAMPLES)


def constant(rng):
    record, _ = good(rng)
    return uq.Record(np.full_like(record.inputs, 2.0), record.outputs, record.rate_hz), None


def dead_output(rng):
    record, _ = good(rng)
    return uq.Record(record.inputs, np.vstack([record.outputs, 0 * record.outputs]), record.rate_hz), None


def dead_input(rng):
    record, _ = good(rng)
    return uq.Record(np.vstack([record.inputs, 0 * record.inputs]), record.outputs, record.rate_hz), None


def collinear(rng):
    record, _ = good(rng)
    return uq.Record(np.vstack([record.inputs, 2 * record.inputs]), record.outputs, record.rate_hz), None


def clipped(rng):
    record, plant = good(rng)
    limit = 0.3 * record.outputs.std()
    return uq.Record(record.inputs, np.clip(record.outputs, -limit, limit), record.rate_hz), plant


def unstable(rng):
    record, _ = good(rng)
    y = lfilter([0, 1e-3], [1, -1.01], record.inputs) + 1e-3 * rng.standard_normal(record.inputs.shape)
    return uq.Record(record.inputs, y, record.rate_hz), None


def short(rng):
    record, plant = good(rng)
    return record.part(0, 40), plant


def tone(rng):
    t = np.arange(SAMPLES) / problems.RATE_HZ
    u = np.sin(2 * np.pi * 20 * t)[None]
    _, plant = good(rng)
    y = plant.simulate(u)
    return uq.Record(u, y + 0.01 * y.std() * rng.standard_normal(y.shape), problems.RATE_HZ), plant


def drifting(rng):
    record, plant = good(rng)
    drift = 1e3 * record.outputs.std() * np.linspace(0, 1, SAMPLES)
    return uq.Record(record.inputs, record.outputs + drift, record.rate_hz), plant


def one_reading(rng):
    record, plant = good(rng)
    y = record.outputs.copy()
    y[0, SAMPLES // 2] = 1e4 * y.std()
    return uq.Record(record.inputs, y, record.rate_hz), plant


CASES = [constant, dead_output, dead_input, collinear, clipped, unstable, short, tone, drifting, one_reading]


def off(model, plant):
    f_hz = np.linspace(5.0, 200.0, 200)
    T = plant.frequency_response(f_hz)
    return np.linalg.norm(model.frequency_response(f_hz) - T) / np.linalg.norm(T)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.__name__)
@pytest.mark.parametrize("name", PARAMETERS)
def test_a_bad_record_yields_no_model_that_looks_fine(name, case, rng):
    record, plant = case(rng)
    try:
        result = registry.lookup("identify", name)().identify(record)
    except InputError:
        return  # a refusal; any other error is a crash and fails the test
    assert result.status.sentence.strip()
    if not result.status.ok:
        return
    error = np.inf if plant is None else off(result.state_space(), plant)
    print(f"\n{name} on a {case.__name__} record: {result.status}; response off by {error:.0%}")
    assert error < WRONG, f"{name} calls a model ok that is off by {error:.0%}"


def test_a_model_of_another_rate_is_refused_on_a_record(rng):
    record, plant = good(rng)
    other = uq.Record(record.inputs, record.outputs, record.rate_hz / 2)
    with pytest.raises(InputError, match=r"sampled at 1000 Hz but .* 500 Hz"):
        uq.validate.compare(plant, other)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_nan_never_becomes_a_record(bad, rng):
    u = rng.standard_normal(100)
    u[7] = bad
    with pytest.raises(InputError, match=r"NaN or infinite"):
        uq.Record(u, u, 100.0)
