"""What is refused, in which words, and that nothing is left behind."""

import sys

import numpy as np
import pytest
from deploy_laws import RANGES, RATE_HZ

from ultraquiet._base.errors import InputError, NumericalError, StorageError
from ultraquiet.deploy import Frame, Processor, c31_code, generate, generate_fixed, word_lengths
from ultraquiet.values import StateSpace


def gain(value=1.0, rate_hz=RATE_HZ):
    return StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[value]], rate_hz=rate_hz)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"precision": "float16"}, r"'precision' must be one of 'float32', 'float64', got 'float16'"),
        (
            {"form": "companion"},
            r"'form' must be one of 'auto', 'modal', 'delta', 'bank', 'bank-delta'",
        ),
        ({"name": "my controller"}, r"must be a C identifier .* got 'my controller'"),
        ({"limits_v": [1.0, 2.0, 3.0]}, r"'limits_v' must be one number, \(1,\) or \(1, 2\)"),
        ({"limits_v": [[5.0, 10.0]]}, r"each actuator's range in 'limits_v' must hold 0,"),
        ({"limits_v": -1.0}, r"each actuator's range in 'limits_v' must hold 0,"),
        ({"limits_v": np.nan}, r"NaN or infinite"),
        ({"limits_v": "all"}, r"'limits_v' must be numbers in the unit of the commands"),
        ({"limits_v": 1e-60}, r"in float32 an actuator's range in 'limits_v' is empty"),
        ({"targets": 3}, r"'targets' must list 'c99'"),
        ({"plant": 3}, r"'plant' must be a StateSpace, got int"),
        ({"ramp_s": 0.0}, r"'ramp_s' must be above zero s"),
        ({"ramp_s": 1e-5}, r"'ramp_s in samples' must be between 1 and"),
        ({"tolerance": 2.0}, r"'tolerance' must lie between 0 and 1"),
        ({"enforce_budget": True, "budget_cycles": 0}, r"'budget_cycles' must be at least 1"),
    ],
)
def test_bad_settings(tmp_path, settings, sentence):
    with pytest.raises(InputError, match=sentence):
        generate(gain(), tmp_path / "code", **settings)
    assert not list(tmp_path.iterdir())


def test_continuous_law(tmp_path):
    with pytest.raises(InputError, match="continuous time; discretise it"):
        generate(gain(rate_hz=None), tmp_path / "code")


def test_something_else_than_a_law(tmp_path):
    with pytest.raises(InputError, match="must be a StateSpace, got list"):
        generate([[1.0]], tmp_path / "code")


def test_coefficient_beyond_the_precision(tmp_path):
    with pytest.raises(InputError, match=r"a coefficient of 1.0e\+39 is beyond float32"):
        generate(gain(1e39), tmp_path / "code")
    assert generate(gain(1e39), tmp_path / "code", "float64").law.D[0, 0] == 1e39


def test_plant_at_another_rate(tmp_path):
    with pytest.raises(InputError, match="sampled at 3500 Hz but the plant is sampled at 1000 Hz"):
        generate(gain(), tmp_path / "code", plant=gain(rate_hz=1000.0))


def test_plant_that_closes_no_loop(tmp_path):
    with pytest.raises(InputError, match="ill-posed"):
        generate(gain(), tmp_path / "code", plant=gain())
    wide = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[1.0, 1.0]], rate_hz=RATE_HZ)
    with pytest.raises(InputError, match=r"a plant \(1, 2\) does not close a loop with a controller \(1, 1\)"):
        generate(gain(), tmp_path / "code", plant=wide)


def test_foreign_folder_is_not_replaced(tmp_path):
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "thesis.tex").write_text("years of work")
    with pytest.raises(StorageError, match="holds something this program did not write"):
        generate(gain(), tmp_path / "code")
    assert (tmp_path / "code" / "thesis.tex").read_text() == "years of work"


@pytest.mark.parametrize("manifest", ["[]", "{}", "not json", '{"writer": "another"}'])
def test_folder_with_another_manifest_is_not_replaced(tmp_path, manifest):
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "manifest.json").write_text(manifest)
    with pytest.raises(StorageError, match="holds something"):
        generate(gain(), tmp_path / "code")


def test_own_folder_is_replaced_whole(tmp_path):
    generate(gain(), tmp_path / "code", name="first")
    generate(gain(), tmp_path / "code", name="second")
    names = {p.name for p in (tmp_path / "code").iterdir()}
    assert "second.c" in names
    assert "first.c" not in names
    assert [p.name for p in tmp_path.iterdir()] == ["code"]


