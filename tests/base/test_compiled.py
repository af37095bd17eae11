"""What is compiled once stays compiled: in a copy of the tree, until it or what it calls changes; and it is told."""

import importlib.util
import resource
import sys

import pytest
from numba.core import config

from ultraquiet._base.progress import listening, task

CALLEE = (
    "from ultraquiet._base.compiled import compiled\n\nSHIFT = 1.0\n\n\n"
    "@compiled\ndef shifted(x):\n    return x + SHIFT\n"
)
CALLER = (
    "from {callee} import shifted\n\nfrom ultraquiet._base.compiled import compiled\n\n\n"
    "@compiled\ndef twice(x):\n    return 2.0 * shifted(x)\n"
)


@pytest.fixture
def tree(tmp_path, monkeypatch):
    """Modules of their own names in a folder; `load` returns the caller freshly imported from a copy of them."""
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "cache"))

    def load(folder, callee=CALLEE):
        (tmp_path / folder).mkdir()
        modules = {}
        for name, text in (("kept_callee", callee), ("kept_caller", CALLER.format(callee="kept_callee"))):
            path = tmp_path / folder / f"{name}.py"
            path.write_text(text)
            spec = importlib.util.spec_from_file_location(name, path)
            modules[name] = importlib.util.module_from_spec(spec)
            monkeypatch.setitem(sys.modules, name, modules[name])
            spec.loader.exec_module(modules[name])
        return modules["kept_caller"].twice

    return load


def test_a_copy_of_the_tree_compiles_nothing(tree):
    first = tree("first")
    assert first(1.0) == 4.0
    assert first.stats.cache_misses
    copy = tree("copy")
    assert copy(1.0) == 4.0
    assert copy.stats.cache_hits
    assert not copy.stats.cache_misses


def test_a_changed_callee_is_never_taken_for_the_old_one(tree):
    assert tree("first")(1.0) == 4.0
    changed = tree("changed", CALLEE.replace("1.0", "2.0"))
    assert changed(1.0) == 6.0
    assert changed.stats.cache_misses


def test_compiling_is_told_beside_what_is_in_hand(tree):
    heard = []

    class Listener:
        def start(self, title, total):
            heard.append(title)
            return len(heard)

        def advance(self, key, steps, note):
            heard.append((key, steps, note))

        def finish(self, key):
            heard.append(key)

    twice = tree("told")
    with listening(Listener()), task("fits", 3) as fits:
        twice(1.0)
        fits.advance()
    assert heard == ["fits", (1, 0, "compiling twice (first use only)"), (1, 0, ""), (1, 1, ""), 1]
    heard.clear()
    with listening(Listener()):
        twice(1.0)
        assert not heard
        twice(1)
    assert heard == ["compiling twice (first use only)", 1]


def kept(tmp_path, suffix):
    return sorted((tmp_path / "cache").rglob(f"*{suffix}"))


def test_a_cache_that_finds_no_room_ends_nothing(tree, tmp_path):
    twice = tree("full")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (16, hard))
    try:
        assert twice(1.0) == 4.0
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not kept(tmp_path, ".nbc")
    assert tree("roomy")(1.0) == 4.0
    assert len(kept(tmp_path, ".nbc")) == 2


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("left", [0, 40])
def test_a_cache_that_was_cut_short_is_compiled_anew(tree, tmp_path, suffix, left):
    assert tree("first")(1.0) == 4.0
    for path in kept(tmp_path, suffix):
        path.write_bytes(path.read_bytes()[:left])
    assert tree("copy")(1.0) == 4.0
    last = tree("last")
    assert last(1.0) == 4.0
    assert last.stats.cache_hits
