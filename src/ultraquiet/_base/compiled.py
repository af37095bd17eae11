"""Compiled functions: one decorator for all of them, a cache that outlives the tree, and word of what is compiled.

Import where it is used: numba costs half a second. What was compiled is kept in NUMBA_CACHE_DIR, else in the user's
cache folder (`~/.cache/ultraquiet` on Linux), under the contents of the function's source file, of the files it calls
into and of the constants it takes from them: a copy of the tree finds what the first one compiled, and a function is
compiled again when a function it calls has changed.
"""

import hashlib
import tempfile
import threading
from contextlib import ExitStack, suppress
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from ultraquiet._base.progress import noted

# numba tells type checkers nothing of its inside.
numba: Any = import_module("numba")
caching, config, event = (import_module(f"numba.core.{name}") for name in ("caching", "config", "event"))
Dispatcher: Any = import_module("numba.core.dispatcher").Dispatcher
user_folders: Any = import_module("numba.misc.appdirs").AppDirs(appname="ultraquiet", appauthor=False)

FLUSH = 1e-140  # its square is still a normal number; denormal tails of decaying responses cost 20 times the work
CONSTANTS = (bool, int, float, str, tuple)


def compiled(function: Any, nogil: bool = True) -> Any:
    """Compile a function on its first call with arguments of new types; it holds no lock while it runs."""
    dispatcher = numba.njit(nogil=nogil, fastmath=False)(function)
    dispatcher._cache = KernelCache(function)
    return dispatcher


def brief(function: Any) -> Any:
    """Compile a function that keeps the lock: handing it to another thread takes longer than its few microseconds."""
    return compiled(function, nogil=False)


def source_digest(function: Any) -> str:
    """Return a digest of the source file, of those of compiled functions its module imports, and of its constants."""
    digest, files, waiting = hashlib.sha256(), set[str](), [function]
    while waiting:
        module = waiting.pop()
        path = module.__code__.co_filename
        if path in files:
            continue
        files.add(path)
        digest.update(Path(path).read_bytes())
        for name, value in sorted(module.__globals__.items(), key=lambda item: item[0]):
            if isinstance(value, Dispatcher):
                waiting.append(value.py_func)
            elif isinstance(value, CONSTANTS) and not name.startswith("__"):
                digest.update(f"{name}={value!r};".encode())
    return digest.hexdigest()


def cache_folder() -> Path:
    """Return the folder that compiled functions are kept below."""
    return Path(config.CACHE_DIR or Path(user_folders.user_cache_dir) / "compiled")


class ContentLocator:
    """Finds what was compiled by what it was compiled from, wherever the tree stands; made as numba's locators are."""

    def __init__(self, function: Any) -> None:
        self._py_file, self._line = function.__code__.co_filename, function.__code__.co_firstlineno
        self._digest = source_digest(function)
        self._path = cache_folder() / f"{function.__module__}-{self._digest[:16]}"

    def ensure_cache_path(self) -> None:
        """Make the folder, and a file in it.

        Raises:
            OSError: it cannot be written to.
        """
        self._path.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=self._path).close()

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> "ContentLocator | None":
        """Return the locator of a function; None without its source or a folder to write to."""
        try:
            found = cls(py_func)
            found.ensure_cache_path()
        except OSError:
            return None
        return found

    def get_cache_path(self) -> str:
        """Return the folder of the function's module."""
        return str(self._path)

    def get_source_stamp(self) -> str:
        """Return what must agree for a cached function to be used."""
        return self._digest

    def get_disambiguator(self) -> str:
        """Return what tells functions of one name in one file apart."""
        return str(self._line)


class CompiledCode(caching.CompileResultCacheImpl):
    """Kept by contents where that can be, else as numba keeps it."""

    _locator_classes: ClassVar[list[Any]] = [ContentLocator, *caching.CompileResultCacheImpl._locator_classes]


class KernelCache(caching.FunctionCache):
    """The cache of one compiled function; whatever is wrong with its files, the function is compiled and runs."""

    _impl_class = CompiledCode

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what was compiled for these types; None where there is nothing, or nothing that can be read."""
        try:
            return caching.FunctionCache.load_overload(self, sig, target_context)
        except Exception:  # a pickle that was cut short or damaged raises anything
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, where that can be done; an index that cannot be read is begun again."""
        for _ in range(2):
            try:
                caching.FunctionCache.save_overload(self, sig, data)
            except OSError:  # a full disk, a folder that was removed or closed meanwhile
                return
            except Exception:
                with suppress(OSError):
                    self.flush()
            else:
                return


class _Announcer(event.Listener):
    """Tells whoever shows progress what is being compiled; what it calls in turn is part of the same wait."""

    def __init__(self) -> None:
        self._here = threading.local()

    def on_start(self, event: Any) -> None:
        """Begin to say so."""
        depth = getattr(self._here, "depth", 0)
        self._here.depth = depth + 1
        if depth == 0:
            self._here.stack = ExitStack()
            dispatcher = event.data["dispatcher"]
            if isinstance(dispatcher._cache, KernelCache):
                self._here.stack.enter_context(noted(f"compiling {dispatcher.py_func.__name__} (first use only)"))

    def on_end(self, event: Any) -> None:
        """Stop saying so."""
        self._here.depth -= 1
        if self._here.depth == 0:
            self._here.stack.close()


event.register("numba:compile", _Announcer())
