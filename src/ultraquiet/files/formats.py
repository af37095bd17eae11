"""The formats: which suffix is read and written by whom. A new format is one file in `readers` and a line here."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ultraquiet._base.errors import InputError
from ultraquiet.files.confined import confined
from ultraquiet.files.readers.extra import extra
from ultraquiet.files.readers.hdf5 import read_hdf5
from ultraquiet.files.readers.matlab import read_mat, write_mat
from ultraquiet.files.readers.npz import read_npz
from ultraquiet.files.readers.parquet import read_parquet, write_parquet
from ultraquiet.files.readers.plain import read_text, write_text
from ultraquiet.files.readers.tdms import read_tdms
from ultraquiet.files.readers.uff import read_uff, write_uff
from ultraquiet.files.readers.wav import read_wav
from ultraquiet.files.table import FileTable
from ultraquiet.values import Record


@dataclass(frozen=True)
class Format:
    """One format: its name, its suffixes, who reads bytes into a table and who makes bytes of a record, if anybody.

    Bytes are read in a process that can open nothing: `needs` are the modules, with their packages, that are imported
    before; `scratch` is asked for by a reader that knows named files only. A writer is left out where the format cannot
    keep names, units and rate (WAV), or where writing is not this package's business. HDF5 is written by `archive`.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[str, bytes], FileTable]
    write: Callable[[Record], bytes] | None = None
    needs: tuple[tuple[str, str], ...] = ()
    scratch: bool = False


ARROW = (("pyarrow.parquet", "pyarrow"), ("pyarrow.compute", "pyarrow"))
FORMATS = (
    Format("HDF5", (".h5", ".hdf5"), read_hdf5, needs=(("h5py", "h5py"),)),
    Format("text columns", (".csv", ".tsv", ".txt", ".dat", ".asc"), read_text, write_text),
    Format("MATLAB", (".mat",), read_mat, write_mat, (("scipy.io", "scipy"), ("h5py", "h5py"))),
    Format("NumPy", (".npz",), read_npz),
    Format("universal file", (".uff", ".unv"), read_uff, write_uff, (("pyuff", "pyuff"),), scratch=True),
    Format("TDMS", (".tdms",), read_tdms, needs=(("nptdms", "npTDMS"), ("nptdms.log", "npTDMS"))),
    Format("Parquet", (".parquet",), read_parquet, write_parquet, ARROW),
    Format("WAV", (".wav",), read_wav, needs=(("scipy.io.wavfile", "scipy"),)),
)
ARCHIVES = FORMATS[0].suffixes


def format_of(who: str, path: str | Path) -> Format:
    """Return the format that a file's suffix names."""
    suffix = Path(path).suffix.lower()
    match = next((form for form in FORMATS if suffix in form.suffixes), None)
    if match is None and Path(path).is_dir():
        raise InputError(f"{who}: '{path}' is a folder; name a file in it.")
    if match is None:
        known = ", ".join(known for form in FORMATS for known in form.suffixes)
        raise InputError(f"{who}: '{path}' has none of the suffixes {known}.")
    return match


def understood(form: Format, name: str, read: Callable[[], Any], file_bytes: int) -> Any:
    """Return the plain tree that `read` makes of bytes of a format, in a process of their own.

    Args:
        form: whose modules are needed.
        name: the file.
        read: what to do with its bytes.
        file_bytes: how many they are.

    Raises:
        StorageError, InputError: no such file; a sentence says why.
        ToolError: a module is missing.
    """
    for module, package in form.needs:
        extra(module, package, form.name)
    return confined(read, name, form.name, file_bytes, form.scratch)
