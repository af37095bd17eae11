"""Processor in the loop: the bench in Python, the law as the target's own binary, sample by sample."""

import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError, ToolError
from ultraquiet.deploy import Processor, generate, on_bench
from ultraquiet.deploy.toolchain.cortex_m.processors import CORTEX_M
from ultraquiet.deploy.toolchain.targets import TARGETS, missing_program
from ultraquiet.deploy.verification.verify import compare, measurements
from ultraquiet.simulate import attenuation
from ultraquiet.values import Controller

QUIET_DB = 10.0  # a law that does less has not closed the loop


@pytest.fixture(autouse=True)
def target():
    absent = missing_program()
    if absent is not None:
        pytest.skip(f"'{absent}' is not installed (Debian: gcc-arm-none-eabi, qemu-system-arm)")


def isolating_law(plant):
    """A law for the bench whose design takes no time: three tones."""
    result = uq.design.Resonators(tones_hz=(25.0,)).design(plant)
    assert result.controller is not None, result.status
    return result.controller


@pytest.mark.slow
@pytest.mark.usefixtures("cc")
@pytest.mark.parametrize("name", TARGETS)
def test_attenuation_through_the_binary_is_that_of_the_code_here(seed, tmp_path, name):
    """Two seconds of the bench a run; every sample of every record is the same number."""
    bench = uq.bench.Hexapod(unit="ground", seed=seed)
    law = isolating_law(bench.linear_model())
    made = generate(law, tmp_path / "code")
    began = time.perf_counter()
    with Processor(made, target=name) as processor:
        assert isinstance(processor, Controller)
        assert processor.rate_hz == bench.rate_hz
        emulated = attenuation(replace(bench), processor, tones_hz=(25,))
        took = time.perf_counter() - began
        output, update = processor.instructions
    host = attenuation(replace(bench), made.instance(), tones_hz=(25,))
    print(f"{name}: {emulated.worst_reduction_db} dB at 25 Hz; 2 s of closed loop in {took:.1f} s")
    print(f"{np.unique(output + update)} instructions a step over {output.size} steps")
    for one, other in zip(emulated.closed, host.closed, strict=True):
        assert np.array_equal(one.outputs, other.outputs)
        assert np.array_equal(one.inputs, other.inputs)
    assert np.array_equal(emulated.reduction_db, host.reduction_db)
    assert emulated.worst_reduction_db.min() > QUIET_DB
    assert output.size == emulated.closed[0].samples
    assert took < 60


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_ramp_limits_and_faults_reach_the_bench_as_they_are(law_of, seed, tmp_path, precision):
    made = generate(law_of(8, 3, 5), tmp_path / "code", precision, ramp_s=0.05)
    y = measurements(made.plan, 1500, seed)
    with Processor(made, ramp=True) as processor:
        first = processor.run(y)
        processor.reset()
        again = processor.run(y)
    twin = uq.deploy.Twin(made.law)
    twin.enable()
    assert compare(first, twin.run(y)) == (0, None)
    assert compare(first, again) == (0, None)


def test_disable_ramps_out(law_of, rng, tmp_path):
    made = generate(law_of(4), tmp_path / "code", ramp_s=0.01)
    y = 1e-3 * rng.standard_normal((6, 80))
    with Processor(made, target="cortex-m4f") as processor:
        assert np.any(processor.run(y[:, :20]))
        processor.disable()
        u = processor.run(y)
    assert np.any(u[:, :30])
    assert not np.any(u[:, 36:])


def test_bench_of_code_and_processor_agree(seed, law_of, tmp_path):
    """`on_bench` takes the processor as it takes the code."""
    bench = uq.bench.Hexapod(unit="ground", seed=seed)
    law = law_of(6)
    small = uq.StateSpace(law.A, law.B, 0.01 * law.C, 0.01 * law.D, rate_hz=law.rate_hz)
    made = generate(small, tmp_path / "code")
    with Processor(made) as processor:
        emulated = on_bench(bench, small, processor, tones_hz=(25.0,), duration_s=0.5)
    here = on_bench(bench, small, made.instance(), tones_hz=(25.0,), duration_s=0.5)
    assert np.array_equal(emulated.code_db, here.code_db)


def test_a_killed_emulator_is_a_sentence(law_of, tmp_path):
    processor = Processor(generate(law_of(2), tmp_path / "code", ramp_s=0.01))
    processor.step(np.zeros(6))
    assert processor._process is not None
    os.kill(processor._process.pid, signal.SIGKILL)
    processor._process.wait()
    with pytest.raises(ToolError, match="emulated Cortex-M7 ended after 1 steps"):
        processor.step(np.zeros(6))
    processor.close()


def test_a_silent_emulator_is_given_up(law_of, tmp_path):
    processor = Processor(generate(law_of(2), tmp_path / "code", ramp_s=0.01), timeout_s=0.5)
    assert processor._process is not None
    os.kill(processor._process.pid, signal.SIGSTOP)
    os.waitpid(processor._process.pid, os.WUNTRACED)  # every thread has stopped
    with pytest.raises(ToolError, match=r"did not answer for 0.5 s"):
        processor.step(np.zeros(6))
    os.kill(processor._process.pid, signal.SIGCONT)
    processor.close()


def test_an_emulator_that_does_not_start_says_why(law_of, tmp_path, monkeypatch):
    made = generate(law_of(2), tmp_path / "code", ramp_s=0.01)
    tools = tmp_path / "tools"
    tools.mkdir()
    (tools / CORTEX_M.emulator).write_text("#!/bin/sh\necho no such machine >&2; exit 1\n")
    (tools / CORTEX_M.emulator).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tools}{os.pathsep}{os.environ['PATH']}")
    with pytest.raises(ToolError, match="ended after 0 steps, saying 'no such machine'"):
        Processor(made)


def test_close_leaves_no_process_and_no_file(law_of, tmp_path):
    processor = Processor(generate(law_of(2), tmp_path / "code", ramp_s=0.01))
    assert processor._process is not None
    pid, work = processor._process.pid, Path(processor._work.name)
    processor.close()
    processor.close()
    assert not work.exists()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    with pytest.raises(ToolError, match="was closed; make a new Processor"):
        processor.step(np.zeros(6))


def test_bad_settings_are_refused(law_of, tmp_path, monkeypatch):
    made = generate(law_of(2), tmp_path / "code", ramp_s=0.01)
    with pytest.raises(InputError, match=f"'target' must be one of {', '.join(map(repr, TARGETS))}, got 'z80'"):
        Processor(made, target="z80")
    with pytest.raises(InputError, match="'timeout_s' must be above zero"):
        Processor(made, timeout_s=0)
    with Processor(made) as processor, pytest.raises(InputError, match=r"measurements must be \(6, n\), got \(2, 5\)"):
        processor.run(np.zeros((2, 5)))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ToolError, match="'arm-none-eabi-gcc' is not installed"):
        Processor(made)
