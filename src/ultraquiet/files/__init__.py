"""Files: every value to one HDF5 file and back, and records from CSV, MAT and NPZ."""

from ultraquiet.files.archive import contents, is_archive, load, load_many, save, save_many
from ultraquiet.files.atomic import reason, write_bytes
from ultraquiet.files.export import export_record
from ultraquiet.files.read import read_record

__all__ = [
    "contents",
    "export_record",
    "is_archive",
    "load",
    "load_many",
    "read_record",
    "reason",
    "save",
    "save_many",
    "write_bytes",
]
