"""Files made to hurt: a sentence for each, nothing but the file is read, no more memory than its size accounts for."""

import hashlib
import io
import os
import pickle
import resource
import struct
import subprocess
import sys
import time
import warnings
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from ultraquiet import files
from ultraquiet._base.errors import StorageError, UltraquietError
from ultraquiet._base.regular import read_regular
from ultraquiet.files import archive
from ultraquiet.files.confined import confined
from ultraquiet.files.readers.parquet import read_parquet
from ultraquiet.values import Record

posix = pytest.mark.skipif(os.name != "posix", reason="no fork")


def refusal(path, **choice):
    with pytest.raises(UltraquietError) as caught:
        files.read_record(path, **choice)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def array_head(shape):
    memory = io.BytesIO()
    np.lib.format.write_array_header_1_0(memory, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return memory.getvalue()


def resealed(path):
    data = path.read_bytes()
    path.write_bytes(data + archive.SEAL + hashlib.sha256(data).hexdigest().encode())
    return path


@posix
def test_a_reader_that_crashes_hangs_opens_or_eats_ends_in_a_sentence(tmp_path, monkeypatch):
    secret = tmp_path / "secret"
    secret.write_text("secret")

    def crash():
        os.kill(os.getpid(), 11)

    def eat():
        return np.ones(3 << 27)

    def steal():
        return secret.read_text()

    def run():
        return os.system("true")

    def hang():
        while True:
            pass

    def delete():
        secret.unlink()

    monkeypatch.setattr("ultraquiet.files.confined.run.LEAST_S", 1)
    begun = time.monotonic()
    for read in (crash, eat, steal, run, hang):
        with pytest.raises(StorageError, match="cannot be read as") as caught:
            confined(read, "bad.bin", "binary", 100)
        print(f"{read.__name__}: {caught.value}")
    with pytest.raises(StorageError, match="permission denied"):
        confined(delete, "bad.bin", "binary", 100)
    assert secret.exists()
    assert time.monotonic() - begun < 60
    assert confined(lambda: {"a": [1, "b", None, (np.arange(3.0), 1 + 2j)]}, "x", "y", 1)["a"][3][1] == 1 + 2j
    assert not [name for name in os.listdir("/proc/self/fd") if _target(name).startswith("/memfd:ultraquiet")]


def _target(name):
    try:
        return os.readlink(f"/proc/self/fd/{name}")
    except OSError:
        return ""


@posix
def test_devices_pipes_and_links_to_them_are_refused_at_every_door(tmp_path):
    (tmp_path / "zero.csv").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "loop.csv").symlink_to("loop.csv")
    doors = (
        files.read_record,
        files.load,
        files.read_log,
        files.load_mapping,
        lambda path: __import__("ultraquiet.experiments", fromlist=["load"]).load(path),
        files.LongRecord,
    )
    for name in ("zero.csv", "pipe.csv", "loop.csv"):
        for door in doors:
            with pytest.raises(UltraquietError) as caught:
                door(tmp_path / name)
            assert "\n" not in str(caught.value)
    (tmp_path / "long").write_bytes(bytes(100))
    with pytest.raises(OSError, match="more than 10"):
        read_regular(tmp_path / "long", 10)


