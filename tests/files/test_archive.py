"""Archives return every value bit for bit, refuse what is not theirs, and never leave half a file."""

import errno
import os

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from ultraquiet import files
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet._base.provenance import Provenance
from ultraquiet.files import atomic
from ultraquiet.values import (
    Channel,
    FrequencyResponse,
    PolynomialMatrix,
    PolynomialModel,
    Record,
    StateSpace,
    Status,
    StatusWord,
)

finite = st.floats(allow_nan=False, allow_infinity=False)
rates = st.floats(min_value=1e-6, max_value=1e9)
names = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)  # no file holds half a pair of UTF-16


def arrays(*shape, elements=finite):
    return hnp.arrays(np.float64, shape, elements=elements)


@st.composite
def channel_values(draw):
    low = draw(st.one_of(st.just(-np.inf), finite))
    high = draw(st.one_of(st.just(np.inf), finite).filter(lambda high: high > low))
    return Channel(draw(names), draw(names), low, high)


def channel_lists(count):
    return st.one_of(st.none(), st.lists(channel_values(), min_size=count, max_size=count))


provenances = st.builds(
    Provenance,
    made_by=names,
    settings=st.dictionaries(names, st.one_of(finite, names, st.integers(-(2**70), 2**70), st.lists(finite))),
    seed=st.one_of(st.none(), st.integers(0, 2**128)),
    parents=st.lists(names, max_size=3).map(tuple),
    versions=st.dictionaries(names, names, max_size=2),
)
sizes = st.integers(1, 3)


@st.composite
def records(draw):
    nu, ny, n = draw(sizes), draw(sizes), draw(st.integers(1, 20))
    made = (draw(channel_lists(nu)), draw(channel_lists(ny)), draw(provenances))
    return Record(draw(arrays(nu, n)), draw(arrays(ny, n)), draw(rates), *made)


@st.composite
def state_spaces(draw):
    n, nu, ny = draw(st.integers(0, 4)), draw(sizes), draw(sizes)
    matrices = [draw(arrays(*shape)) for shape in ((n, n), (n, nu), (ny, n), (ny, nu))]
    made = (draw(channel_lists(nu)), draw(channel_lists(ny)), draw(provenances))
    return StateSpace(*matrices, draw(st.one_of(st.none(), rates)), *made)


@st.composite
def responses(draw):
    ny, nu, nf = draw(sizes), draw(sizes), draw(st.integers(0, 9))
    f_hz = draw(arrays(nf, elements=st.floats(0, 1e9)))
    values = draw(hnp.arrays(np.complex128, (ny, nu, nf)))  # NaN and infinities included: a gain may be unknown
    coherence = draw(st.one_of(st.none(), arrays(ny, nu, nf)))
    made = (draw(channel_lists(nu)), draw(channel_lists(ny)), draw(provenances))
    return FrequencyResponse(f_hz, values, coherence, draw(names), *made)


@st.composite
def polynomial_models(draw, nu=None, rate_hz=None):
    nu = nu or draw(sizes)

    def monic():
        return np.concatenate([[1.0], draw(arrays(draw(st.integers(0, 4))))])

    b = [draw(arrays(draw(st.integers(1, 4)))) for _ in range(nu)]
    noise = {k: monic() for k in "acd"}
    return PolynomialModel(b, [monic() for _ in b], rate_hz or draw(rates), **noise, noise_variance=draw(finite))


@st.composite
def polynomial_matrices(draw):
    ny, models, nu, rate_hz = draw(sizes), draw(sizes), draw(sizes), draw(rates)
    rows = [[draw(polynomial_models(nu, rate_hz)) for _ in range(models)] for _ in range(ny)]
    return PolynomialMatrix(rows, draw(channel_lists(models * nu)), draw(channel_lists(ny)), draw(provenances))


statuses = st.builds(Status, st.sampled_from(StatusWord), names)
values = st.one_of(records(), state_spaces(), responses(), polynomial_models(), polynomial_matrices(), statuses)


