"""Every format there and back: samples, names, units, roles and the rate."""

import io

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from matlab import matlab_73
from nptdms import ChannelObject, TdmsWriter
from scipy.io import wavfile

from ultraquiet import files
from ultraquiet._base.errors import InputError
from ultraquiet.files import formats
from ultraquiet.files.table import Column, FileTable
from ultraquiet.values import Channel, Record

read = files.read_record

# Largest relative departure of a sample: nothing but UFF as text rounds, to the twelve digits that pyuff prints.
RESOLUTION = {"csv": 0.0, "mat": 0.0, "uff": 0.0, "unv text": 6e-12, "parquet": 0.0, "h5": 0.0}

letters = st.characters(exclude_categories=("Cs", "Cc", "Zl", "Zp", "Zs"), exclude_characters="[]()/")
words = st.text(letters, min_size=1, max_size=20).filter(lambda text: text != "NONE")
names = st.lists(words, min_size=1, max_size=3).map(" ".join)
channel = st.builds(Channel, names, st.one_of(st.just(""), words))


@st.composite
def records(draw):
    """Records of any shape from two samples on, with any names that stand in a line, twins between in and out too."""
    samples = draw(st.integers(2, 12))
    floats = st.floats(-1e300, 1e300, allow_subnormal=False)
    sides = [draw(st.lists(channel, min_size=1, max_size=4)) for _ in range(2)]
    rows = [[draw(st.lists(floats, min_size=samples, max_size=samples)) for _ in side] for side in sides]
    rate_hz = draw(st.one_of(st.sampled_from([3500.0, 2048.0, 44100.0, 1 / 3]), st.floats(1e-3, 1e6)))
    return Record(rows[0], rows[1], rate_hz, *sides)


def same(back, record, resolution):
    for got, sent in ((back.inputs, record.inputs), (back.outputs, record.outputs)):
        np.testing.assert_allclose(got, sent, rtol=resolution, atol=0)
    for got, sent in ((back.actuators, record.actuators), (back.sensors, record.sensors)):
        assert [(c.name, c.unit) for c in got] == [(c.name, c.unit) for c in sent]


@pytest.mark.gate("csv")
@pytest.mark.parametrize("kind", RESOLUTION)
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(record=records())
def test_there_and_back(tmp_path_factory, kind, record):
    suffix, _, text = kind.partition(" ")
    path = tmp_path_factory.mktemp("back") / f"run.{suffix}"
    back = read(files.export_record(record, path, text=bool(text)))
    same(back, record, RESOLUTION[kind])
    # Time stamps of CSV tell the rate but for the rounding of the last one; the other formats state it.
    assert back.rate_hz == pytest.approx(record.rate_hz, rel=1e-12 if suffix == "csv" else 0)
    if suffix in ("h5", "parquet"):
        assert [(c.low, c.high) for c in back.sensors] == [(c.low, c.high) for c in record.sensors]


@pytest.mark.parametrize("rate_hz", [3500.0, 1024.0, 44100.0, 12.5, 1000 / 3])
def test_csv_gives_the_very_rate_back(tmp_path, rng, rate_hz):
    record = Record(rng.standard_normal((1, 5000)), rng.standard_normal((1, 5000)), rate_hz)
    assert read(files.export_record(record, tmp_path / "a.csv")).rate_hz == rate_hz


def test_all_formats_one_after_the_other(tmp_path, rng):
    """A record that went through every exact format is the record that set out."""
    sides = [Channel("strut 1", "V", -25.0, 25.0)], [Channel("strut 1", "m/s²"), Channel("Геофон", "µm")]
    record = back = Record(rng.standard_normal((1, 500)), rng.standard_normal((2, 500)), 3500.0, *sides)
    for suffix in ("csv", "mat", "uff", "parquet", "h5", "unv"):
        back = read(files.export_record(back, tmp_path / f"run.{suffix}"))
        assert back.hash == record.hash, suffix
        same(back, record, 0.0)


