"""Files: every value to one HDF5 file and back, logs of runs, and records from CSV, MAT and NPZ."""

from ultraquiet.files.archive import contents, is_archive, load, load_many, save, save_many
from ultraquiet.files.atomic import reason, write_bytes
from ultraquiet.files.export import export_record
from ultraquiet.files.log import LogWriter, log_header
from ultraquiet.files.logged import Log, finalise, read_log
from ultraquiet.files.read import read_record

__all__ = [
    "Log",
    "LogWriter",
    "contents",
    "export_record",
    "finalise",
    "is_archive",
    "load",
    "load_many",
    "log_header",
    "read_log",
    "read_record",
    "reason",
    "save",
    "save_many",
    "write_bytes",
]
