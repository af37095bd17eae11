"""Folders of code that an ordinary user may not write: refused whole, and nothing is left beside them."""

import os
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from ultraquiet._base.errors import StorageError
from ultraquiet.deploy import generate
from ultraquiet.values import StateSpace

NOBODY = 65534
LAW = StateSpace([[0.9, 0.1], [-0.1, 0.9]], [[0.1], [0.0]], [[1.0, 0.0]], [[0.0]], rate_hz=3500.0)
pytestmark = pytest.mark.skipif(os.name != "posix", reason="no POSIX permissions")


@contextmanager
def ordinary_user():
    """Yield a folder of an ordinary user, who this process is meanwhile: root may write everywhere."""
    folder, root = Path(tempfile.mkdtemp(prefix="ultraquiet-permissions-")), os.geteuid() == 0
    try:
        if root:
            os.chown(folder, NOBODY, -1)
            os.seteuid(NOBODY)
        yield folder
    finally:
        if root:
            os.seteuid(0)
        shutil.rmtree(folder)


@pytest.fixture
def code(tmp_path):
    """A folder of code in a folder of an ordinary user."""
    generate(LAW, tmp_path / "code", limits_v=1.0)  # whatever is imported on the way is imported now
    with ordinary_user() as folder:
        generate(LAW, folder / "code", limits_v=1.0)
        yield folder / "code"


def test_a_folder_that_is_read_only_is_refused_and_stays(code):
    was = (code / "controller.c").read_bytes()
    code.chmod(0o500)
    try:
        with pytest.raises(StorageError, match="nothing was changed there"):
            generate(LAW, code, "float64", limits_v=1.0)
    finally:
        code.chmod(0o700)
    assert (code / "controller.c").read_bytes() == was
    assert list(code.parent.iterdir()) == [code]


def test_a_read_only_folder_inside_goes_with_the_code_that_is_replaced(code):
    inside = code / "build"
    inside.mkdir()
    (inside / "controller.o").write_bytes(b"")
    inside.chmod(0o500)
    generate(LAW, code, "float64", limits_v=1.0)
    assert list(code.parent.iterdir()) == [code]
    assert not inside.exists()


def test_a_folder_beside_which_nothing_can_be_written_is_refused(code):
    code.parent.chmod(0o500)
    try:
        with pytest.raises(StorageError, match="cannot write beside"):
            generate(LAW, code, limits_v=1.0)
    finally:
        code.parent.chmod(0o700)
    assert list(code.parent.iterdir()) == [code]