def npz(path, members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, data in members.items():
            packed.writestr(name, data)
    return path


def test_what_a_file_says_it_unpacks_into_is_checked_before(tmp_path, monkeypatch):
    monkeypatch.setattr("ultraquiet.files.confined.unpacked.FREE_BYTES", 8 << 20)
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    zeros = array_head((1, 2_000_000)) + bytes(16_000_000)
    cases = {
        "bomb": npz(tmp_path / "bomb.npz", {"u.npy": zeros}),
        "declared": npz(tmp_path / "declared.npz", {"u.npy": array_head((1, 10**12))}),
        "cut": npz(tmp_path / "cut.npz", {"u.npy": array_head((1, 10**6)) + bytes(80)}),
    }
    del zeros
    for name, count in (("h", 10**12), ("h2", 4 * 10**8)):
        cases[name] = tmp_path / f"{name}.hdf5"
        with h5py.File(cases[name], "w") as file:
            file.create_dataset("u", (1, count), "f8", chunks=(1, 1 << 16))
    with h5py.File(tmp_path / "chunk.hdf5", "w") as file:
        file.create_dataset("u", (1, 8), "f8", chunks=(1, 1 << 28), maxshape=(1, None))
    cases["chunk"] = tmp_path / "chunk.hdf5"
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["format"], file.attrs["format_version"] = "ultraquiet", 1
        group = file.create_group("value")
        group.attrs["kind"] = "record"
        group.create_dataset("inputs", (1, 4 * 10**8), "f8", chunks=(1, 1 << 20))
    cases["archive"] = resealed(tmp_path / "a.h5")
    pack = zlib.compressobj(9)
    inner = struct.pack("<II", 14, 1 << 30) + bytes(1 << 16)
    packed = pack.compress(inner) + pack.flush()
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    cases["mat"] = tmp_path / "m.mat"
    cases["mat"].write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    for name, path in cases.items():
        print(f"{name}: {refusal(path)}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    grown = max(now - then for now, then in zip(after, before, strict=True)) >> 10
    assert grown < 1024, f"{grown} MB more than before"


def test_storage_outside_the_file_is_never_followed(tmp_path):
    (tmp_path / "secret.bin").write_bytes(b"TOPSECRET" * 200)
    with h5py.File(tmp_path / "target.hdf5", "w") as file:
        file["d"] = np.arange(1800.0)
    with h5py.File(tmp_path / "external.hdf5", "w") as file:
        file.create_dataset("u", (1800,), "u1", external=[(str(tmp_path / "secret.bin"), 0, 1800)])
        file["y"] = np.arange(1800.0)
    with h5py.File(tmp_path / "virtual.hdf5", "w") as file:
        layout = h5py.VirtualLayout(shape=(1800,), dtype="f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "target.hdf5"), "d", shape=(1800,))
        file.create_virtual_dataset("u", layout)
        file["y"] = np.arange(1800.0)
    for name in ("external", "virtual"):
        path = tmp_path / f"{name}.hdf5"
        assert "outside itself" in refusal(path, rate_hz=10.0)
        with pytest.raises(StorageError, match="outside itself"):
            files.LongRecord(path, "u", "y", rate_hz=10.0)
    with h5py.File(tmp_path / "linked.hdf5", "w") as file:
        file["u"] = h5py.ExternalLink(str(tmp_path / "target.hdf5"), "d")
        file["y"] = np.arange(1800.0)
    with pytest.raises(StorageError):
        files.LongRecord(tmp_path / "linked.hdf5", "u", "y", rate_hz=10.0)
    assert "u" not in files.survey(tmp_path / "linked.hdf5").channels[0].name


def lies(tmp_path):
    """Archives with a right checksum and what no archive holds."""

    def made(name, change):
        path = tmp_path / f"{name}.h5"
        with h5py.File(path, "w") as file:
            file.attrs["format"], file.attrs["format_version"] = "ultraquiet", 1
            group = file.create_group("value")
            group.attrs["kind"] = "record"
            group["inputs"], group["outputs"], group["rate_hz"] = np.zeros((1, 5)), np.zeros((1, 5)), 10.0
            for key, text in (("actuators", '[["a","V",null,null]]'), ("sensors", '[["b","V",null,null]]')):
                group[key] = text
            group["provenance"] = '{"made_by": "x", "parents": []}'
            change(file, group)
        return resealed(path)

    def put(key, value):
        def change(_, group):
            del group[key]
            group[key] = value

        return change

    def no_kind(_, group):
        del group.attrs["kind"]

    def cyclic(_, group):
        group["again"] = group

    def soft(_, group):
        group["again"] = h5py.SoftLink("/value")

    def alone(file, _):
        file["x"] = 1.0

    def version(file, _):
        file.attrs["format_version"] = "one"

    def versionless(file, _):
        del file.attrs["format_version"]

    return [made(change.__name__, change) for change in (no_kind, cyclic, soft, alone, version, versionless)] + [
        made(f"{key}-{k}", put(key, value))
        for k, (key, value) in enumerate(
            [
                ("actuators", b"[["),
                ("sensors", b"\xff\xfe"),
                ("actuators", '[["a",3,null,null]]'),
                ("sensors", '[["a","V","x",null]]'),
                ("actuators", "[" * 50_000),
                ("provenance", b"[]"),
                ("provenance", '{"made_by": 3, "parents": []}'),
                ("provenance", '{"settings": [], "parents": []}'),
                ("provenance", '{"parents": 3}'),
                ("rate_hz", np.zeros(3)),
                ("rate_hz", np.nan),
                ("inputs", "text"),
                ("inputs", np.zeros((1, 4))),
                ("inputs", np.zeros(())),
            ]
        )
    ]


def test_sealed_lies_end_in_a_sentence_each(tmp_path):
    for path in lies(tmp_path):
        for door in (files.load, files.read_record):
            with pytest.raises(UltraquietError) as caught:
                door(path)
            assert "\n" not in str(caught.value)
            assert path.name in str(caught.value)
        print(f"{path.name}: {caught.value}")


def test_nothing_in_a_file_is_executed(tmp_path):
    class Evil:
        def __reduce__(self):
            return Path.touch, (tmp_path / "EXECUTED",)

    memory = io.BytesIO()
    np.save(memory, np.array([Evil()], dtype=object), allow_pickle=True)
    y = array_head((1, 3)) + bytes(24)
    for members in ({"u.npy": memory.getvalue(), "y.npy": y}, {"u": pickle.dumps(Evil()), "y.npy": y}):
        refusal(npz(tmp_path / "pickle.npz", members), rate_hz=1.0)
    (tmp_path / "is-pickle.npz").write_bytes(pickle.dumps(Evil()))
    refusal(tmp_path / "is-pickle.npz")
    assert not (tmp_path / "EXECUTED").exists()


def test_circles_of_matlab_and_names_that_command_a_terminal(tmp_path):
    for name in ("group", "cell"):
        path = tmp_path / f"{name}.mat"
        with h5py.File(path, "w", userblock_size=512) as file:
            if name == "group":
                group = file.create_group("g")
                group["again"] = group
            else:
                cell = file.create_dataset("c", (1, 1), dtype=h5py.ref_dtype)
                cell[0, 0] = cell.ref
                cell.attrs["MATLAB_class"] = np.bytes_("cell")
        head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
        path.write_bytes(head + path.read_bytes()[128:])
        assert "circle" in refusal(path)
    path = tmp_path / "escape.csv"
    path.write_bytes(b"u \x1b]0;owned\x07\x1b[31m [V],y[V]\n1,2\n2,3\n3,5\n")
    assert "\x1b" not in repr([c.name for c in files.survey(path).channels]) + files.survey(path).channels[0].name
    (tmp_path / "wide.csv").write_text(",".join("1" * 20_000) + "\n")
    assert "columns" in refusal(tmp_path / "wide.csv")


def test_what_this_process_wrote_is_read_without_a_child(tmp_path, monkeypatch):
    path = files.save(Record([[1.0, 0.0]], [[0.1, 0.3]], rate_hz=10.0), tmp_path / "mine.h5")
    asked = []
    monkeypatch.setattr(archive, "confined", lambda read, *_, **__: asked.append(1) or read())
    files.load(path)
    assert not asked
    monkeypatch.setattr(archive, "_sound", {})
    assert files.load(path).outputs.tolist() == [[0.1, 0.3]]
    assert files.load(path).outputs.tolist() == [[0.1, 0.3]]
    assert len(asked) == 1


def test_two_arrays_of_one_name_and_more_than_anybody_records(tmp_path):
    memory = io.BytesIO()
    np.save(memory, np.ones((1, 50)))
    for names, said in ((["u", "u", "y"], "more than once"), ([f"m{k}" for k in range(10_001)], "up to 10000")):
        with warnings.catch_warnings(), zipfile.ZipFile(tmp_path / "odd.npz", "w") as archive:
            warnings.simplefilter("ignore")  # zipfile's own, of a name that it writes twice
            for name in names:
                archive.writestr(f"{name}.npy", memory.getvalue())
        with pytest.raises(StorageError, match=said):
            files.read_record(tmp_path / "odd.npz", 100.0, "u", "y")


@pytest.mark.gate("parquet")
@pytest.mark.parametrize("suffix", ["csv", "mat", "uff", "parquet", "npz", "h5"])
def test_a_process_that_has_imported_nothing_else_reads_it(tmp_path, suffix):
    """The child opens nothing: whatever a library imports on the way must be there before, pandas for Arrow too."""
    record, path = Record(np.arange(50.0)[None], np.ones((1, 50)), 100.0), tmp_path / f"plain.{suffix}"
    if suffix == "npz":
        np.savez(path, u=record.inputs, y=record.outputs)
    else:
        (files.save if suffix == "h5" else files.export_record)(record, path)
    chosen = ("u", "y") if suffix == "npz" else (None, None)
    code = f"from ultraquiet import files; print(files.read_record({str(path)!r}, 100.0, *{chosen!r}).samples)"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert told.stdout.strip() == "50", told.stderr[-300:]


def test_parquet_leaves_gaps_where_values_or_stamps_are_missing(tmp_path):
    stamps = pa.array([None, 5, 7_000_000, 9], pa.timestamp("ns"))
    count = pa.chunked_array([pa.array([1, None, 3], pa.int16()).slice(1), pa.array([4, None], pa.int16())])
    pq.write_table(pa.table({"t": stamps, "count": count}), tmp_path / "gaps.parquet")
    table = read_parquet("gaps.parquet", (tmp_path / "gaps.parquet").read_bytes())
    np.testing.assert_array_equal(table.columns[1].values, [np.nan, 3.0, 4.0, np.nan])
    assert np.isnan(table.columns[0].values).tolist() == [True, False, False, False]


@pytest.mark.parametrize("mark", ["\x1c", "\x1b[2J", "\x85", "\u2028", "\u202e", "\x00"])
def test_what_a_sentence_quotes_of_a_file_ends_no_line_and_commands_no_terminal(tmp_path, mark):
    path = tmp_path / "hurt.csv"
    path.write_text(f"time,gap\n0,1\n0.1,2\n0.2,3\n0.{mark}3,4\n0.4,5\n", encoding="utf-8")
    said = refusal(path, inputs=("gap",), outputs=())
    assert said.isprintable(), ascii(said)
    assert len(said.splitlines()) == 1
