"""A model as a bench, compiled with its law, against its twin: one step of each after the other."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.values.controller import SteppedController

RATE_HZ = 500.0


class Asked:
    """A law that a bench asks sample by sample."""

    def __init__(self, law):
        self._law = SteppedController(law)
        self.rate_hz = law.rate_hz

    def reset(self):
        self._law.reset()

    def step(self, y):
        return self._law.step(y)


def drawn(rng, n, ny, nu, direct):
    A = rng.standard_normal((n, n))
    A *= 0.98 / np.abs(np.linalg.eigvals(A)).max() if n else 1.0
    D = 0.3 * rng.standard_normal((ny, nu)) * direct
    return uq.StateSpace(A, rng.standard_normal((n, nu)), rng.standard_normal((ny, n)), D, RATE_HZ)


@pytest.mark.gate("1.0-1-1-2-0-False", "1e-09-3-5-12-1-True", "1.0-4-3-7-5-True", "1e-09-2-2-0-3-False")
@pytest.mark.parametrize("direct", [False, True])
@pytest.mark.parametrize(("ny", "nu", "n", "of_law"), [(1, 1, 2, 0), (4, 3, 7, 5), (3, 5, 12, 1), (2, 2, 0, 3)])
@pytest.mark.parametrize("unit", [1e-9, 1.0])
def test_the_loop_is_that_of_its_twin(ny, nu, n, of_law, direct, unit, rng):
    """Limits that are met, no two alike; an actuation, a disturbance; from rest, twice."""
    model = drawn(rng, n, ny, nu, direct)
    force = [uq.Channel(f"force {i}", "N", -0.3 - i, 0.5 + i) for i in range(nu)]
    place = [uq.Channel(f"place {i}", "nm", -(2.0 + i) * unit, (1.0 + i) * unit) for i in range(ny)]
    model = uq.StateSpace(
        model.A, model.B, unit * model.C, unit * model.D, RATE_HZ, actuators=tuple(force), sensors=tuple(place)
    )
    law = drawn(rng, of_law, nu, ny, True)
    gains = [uq.analyse.hinf_norm(system)[0] for system in (law, model)]
    small = 0.5 / (gains[0] * (gains[1] or unit))  # stable by the small-gain theorem
    law = uq.StateSpace(law.A, law.B, small * law.C, small * law.D, RATE_HZ)
    bench = uq.bench.LinearBench(model)
    u, d = rng.standard_normal((2, nu, 3000))
    for controller in (law, None):
        found = bench.run(u, disturbance=d, controller=controller)
        asked = Asked(law if controller is not None else uq.StateSpace(*_nothing(nu, ny), RATE_HZ))
        twin = bench.run(u, disturbance=d, controller=asked)
        np.testing.assert_allclose(found.outputs, twin.outputs, rtol=1e-9, atol=1e-9 * unit)
        np.testing.assert_allclose(found.inputs, twin.inputs, rtol=1e-9, atol=1e-9)
        assert found.provenance.settings == twin.provenance.settings
        assert found.hash == bench.run(u, disturbance=d, controller=controller).hash
        for block in (1, 7, 5000):
            parts = list(bench.stream(u, d, controller, block_samples=block))
            np.testing.assert_array_equal(np.concatenate([part.readings for part in parts], axis=1), found.outputs)
            np.testing.assert_array_equal(np.concatenate([part.command for part in parts], axis=1), found.inputs)


def _nothing(nu, ny):
    return np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), np.zeros((nu, ny))


@np.errstate(over="ignore", invalid="ignore")
def test_a_law_without_a_finite_answer_is_named_with_the_sample():
    """The state of the law doubles four hundred times in a sample, and then there is no number so large."""
    model = uq.StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], RATE_HZ)
    law = uq.StateSpace([[2.0**400]], [[1.0]], [[1.0]], [[0.0]], RATE_HZ)
    bench = uq.bench.LinearBench(model)
    said = []
    for controller in (law, Asked(law)):
        blocks = bench.stream(np.ones((1, 50)), controller=controller, block_samples=40)
        measured = next(blocks)
        with pytest.raises(InputError) as error:
            next(blocks)
        said.append((measured.readings.tolist(), measured.command.tolist(), str(error.value)))
    assert said[0] == said[1]
    assert "at sample 5 the controller must return 1 finite commands" in said[0][2]


@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (4, 3), (3, 5)])
@pytest.mark.parametrize("unit", [1e-9, 1.0])
def test_a_model_that_runs_away_is_named_with_the_sample_and_no_law_blamed(ny, nu, unit, rng):
    A = np.diag([2.0, *np.full(ny - 1, 0.5)])
    model = uq.StateSpace(A, np.ones((ny, nu)), unit * rng.uniform(1, 2, (ny, ny)), np.zeros((ny, nu)), RATE_HZ)
    bench, u = uq.bench.LinearBench(model), np.ones((nu, 1500))
    idle = uq.StateSpace(*_nothing(nu, ny), RATE_HZ)
    told = []
    for controller in (None, idle, Asked(idle)):
        blocks = bench.stream(u, None, controller, block_samples=1500)
        kept = next(blocks).readings
        assert np.isfinite(kept).all()
        with pytest.raises(InputError, match="readings were no longer finite numbers: it ran away") as caught:
            next(blocks)
        told.append((kept.shape[1], str(caught.value)))
        assert f"at sample {kept.shape[1]} " in told[-1][1]
    assert told[0] == told[1] == told[2]
    assert bench.run(u[:, :900]).outputs.max() > 1e200 * unit


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_compiled_code_runs_in_the_loop_as_it_does_step_by_step(precision, rng, tmp_path):
    model, law = drawn(rng, 5, 3, 2, False), drawn(rng, 4, 2, 3, True)
    small = 0.5 / (uq.analyse.hinf_norm(law)[0] * uq.analyse.hinf_norm(model)[0])
    law = uq.StateSpace(law.A, law.B, small * law.C, small * law.D, RATE_HZ)
    made = uq.deploy.generate(law, tmp_path, precision, limits_v=1.0)
    bench, u = uq.bench.LinearBench(model), rng.standard_normal((2, 2000))
    found, again = (bench.run(u, controller=made.instance()) for _ in range(2))
    code = made.instance()
    asked = Asked(law)
    asked.reset, asked.step = code.reset, code.step
    twin = bench.run(u, controller=asked)
    assert found.hash == again.hash
    np.testing.assert_allclose(found.outputs, twin.outputs, rtol=1e-9, atol=1e-5 if precision == "float32" else 1e-9)
    assert np.abs(found.inputs - u).max() > 1e-3  # the law does something, by far more than what is let pass


def test_a_run_that_is_stopped_fades(rng):
    model = drawn(rng, 3, 2, 2, False)
    law = drawn(rng, 2, 2, 2, True)
    law = uq.StateSpace(law.A, law.B, 1e-3 * law.C, 1e-3 * law.D, RATE_HZ)
    bench = uq.bench.LinearBench(model)
    runs = []
    for controller in (law, Asked(law)):
        how = {"block_samples": 30, "ramp_samples": 20, "stop": lambda: True}
        parts = list(bench.stream(np.ones((2, 200)), controller=controller, **how))
        runs.append([np.concatenate([getattr(part, n) for part in parts], axis=1) for n in ("command", "readings")])
    for found, twin in zip(*runs, strict=True):
        assert found.shape == (2, 20)
        np.testing.assert_allclose(found, twin, rtol=1e-9, atol=1e-12)
    assert np.all(runs[0][0][:, -1] == 0.0)
