"""TDMS, the files of LabVIEW, by npTDMS (extra `lab`)."""

import io
import logging
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ultraquiet._base.errors import StorageError
from ultraquiet.files.confined import announce
from ultraquiet.files.readers.extra import extra
from ultraquiet.files.table import Column, FileTable, rate_of_step

FLOAT_BYTES = 8
UNITS = ("unit_string", "NI_UnitDescription")


def read_tdms(name: str, data: bytes) -> FileTable:
    """Return the numeric channels of all groups, scaled as the file says.

    The waveform properties give each channel its rate (`wf_increment`) and start (`wf_start_offset`, `wf_start_time`).
    A name that two groups share is written `group/channel`.
    """
    nptdms = extra("nptdms", "npTDMS", "TDMS")
    with _quiet():
        told = nptdms.TdmsFile.read_metadata(io.BytesIO(data))
        samples = sum(len(channel) for group in told.groups() for channel in group.channels())
        announce(name, FLOAT_BYTES * samples, len(data))
        file = nptdms.TdmsFile.read(io.BytesIO(data))
    if file.file_status.incomplete_final_segment:
        raise StorageError(f"read_record: '{name}' was cut short: its last segment is incomplete.")
    channels = [channel for group in file.groups() for channel in group.channels()]
    values = [np.asarray(channel[:]) for channel in channels]
    names = Counter(channel.name for channel in channels)
    origin = min((t for c in channels if (t := c.properties.get("wf_start_time")) is not None), default=None)
    columns: list[Column] = []
    unusable: list[str] = []
    for channel, samples in zip(channels, values, strict=True):
        called = channel.name if names[channel.name] == 1 else f"{channel.group_name}/{channel.name}"
        if samples.dtype.kind in "fiu" and samples.size:
            columns.append(_column(called, samples, channel.properties, origin))
        else:
            unusable.append(f"{called} of shape {samples.shape}")
    return FileTable(name, tuple(columns), {}, tuple(unusable))


@contextmanager
def _quiet() -> Iterator[None]:
    """Hold back what npTDMS prints about odd bytes: what matters of it is told in a sentence, or refused."""
    manager = extra("nptdms.log", "npTDMS", "TDMS").log_manager
    level = manager.log_level
    manager.set_level(logging.CRITICAL)
    try:
        yield
    finally:
        manager.set_level(level)


def _column(name: str, samples: np.ndarray, properties: Any, origin: Any) -> Column:
    step_s = float(properties.get("wf_increment", 0.0))
    unit = next((str(properties[key]) for key in UNITS if key in properties), "")
    start_s = float(properties.get("wf_start_offset", 0.0))
    if "wf_start_time" in properties:
        start_s += float((properties["wf_start_time"] - origin) / np.timedelta64(1, "s"))
    rate_hz = rate_of_step(step_s) if step_s > 0 else None
    return Column(name, samples.astype(np.float64), unit, rate_hz=rate_hz, start_s=start_s)
