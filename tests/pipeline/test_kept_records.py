"""Records that were measured stay: taken up when nothing changed, refused or set aside when something did."""

import re
import sys
from functools import partial

import numpy as np
import pytest
from small_study import TwoMasses

import ultraquiet as uq
from ultraquiet import experiments, pipeline
from ultraquiet._base.provenance import content_hash
from ultraquiet.bench import Process, Wrapped
from ultraquiet.pipeline.store.identity import identity
from ultraquiet.pipeline.store.recorded import Records, finished_names
from ultraquiet.pipeline.walk import bench_key_of, bench_of, bench_table, described, measure, with_read_matrices

LIST = """
[[commands]]
do = "excite"
name = "push"
signal = { method = "chirp", start_hz = 5.0, stop_hz = 40.0 }
samples = 300
actuator = 1
"""
MORE = LIST + LIST.replace("push", "pull")
PLANT = """
import sys
for line in sys.stdin:
    word, *rest = line.split()
    if word == "hello":
        print("ultraquiet-plant 1\\nrate 100\\nactuator N -50 50 force\\nsensor m/s -inf inf speed\\nready")
    elif word == "step":
        open(sys.argv[1], "a").write("x")
        print("y", 2 * (float(rest[0]) + float(rest[1])))
    else:
        print("ok")
    sys.stdout.flush()
"""


def take(folder, bench, text=LIST, again=False, say=print, table=None):
    """What a study does about its records."""
    folder.mkdir(exist_ok=True)
    describe = partial(identity, bench, table or {})
    records = Records(experiments.parse(text, bench), bench, describe, folder, say)
    records.claim(again)
    return records.take()