def test_sep005_there_and_back(rng):
    twins = Record(rng.standard_normal((1, 9)), rng.standard_normal((2, 9)), 3500.0, ["a"], [Channel("a", "g"), "b"])
    signals = files.to_sep005(twins)
    # What the standard asks of each channel, and what it forbids.
    assert len({signal["name"] for signal in signals}) == 3
    for signal in signals:
        assert {"data", "name", "fs", "unit_str"} <= set(signal)
        assert not {"unit", "timestamp", "signal", "sample_frequency", "Fs"} & set(signal)
        assert isinstance(signal["data"], np.ndarray)
    back = files.from_sep005(signals)
    assert back.hash == twins.hash
    same(back, twins, 0.0)


def test_sep005_of_others(rng):
    data, time = rng.standard_normal((2, 8)), np.arange(8) / 250.0
    signals = [
        {"data": data[0], "name": "force", "unit_str": "N", "time": time},
        {"data": data, "name": "rig", "unit_str": None, "fs": 250},
    ]
    record = files.from_sep005(signals, inputs="force", outputs="rig:2")
    assert (record.rate_hz, record.actuators[0].unit, record.sensors[0].name) == (250.0, "N", "rig:2")
    assert np.array_equal(record.outputs[0], data[1])
    with pytest.raises(InputError, match=r"signal 1 \('x'\) lacks unit_str"):
        files.from_sep005({"data": time, "name": "x", "fs": 1})
    with pytest.raises(InputError, match=r"differ in rate: force \(250 Hz\), slow \(10 Hz\)"):
        files.from_sep005([signals[0], {"data": time, "name": "slow", "unit_str": "", "fs": 10}], "force", "slow")
    with pytest.raises(InputError, match=r"'force' has 8 samples but time of shape \(3,\)"):
        files.from_sep005([{**signals[0], "time": time[:3]}], "force", "force")


def tdms(path, rng, **changes):
    """Two groups as LabVIEW writes them: a force, and two accelerometers."""
    told = {"wf_increment": 1 / 3500, "wf_start_offset": 0.0, "unit_string": "N"}
    held = {name: rng.standard_normal(64) for name in ("force", "accel 1", "accel 2")}
    with TdmsWriter(str(path)) as writer:
        for name, values in held.items():
            own = {**told, "unit_string": "N" if name == "force" else "m/s²", **changes.get(name.replace(" ", "_"), {})}
            group = "drive" if name == "force" else "response"
            writer.write_segment([ChannelObject(group, name, values[: own.pop("samples", None)], own)])
    return held


def test_tdms(tmp_path, rng):
    held = tdms(tmp_path / "run.tdms", rng)
    record = read(tmp_path / "run.tdms", inputs="force", outputs="accel 1,accel 2")
    assert record.rate_hz == 3500.0
    assert [(c.name, c.unit) for c in record.sensors] == [("accel 1", "m/s²"), ("accel 2", "m/s²")]
    assert np.array_equal(record.inputs[0], held["force"])
    assert np.array_equal(record.outputs, [held["accel 1"], held["accel 2"]])


MISFITS = {
    "rates": ({"accel_1": {"wf_increment": 1e-3}}, r"differ in rate: force \(3500 Hz\), accel 1 \(1000 Hz\)"),
    "lengths": ({"accel_1": {"samples": 60}}, r"differ in length: force \(64\), accel 1 \(60\)"),
    "starts": ({"accel_1": {"wf_start_offset": 0.5}}, r"do not start together: force \(0 s\), accel 1 \(0\.5 s\)"),
}


@pytest.mark.parametrize("misfit", MISFITS)
def test_tdms_channels_that_do_not_fit(tmp_path, rng, misfit):
    changes, told = MISFITS[misfit]
    tdms(tmp_path / "run.tdms", rng, **changes)
    with pytest.raises(InputError, match=told):
        read(tmp_path / "run.tdms", inputs="force", outputs="accel 1")
    assert read(tmp_path / "run.tdms", inputs="force", outputs="accel 2").samples == 64


