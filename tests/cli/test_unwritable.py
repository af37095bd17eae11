"""What cannot be written: one sentence, exit code 2, and nothing of it on the disk, whichever command writes."""

import importlib
import importlib.util
import os
import resource
import shlex
import shutil
import sys

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import StorageError
from ultraquiet.cli.output.options import with_options

RATE_HZ = 500.0
LIST = """
title = "short"
[bench]
method = "hexapod"
[[commands]]
do = "record"
name = "rest"
samples = 300
"""
OF_FILES = """
[study]
title = "mine"
[records]
files = ["record.h5"]
[plant]
method = "subspace"
order = 2
[controllers.quiet.design]
method = "lqg"
[deploy]
limits = 5.0
"""
DRAWN = """
[study]
title = "drawn"
[bench]
method = "hexapod"
[plant]
method = "rational"
records = ["low"]
period_samples = 7000
[controllers.quiet.design]
method = "lqg"
"""
FILES = {
    "convert to text": "convert record.h5 {}.csv",
    "convert to MAT": "convert record.h5 {}.mat",
    "convert to HDF5": "convert record.h5 {}.h5",
    "convert to UFF": "convert record.h5 {}.uff",
    "convert a response": "convert --response response.npz {}.h5",
    "identify": "identify record.h5 --method arx --order 2 --out {}.h5",
    "design": "design plant.h5 --method lqg --out {}.h5",
    "spectra": "spectra record.h5 --out {}.svg",
    "deploy an FMU": "deploy law.h5 --limits 5 --target none --steps 100 --fmu {}.fmu",
    "deploy a table": "deploy law.h5 --limits 5 --target none --steps 100 --export {}.mat",
}
FOLDERS = {
    "analyse": "analyse plant.h5 law.h5 --out {}",
    "deploy": "deploy law.h5 --limits 5 --target none --steps 100 --out {}",
    "deploy in fixed point": "deploy law.h5 --limits 5 --range 5 --precision q31 --steps 100 --out {}",
    "deploy a project": "deploy law.h5 --limits 5 --target none --steps 100 --project {}",
    "run": "run files.toml --out {}",
    "campaign": "campaign drawn.toml --out {}",
    "demo": "demo --quick --out {}",
    "experiment": "experiment list.toml --out {}",
    "serve": "serve {} --no-open --port 0",
}
LONG = "n" * 300
# Where a file cannot be, by where it is sought.
NO_FILE = {
    "a file for a folder": "notes.txt/out",
    "a folder that is not there": "missing/out",
    "a long name": LONG,
    "a folder of a long name": f"{LONG}/out",
    "a link to nowhere": "lost",
    "a link to itself": "loop",
    "a place of the system": "/proc/out",
    "a folder": "taken",
    "a pipe": "pipe",
}
NO_FOLDER = {
    "a file for a folder": "notes.txt/out",
    "a file": "notes.txt",
    "a long name": LONG,
    "a folder of a long name": f"{LONG}/out",
    "a link to itself": "loop",
    "a place of the system": "/proc/out",
    "a pipe": "pipe",
}


# One command tries every place, the others those that they could meet differently; pictures are never written over.
NO_FILES = [("identify", place, force) for place in NO_FILE for force in ("", " --force")]
NO_FILES += [(c, place, "") for c in FILES for place in ("a file for a folder", "a long name", "a place of the system")]
NO_FILES += [(c, "a pipe", " --force") for c in FILES if c != "spectra"]
NO_FILES = list(dict.fromkeys(NO_FILES))
NO_FOLDERS = [("analyse", place) for place in NO_FOLDER]
NO_FOLDERS += [(c, place) for c in FOLDERS for place in ("a file for a folder", "a long name", "a link to itself")]
NO_FOLDERS = list(dict.fromkeys(NO_FOLDERS))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    rng = np.random.default_rng(1)
    u = rng.standard_normal((1, 600))
    plant = uq.StateSpace([[0.8]], [[0.5]], [[1.0]], [[0.0]], RATE_HZ)
    uq.files.save(uq.Record(u, plant.simulate(u) + 0.01 * rng.standard_normal((1, 600)), RATE_HZ), folder / "record.h5")
    uq.files.save(plant, folder / "plant.h5")
    uq.files.save(uq.StateSpace([[0.5]], [[0.1]], [[-0.1]], [[0.0]], RATE_HZ), folder / "law.h5")
    np.savez(folder / "response.npz", f_hz=np.arange(1.0, 5.0), G=np.ones((1, 1, 4), dtype=complex))
    (folder / "list.toml").write_text(LIST)
    (folder / "files.toml").write_text(OF_FILES)
    (folder / "drawn.toml").write_text(DRAWN)
    (folder / "notes.txt").write_text("mine\n")
    return folder


