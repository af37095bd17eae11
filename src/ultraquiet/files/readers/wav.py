"""WAV files: whole numbers become parts of full scale, floats stay as they are."""

import io
import warnings

import numpy as np

from ultraquiet._base.errors import InputError
from ultraquiet.files.table import Column, FileTable

FULL_SCALE = "FS"  # the unit of samples that are parts of full scale
SILENCE_8 = 128  # 8-bit WAV is unsigned


def read_wav(name: str, data: bytes) -> FileTable:
    """Return the channels of a WAV file, `channel 1` onwards.

    16, 24 and 32 bits are divided by 2^15, 2^23 and 2^31, so that full scale is 1; a mapping's `scale` makes volts of
    them. 32- and 64-bit floats keep their values. WAV knows neither names nor units.

    Raises:
        InputError: a rate of zero.
    """
    from scipy.io import wavfile

    with warnings.catch_warnings():
        # What is said of foreign chunks is of no concern; of an early end it is.
        warnings.filterwarnings("ignore", "Chunk", wavfile.WavFileWarning)
        warnings.filterwarnings("error", "Reached EOF|Incomplete", wavfile.WavFileWarning)
        rate_hz, samples = wavfile.read(io.BytesIO(data))
    if not rate_hz > 0:
        raise InputError(f"{name}: it says a rate of {rate_hz} Hz; no record can be made of that.")
    rows = np.atleast_2d(samples.T)
    unit = "" if rows.dtype.kind == "f" else FULL_SCALE
    values = _scaled(rows)
    return FileTable(
        name, tuple(Column(f"channel {k + 1}", row, unit, rate_hz=float(rate_hz)) for k, row in enumerate(values))
    )


def _scaled(rows: np.ndarray) -> np.ndarray:
    if rows.dtype.kind == "f":
        return rows.astype(np.float64)
    if rows.dtype.kind == "u":
        return (rows.astype(np.float64) - SILENCE_8) / SILENCE_8
    # SciPy sets 24 bits to the left of 32, so full scale is that of the type it gives.
    return rows / -float(np.iinfo(rows.dtype).min)
