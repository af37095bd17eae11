"""Folders of code that an ordinary user may not write: refused whole, and nothing is left beside them."""

import ctypes
import os
import sys
from contextlib import contextmanager

import pytest

from ultraquiet._base.errors import StorageError
from ultraquiet.deploy import generate
from ultraquiet.values import StateSpace

LAW = StateSpace([[0.9, 0.1], [-0.1, 0.9]], [[0.1], [0.0]], [[1.0, 0.0]], [[0.0]], rate_hz=3500.0)
CAPABILITIES = 0x20080522  # the layout of capget(2) and capset(2) with 64 capabilities
CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH = 1, 2
pytestmark = pytest.mark.skipif(os.name != "posix", reason="no POSIX permissions")


@contextmanager
def permissions_of_its_own():
    """Hold this thread to the permissions of files also where it is root's, who may write everywhere else.

    Another user's identity would do as well, but could not read a tree in root's private folder.
    """
    if os.geteuid() != 0:
        yield
        return
    if sys.platform != "linux":
        pytest.skip("root, and no way to be held to permissions")
    libc, header, held = ctypes.CDLL(None, use_errno=True), (ctypes.c_uint32 * 2)(CAPABILITIES, 0), ctypes.c_uint32 * 6
    before, without = held(), held()
    assert libc.capget(header, before) == 0
    without[:] = before[:]
    without[0] &= ~(1 << CAP_DAC_OVERRIDE | 1 << CAP_DAC_READ_SEARCH)  # the effective ones; those permitted stay
    assert libc.capset(header, without) == 0
    try:
        yield
    finally:
        assert libc.capset(header, before) == 0


@pytest.fixture
def code(tmp_path):
    """A folder of code in a folder of this user's."""
    with permissions_of_its_own():
        generate(LAW, tmp_path / "own" / "code", limits_v=1.0)
        yield tmp_path / "own" / "code"


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