def state(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture
def process(tmp_path):
    """Makes the same process bench again and again, as each run of a study does; it notes how often it is stepped."""
    program, steps = tmp_path / "plant.py", tmp_path / "steps"
    program.write_text(PLANT)
    return lambda **more: Process((sys.executable, str(program), str(tmp_path / "steps")), **more), program, steps


def test_records_of_a_process_are_taken_up_by_the_next_run(process, tmp_path):
    bench, _, steps = process
    first = take(tmp_path / "out", bench())["push"]
    before, stepped = state(tmp_path / "out"), len(steps.read_text())
    # The plant's diary, named in its command, is no part of what it is; its program is.
    assert b'"steps"' in before["records/list.key"]
    assert before["records/list.key"].count(b"sha256") == 2
    with steps.open("a") as diary:
        diary.write("x")
    # How long an answer may take decides no number.
    for again in (bench(), bench(timeout_s=33.0)):
        assert take(tmp_path / "out", again)["push"].hash == first.hash
        again.close()
    assert len(steps.read_text()) == stepped + 1 == 301
    assert state(tmp_path / "out") == before


def test_a_plant_whose_program_was_changed_is_another_bench(process, tmp_path):
    bench, program, _ = process
    take(tmp_path / "out", bench())
    before = state(tmp_path / "out")
    program.write_text(PLANT.replace("2 *", "3 *"))
    with pytest.raises(uq.errors.StorageError, match=r"'command': plant.py has another content.*--record-again"):
        take(tmp_path / "out", bench())
    assert state(tmp_path / "out") == before


def test_a_changed_bench_is_refused_by_name_and_nothing_is_touched(tmp_path):
    first = take(tmp_path, TwoMasses(noise=0.0))["push"]
    before, said = state(tmp_path), []
    other = TwoMasses(masses_kg=(2.5, 3.0), noise=0.0)
    with pytest.raises(uq.errors.StorageError, match=re.escape("'masses_kg' was [2.0, 3.0] and is [2.5, 3.0]")):
        take(tmp_path, other)
    assert state(tmp_path) == before
    assert take(tmp_path, TwoMasses(noise=0.0))["push"].hash == first.hash
    second = take(tmp_path, other, again=True, say=said.append)["push"]
    assert not np.array_equal(second.outputs, first.outputs)
    assert uq.files.load(tmp_path / "records.1" / "push.h5").hash == first.hash
    assert "records.1" in said[0]
    # Without the flag they are this bench's own now; with it, a second set stands aside.
    assert take(tmp_path, other)["push"].hash == second.hash
    take(tmp_path, other, again=True)
    assert {p.name for p in tmp_path.iterdir()} == {"records", "records.1", "records.2"}


def test_a_list_that_grows_keeps_what_was_measured_and_one_that_changes_is_refused(tmp_path):
    bench = TwoMasses()
    first = take(tmp_path, bench)["push"]
    assert take(tmp_path, bench, "# a remark decides nothing\n" + LIST)["push"].hash == first.hash
    both = take(tmp_path, bench, MORE)
    assert both["push"].hash == first.hash
    before = state(tmp_path)
    for text in (MORE.replace("300", "301", 1), LIST.replace("push", "pull")):
        with pytest.raises(uq.errors.StorageError, match=r"the list's 'pu(sh|ll)' is another measurement"):
            take(tmp_path, bench, text)
        assert state(tmp_path) == before
    # What the list has no more stays, and is taken up when it comes back.
    assert take(tmp_path, bench)["push"].hash == first.hash
    assert finished_names(tmp_path) == ["push"]
    assert take(tmp_path, bench, MORE)["pull"].hash == both["pull"].hash


def test_a_broken_off_run_takes_up_no_record_of_another_bench(tmp_path, monkeypatch):
    one, other = TwoMasses(), TwoMasses(masses_kg=(2.5, 3.0))
    first = take(tmp_path, one)["push"]

    def stopped(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(experiments, "run", stopped)
        with pytest.raises(KeyboardInterrupt):
            take(tmp_path, other, again=True)
    # The same words again find nothing finished, and set nothing aside a second time.
    again = take(tmp_path, other, again=True)["push"]
    assert not np.array_equal(again.outputs, first.outputs)
    assert {p.name for p in tmp_path.iterdir()} == {"records", "records.1"}


@pytest.mark.parametrize("repeats", [True, False], ids=["repeats itself", "drifts"])
def test_what_is_left_of_a_broken_off_record_goes_only_where_it_says_nothing_more(repeats, tmp_path):
    runs, steps = [], []

    def step(u, d):
        steps.append(1)
        if len(steps) == 200:
            raise KeyboardInterrupt
        return u * (1 if repeats else len(runs))

    bench = Wrapped(step, lambda: runs.append(1), 100.0, ["force"], ["speed"])
    with pytest.raises(KeyboardInterrupt):
        take(tmp_path, bench)
    record, part = take(tmp_path, bench)["push"], tmp_path / "records" / "push.partial.h5"
    assert record.samples == 300
    assert part.exists() != repeats
    if not repeats:
        assert np.array_equal(2 * uq.files.load(part).outputs, record.outputs[:, :199])


def test_records_that_no_study_left_are_not_touched(tmp_path):
    bench = TwoMasses()
    experiments.run(experiments.parse(LIST, bench), tmp_path / "records", bench)
    before = state(tmp_path)
    for again in (False, True):
        with pytest.raises(uq.errors.StorageError, match="no study left"):
            take(tmp_path, bench, again=again)
    assert state(tmp_path) == before


def test_records_of_the_version_before_are_taken_up_or_refused(tmp_path):
    bench, key = TwoMasses(), tmp_path / "records" / "list.key"
    first = take(tmp_path, bench)["push"]
    older = content_hash(experiments.parse(LIST, bench).hash, bench).encode()
    key.write_bytes(older)
    assert take(tmp_path, bench)["push"].hash == first.hash
    assert finished_names(tmp_path) == ["push"]
    for unknown in (older[::-1], b"{", b"[]", b""):
        key.write_bytes(unknown)
        with pytest.raises(uq.errors.StorageError, match="cannot be told"):
            take(tmp_path, bench)
        assert key.read_bytes() == unknown


def test_a_record_that_was_changed_by_hand_is_refused(tmp_path):
    bench = TwoMasses()
    record, path = take(tmp_path, bench)["push"], tmp_path / "records" / "push.h5"
    edited = uq.Record(
        record.inputs, 1.1 * record.outputs, record.rate_hz, record.actuators, record.sensors, record.provenance
    )
    uq.files.save(edited, path)
    with pytest.raises(uq.errors.StorageError, match="other samples than were measured"):
        take(tmp_path, bench)
    assert uq.files.load(path).hash == edited.hash


def test_functions_are_the_same_bench_by_their_source():
    def bench(gain=2.0, name="speed"):
        memory = [0.0]

        def step(u, d):
            memory[0] += 1.0
            return gain * u

        return Wrapped(step, lambda: None, 100.0, ["force"], [name])

    one, other = bench(), bench()
    one.run([[1.0, 2.0]])
    assert identity(one, {}) == identity(other, {})
    assert identity(one, {}) != identity(bench(name="place"), {})
    assert identity(one, {"gain": 2.0}) != identity(one, {"gain": 3.0})
    assert identity(one, {}) != identity(Wrapped(lambda u, d: u, lambda: None, 100.0, ["force"], ["speed"]), {})


def test_a_file_that_the_study_names_counts_by_its_content(tmp_path):
    (tmp_path / "mine.py").write_text("a = 1")
    table = {"object": "mine.py:make"}
    bench = TwoMasses()
    relative, absolute = (
        identity(bench, table, tmp_path),
        identity(bench, {"object": str(tmp_path / "mine.py") + ":make"}),
    )
    assert relative == absolute
    (tmp_path / "mine.py").write_text("a = 2")
    assert identity(bench, table, tmp_path) != relative


MIXED = """
import numpy as np
import ultraquiet as uq

def make(ny, nu):
    G, held = np.fromfunction(lambda i, j: (1.0 + i) * (1.0 + j * j), (ny, nu)), np.zeros(ny)

    def step(u, d):
        y = held.copy()
        held[:] = 0.5 * held + G @ (u + d)
        return y

    forces = [uq.Channel(f"force {k}", "N", -20.0, 20.0) for k in range(nu)]
    return uq.bench.Wrapped(step, lambda: held.fill(0.0), 800.0, forces, [f"acc {k}" for k in range(ny)])
"""
MODAL = """
[study]
title = "one mode"
[bench]
object = "mixed.py:make"
ny = {ny}
nu = {nu}
[experiment]
list = "list.toml"
[blending]
{blending}
[plant]
method = "subspace"
order = 2
records = ["push"]
[controllers.quiet.design]
method = "lqg"
"""


def modal(place, ny, nu, blending):
    """A study of one actuator mode whose matrices are given by the lines of its table."""
    (place / "mixed.py").write_text(MIXED)
    (place / "list.toml").write_text(LIST)
    (place / "study.toml").write_text(MODAL.format(ny=ny, nu=nu, blending=blending))
    return pipeline.load_study(place / "study.toml")


def one_of(nu, k):
    """Ta that drives actuator k of nu alone, as text of a study."""
    return f"actuators = {[[float(j == k)] for j in range(nu)]}\n"


@pytest.mark.parametrize(("ny", "nu"), [(2, 2), (4, 3), (3, 5)])
def test_records_driven_through_another_matrix_are_not_taken_up(ny, nu, tmp_path):
    first, last, out = one_of(nu, 0), one_of(nu, nu - 1), tmp_path / "out"

    def taken(blending):
        return measure(modal(tmp_path, ny, nu, blending), out, tmp_path)["push"]

    record, before = taken(first), state(out)
    with pytest.raises(uq.errors.StorageError, match=r"'blending.actuators' was \[\[1.0\].*--record-again"):
        taken(last)
    assert state(out) == before
    # Each sensor is recorded by itself: how they are blended decides no record.
    assert taken(f"{first}sensors = {[[1.0] * ny]}").hash == taken(first).hash == record.hash
    with pytest.raises(uq.errors.StorageError, match=r"'blending.actuator_modes' was \[\['actuator mode 1', 'N'\]\]"):
        taken(first + 'actuator_names = ["push"]')


def test_records_at_another_control_rate_or_through_another_filter_are_not_taken_up(tmp_path):
    def taken(more, folder="out"):
        return measure(modal(tmp_path, 2, 2, one_of(2, 0) + more), tmp_path / folder, tmp_path)["push"]

    slow = taken("control_rate_hz = 200.0\n")
    assert taken("control_rate_hz = 200.0\naverages = 2\nlatency_samples = 4\n").hash == slow.hash
    for more, said in {
        "control_rate_hz = 200.0\naverages = 4\n": "'blending.averages' was 2 and is 4",
        "control_rate_hz = 200.0\nlatency_samples = 1\n": "'blending.latency_samples' was 4 and is 1",
        "control_rate_hz = 400.0\n": "'blending.control_rate_hz' was 200.0 and is 400.0",
    }.items():
        with pytest.raises(uq.errors.StorageError, match=re.escape(said)):
            taken(more)
    # Without a slower rate there is no filter that could change anything.
    fast = taken("", "fast")
    assert taken("averages = 4\ncontrol_rate_hz = 800.0\n", "fast").hash == fast.hash


def test_a_matrix_of_a_file_counts_by_its_content(tmp_path):
    study = modal(tmp_path, 2, 2, 'actuators = "Ta.csv"\nsensors = "Ts.csv"\nnames = ["heave"]')

    def key():
        settings = with_read_matrices(study, tmp_path)
        return content_hash(bench_key_of(settings, described(bench_of(study, tmp_path), settings, tmp_path)))

    (tmp_path / "Ta.csv").write_text("1\n0\n")
    (tmp_path / "Ts.csv").write_text("0.5,0.5\n")
    record, before = measure(study, tmp_path / "out", tmp_path)["push"], key()
    (tmp_path / "Ts.csv").write_text("0.5,0.25\n")
    assert measure(study, tmp_path / "out", tmp_path)["push"].hash == record.hash
    assert key() != before
    (tmp_path / "Ta.csv").write_text("0\n1\n")
    with pytest.raises(uq.errors.StorageError, match=re.escape("was [[1.0], [0.0]] and is [[0.0], [1.0]]")):
        measure(study, tmp_path / "out", tmp_path)


def test_a_table_that_changes_no_record_leaves_the_bench_its_key(tmp_path):
    plain = modal(tmp_path, 3, 2, one_of(2, 0)).model_copy(update={"blending": None})
    blended = modal(tmp_path, 3, 2, "sensors = [[1.0, 0.0, 1.0]]\n")
    own = bench_of(plain, tmp_path)
    assert described(own, plain, tmp_path) == identity(own, bench_table(plain), tmp_path)
    assert described(own, blended, tmp_path) == described(own, plain, tmp_path)