def test_unwritable_place(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot write beside"):
        generate(gain(), tmp_path / "file" / "code")
    with pytest.raises(StorageError, match="holds something"):
        generate(gain(), tmp_path / "file")


def test_half_written_folder_never_appears(tmp_path, monkeypatch):
    generate(gain(), tmp_path / "code", name="first")
    from pathlib import Path

    write = Path.write_text
    calls = []

    def full(self, *args, **kwargs):
        calls.append(self)
        if len(calls) > 12:  # the measured object's files come first
            raise OSError(28, "No space left on device")
        return write(self, *args, **kwargs)

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(StorageError, match="No space left on device"):
        generate(gain(), tmp_path / "code", name="second")
    monkeypatch.undo()
    assert (tmp_path / "code" / "first.c").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["code"]


def test_without_a_compiler_a_sentence_and_the_twin(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    made = generate(gain(0.5), tmp_path / "code")
    found = made.verify(steps=10)
    print(found.status)
    assert found.status.word == "no compiler"
    assert found.bit_exact is None
    assert made.tables["bit_exact"] is None
    assert made.tables["flash_from"] == "constants alone, no compiler"
    assert made.controller.step(np.array([2.0])) == pytest.approx([1.0])
    ramped = made.instance(ramp=True)
    assert ramped.step(np.array([2.0]))[0] == pytest.approx(1.0 / 1750)


@pytest.mark.parametrize("signal", ["INT", "TERM", "HUP"])
def test_a_compiler_that_is_ended_with_everything_else_says_nothing_of_the_code(signal, tmp_path, monkeypatch):
    """Ctrl-C reaches whatever the terminal runs: a study kept "not compiled" of a law as it ended."""
    compiler, number = tmp_path / "cc", f"signal.SIG{signal}"
    ended = f"signal.signal({number}, signal.SIG_DFL)\nos.kill(os.getpid(), {number})"  # under nohup HUP is ignored
    compiler.write_text(f"#!{sys.executable}\nimport os, signal\n{ended}\n")
    compiler.chmod(0o755)
    made = generate(gain(0.5), tmp_path / "code")
    monkeypatch.setenv("CC", str(compiler))
    with pytest.raises(KeyboardInterrupt):
        made.verify(steps=10)


def damped():
    return StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"name": "../elsewhere"}, r"must be a C identifier"),
        ({"plant": 3}, r"'plant' must be a StateSpace, got int"),
        ({"word": "q7"}, r"'word' must be one of 'q15', 'q31'"),
        ({"word": "q15", "ramp_s": 10.0}, r"'ramp_s' may be 4.68 s in q15 at this rate, got 10 s"),
        ({"ramp_s": 1e9}, r"'ramp_s' may be 74.9 s in q31"),
    ],
)
def test_bad_settings_of_whole_numbers(tmp_path, settings, sentence):
    with pytest.raises(InputError, match=sentence):
        generate_fixed(damped(), tmp_path / "code", **RANGES, **settings)
    assert not list(tmp_path.iterdir())


def test_whole_numbers_need_a_discrete_law_with_channels(tmp_path):
    deaf = StateSpace([[0.5]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0)), rate_hz=RATE_HZ)
    for law, sentence in [(gain(rate_hz=None), "continuous time"), (deaf, "needs measurements"), (None, "NoneType")]:
        with pytest.raises(InputError, match=sentence):
            generate_fixed(law, tmp_path / "code")


def test_a_loop_that_is_unstable_as_designed_is_refused(tmp_path):
    plant = StateSpace([[1.1]], [[1.0]], [[1.0]], [[0.0]], rate_hz=RATE_HZ)
    for make, ranges in ((generate, {}), (generate_fixed, RANGES)):
        with pytest.raises(NumericalError, match=r"unstable, as designed already: its largest pole is 1\."):
            make(damped(), tmp_path / "code", plant=plant, **ranges)
    assert not list(tmp_path.iterdir())


def test_what_needs_a_deployment_in_floating_point(tmp_path):
    whole = generate_fixed(damped(), tmp_path / "whole", **RANGES)
    made = generate(damped(), tmp_path / "code")
    calls = [
        lambda: Frame().simulate(whole, 10),
        lambda: Frame().controller(whole),
        lambda: Processor(whole),
        lambda: c31_code(damped()),
        lambda: made.bank(3),
        lambda: made.verify(10, -1),
        lambda: whole.verify(10, -1),
        lambda: Frame().simulate(made, 10, seed=-1),
        lambda: Frame(overloads=3),
        lambda: word_lengths(damped(), precisions=3),
    ]
    for call in calls:
        with pytest.raises(InputError):
            call()
