"""Files: every value to one HDF5 file and back, logs of runs, and records in the formats of other programs."""

from ultraquiet._base.shown import show
from ultraquiet.files.archive import contents, is_archive, load_many
from ultraquiet.files.atomic import possible, reason, write_bytes
from ultraquiet.files.export import export_record
from ultraquiet.files.log import LogWriter, log_header
from ultraquiet.files.logged import Log, finalise, read_log
from ultraquiet.files.long_record import LongRecord
from ultraquiet.files.long_writer import LongWriter
from ultraquiet.files.mapping import MappingError, load_mapping, parse_mapping
from ultraquiet.files.read import read_record, refuse_data
from ultraquiet.files.responses import export_frf, read_frf
from ultraquiet.files.sep005 import from_sep005, to_sep005
from ultraquiet.files.survey import Survey, survey
from ultraquiet.files.value import load, save, save_many

__all__ = [
    "Log",
    "LogWriter",
    "LongRecord",
    "LongWriter",
    "MappingError",
    "Survey",
    "contents",
    "export_frf",
    "export_record",
    "finalise",
    "from_sep005",
    "is_archive",
    "load",
    "load_many",
    "load_mapping",
    "log_header",
    "parse_mapping",
    "possible",
    "read_frf",
    "read_log",
    "read_record",
    "reason",
    "refuse_data",
    "save",
    "save_many",
    "survey",
    "to_sep005",
    "write_bytes",
]

show(globals(), __all__)
