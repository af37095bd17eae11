"""Lists do what they say, in order; records are kept, never written over, and no excitation is repeated unasked."""

import numpy as np
import pytest
from fakes import LIST, Fake, run

import ultraquiet as uq
from ultraquiet import experiments, files
from ultraquiet._base import progress
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.signals import Chirp, Tone
from ultraquiet.values import StateSpace


@pytest.fixture
def bench():
    return Fake()


def test_commands_in_order_and_records_that_reopen(bench, tmp_path):
    slept = []
    listed = experiments.parse(LIST, bench)
    records = experiments.run(listed, tmp_path / "out", sleep=slept.append)
    assert list(records) == ["chirp-1", "chirp-2", "tone", "quiet"]
    assert listed.groups == {"chirp": ("chirp-1", "chirp-2"), "tone": ("tone",), "quiet": ("quiet",)}
    assert slept == [2.5]
    assert listed.duration_s == pytest.approx((3 * 256 + 100) / 1000 + 2.5)
    sweep = Chirp(start_hz=5.0, stop_hz=100.0).at(2.5).generate(256, 1000.0)
    assert np.array_equal(bench.calls[0][0], [sweep, 0 * sweep])
    assert np.array_equal(bench.calls[1][0], [0 * sweep, sweep])
    tone = Tone(frequency_hz=60.0, amplitude_v=10.0).generate(100, 1000.0)
    assert np.array_equal(records["tone"].inputs, [0 * tone, tone])
    assert not bench.calls[3][0].any()
    assert all(d is None and c is None for _, d, c in bench.calls)
    for name, record in records.items():
        again = files.read_record(tmp_path / "out" / f"{name}.h5")
        assert again.hash == record.hash
        assert again.sensors == bench.sensors
        made = again.provenance.settings
        assert made["measurement"]["name"] == name
        assert made["list"] == "three chirps, a tone and silence"
        assert again.provenance.parents == (listed.hash,)


def test_controller_and_disturbance_come_and_go(bench, tmp_path, rng):
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((2, 0)), rng.standard_normal((2, 3)), 1000.0)
    files.save(law, tmp_path / "law.h5")
    text = """
[[commands]]
do = "record"
name = "open"
[[commands]]
do = "controller-on"
file = "law.h5"
[[commands]]
do = "disturbance-on"
actuator = 1
signal = { method = "tone", frequency_hz = 25.0, amplitude_v = 1.0 }
[[commands]]
do = "record"
name = "closed"
[[commands]]
do = "controller-off"
[[commands]]
do = "record"
name = "disturbed"
[[commands]]
do = "disturbance-off"
[[commands]]
do = "record"
name = "end"
"""
    records = run(text, tmp_path, bench)
    disturbed = [d is not None for _, d, _ in bench.calls]
    closed = [c is not None for _, _, c in bench.calls]
    assert disturbed == [False, True, True, False]
    assert closed == [False, True, False, False]
    assert bench.calls[1][2].hash == law.hash
    assert not bench.calls[1][1][1].any()
    assert bench.calls[1][1][0].max() == pytest.approx(1.0, abs=0.01)
    assert records["closed"].provenance.settings["measurement"]["controller_hash"] == law.hash


def test_repeat_numbers_its_rounds_and_knows_them(bench, tmp_path):
    text = """
[[commands]]
do = "set"
level = 3
[[commands]]
do = "repeat"
times = 2
[[commands.commands]]
do = "repeat"
times = 2
[[commands.commands.commands]]
do = "excite"
name = "s"
actuator = 1
samples = 200
signal = { method = "step", level_v = "$round", rise_s = 0.0, fall_s = 0.1 }
[[commands]]
do = "excite"
name = "last"
actuator = [1, 2]
samples = 200
signal = { method = "step", level_v = "$level", rise_s = 0.0, fall_s = 0.1 }
"""
    records = run(text, tmp_path, bench)
    assert list(records) == ["s-r1-r1", "s-r1-r2", "s-r2-r1", "s-r2-r2", "last"]
    assert [r.inputs[0, 0] for r in records.values()] == [1.0, 2.0, 1.0, 2.0, 3.0]
    assert records["last"].inputs[1, 0] == 3.0


