"""Folders that somebody sent, with links that lead out, pipes, circles: nothing outside is written, nothing waits."""

import os
import shutil
import sqlite3
import zipfile
from pathlib import Path

import numpy as np
import pytest
import tiny_study

from ultraquiet import experiments
from ultraquiet._base.errors import InputError, StorageError, UltraquietError
from ultraquiet.deploy.c_code.output_folder import rewrite
from ultraquiet.experiments import journal
from ultraquiet.pipeline.store.contents import hash_of
from ultraquiet.pipeline.store.lock import locked
from ultraquiet.pipeline.store.own import FILES, ROOMS
from ultraquiet.pipeline.store.sources import place_beside as located
from ultraquiet.pipeline.tables.matrices import matrix_of

INSIDE = (*FILES, *ROOMS, "records/list.key", "stages/plant.json", "code/calm", "code/calm/README.md", "models/x.h5")


def held(folder):
    with locked(folder, lambda _: None):
        pass


def under(folder, name):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("name", INSIDE)
def test_a_link_out_of_a_study_is_refused_before_anything_is_written(name, there, tmp_path):
    victim, folder = tmp_path / "victim", tmp_path / "study"
    if there:
        victim.write_text("mine")
    under(folder, name).symlink_to(victim)
    with pytest.raises(StorageError, match=rf"'{folder / name}' is a link that leads out"):
        held(folder)
    assert sorted(os.listdir(tmp_path)) == (["study", "victim"] if there else ["study"])
    assert not there or victim.read_text() == "mine"
    assert (folder / name).is_symlink()
    assert not (folder / "study.lock").exists() or name == "study.lock"


@pytest.mark.parametrize("name", INSIDE)
def test_a_circle_or_a_pipe_in_a_study_is_refused(name, tmp_path):
    path = under(tmp_path, name)
    path.symlink_to(path.name)
    with pytest.raises(StorageError, match="leads out of its folder"):
        held(tmp_path)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(StorageError, match="is a device or a pipe, no file"):
        held(tmp_path)


def test_links_that_stay_and_what_is_not_the_studys_are_its_owners_affair(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "records").symlink_to("disk")
    (tmp_path / "papers").symlink_to("/etc")
    held(tmp_path)


def test_the_end_of_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    assert hash_of(tmp_path / "pipe") == ""


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("loop.toml", r"'.*/loop.toml' cannot be read \(too many levels of symbolic links\)"),
        ("fifo.toml", r"'.*/fifo.toml' cannot be read \(it is a pipe, no file\)"),
        ("none.toml", r"'.*/none.toml' cannot be read \(no such file"),
        (".", r"cannot be read \(is a directory\)"),
        ("a\0b.toml", r"'a.x00b.toml' is no name of a file"),
        ("n" * 300, r"'n+ is no name of a file \(file name too long\)"),
        ("n/" * 3000, r"'[n/]+ is no name of a file \(file name too long\)"),
    ],
    ids=["circle", "pipe", "nothing", "folder", "NUL", "long", "longer"],
)
def test_a_file_of_a_study_that_is_none_is_one_sentence(name, words, tmp_path):
    (tmp_path / "loop.toml").symlink_to("loop.toml")
    os.mkfifo(tmp_path / "fifo.toml")
    text = tiny_study.STUDY.replace('"list.toml"', f'"{name}"'.replace("\0", "\\u0000"))
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(UltraquietError, match=words):
        tiny_study.walk(tmp_path / "study.toml", tmp_path / "out")


def test_a_record_is_called_by_the_name_that_the_study_gives_it(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "run.h5").symlink_to(tmp_path / "elsewhere" / "other.h5")
    assert located("run.h5", tmp_path) == tmp_path / "run.h5"
    assert located("elsewhere/../run.h5", tmp_path) == tmp_path / "run.h5"


def test_a_bench_whose_name_is_too_long_for_the_system_is_no_file(tmp_path):
    text = tiny_study.STUDY.replace('method = "one-mass"', f'object = "{"n" * 300}.py:make"')
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(InputError, match="there is no file"):
        tiny_study.walk(tmp_path / "study.toml", tmp_path / "out")