@pytest.fixture
def folder(made, tmp_path):
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    for suffix in ("", ".csv", ".mat", ".h5", ".uff", ".svg", ".fmu"):
        (tmp_path / f"lost{suffix}").symlink_to(tmp_path / "gone" / f"out{suffix}")
        (tmp_path / f"loop{suffix}").symlink_to(f"loop{suffix}")
        (tmp_path / f"taken{suffix}").mkdir()
        os.mkfifo(tmp_path / f"pipe{suffix}")
    return tmp_path


def everything(folder):
    return sorted((str(path.relative_to(folder)), path.lstat().st_mode) for path in folder.rglob("*"))


def refused(run, folder, words, named):
    """Run a command that must refuse, and return its one sentence."""
    before = everything(folder)
    code, out, err = run(*shlex.split(words))
    print(err, end="")
    assert code == 2, (code, out, err)
    assert err.startswith("ultraquiet: ")
    assert err.count("\n") == 1
    assert named[:20] in err
    assert not out.strip()
    assert everything(folder) == before


@pytest.mark.parametrize(("command", "place", "force"), NO_FILES, ids="-".join)
def test_a_file_that_cannot_be_there(run, folder, command, place, force):
    refused(run, folder, FILES[command].format(NO_FILE[place]) + force, NO_FILE[place].split("/")[0] or "/proc")


@pytest.mark.parametrize(("command", "place"), NO_FOLDERS, ids="-".join)
def test_a_folder_that_cannot_be_there(run, folder, command, place):
    refused(run, folder, FOLDERS[command].format(NO_FOLDER[place]), NO_FOLDER[place].split("/")[0] or "/proc")


@pytest.fixture
def full_disk(monkeypatch):
    """No file may grow beyond a few bytes, as on a disk that is full."""
    pytest.importorskip("joblib")  # asks for a semaphore when it is imported, which is a file too
    # Python keeps a file of bytecode as far as it could be written, for every later process: not the suite's own.
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

    class Full:
        def __enter__(self):
            resource.setrlimit(resource.RLIMIT_FSIZE, (16, hard))

        def __exit__(self, *_):
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

    return Full()


@pytest.mark.parametrize("command", [*FILES, "analyse", "deploy", "deploy in fixed point", "run", "experiment"])
def test_a_full_disk(run, folder, full_disk, command):
    words = shlex.split({**FILES, **FOLDERS}[command].format("new"))
    before = everything(folder)
    with full_disk:
        code, _, err = run(*words)
    print(code, err)
    assert code in (1, 2)
    assert err.startswith("ultraquiet: ")
    assert err.count("\n") == 1
    names = {name for name, _ in before}
    left = [path for path in folder.rglob("*") if path.is_file() and str(path.relative_to(folder)) not in names]
    print(left)
    # A journal and a lock are written as they grow, and mean what they say however they end.
    assert not [path for path in left if path.stat().st_size and path.name not in ("journal.txt", ".lock")]
    if command in FILES:
        assert everything(folder) == before


def test_bytecode_that_was_cut_short_is_a_sentence(tmp_path, monkeypatch):
    (tmp_path / "cut.pyc").write_bytes(importlib.util.MAGIC_NUMBER + bytes(12))  # what 16 bytes of room leave of it
    monkeypatch.syspath_prepend(tmp_path)

    def command():
        importlib.import_module("cut")

    with pytest.raises(StorageError, match="compiled Python was cut short"):
        with_options(command)()