STEP = 'do = "excite"\nactuator = 1\nsamples = 200\n' + (
    'signal = { method = "step", level_v = "$round", rise_s = 0.0, fall_s = 0.1 }\n'
)


def test_after_an_inner_repeat_the_round_is_the_outer_one_again(bench, tmp_path):
    text = f"""
[[commands]]
do = "repeat"
times = 2
[[commands.commands]]
name = "before"
{STEP}
[[commands.commands]]
do = "repeat"
times = 3
[[commands.commands.commands]]
name = "inside"
{STEP}
[[commands.commands]]
name = "after"
{STEP}
"""
    sent = {name: record.inputs[0, 0] for name, record in run(text, tmp_path, bench).items()}
    assert {name: level for name, level in sent.items() if "inside" not in name} == {
        "before-r1": 1.0, "after-r1": 1.0, "before-r2": 2.0, "after-r2": 2.0,
    }  # fmt: skip
    assert [level for name, level in sent.items() if "inside" in name] == [1.0, 2.0, 3.0] * 2


def test_outside_every_repeat_the_round_is_what_was_set_or_nothing(bench, tmp_path):
    inner = f'[[commands]]\ndo = "repeat"\ntimes = 3\n[[commands.commands]]\nname = "inside"\n{STEP}'
    after = f'[[commands]]\nname = "after"\n{STEP}'
    records = run(f'[[commands]]\ndo = "set"\nround = 5\n{inner}{after}', tmp_path / "set", bench)
    assert records["after"].inputs[0, 0] == 5.0
    with pytest.raises(experiments.ListError, match="there is no variable 'round' here"):
        experiments.parse(inner + after, bench)


def test_a_refused_repeat_does_not_refuse_the_round_inside(bench):
    text = f'[[commands]]\ndo = "repeat"\ntimes = 0\n[[commands.commands]]\nname = "inside"\n{STEP}'
    with pytest.raises(experiments.ListError) as caught:
        experiments.parse(text, bench)
    assert [sentence for _, sentence in caught.value.mistakes] == [
        "'times' should be greater than or equal to 1, got 0."
    ]


def test_random_signals_are_independent_and_repeatable(bench, tmp_path, seed):
    noise = 'signal = { method = "noise", stop_hz = 250.0 }'
    text = f"""
seed = {seed}
[[commands]]
do = "excite"
name = "each"
{noise}
[[commands]]
do = "excite"
name = "all"
actuator = "all"
{noise}
[[commands]]
do = "excite"
name = "own"
actuator = 1
seed = 7
{noise}
[[commands]]
do = "excite"
name = "same"
actuator = 1
seed = 7
{noise}
"""
    records = run(text, tmp_path / "a", bench)
    rows = [records["each-1"].inputs[0], records["each-2"].inputs[1], *records["all"].inputs, records["own"].inputs[0]]
    # 250 of 500 Hz are filled, so 4096 samples hold about 2048 independent ones: sigma 0.022, five of them 0.11.
    correlation = np.abs(np.corrcoef(rows) - np.eye(len(rows))).max()
    print(f"largest correlation between actuators and measurements: {correlation:.3f}")
    assert correlation < 0.15
    assert np.array_equal(records["own"].inputs, records["same"].inputs)
    again = run(text, tmp_path / "b", bench)
    assert all(again[name].hash == record.hash for name, record in records.items())


def test_progress_is_told(bench, tmp_path):
    told = []

    class Listener:
        def start(self, title, total):
            told.append((title, total))
            return 0

        def advance(self, key, steps, note):
            told.append(note)

        def finish(self, key):
            told.append("done")

    with progress.listening(Listener()):
        run(LIST, tmp_path, bench)
    assert told == [("three chirps, a tone and silence", 4), "chirp-1", "chirp-2", "tone", "quiet", "done"]


def test_nothing_is_written_over_unasked(bench, tmp_path):
    (tmp_path / "tone.h5").write_bytes(b"precious")
    with pytest.raises(StorageError, match="holds 1 of the records already \\(tone\\)"):
        run(LIST, tmp_path, bench)
    assert not bench.calls
    with pytest.raises(StorageError, match="not an HDF5 file"):
        run(LIST, tmp_path, bench, resume=True)
    assert (tmp_path / "tone.h5").read_bytes() == b"precious"
    assert not bench.calls
    run(LIST, tmp_path, bench, overwrite=True)
    assert files.read_record(tmp_path / "tone.h5").samples == 100