@pytest.mark.parametrize("kind", ["uint8", "int16", "int24", "int32", "float32", "float64"])
def test_wav(tmp_path, rng, kind):
    sent = np.clip(rng.uniform(-1, 1, (50, 3)), -1, 1)
    sent[0] = -1.0
    bits = int(kind.lstrip("abcdefghijklmnopqrstuvwxyz"))
    if kind.startswith("float"):
        stored = sent.astype(kind)
        wavfile.write(tmp_path / "a.wav", 48000, stored)
        expected = stored.astype(float)
    else:
        steps = np.clip(np.round(sent * 2 ** (bits - 1)), -(2 ** (bits - 1)), 2 ** (bits - 1) - 1).astype(np.int64)
        expected = steps / 2.0 ** (bits - 1)
        write_whole(tmp_path / "a.wav", steps, bits)
    record = read(tmp_path / "a.wav", inputs="channel 1", outputs="2-3")
    assert record.rate_hz == 48000.0
    assert np.array_equal(np.vstack([record.inputs, record.outputs]), expected.T)
    assert record.sensors[0].unit == ("" if kind.startswith("float") else "FS")


def write_whole(path, steps, bits):
    """WAV of any number of bits, which SciPy does not write for 24."""
    import wave

    raw = (steps + 128).astype("u1") if bits == 8 else steps.astype("<i4").view("u1").reshape(*steps.shape, 4)
    with wave.open(str(path), "wb") as file:
        file.setnchannels(steps.shape[1])
        file.setsampwidth(bits // 8)
        file.setframerate(48000)
        file.writeframes(np.ascontiguousarray(raw if bits == 8 else raw[..., : bits // 8]).tobytes())


def test_parquet_of_others(tmp_path):
    stamps = pa.array(np.datetime64("2026-01-01") + np.arange(4) * np.timedelta64(2, "ms"))
    force = pa.field("force", pa.float32(), metadata={"unit": "N"})
    schema = pa.schema(
        [pa.field("time", stamps.type), force, pa.field("count", pa.int16()), pa.field("word", pa.string())]
    )
    arrays = [stamps, pa.array([1, 2, 3, 4], pa.float32()), pa.array([5, 6, None, 8], pa.int16()), pa.array(["a"] * 4)]
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), tmp_path / "a.parquet")
    with pytest.raises(InputError, match=r"'count' of .* has 1 NaN or infinite values, the first at sample 2"):
        read(tmp_path / "a.parquet", inputs="force", outputs="count")
    record = read(tmp_path / "a.parquet", inputs="force", outputs="force")
    assert (record.rate_hz, record.actuators[0].unit, record.inputs.tolist()) == (500.0, "N", [[1.0, 2.0, 3.0, 4.0]])


def test_hdf5_of_others(tmp_path, rng):
    u, y = rng.standard_normal(40), rng.standard_normal((40, 2))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["sample_rate"] = 2000
        run = file.create_group("run 1")
        run["force"], run["accel"] = u, y
        run["force"].attrs["units"] = "N"
        run["accel"].attrs.update({"names": ["left", "ri ght"], "unit": "g"})
        run["table"] = np.array([(1.0, 2)] * 40, dtype=[("p", "f8"), ("q", "i4")])
        file["remark"] = "text"
    record = read(tmp_path / "a.h5", inputs="run 1.force", outputs="run 1.accel")
    assert (record.rate_hz, record.actuators[0].unit) == (2000.0, "N")
    assert [(c.name, c.unit) for c in record.sensors] == [("left", "g"), ("ri ght", "g")]
    assert np.array_equal(record.inputs[0], u)
    assert np.array_equal(record.outputs, y.T)
    assert read(tmp_path / "a.h5", inputs="run 1.table.p", outputs="ri ght").samples == 40


@pytest.mark.parametrize("samples", [2, 3, 40])
def test_mat_version_73_with_names(tmp_path, rng, samples):
    u, y = rng.standard_normal((samples, 1)), rng.standard_normal((samples, 3))
    held = {
        "run/u": u,
        "run/y": y,
        "run/fs": 3500.0,
        "run/y_names": ["acc 1", "Ünit", "z"],
        "run/y_units": ["g", "m", "V"],
    }
    held["run/u_names"] = ["drive"]
    matlab_73(tmp_path / "a.mat", held)
    record = read(tmp_path / "a.mat")
    assert (record.rate_hz, record.actuators[0].name) == (3500.0, "drive")
    assert [(c.name, c.unit) for c in record.sensors] == [("acc 1", "g"), ("Ünit", "m"), ("z", "V")]
    assert np.array_equal(record.inputs, u.T)
    assert np.array_equal(record.outputs, y.T)


def test_our_mat_is_plain_matlab(tmp_path, rng):
    record = Record(rng.standard_normal((2, 30)), rng.standard_normal((3, 30)), 3500.0)
    held = scipy.io.loadmat(files.export_record(record, tmp_path / "a.mat"), simplify_cells=True)
    assert (held["u"].shape, held["y"].shape, held["fs"]) == ((30, 2), (30, 3), 3500.0)


def test_our_uff_counts_its_bytes(tmp_path, rng):
    """Readers that trust the head of a binary set find it right: it says as many bytes as stand there."""
    record = Record(rng.standard_normal((1, 30)), rng.standard_normal((1, 30)), 3500.0)
    data = files.export_record(record, tmp_path / "a.uff").read_bytes()
    head = io.BytesIO(data).readlines()[1]
    assert int(head[31:43]) == 240
    assert data.count(b"    -1\n") == 4


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # pyuff leaves a handle open
@pytest.mark.parametrize("kind", ["text", "binary"])
def test_uff_of_others(tmp_path, rng, kind):
    """Names by node and direction, the rate from a step of six digits, the unit from the label."""
    import pyuff

    path = tmp_path / "a.unv"
    values = rng.standard_normal((2, 70))
    for k, row in enumerate(values):
        told = {"binary": int(kind == "binary"), "func_type": 1, "rsp_node": 12 + k, "rsp_dir": -3 if k else 1}
        ids = {"id1": "Wing, run 4", "ordinate_axis_units_lab": "m/s^2", "abscissa_spacing": 1}
        stamps = {"x": np.arange(70) / 3500, "data": row, "ref_node": 0, "ref_dir": 0, "type": 58}
        axes = {"orddenom_spec_data_type": 0, "abscissa_spec_data_type": 17}
        pyuff.UFF(str(path)).write_sets({**told, **ids, **stamps, **axes}, mode="add")
    record = read(path, inputs="12 +X", outputs="13 -Z")
    assert (record.rate_hz, record.sensors[0].unit) == (3500.0, "m/s^2")
    np.testing.assert_allclose(record.outputs[0], values[1], rtol=0 if kind == "binary" else 6e-12)


def read_pairs(name, data):
    """A format that nobody has: input and output alternate, two a sample."""
    u, y = np.frombuffer(data, "<f8").reshape(-1, 2).T
    return FileTable(name, (Column("u", u.copy(), rate_hz=10.0), Column("y", y.copy(), rate_hz=10.0)))


def write_pairs(record):
    return np.vstack([record.inputs, record.outputs]).T.astype("<f8").tobytes()


def test_a_new_format_is_a_reader_and_one_line(tmp_path, monkeypatch):
    added = formats.Format("pairs", (".pairs",), read_pairs, write_pairs)
    monkeypatch.setattr(formats, "FORMATS", (*formats.FORMATS, added))
    record = Record([[1.0, 2.0, 3.0]], [[0.5, -1.0, 0.25]], 10.0)
    path = files.export_record(record, tmp_path / "run.pairs")
    same(read(path), Record(record.inputs, record.outputs, 10.0, [Channel("u", "")], [Channel("y", "")]), 0.0)
    assert files.survey(path).format == "pairs"
    with pytest.raises(InputError, match=r"\.pairs"):
        read(tmp_path / "run.unknown")