def bits(value):
    """All a value holds, arrays as bytes, so that NaN and -0.0 count."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, tuple):
        return tuple(bits(v) for v in value)
    if isinstance(value, float):
        return np.float64(value).tobytes()
    if isinstance(value, Provenance):
        return value.to_json()
    if hasattr(value, "__dataclass_fields__"):
        return type(value), tuple((k, bits(getattr(value, k))) for k in value.__dataclass_fields__)
    return value


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("archives")


@settings(max_examples=150, deadline=None)
@given(value=values)
def test_every_value_returns_bit_for_bit(folder, value):
    path = files.save(value, folder / "one.h5")
    assert bits(files.load(path)) == bits(value)
    assert not list(folder.glob(".*.part"))


@settings(max_examples=30, deadline=None)
@given(held=st.dictionaries(st.text("abc .µ-7", min_size=1).filter(lambda n: n != "."), values, max_size=4))
def test_several_values_in_one_file(folder, held):
    path = files.save_many(held, folder / "many.h5")
    back = files.load_many(path)
    assert list(back) == list(held)
    assert {name: bits(v) for name, v in back.items()} == {name: bits(v) for name, v in held.items()}
    assert list(files.contents(path)) == list(held)


def record(rng):
    return Record(rng.standard_normal((2, 50)), rng.standard_normal((3, 50)), rate_hz=3500.0)


def test_equal_values_make_equal_files(rng, tmp_path):
    value = record(rng)
    first, second = files.save(value, tmp_path / "a.h5"), files.save(value, tmp_path / "b.h5")
    assert first.read_bytes() == second.read_bytes()


def test_one_of_several_by_name(rng, tmp_path):
    value = record(rng)
    path = files.save_many({"first": Status("ok", "yes"), "second": value}, tmp_path / "two.h5")
    assert files.load(path, "second").hash == value.hash
    assert files.contents(path) == {"first": "status", "second": "record"}
    with pytest.raises(StorageError, match="holds 2 values \\(first, second\\)"):
        files.load(path)
    with pytest.raises(StorageError, match="holds no 'third', only first, second"):
        files.load(path, "third")


@pytest.mark.parametrize("name", ["", ".", "a/b", "a\0b", "a\nb"])
def test_names_that_hdf5_cannot_carry(name, tmp_path):
    with pytest.raises(InputError, match="cannot name a value"):
        files.save_many({name: Status("ok", "")}, tmp_path / "x.h5")


def test_what_is_no_value_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot hold a dict"):
        files.save({}, tmp_path / "x.h5")  # pyright: ignore[reportArgumentType]
    assert not list(tmp_path.iterdir())


def test_a_taken_name_is_kept_unless_asked(rng, tmp_path):
    path = files.save(record(rng), tmp_path / "kept.h5")
    before = path.read_bytes()
    with pytest.raises(StorageError, match="exists already"):
        files.save(Status("ok", ""), path, overwrite=False)
    assert path.read_bytes() == before
    files.save(Status("ok", ""), path)
    assert files.load(path) == Status("ok", "")


def test_a_name_taken_on_the_way_is_kept(rng, tmp_path, monkeypatch):
    path = tmp_path / "raced.h5"
    through = atomic._write_through

    def race(part, data):
        through(part, data)
        path.write_bytes(b"theirs")

    monkeypatch.setattr(atomic, "_write_through", race)
    with pytest.raises(StorageError, match="exists already"):
        files.save(record(rng), path, overwrite=False)
    assert path.read_bytes() == b"theirs"
    assert [p.name for p in tmp_path.iterdir()] == ["raced.h5"]


def test_a_link_stays_a_link(rng, tmp_path):
    files.save(record(rng), tmp_path / "real.h5")
    (tmp_path / "link.h5").symlink_to(tmp_path / "real.h5")
    files.save(Status("ok", ""), tmp_path / "link.h5")
    assert (tmp_path / "link.h5").is_symlink()
    assert files.load(tmp_path / "real.h5") == Status("ok", "")


@pytest.mark.parametrize("fails", ["fsync", "write", "open", "replace"])
def test_a_failing_disk_leaves_what_was_there(fails, rng, tmp_path, monkeypatch):
    path = files.save(record(rng), tmp_path / "kept.h5")
    before = path.read_bytes()

    def full(*_args, **_kwargs):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    target = {"fsync": "os.fsync", "write": "_write_through", "open": "os.open", "replace": "_take_name"}[fails]
    monkeypatch.setattr(f"ultraquiet.files.atomic.{target}", full)
    with pytest.raises(StorageError, match=r"no space left on device.*untouched") as caught:
        files.save(Status("ok", ""), path)
    assert str(caught.value).count("\n") == 0
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["kept.h5"]


def test_a_missing_folder_is_named(rng, tmp_path):
    with pytest.raises(StorageError, match="no such file or directory"):
        files.save(record(rng), tmp_path / "nowhere" / "x.h5")


def test_foreign_files_are_refused_in_one_sentence(tmp_path):
    with pytest.raises(StorageError, match="no such file"):
        files.load(tmp_path / "missing.h5")
    (tmp_path / "text.h5").write_text("time,volts\n0,1\n")
    with pytest.raises(StorageError, match="is not an HDF5 file"):
        files.load(tmp_path / "text.h5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = [1.0]
    with pytest.raises(StorageError, match="by another program"):
        files.load(tmp_path / "other.h5")
    assert not files.is_archive(tmp_path / "other.h5")


def test_a_newer_format_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("ultraquiet.files.archive.FORMAT_VERSION", 99)
    path = files.save(Status("ok", ""), tmp_path / "newer.h5")
    monkeypatch.undo()
    with pytest.raises(StorageError, match="format version 99"):
        files.load(path)


def test_content_of_the_wrong_shape_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("ultraquiet.files.archive.pack", lambda _: ("record", {"inputs": np.zeros((1, 2))}))
    path = files.save(Status("ok", ""), tmp_path / "odd.h5")
    with pytest.raises(StorageError, match=r"'value' in '.*' is no valid record"):
        files.load(path)


def test_any_hdf5_reader_reads_it(rng, tmp_path):
    value = record(rng)
    with h5py.File(files.save(value, tmp_path / "x.h5"), "r") as file:
        assert file.attrs["format"] == "ultraquiet"
        assert np.array_equal(file["value/outputs"][()], value.outputs)  # pyright: ignore[reportIndexIssue]


def test_damage_gives_a_sentence_or_the_very_value(rng, tmp_path):
    """Flip bytes and cut tails anywhere: never another exception, never another value."""
    value = record(rng)
    whole = files.save(value, tmp_path / "whole.h5").read_bytes()
    hurt = tmp_path / "hurt.h5"
    refused, sentences = 0, set()
    for _ in range(150):
        data = bytearray(whole)
        if rng.random() < 0.3:
            del data[int(rng.integers(len(data))) :]
        else:
            for k in rng.integers(len(data), size=int(rng.integers(1, 20))):
                data[k] ^= int(rng.integers(1, 256))
        hurt.write_bytes(data)
        try:
            assert bits(files.load(hurt)) == bits(value)
        except StorageError as error:
            refused += 1
            sentences.add(str(error))
    print(f"damaged files refused: {refused} of 150, the others read back exactly")
    assert refused > 0
    assert not any("\n" in sentence for sentence in sentences)
