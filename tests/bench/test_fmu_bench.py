"""A functional mock-up unit, built here from C, is the same bench as the same plant in Python."""

import pickle
import subprocess
import sys
import time

import numpy as np
import pytest

from fmu_archive import RATE_HZ, compiled, pack
from ultraquiet._base.errors import BenchError, InputError, StorageError
from ultraquiet.bench import Bench, Fmu, Streaming, Wrapped
from ultraquiet.testing import check
from ultraquiet.values import StateSpace


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    return compiled(tmp_path_factory.mktemp("fmu"))


@pytest.fixture
def packed(library, tmp_path):
    def packed_as(version, **options):
        return pack(library, tmp_path / f"plant{version}.fmu", version, **options)

    return packed_as


class Plant:
    """The twin of fmu_plant.c."""

    def __init__(self, stiffness=9.0e4):
        self.stiffness = stiffness

    def reset(self):
        self.position, self.speed = [0.0, 0.0], [0.0, 0.0]

    def step(self, u, d):
        h, y = 1.0 / RATE_HZ, list(self.speed)
        for i in range(2):
            push = float(u[i] + d[i])
            force = push - self.stiffness * self.position[i] - 12.0 * self.speed[i] + 0.125 * y[1 - i]
            self.speed[i] = self.speed[i] + h * force
            self.position[i] = self.position[i] + h * self.speed[i]
        return y


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_gives_the_record_of_the_wrapped_plant_to_the_bit(version, packed, rng):
    bench = Fmu(packed(version))
    assert isinstance(bench, Bench)
    assert isinstance(bench, Streaming)
    assert bench.rate_hz == RATE_HZ
    assert [(c.name, c.unit, c.low, c.high) for c in bench.actuators] == [
        ("push 1", "N", -25.0, 25.0),
        ("push 2", "N", -25.0, 25.0),
    ]
    assert [(c.name, c.unit, c.low, c.high) for c in bench.sensors] == [
        ("speed 1", "m/s", -np.inf, np.inf),
        ("speed 2", "m/s", -np.inf, 10.0),
    ]
    stiff = Fmu(bench.path, parameters={"stiffness": 2.0e5})
    law = StateSpace([[0.9]], 0.1 * rng.normal(size=(1, 2)), rng.normal(size=(2, 1)), rng.normal(size=(2, 2)), RATE_HZ)
    u, d = 20.0 * rng.normal(size=(2, 2, 800))
    for outside, plant in ((bench, Plant()), (stiff, Plant(2.0e5))):
        inside = Wrapped(plant.step, plant.reset, RATE_HZ, bench.actuators, bench.sensors)
        for controller in (None, law):
            began = time.perf_counter()
            theirs = outside.run(u, d, controller)
            rate = u.shape[1] / (time.perf_counter() - began)
            ours = inside.run(u, d, controller)
            assert np.array_equal(theirs.inputs, ours.inputs)
            assert np.array_equal(theirs.outputs, ours.outputs)
            parts = [b.readings for b in outside.stream(u, d, controller, block_samples=77)]
            assert np.array_equal(np.concatenate(parts, axis=1), ours.outputs)
    assert np.ptp(ours.outputs) > 0
    print(f"FMI {version}.0: equal to the bit, {rate:.0f} samples/s in closed loop")
    assert theirs.provenance.settings["parameters"] == {"stiffness": 2.0e5}


@pytest.mark.parametrize("version", [2, 3])
def test_a_step_that_fails_is_one_sentence_and_keeps_what_was_measured(version, packed, rng):
    at = int(rng.integers(1, 90))
    bench, blocks = Fmu(packed(version), parameters={"fails at": float(at)}), []
    words = "the table is not level" if version == 2 else "failed"
    with pytest.raises(BenchError, match=rf"Fmu: at sample {at} the model failed \(fmi{version}DoStep .*{words}"):
        blocks.extend(bench.stream(np.ones((2, 100)), block_samples=16))
    assert sum(b.readings.shape[1] for b in blocks) == at


def test_outputs_that_are_not_finite_are_refused(packed):
    with pytest.raises(BenchError, match="the outputs must be finite"):
        Fmu(packed(2), parameters={"stiffness": 1e300}).run(np.ones((2, 100)))


def test_channels_can_be_chosen_and_the_rate_given(packed):
    bench = Fmu(packed(2), 1000.0, ("push 2",), ("speed 2", "speed 1"))
    assert [c.name for c in (*bench.actuators, *bench.sensors)] == ["push 2", "speed 2", "speed 1"]
    assert bench.run(np.ones((1, 3))).outputs[:, 2].tolist() == [0.001, 0.0]
    again = pickle.loads(pickle.dumps(bench))
    assert np.array_equal(again.run(np.ones((1, 50))).outputs, bench.run(np.ones((1, 50))).outputs)


def test_it_keeps_the_promises_of_a_bench(packed, seed):
    check("bench", "fmu", seed, path=packed(2))


def test_what_cannot_work_is_refused(packed, tmp_path):
    path = packed(2, step="")
    with pytest.raises(InputError, match="proposes no step, so 'rate_hz' must be given"):
        Fmu(path)
    with pytest.raises(InputError, match="has no real input 'pull'; it has push 1, push 2"):
        Fmu(path, 100.0, ("pull",))
    with pytest.raises(InputError, match="has no real parameter 'mass'; it has stiffness, fails at"):
        Fmu(path, 100.0, parameters={"mass": 1.0})
    with pytest.raises(StorageError, match="there is no file"):
        Fmu(str(tmp_path / "none.fmu"))
    (tmp_path / "text.fmu").write_text("hello")
    with pytest.raises(InputError, match="cannot be read as an FMU"):
        Fmu(str(tmp_path / "text.fmu"))


def test_a_missing_extra_says_how_to_install_it(packed):
    script = (
        "import sys; sys.modules['fmpy'] = None; from ultraquiet.bench import Fmu; "
        f"from ultraquiet._base.errors import ToolError\ntry: Fmu({packed(2)!r})\nexcept ToolError as e: print(e)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert 'pip install "ultraquiet[fmu]"' in done.stdout
    print(done.stdout)
