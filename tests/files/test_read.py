"""Records from the files of others: what is found, what is chosen, and what is refused with which words."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from ultraquiet import files
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.values import Record, Status

DATA = Path(__file__).parents[1] / "data"
read = files.read_record


@pytest.fixture
def table(tmp_path):
    def write(text, name="run.csv"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_hairdryer_is_one_table_of_input_and_output():
    record = read(DATA / "hairdryer.mat", 12.5)
    held = scipy.io.loadmat(DATA / "hairdryer.mat")["hairdryer"]
    assert np.array_equal(record.inputs[0], held[:, 0])
    assert np.array_equal(record.outputs[0], held[:, 1])
    assert read(DATA / "hairdryer.mat", 12.5, inputs="1", outputs="2").hash == record.hash
    assert record.provenance.settings["inputs"] == ["hairdryer:1"]
    with pytest.raises(InputError, match="states no sampling rate; give it with --rate"):
        read(DATA / "hairdryer.mat")


def test_two_inertia_bench_is_chosen_by_name():
    path = DATA / "two_inertia_cut.mat"
    with pytest.raises(InputError) as caught:
        read(path)
    print(caught.value)
    for words in ("iq_adx (2500), iq_refx (2500), omega_max (2500)", "--inputs and --outputs"):
        assert words in str(caught.value)
    for names in ("omega_max,omega_may", ["omega_max", "omega_may"], "omega_max, omega_may"):
        record = read(path, inputs="iq_adx", outputs=names)
        assert (record.rate_hz, record.inputs.shape, record.outputs.shape) == (2500.0, (1, 2500), (2, 2500))
        assert [c.name for c in record.sensors] == ["omega_max", "omega_may"]
    with pytest.raises(InputError, match=r"has no column 'current'; it holds the variables iq_adx"):
        read(path, inputs="current", outputs="omega_max")
    with pytest.raises(InputError, match="is a number, but"):
        read(path, inputs="1", outputs="2")
    with pytest.raises(InputError, match="go together"):
        read(path, inputs="iq_adx")


def test_text_with_header_units_time_and_remarks(table):
    text = "\ufeff# bench 3\ntime [ms]; force [N]; strut 1 (V); strut 2 (V)\n0;1;10;20\n2;2;11;21\n4;3;12;22\n"
    record = read(table(text), inputs="force", outputs="strut 1,strut 2 (V)")
    assert record.rate_hz == pytest.approx(500.0, rel=1e-12)
    assert [(c.name, c.unit) for c in (*record.actuators, *record.sensors)] == [
        ("force", "N"),
        ("strut 1", "V"),
        ("strut 2", "V"),
    ]
    assert record.outputs.tolist() == [[10.0, 11.0, 12.0], [20.0, 21.0, 22.0]]
    assert read(table(text), inputs="2", outputs="3-4").hash == record.hash
    assert read(table(text), rate_hz=7.0, inputs="2", outputs="3-4").rate_hz == 7.0


@pytest.mark.parametrize(
    "text",
    [
        "t,u,y\n0,1,3\n0.1,2,4\n",
        "t,u1,y1\n0,1,3\n0.1,2,4\n",
        "t,Input 1,Output 1\n0,1,3\n0.1,2,4\n",
        '"t","u","y"\n0,1,3\n0.1,2,4\n',
        '"t", "force, x", "speed, y"\n0,1,3\n0.1,2,4\n',
        "# t u y\n0 1 3\n0.1 2 4\n",
        "t\tforce\tspeed\n0\t1\t3\n0.1\t2\t4\n",
        "y,t,u\n3,0,1\n4,0.1,2\n",
    ],
)
def test_names_or_order_may_say_it(text, table):
    record = read(table(text))
    assert record.rate_hz == pytest.approx(10.0)
    assert (record.inputs.tolist(), record.outputs.tolist()) == ([[1.0, 2.0]], [[3.0, 4.0]])


def test_columns_of_numbers_padded_with_blanks(table):
    record = read(table("  1.0e+00\t  2 \t 3\t\n  4\t  5 \t 6\t\n", "arm.dat"), 2048.0, "1-2", "3")
    assert record.inputs.tolist() == [[1.0, 4.0], [2.0, 5.0]]
    assert [c.name for c in record.sensors] == ["column 3"]


@pytest.mark.parametrize(
    ("text", "choice", "words"),
    [
        ("a,b,c\n1,2,3\n", (None, None), r"does not say what goes in .* a \(1\), b \(1\), c \(1\).*--inputs 1-2"),
        ("a,b\n0,5\n1,6\n2,7\n", (None, None), "does not say what goes in"),  # the first column counts samples
        ("a,b\n1,x\n", ("a", "b"), "holds no line of numbers"),
        ("a,b\n1,2\n3,x\n", ("a", "b"), r"'x', which is no number, stands in line 3, column 2 \('b'\)"),
        ("a,b\n1,2\n3\n", ("a", "b"), "the number of columns changed"),
        ("\n", ("a", "b"), "holds no line of numbers"),
        ("a,a\n1,2\n", ("a", "a"), "has 2 columns called 'a'; choose by number"),
        ("a,b\n1,2\n", ("1-2", "2"), "'inputs' "),
        ("a,b\n1,2\n", ("1,1", "2"), "'a' was chosen twice"),
        ("a,b\n1,2\n", ("0", "2"), "'0' was asked .* numbered 1 to 2"),
        ("a,b\n1,2\n", ("3", "2"), "'3' was asked .* numbered 1 to 2"),
        ("a,b\n1,2\n", ("2-1", "2"), "'2-1' was asked"),
        ("a,b\n1,2\n", ("", "2"), "has no column ''"),
        ("t,a,b\n0,1,2\n1,1,2\n2,1,2\n4,1,2\n", ("a", "b"), "is not evenly sampled: sample 3 "),
        ("t,a,b\n3,1,2\n1,1,2\n", ("a", "b"), "does not rise"),
        ("t,a,b\n0,1,2\n0,1,2\n1,1,2\n", ("a", "b"), "does not rise"),
        ("t [weeks],a,b\n0,1,2\n1,1,2\n", ("a", "b"), "counts time in 'weeks'"),
    ],
)
def test_what_text_is_refused_for(text, choice, words, table):
    if choice == ("1-2", "2"):
        # One column may be both measured and sent: that is a choice, not a mistake.
        assert read(table(text), 1.0, *choice).inputs.tolist() == [[1.0], [2.0]]
        return
    rate_hz = None if text.startswith("t") else 1.0
    with pytest.raises(InputError, match=words) as caught:
        read(table(text), rate_hz, *choice)
    assert "\n" not in str(caught.value)


def test_missing_values_are_refused(table):
    with pytest.raises(InputError, match=r"'y' of 'run\.csv' has 1 NaN or infinite values, the first at sample 1"):
        read(table("u,y\n1,2\n3,nan\n"), 1.0)


def test_npz_and_mat_agree(tmp_path, rng):
    u, y = rng.standard_normal((2, 40)), rng.standard_normal((3, 40))
    np.savez(tmp_path / "a.npz", inputs=u, outputs=y, rate_hz=3500.0, remark=np.array("text"))
    scipy.io.savemat(tmp_path / "b.mat", {"u": u.T, "y": y.T, "dt": 1 / 3500, "remark": "text"})
    scipy.io.savemat(tmp_path / "c.mat", {"run": {"u": u.T, "y": y.T, "Fs": 3500}})
    with h5py.File(tmp_path / "d.mat", "w", userblock_size=512) as file:
        file["u"], file["y"], file["fs"] = u, y, [[3500.0]]
    # MATLAB's own header of version 7.3, which is what tells SciPy that this is HDF5.
    with (tmp_path / "d.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    for name in ("a.npz", "b.mat", "c.mat", "d.mat"):
        record = read(tmp_path / name)
        assert np.array_equal(record.inputs, u), name
        assert np.array_equal(record.outputs, y), name
        assert record.rate_hz == pytest.approx(3500.0, rel=1e-12)
    some = read(tmp_path / "b.mat", inputs="u:2", outputs="y:1-2")
    assert np.array_equal(some.inputs, u[1:])
    assert np.array_equal(some.outputs, y[:2])


def test_unequal_lengths_and_separate_variables(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.arange(5.0), b=np.arange(4.0))
    with pytest.raises(InputError, match=r"differ in length: a \(5\), b \(4\)"):
        read(tmp_path / "a.npz", 1.0, "a", "b")
    np.savez(tmp_path / "b.npz", accel=[0.0, 3.0, 1.0], force=[1.0, 1.0, 2.0])
    # Variables come in the order of the alphabet, which says nothing about what goes in.
    with pytest.raises(InputError, match="does not say what goes in"):
        read(tmp_path / "b.npz", 1.0)


def test_archives_with_a_choice_of_channels(tmp_path, rng):
    record = Record(rng.standard_normal((2, 9)), rng.standard_normal((3, 9)), 3500.0, ["a", "b"], ["a", "c", "d"])
    path = files.save(record, tmp_path / "r.h5")
    assert read(path).hash == record.hash
    some = read(path, inputs="b", outputs="a,3")
    assert np.array_equal(some.inputs, record.inputs[1:])
    assert np.array_equal(some.outputs, record.outputs[[0, 2]])
    assert np.array_equal(read(path, outputs="c").inputs, record.inputs)
    with pytest.raises(InputError, match="was recorded at 3500 Hz; it cannot be read at 3000 Hz"):
        read(path, 3000.0)
    with pytest.raises(InputError, match="holds no record"):
        read(files.save(Status("ok", ""), tmp_path / "s.h5"))
    with pytest.raises(InputError, match=r"holds 2 records \(x, y\)"):
        read(files.save_many({"x": record, "y": record}, tmp_path / "t.h5"))


def test_files_that_are_not_there_or_not_what_they_say(tmp_path, table):
    with pytest.raises(InputError, match=r"none of the suffixes .h5, "):
        read(tmp_path / "x.xlsx")
    for suffix in (".csv", ".mat", ".npz", ".h5"):
        with pytest.raises(StorageError, match="no such file or directory"):
            read(tmp_path / f"missing{suffix}")
        with pytest.raises((StorageError, InputError)) as caught:
            read(table("\x00\x01 not at all \x02\n" * 20, f"bad{suffix}"))
        assert "\n" not in str(caught.value)
    (tmp_path / "latin.csv").write_bytes("µ,y\n1,2\n".encode("latin-1"))
    with pytest.raises(InputError, match="no text file in UTF-8"):
        read(tmp_path / "latin.csv")


@pytest.mark.slow
def test_damaged_files_are_refused_in_one_sentence_or_read(tmp_path, rng):
    np.savez_compressed(tmp_path / "whole.npz", u=rng.standard_normal((2, 40)), y=rng.standard_normal((2, 40)))
    refused, sentences = 0, set()
    for source in (DATA / "hairdryer.mat", DATA / "two_inertia_cut.mat", tmp_path / "whole.npz"):
        whole, hurt = source.read_bytes(), tmp_path / f"hurt{source.suffix}"
        for _ in range(60):
            data = bytearray(whole)
            for k in rng.integers(len(data), size=int(rng.integers(1, 6))):
                data[k] ^= int(rng.integers(1, 256))
            if rng.random() < 0.2:
                del data[int(rng.integers(len(data))) :]
            hurt.write_bytes(data)
            try:
                read(hurt, 12.5)
            except (StorageError, InputError) as error:
                refused += 1
                sentences.add(str(error))
    print(f"damaged files refused: {refused} of 180")
    assert refused > 0
    assert not any("\n" in sentence for sentence in sentences)


finite = st.floats(allow_nan=False, allow_infinity=False)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(finite, finite, finite), min_size=1, max_size=20), st.sampled_from([",", ";", "\t", " "]))
def test_text_keeps_every_bit(tmp_path_factory, rows, delimiter):
    path = tmp_path_factory.mktemp("text") / "x.csv"
    path.write_text(delimiter.join("uyz") + "\n" + "".join(delimiter.join(map(repr, row)) + "\n" for row in rows))
    record = read(path, 3500.0, "u", "y,z")
    assert np.array_equal(np.vstack([record.inputs, record.outputs]).T, np.array(rows))


def test_exported_records_come_back(tmp_path, rng):
    u, y = rng.standard_normal((2, 30)), rng.standard_normal((3, 30))
    struts = Record(u, y, 3500.0, ["strut 1", "strut 2"], ["strut 1", "strut 2", "strut 3"])
    for choice in (("u strut 1,u strut 2", "y strut 1,y strut 2,y strut 3"), ("2-3", "4-6")):
        back = read(files.export_record(struts, tmp_path / "a.csv"), None, *choice)
        assert np.array_equal(back.inputs, u)
        assert np.array_equal(back.outputs, y)
        assert back.rate_hz == pytest.approx(3500.0, rel=1e-12)
    back = read(files.export_record(struts, tmp_path / "a.mat"))
    assert (back.hash, back.rate_hz) == (struts.hash, 3500.0)
    with pytest.raises(StorageError, match="exists already"):
        files.export_record(struts, tmp_path / "a.mat", overwrite=False)
    with pytest.raises(InputError, match="none of the suffixes"):
        files.export_record(struts, tmp_path / "a.xlsx")


def two_runs(place, **each):
    """A file of two structures, and what `each` holds for the first and the second of them beside u and y."""
    u, y = np.random.default_rng(0).standard_normal((2, 50))
    runs = {f"run{k}": {name: values[k - 1] for name, values in each.items()} | {"u": u, "y": y} for k in (1, 2)}
    if place.suffix == ".mat":
        scipy.io.savemat(place, runs)
        return place
    with h5py.File(place, "w") as file:
        for run, held in runs.items():
            group = file.create_group(run)
            for name, value in held.items():
                if np.ndim(value):
                    group[name] = value
                else:
                    group.attrs[name] = value
    return place


STAMPS = np.arange(50.0)


@pytest.mark.parametrize("suffix", [".mat", ".h5"])
@pytest.mark.parametrize(
    "each",
    [
        {"fs": (1000.0, 2000.0)},
        {"dt": (1e-3, 5e-4)},
        {"t": (STAMPS / 1000.0, STAMPS / 2000.0)},
        {"time_ms": (STAMPS, STAMPS / 2.0)},
    ],
)
def test_a_record_goes_by_the_clock_that_stands_beside_its_channels(tmp_path, suffix, each):
    path = two_runs(tmp_path / f"runs{suffix}", **each)
    for k, rate_hz in ((1, 1000.0), (2, 2000.0)):
        assert read(path, inputs=f"run{k}.u", outputs=f"run{k}.y").rate_hz == rate_hz
    with pytest.raises(InputError, match=r"differ in rate: run1.u \(1000 Hz\), run2.y \(2000 Hz\)"):
        read(path, inputs="run1.u", outputs="run2.y")
    assert read(path, 500.0, "run1.u", "run2.y").rate_hz == 500.0
    looks = {look.name: look.rate_hz for look in files.survey(path).channels}
    assert looks == {"run1.u": 1000.0, "run1.y": 1000.0, "run2.u": 2000.0, "run2.y": 2000.0}


def test_channels_whose_clocks_begin_apart_are_no_record(tmp_path):
    path = two_runs(tmp_path / "runs.mat", t=(STAMPS / 1000.0, 5.0 + STAMPS / 1000.0))
    assert read(path, inputs="run2.u", outputs="run2.y").rate_hz == 1000.0
    with pytest.raises(InputError, match=r"do not start together: run1.u \(0 s\), run2.y \(5 s\)"):
        read(path, inputs="run1.u", outputs="run2.y")


def test_a_rate_that_stands_elsewhere_in_the_file_holds_where_it_is_the_only_one(tmp_path):
    u, y = np.random.default_rng(0).standard_normal((2, 50))
    one, two = tmp_path / "one.mat", tmp_path / "two.mat"
    scipy.io.savemat(one, {"setup": {"fs": 1000.0}, "run": {"u": u, "y": y}})
    scipy.io.savemat(two, {"setup": {"fs": 1000.0}, "other": {"fs": 2000.0}, "run": {"u": u, "y": y}})
    assert read(one).rate_hz == 1000.0
    with pytest.raises(InputError, match=r"several sampling rates, none of them beside 'run.u'; give its own"):
        read(two)


def test_signals_in_memory_start_together():
    stamps = STAMPS / 1000.0
    u, y = np.random.default_rng(0).standard_normal((2, 50))
    force = {"data": u, "name": "force", "unit_str": "N", "time": 5.0 + stamps}
    speed = {"data": y, "name": "speed", "unit_str": "m/s", "time": stamps}
    assert files.from_sep005([force, speed | {"time": 5.0 + stamps}], "force", "speed").rate_hz == 1000.0
    with pytest.raises(InputError, match=r"do not start together: force \(5 s\), speed \(0 s\)"):
        files.from_sep005([force, speed], "force", "speed")


@pytest.mark.parametrize("suffix", [".csv", ".h5"])
def test_columns_and_rates_may_be_numbers_of_numpy_and_nothing_else(tmp_path, suffix):
    u, y = np.random.default_rng(0).standard_normal((2, 50))
    path = files.export_record(Record(u, y, 1000.0), tmp_path / f"run{suffix}")
    first, last = (2, 3) if suffix == ".csv" else (1, 1)  # of an archive each side is counted
    record = read(path, np.float32(1000.0), np.int64(first), [np.uint8(last)])
    assert record.hash == read(path, "1000", first, last).hash
    for odd in (1.5, [1.5], [None], b"u", {"u": 1}.items()):
        with pytest.raises(InputError, match="a column is chosen by its name or by its number from one, got"):
            read(path, inputs=odd, outputs=last)
    for odd in ("fast", [1000.0], -1.0, np.nan):
        with pytest.raises(InputError, match="read_record: 'rate_hz' must be"):
            read(path, odd, first, last)


@pytest.mark.parametrize("rate_hz", [1e4 / 3, 3500.0, 1 / 7, np.pi, 44100.0, 2e5 / 7])
@pytest.mark.parametrize("samples", [50, 1000])
def test_a_rate_of_any_digits_outlasts_its_stamps(tmp_path, rng, rate_hz, samples):
    record = Record(rng.standard_normal((3, samples)), rng.standard_normal((2, samples)), rate_hz)
    back = read(files.export_record(record, tmp_path / "run.csv"))
    assert back.rate_hz == rate_hz
    assert back.hash == record.hash


def test_a_single_sample_is_written_where_it_can_be_read(tmp_path):
    record = Record([[1.0]], [[2.0]], 1000.0)
    with pytest.raises(InputError, match=r"of a single sample no stamps tell the rate; write .h5, .mat or .uff"):
        files.export_record(record, tmp_path / "run.csv")
    assert not list(tmp_path.iterdir())
    for suffix in (".h5", ".mat", ".uff"):
        assert read(files.export_record(record, tmp_path / f"run{suffix}")).hash == record.hash
