"""What is told while a list runs, how it is stopped, which pauses are waited for, and what a plan costs to check."""

import sys
import time

import numpy as np
import pytest
from fakes import LIST, Fake

from ultraquiet import experiments
from ultraquiet.bench import Block, Hexapod, Process, Replay, Wrapped
from ultraquiet.experiments import clock, journal
from ultraquiet.values import Record


class Notes(experiments.Onlooker):
    """Keeps everything it is told."""

    def __init__(self):
        self.told = []

    def begins(self, steps, finished, course):
        self.course = course
        self.told.append(("begins", len(steps), len(finished)))

    def measures(self, step, levels):
        self.told.append(("measures", step.name))

    def advances(self, step, levels):
        self.levels = levels
        self.left_s = self.course.left_s

    def ends(self, step, levels, status, warnings):
        self.told.append(("ends", step.name, status, levels.samples))

    def waits(self, seconds, skipped):
        self.told.append(("waits", seconds, skipped))


class Simulated(Fake):
    real_time = False


def test_everything_is_told_in_order(tmp_path):
    notes = Notes()
    experiments.run(experiments.parse(LIST, Simulated()), tmp_path, onlooker=notes)
    assert notes.told == [
        ("begins", 4, 0),
        *(entry for k in (1, 2) for entry in (("measures", f"chirp-{k}"), ("ends", f"chirp-{k}", "DONE", 256))),
        ("waits", 2.5, True),
        ("measures", "tone"),
        ("ends", "tone", "DONE", 100),
        ("measures", "quiet"),
        ("ends", "quiet", "DONE", 256),
    ]
    assert notes.left_s == 0.0


def test_levels_are_those_of_the_record(tmp_path):
    notes = Notes()
    text = '[bench]\nmethod = "hexapod"\n[[commands]]\ndo = "excite"\nname = "loud"\nactuator = 2\nsamples = 1000\n'
    text += 'signal = { method = "tone", frequency_hz = 60.0, amplitude_v = 25.0 }\n'
    (record,) = experiments.run(experiments.parse(text), tmp_path, onlooker=notes).values()
    levels = notes.levels
    assert levels.samples == 1000
    assert np.allclose(levels.rms, np.sqrt(np.mean(record.outputs**2, axis=1)), rtol=1e-12)
    assert np.array_equal(levels.peak, np.abs(record.outputs).max(axis=1))
    assert np.allclose(levels.share, levels.peak / 10.0)
    assert tuple(levels.clipped) == record.clipped()
    told = list(levels.warnings(excited=True))
    assert told == [f"readings clipped: strut 2 in {record.clipped()[1]} of 1000 samples"]


def test_warnings_of_a_bench_with_a_bad_day():
    channels = experiments.parse(LIST, Fake()).bench.actuators
    levels = experiments.Levels(channels, channels)
    levels.take(Block(np.zeros((2, 4)), np.full((2, 4), 0.2), np.array([0, 3]), np.array([0, 0]), overruns=2))
    stacks = {"limited_stacks": np.array([0, 3]), "limited_proof_masses": np.array([0])}
    levels.take(Block(np.zeros((2, 4)), np.full((2, 4), -0.1), np.array([1, 0]), np.array([0, 0]), 1, stacks))
    told = list(levels.warnings(excited=True))
    assert told == [
        "commands met their limits: a in 1, b in 3 of 8 samples",
        "stacks met their limits: 2 in 3 of 8 samples",
        "3 frames came too late",
        "the level is low: the loudest reading, 'a', uses 0.8 % of its range",
    ]
    assert len(list(levels.warnings(excited=False))) == 3


def test_a_stop_between_measurements_leaves_the_rest_for_later(tmp_path):
    """A bench that does not stream ends what it has begun."""
    bench = Simulated()
    listed = experiments.parse(LIST, bench)
    with pytest.raises(experiments.StoppedError, match="stopped as asked before 'tone'; 2 done, 0 aborted, 2 not") as e:
        experiments.run(listed, tmp_path, stop=lambda: len(bench.calls) >= 2)
    assert [s.status for s in e.value.states] == ["DONE", "DONE", "NOT STARTED", "NOT STARTED"]
    assert e.value.asked
    assert experiments.states(listed.measurements, tmp_path) == e.value.states
    assert len(experiments.run(listed, tmp_path, resume=True)) == len(bench.calls) == 4
    assert [e["event"] for e in journal.entries(tmp_path)].count("begun") == 4


class Tired(Hexapod):
    """Ends every run after its first block."""

    def stream(self, *args, **kwargs):
        stream = super().stream(*args, **kwargs)
        yield next(stream)
        stream.close()


def test_a_bench_that_ends_by_itself_ends_the_list(tmp_path):
    text = "".join(f'[[commands]]\ndo = "record"\nname = "{n}"\nsamples = 500\n' for n in "ab")
    listed = experiments.parse(text, Tired())
    with pytest.raises(experiments.StoppedError, match="the bench ended 'a' after 175 of 500 samples") as caught:
        experiments.run(listed, tmp_path)
    assert not caught.value.asked
    assert [(s.status, s.file) for s in caught.value.states] == [("ABORTED", "a.partial.h5"), ("NOT STARTED", "")]


def test_pauses_are_waited_for_in_real_time_only(tmp_path, monkeypatch):
    slept = []
    monkeypatch.setattr(clock, "rest", lambda seconds, stop: slept.append(seconds))
    for bench, expected in ((Simulated(), []), (Fake(), [2.5])):
        slept.clear()
        experiments.run(experiments.parse(LIST, bench), tmp_path / type(bench).__name__)
        assert slept == expected
    computed = (Hexapod(), Replay((Record([[0.0]], [[0.0]], 1.0),)), Wrapped(max, max, 1.0, ["u"], ["y"]))
    assert not any(map(experiments.real_time, computed))
    assert experiments.real_time(Process((sys.executable,)))


def test_a_pause_ends_when_it_is_asked_to():
    begun = time.monotonic()
    clock.rest(0.25, lambda: False)
    whole = time.monotonic() - begun
    clock.rest(3600.0, lambda: time.monotonic() - begun > 0.4)
    print(
        f"a pause of 0.25 s took {whole:.3f} s, one of 3600 s was ended after {time.monotonic() - begun - whole:.2f} s"
    )
    assert whole >= 0.25
    assert time.monotonic() - begun < 30


def test_a_wrong_list_does_not_start_the_program_of_its_bench(tmp_path):
    plant = f"import pathlib; pathlib.Path({str(tmp_path / 'started')!r}).touch()"
    bench = f'[bench]\nmethod = "process"\ncommand = {[sys.executable, "-c", plant]!r}\n'
    with pytest.raises(experiments.ListError, match="line 5: there is no command 'jump'"):
        experiments.parse(bench + '[[commands]]\ndo = "jump"\n')
    assert not (tmp_path / "started").exists()
    with pytest.raises(experiments.ListError, match="line 1: Process is no bench that can be used here"):
        experiments.parse(bench + '[[commands]]\ndo = "record"\nname = "x"\n')
    assert (tmp_path / "started").exists()