def test_matrices_are_read_as_foreign_files_are(tmp_path):
    os.mkfifo(tmp_path / "fifo.csv")
    (tmp_path / "zero.csv").symlink_to("/dev/zero")
    with (
        zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as bomb,
        bomb.open("sensors.npy", "w") as out,
    ):
        np.lib.format.write_array_header_1_0(out, {"descr": "<f8", "fortran_order": False, "shape": (1 << 13, 1 << 13)})
        for _ in range(64):
            out.write(bytes(1 << 20))
    np.savez(tmp_path / "object.npz", sensors=np.array([{}], dtype=object))
    np.savez(tmp_path / "good.npz", sensors=np.eye(3))
    assert np.array_equal(matrix_of("sensors", "good.npz", tmp_path), np.eye(3))
    for name, words in (
        ("fifo.csv", "it is a pipe, no file"),
        ("zero.csv", "it is a device, no file"),
        ("bomb.npz", "cut"),
        ("object.npz", "holds no array 'sensors', only none"),
        ("a\0b.csv", "null byte"),
    ):
        with pytest.raises(InputError, match=words):
            matrix_of("sensors", name, tmp_path)


def test_a_journal_that_leads_out_of_its_folder_is_left_alone(tmp_path):
    (tmp_path / "victim").write_text("mine")
    (tmp_path / "records").mkdir()
    (tmp_path / "records" / journal.FILE).symlink_to(tmp_path / "victim")
    with pytest.raises(StorageError, match="leads out of its folder"), journal.opened(tmp_path / "records"):
        pass
    assert (tmp_path / "victim").read_text() == "mine"


@pytest.mark.parametrize("ending", ["", "-wal", "-journal"])
def test_a_catalogue_that_leads_out_of_its_folder_is_made_in_memory(ending, tmp_path):
    victim, records = tmp_path / "victim", tmp_path / "records"
    with sqlite3.connect(victim) as base:
        base.execute("CREATE TABLE runs (mine)")
    base.close()
    before = victim.read_bytes()
    records.mkdir()
    (records / f"catalogue.sqlite{ending}").symlink_to(victim)
    assert experiments.find(records) == ()
    assert victim.read_bytes() == before
    (records / f"catalogue.sqlite{ending}").unlink()
    os.mkfifo(records / f"catalogue.sqlite{ending}")
    assert experiments.find(records) == ()


def test_rewritten_code_follows_no_link(tmp_path):
    (tmp_path / "victim").write_text("mine")
    folder = tmp_path / "code"
    folder.mkdir()
    for name in ("README.md", ".README.md.new"):
        (folder / name).symlink_to(tmp_path / "victim")
    rewrite(folder, {"README.md": "ours"})
    assert (tmp_path / "victim").read_text() == "mine"
    assert (folder / "README.md").read_text() == "ours"
    assert not (folder / "README.md").is_symlink()
    assert (folder / "README.md").stat().st_mode & 0o777 == 0o644


@pytest.fixture
def swiftly():
    """Nothing is computed or drawn twice, and no compiler found, while a test runs, and not after it."""
    with tiny_study.swiftly():
        yield


@pytest.mark.slow
@pytest.mark.usefixtures("swiftly")
@pytest.mark.parametrize("fresh", [False, True])
def test_everything_that_a_study_leaves_replaced_by_a_link_out(fresh, tmp_path):
    source, whole, folder, outside = (tmp_path / name for name in ("source", "whole", "folder", "outside"))
    source.mkdir()
    study = tiny_study.written(source)
    tiny_study.walk(study, whole)
    for name in sorted(path.relative_to(whole).as_posix() for path in whole.rglob("*")):
        shutil.rmtree(folder, ignore_errors=True)
        shutil.rmtree(outside, ignore_errors=True)
        outside.mkdir()
        if not fresh:
            shutil.copytree(whole, folder)
            (folder / name).rename(outside / "victim")
        else:
            (outside / "victim").write_text("mine")
        under(folder, name).symlink_to(outside / "victim")
        before = contents(outside)
        with pytest.raises(StorageError, match="leads out of its folder") as caught:
            tiny_study.walk(study, folder)
        assert name in str(caught.value)
        assert contents(outside) == before
        print(f"{name}: {caught.value}")


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