def test_resume_measures_only_what_is_missing(bench, tmp_path):
    records = run(LIST, tmp_path, bench)
    assert len(bench.calls) == 4
    again = run(LIST, tmp_path, bench, resume=True)
    assert len(bench.calls) == 4
    assert {n: r.hash for n, r in again.items()} == {n: r.hash for n, r in records.items()}
    more = LIST + '[[commands]]\ndo = "record"\nname = "more"\n'
    assert list(run(more, tmp_path, bench, resume=True)) == [*records, "more"]
    assert len(bench.calls) == 5


def test_resume_refuses_records_of_another_list(bench, tmp_path):
    run(LIST, tmp_path, bench)
    changed = LIST.replace("60.0", "61.0")
    with pytest.raises(InputError, match=r"was not made by 'tone' as the list has it now \(line 12\)"):
        run(changed, tmp_path, bench, resume=True)
    assert len(bench.calls) == 4


def test_resume_says_what_to_do_with_a_damaged_record(bench, tmp_path):
    run(LIST, tmp_path, bench)
    with (tmp_path / "tone.h5").open("ab") as file:
        file.write(b"z")
    with pytest.raises(StorageError, match=r"experiment: .*tone\.h5' was cut short, .*; move it away or choose"):
        run(LIST, tmp_path, bench, resume=True)
    assert len(bench.calls) == 4


def test_what_was_begun_is_not_repeated_unasked(bench, tmp_path):
    def broken(*args, **kwargs):
        raise RuntimeError("cable")

    whole, bench.run = bench.run, broken
    with pytest.raises(RuntimeError):
        run(LIST, tmp_path, bench)
    bench.run = whole
    for resume in (False, True):
        with pytest.raises(StorageError, match=r"chirp-1 in .* was begun before and left no record"):
            run(LIST, tmp_path, bench, resume=resume)
    assert not bench.calls
    with pytest.raises(InputError, match="no measurement 'chirp-9' to repeat"):
        run(LIST, tmp_path, bench, resume=True, repeat=["chirp-9"])
    run(LIST, tmp_path, bench, resume=True, repeat=["chirp-1"])
    assert len(bench.calls) == 4


def test_a_lost_record_is_not_measured_again_unasked(bench, tmp_path):
    run(LIST, tmp_path, bench)
    (tmp_path / "tone.h5").unlink()
    with pytest.raises(StorageError, match=r"tone in .* was begun before and left no record"):
        run(LIST, tmp_path, bench, resume=True)
    assert len(bench.calls) == 4


def test_the_suite_list(tmp_path):
    listed = uq.experiments.load("suite")
    paper = {"chirp": 6, "noise": 6, "prbs": 6, "step": 1, "tone": 1, "broadband": 1}
    assert paper.items() <= {name: len(records) for name, records in listed.groups.items()}.items()
    records = uq.experiments.run(listed, tmp_path)
    assert all(records[name].samples == 4096 for group in paper for name in listed.groups[group])
    assert all(r.rate_hz == 3500.0 and len(r.sensors) == 6 for r in records.values())
    assert all(np.abs(r.inputs).max() <= 25.0 for r in records.values())
    excited = [np.flatnonzero(records[f"chirp-{k + 1}"].inputs.any(axis=1)).tolist() for k in range(6)]
    assert excited == [[k] for k in range(6)]
    assert np.abs(np.corrcoef(records["broadband"].inputs) - np.eye(6)).max() < 0.25
    assert sum(records["tone"].clipped()) > 0
    print(f"suite: {len(records)} records, {listed.duration_s:.1f} s on the bench")


def test_the_bench_numbers_its_noise_by_the_list(tmp_path):
    text = '[bench]\nmethod = "hexapod"\n' + "".join(
        f'[[commands]]\ndo = "record"\nname = "{n}"\nsamples = 500\n' for n in "ab"
    )
    records = experiments.run(experiments.parse(text), tmp_path)
    (tmp_path / "b.h5").unlink()
    resumed = experiments.run(experiments.parse(text), tmp_path, resume=True, repeat=["b"])
    assert resumed["b"].hash == records["b"].hash != records["a"].hash
