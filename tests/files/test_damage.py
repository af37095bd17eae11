"""Files that are empty, foreign, cut short, damaged or too large: one sentence each, and nothing half written."""

import errno
import os
import subprocess
import sys

import numpy as np
import pytest
from matlab import matlab_73

from ultraquiet import files
from ultraquiet._base.errors import InputError, StorageError, ToolError, UltraquietError
from ultraquiet.files.formats import FORMATS
from ultraquiet.files.readers import extra as extra_module
from ultraquiet.values import Channel, Record

read = files.read_record
SUFFIXES = [suffix for held in FORMATS for suffix in held.suffixes]


@pytest.fixture
def strikes(request):
    """How many cuts, or damages, of a file: a dozen in the gate."""
    return 12 if "not slow" in request.config.getoption("markexpr") else 40


@pytest.fixture
def good(tmp_path, rng):
    """Write a sound file of any kind; returns its path and how to read it."""

    def make(suffix):
        path = tmp_path / f"good{suffix}"
        u, y = rng.standard_normal((1, 60)), rng.standard_normal((2, 60))
        if suffix == ".wav":
            from scipy.io import wavfile

            wavfile.write(path, 3500, np.vstack([u, y]).T)
            return path, {"inputs": "1", "outputs": "2-3"}
        if suffix == ".tdms":
            from nptdms import ChannelObject, TdmsWriter

            told = {"wf_increment": 1 / 3500}
            rows = [ChannelObject("g", f"c{k}", row, told) for k, row in enumerate(np.vstack([u, y]))]
            with TdmsWriter(str(path)) as writer:
                writer.write_segment(rows)
            return path, {"inputs": "c0", "outputs": "c1,c2"}
        if suffix == ".npz":
            np.savez(path, u=u, y=y, fs=3500.0)
            return path, {}
        if suffix == ".hdf5":
            import h5py

            with h5py.File(path, "w") as file:
                file.attrs["fs"] = 3500.0
                file["u"], file["y"] = u, y
            return path, {}
        return files.export_record(Record(u, y, 3500.0, [Channel("a", "N")]), path), {}

    return make


def refused(path, **choice):
    with pytest.raises(UltraquietError) as caught:
        read(path, **choice)
    assert "\n" not in str(caught.value)
    assert path.name in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_empty_files(tmp_path, suffix):
    (tmp_path / f"nothing{suffix}").touch()
    assert "is empty" in refused(tmp_path / f"nothing{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    assert "is a directory" in refused(tmp_path / f"folder{suffix}")


@pytest.mark.parametrize("suffix", [".mat", ".npz", ".h5", ".uff", ".tdms", ".parquet", ".wav", ".csv"])
def test_the_wrong_suffix(good, tmp_path, suffix):
    for other in (".csv", ".wav", ".parquet", ".h5"):
        if other == suffix:
            continue
        wrong = tmp_path / f"wrong{suffix}"
        wrong.write_bytes(good(other)[0].read_bytes())
        print(refused(wrong))


@pytest.mark.gate(".mat", ".h5")
@pytest.mark.parametrize("suffix", [".mat", ".npz", ".h5", ".hdf5", ".uff", ".tdms", ".parquet", ".wav"])
def test_files_cut_short(good, tmp_path, rng, strikes, suffix):
    """No cut is taken for a whole file, wherever it falls; the last bytes included."""
    path, choice = good(suffix)
    whole, cut = path.read_bytes(), tmp_path / f"cut{suffix}"
    assert read(path, **choice).samples == 60
    # Blanks behind the last mark of a universal file say nothing.
    full = len(whole.rstrip(b"\n")) if suffix == ".uff" else len(whole)
    sentences = set()
    for size in {1, 8, full // 2, full - 1, *rng.integers(1, full, strikes).tolist()}:
        cut.write_bytes(whole[:size])
        sentences.add(refused(cut, **choice).partition("(")[0])
    print(f"{suffix}: every cut refused, in {len(sentences)} sentences: {sorted(sentences)[0]}")


def test_universal_files_cut_between_two_sets(good, tmp_path):
    path, _ = good(".uff")
    whole, cut = path.read_bytes(), tmp_path / "cut.uff"
    ends = [k for k in range(len(whole)) if whole.startswith(b"    -1\n", k)][1::2]
    assert len(ends) == 3
    for end in ends[:-1]:
        cut.write_bytes(whole[: end + 7])
        print(refused(cut))


def test_text_cut_short_is_refused_or_a_part(good, tmp_path, rng, strikes):
    """Text has no end mark: what is read of a part is the part, but for the last number, which may lack digits."""
    path, _ = good(".csv")
    whole, cut = path.read_bytes(), tmp_path / "cut.csv"
    record, refusals = read(path), 0
    for size in rng.integers(80, len(whole), strikes).tolist():
        cut.write_bytes(whole[:size])
        try:
            back = read(cut)
        except UltraquietError:
            refusals += 1
            continue
        assert np.array_equal(back.inputs, record.inputs[:, : back.samples])
        assert np.array_equal(back.outputs[:, :-1], record.outputs[:, : back.samples - 1])
    print(f"text: {refusals} of {strikes} cuts refused")


# HDF5 of others and MAT 7.3, its relative, are tried below, in a process of their own.
@pytest.mark.gate(".npz", ".csv")
@pytest.mark.parametrize("suffix", [".mat", ".npz", ".uff", ".tdms", ".parquet", ".wav", ".csv", ".h5"])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of NumPy, on absurd numbers
def test_damaged_bytes_leave_no_traceback(good, tmp_path, rng, strikes, suffix):
    path, choice = good(suffix)
    whole, hurt = path.read_bytes(), tmp_path / f"hurt{suffix}"
    sentences = []
    for _ in range(strikes):
        data = bytearray(whole)
        for k in rng.integers(len(data), size=int(rng.integers(1, 6))):
            data[k] ^= int(rng.integers(1, 256))
        hurt.write_bytes(data)
        try:
            read(hurt, **choice)
        except UltraquietError as error:
            sentences.append(str(error))
    refusals = len(sentences)
    for sentence in sentences:
        assert all(line.startswith("  - ") for line in sentence.splitlines()[1:]), sentence  # one line a mistake
    print(f"{suffix}: {refusals} of {strikes} damaged files refused, the others read")
    assert refusals == strikes or suffix != ".h5"


READER = """
import sys, warnings
from ultraquiet import files
from ultraquiet._base.errors import UltraquietError
warnings.simplefilter("ignore")
for path in sys.argv[1:]:
    try:
        files.read_record(path)
        print("read", flush=True)
    except UltraquietError as error:
        print("one sentence" if "\\n" not in str(error) else "several lines", flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".mat", ".hdf5"])
def test_damaged_hdf5_of_others(good, tmp_path, rng, strikes, suffix):
    """MAT 7.3 and foreign HDF5 carry no checksum: every cut is refused, changed bytes are refused or read, no more."""
    if suffix == ".mat":
        path = tmp_path / "good.mat"
        matlab_73(path, {"u": rng.standard_normal((60, 1)), "y": rng.standard_normal((60, 2)), "fs": 3500.0})
        assert read(path).samples == 60
    else:
        path, _ = good(suffix)
    whole = path.read_bytes()
    cuts = [whole[:size] for size in {1, len(whole) - 1, *rng.integers(2, len(whole), strikes).tolist()}]
    hurts = []
    for _ in range(strikes):
        data = bytearray(whole)
        for k in rng.integers(len(data), size=int(rng.integers(1, 6))):
            data[k] ^= int(rng.integers(1, 256))
        hurts.append(bytes(data))
    said = []
    for kind, many in (("cut", cuts), ("hurt", hurts)):
        paths = [tmp_path / f"{kind}{k}{suffix}" for k in range(len(many))]
        for one, data in zip(paths, many, strict=True):
            one.write_bytes(data)
        words = [sys.executable, "-c", READER, *map(str, paths)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        said.append(done.stdout.splitlines())
    print(f"{suffix}: {len(cuts)} cuts refused, {said[1].count('one sentence')} of {strikes} damaged files refused")
    assert said[0] == ["one sentence"] * len(cuts)
    assert set(said[1]) <= {"one sentence", "read"}
    assert len(said[1]) == strikes


@pytest.mark.skipif(os.name != "posix", reason="sparse files and /proc are not everywhere")
def test_a_file_larger_than_memory(tmp_path):
    path = tmp_path / "long.csv"
    with path.open("wb") as file:
        file.truncate(10**13)
    told = refused(path)
    print(told)
    assert "has 10 TB; reading it takes up to 60 TB of memory" in told


def test_a_missing_extra_is_told(good, monkeypatch):
    path, choice = good(".tdms")

    def absent(name):
        raise ImportError(name)

    monkeypatch.setattr(extra_module, "import_module", absent)
    for known, package in ((path, "npTDMS"), (path.with_name("good.parquet"), "pyarrow")):
        known.touch()
        known.write_bytes(b"x")
        with pytest.raises(
            ToolError, match=rf"'{package}', which is not installed; install it with: pip install {package}"
        ):
            read(known, **choice)


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".uff", ".unv", ".parquet", ".h5"])
def test_nothing_is_half_written(tmp_path, rng, monkeypatch, suffix):
    """A disk that is full leaves what was there, and no other file."""
    record = Record(rng.standard_normal((1, 50)), rng.standard_normal((1, 50)), 10.0)
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"mine")

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="no space left"):
        files.export_record(record, path)
    assert path.read_bytes() == b"mine"
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(StorageError, match="no such file or directory"):
        files.export_record(record, tmp_path / "absent" / f"a{suffix}")


def test_a_wav_file_without_a_rate_is_refused(tmp_path):
    from scipy.io import wavfile

    path = tmp_path / "a.wav"
    wavfile.write(path, 3500, np.zeros((8, 2)))
    data = bytearray(path.read_bytes())
    data[24:28] = bytes(4)  # samples a second, in the format chunk
    path.write_bytes(data)
    assert "a rate of 0 Hz" in refused(path)


def test_names_that_a_format_cannot_hold(tmp_path):
    for name, suffix in (
        ("x" * 81, ".uff"),
        ("two\nlines", ".uff"),
        ("two\nlines", ".csv"),
        (" blank", ".csv"),
        ("", ".csv"),
    ):
        record = Record([[0.0, 1.0]], [[0.0, 1.0]], 1.0, [name])
        with pytest.raises(InputError, match="rename it"):
            files.export_record(record, tmp_path / f"a{suffix}")
    with pytest.raises(InputError, match=r"WAV files are read only; write .h5"):
        files.export_record(record, tmp_path / "a.wav")
    assert not list(tmp_path.iterdir())


def test_a_file_with_a_name_in_any_script(good, tmp_path):
    for suffix in (".csv", ".mat", ".npz", ".h5", ".uff", ".tdms", ".parquet", ".wav"):
        path, choice = good(suffix)
        assert read(path.rename(tmp_path / f"Messung №3 – 振動 {suffix[1:]}{suffix}"), **choice).samples == 60


def test_one_channel_and_none(tmp_path):
    from scipy.io import wavfile

    wavfile.write(tmp_path / "mono.wav", 100, np.zeros(5))
    assert "holds one signal, 'channel 1'; a record takes an input and an output" in refused(tmp_path / "mono.wav")
    np.savez(tmp_path / "none.npz", fs=3.0)
    assert "holds no signal" in refused(tmp_path / "none.npz")
    (tmp_path / "time.csv").write_text("time\n0\n1\n")
    assert "holds no signal" in refused(tmp_path / "time.csv")
    wavfile.write(tmp_path / "short.wav", 100, np.zeros((0, 2)))
    assert "no samples" in refused_whole(tmp_path / "short.wav")


def refused_whole(path):
    with pytest.raises(UltraquietError) as caught:
        read(path, inputs="1", outputs="2")
    return str(caught.value)


def test_no_reader_is_loaded_before_it_reads():
    """`import ultraquiet.files` loads none of the libraries that read for it."""
    heavy = ("pyuff", "nptdms", "pyarrow", "h5py", "scipy.io", "scipy.signal", "numba", "matplotlib")
    script = f"import sys, ultraquiet.files; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
