"""Every door through which something from outside comes in, with something sound to begin from."""

import ctypes
import json
import os
import shutil
import struct
import subprocess
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import mutants
import numpy as np
from nptdms import ChannelObject, TdmsWriter
from scipy.io import wavfile

from ultraquiet import files
from ultraquiet._base.provenance import Provenance
from ultraquiet.bench import Process
from ultraquiet.bench.process.link import Deadline, Link
from ultraquiet.bench.process.protocol import Card
from ultraquiet.deploy import generate
from ultraquiet.deploy.law.coefficients import bank_of
from ultraquiet.deploy.toolchain.compiler import FLAGS
from ultraquiet.experiments import journal, load
from ultraquiet.pipeline.study import load_study
from ultraquiet.values import Channel, FrequencyResponse, Record, StateSpace

SAMPLES = 40


@dataclass(frozen=True)
class Door:
    """A door: its sound bytes, what reads a file of it, and what mutants of its own kind are made by.

    `summed`: what comes through unrefused must be what was there, or the beginning of it, since the format carries a
    checksum. `lies` break no sum and need only end in a sentence, or in something harmless.
    """

    name: str
    data: bytes
    read: Callable[[Path], Any]
    lies: Callable[[Any, bytes], bytes] | None = None
    summed: bool = False


class Spoken(Link):
    """What a plant says, all at once, and then nothing."""

    def __init__(self, data: bytes) -> None:
        reads, writes = os.pipe()
        os.write(writes, data[:60_000])
        os.close(writes)
        super().__init__("mutant", reads, reads)

    def _give(self, data: bytes) -> int:
        return len(data)

    def _take(self, most: int) -> bytes:
        return os.read(self._reads, most)

    def close(self) -> None:
        os.close(self._reads)

    def ending(self) -> str:
        return "fell silent"


def drive(path: Path) -> Any:
    link = Spoken(path.read_bytes())
    bench = Process(("mutant",), timeout_s=1.0)
    bench._line.hold(link)
    bench._line.card = Card.from_handshake(link, Deadline(1.0))
    return bench.run(np.zeros((len(bench.actuators), 5))).outputs


PLANT = "ultraquiet-plant 1\nrate 100\nactuator V -5 5 a b\nsensor V -inf inf c\nahead 4\nnumbers hex\nready\nok\n" + (
    "# said\nlate 2\ny 0.5\ny 0x1.8p+1\ny -1e-3\ny 2\ny 3\nok\n"
)
LIST = """[list]
title = "short"
[[commands]]
do = "excite"
name = "push"
signal = { method = "tone", frequency_hz = 60.0 }
amplitude_v = 2.0
samples = 100
actuator = 1
"""
MAPPING = """rate_hz = 100.0
crop_s = [0.0, 0.3]
[[inputs]]
column = "u"
name = "force"
unit = "N"
scale = 2.0
limits = [-9.0, 9.0]
[[outputs]]
column = "y"
"""


def arrays(value: Any) -> list[np.ndarray]:
    """Return the numbers of what a door gave."""
    if isinstance(value, Record):
        return [value.inputs, value.outputs]
    if isinstance(value, FrequencyResponse):
        return [value.values]
    if isinstance(value, StateSpace):
        return [value.A, value.B, value.C, value.D]
    if isinstance(value, files.Log):
        return [value.samples]
    return [value] if isinstance(value, np.ndarray) else []


def doors(folder: Path, rng: Any) -> list[Door]:
    """Return all doors."""
    u, y = rng.standard_normal((1, SAMPLES)), rng.standard_normal((1, SAMPLES))
    record = Record(u, y, 100.0, [Channel("u", "V", -9, 9)], [Channel("y", "m/s")], Provenance("x", {"a": 1}, 3))
    found = [_archive(folder, "record archive", record), _archive(folder, "law archive", _law(rng))]
    f = np.arange(1.0, 9.0)
    found.append(_archive(folder, "response archive", FrequencyResponse(f, rng.standard_normal((1, 1, 8)) + 0j)))
    for suffix, lies in ((".csv", _text), (".mat", mutants.false_mat), (".uff", _text), (".parquet", None)):
        path = files.export_record(record, folder / f"good{suffix}")
        found.append(Door(suffix, path.read_bytes(), _reader(suffix), lies))
    np.savez_compressed(folder / "good.npz", u=u, y=y, fs=100.0)
    found.append(Door(".npz", (folder / "good.npz").read_bytes(), _reader(".npz"), mutants.false_zip, summed=True))
    with h5py.File(folder / "good.hdf5", "w") as file:
        file.attrs["fs"], file["u"], file["y"] = 100.0, u, y
    found.append(Door(".hdf5", (folder / "good.hdf5").read_bytes(), _reader(".hdf5"), mutants.false_hdf5))
    wavfile.write(folder / "good.wav", 100, np.vstack([u, y]).T)
    found.append(Door(".wav", (folder / "good.wav").read_bytes(), _reader(".wav")))
    rows = [ChannelObject("g", name, row[0], {"wf_increment": 0.01}) for name, row in (("u", u), ("y", y))]
    with TdmsWriter(str(folder / "good.tdms")) as writer:
        writer.write_segment(rows)
    found.append(Door(".tdms", (folder / "good.tdms").read_bytes(), _reader(".tdms")))
    return [*found, _log(folder, record), _journal(folder), *_written(), _bank(rng)]


def _archive(folder: Path, name: str, value: Any) -> Door:
    data = files.save(value, folder / "good.h5").read_bytes()
    return Door(name, data, files.load, mutants.false_archive, summed=True)


def _law(rng: Any) -> StateSpace:
    return StateSpace(0.5 * np.eye(2), rng.standard_normal((2, 1)), rng.standard_normal((1, 2)), [[0.1]], rate_hz=100.0)


def _reader(suffix: str) -> Callable[[Path], Any]:
    def read(path: Path) -> Any:
        named = path.with_suffix(suffix)
        path.replace(named)
        files.survey(named)
        numbered = {"inputs": "1", "outputs": "2"} if suffix == ".wav" else {}
        return files.read_record(named, rate_hz=100.0, **numbered)

    return read


def _text(rng: Any, data: bytes) -> bytes:
    return mutants.retold(rng, data.decode("latin-1")).encode("utf-8", "replace")


def _log(folder: Path, record: Record) -> Door:
    header = files.log_header(record.actuators, record.sensors, 100.0, SAMPLES, record.provenance)
    with files.LogWriter(folder / "good.log", header) as log:
        for k in range(0, SAMPLES, 10):
            log.append(np.vstack([record.inputs, record.outputs])[:, k : k + 10])
        log.close(complete=True)

    def read(path: Path) -> Any:
        log = files.read_log(path)
        if log.samples.shape[1]:
            log.record()
        return log

    return Door("log", (folder / "good.log").read_bytes(), read, mutants.false_log, summed=True)


def _journal(folder: Path) -> Door:
    entries = [
        {"event": "planned", "list": "x", "measurements": [{"name": "a", "hash": "h"}, {"name": "b", "hash": "i"}]},
        {"event": "begun", "name": "a", "hash": "h"},
        {"event": "finished", "name": "a", "hash": "h"},
        {"event": "begun", "name": "b", "hash": "i"},
    ]
    bodies = [json.dumps(entry, sort_keys=True).encode() for entry in entries]
    data = b"".join(b"%08x %s\n" % (zlib.crc32(body), body) for body in bodies)

    def read(path: Path) -> Any:
        place = path.parent / "records"
        place.mkdir(exist_ok=True)
        path.replace(place / journal.FILE)
        assert all("/" not in name for name in journal.begun(place))
        with journal.opened(place):
            pass

    return Door("journal", data, read, mutants.false_journal)


def _written() -> list[Door]:
    suite = (Path(files.__file__).parents[1] / "pipeline" / "suite.toml").read_bytes()
    return [
        Door("list", LIST.encode(), load, _text),
        Door("study", suite, load_study, _text),
        Door("mapping", MAPPING.encode(), files.load_mapping, _text),
        Door("plant", PLANT.encode(), drive, _text),
    ]


def _bank(rng: Any) -> Door:
    """A coefficient bank: words and their sum, which running code takes or leaves."""
    law = _law(rng)
    code: list[Any] = []

    def read(path: Path) -> Any:
        if not code:
            code.append(_Code(generate(law, path.parent / "code", anti_windup=False)))
        words = np.frombuffer(path.read_bytes()[: path.stat().st_size // 4 * 4], "<u4")
        if words.size != code[0].words + 1:
            return None  # nobody can hand over another number of words
        right = zlib.crc32(words[:-1].tobytes()) == words[-1]
        finite = bool(np.isfinite(words[:-1].view(np.float32)).all())
        assert code[0].takes(words) == (right and finite), "a bank was taken that is not sound, or left that is"
        return None

    def lies(rng: Any, data: bytes) -> bytes:
        words = np.frombuffer(data, "<u4").copy()[:-1]
        words[int(rng.integers(words.size))] = mutants.pick(rng, (0x7FC00000, 0x7F800000, 0xFF800001, 0, 0x80000000, 1))
        return words.tobytes() + struct.pack("<I", zlib.crc32(words.tobytes()))

    good = bank_of(generate(law, Path(tempfile.mkdtemp()) / "code", anti_windup=False).law)
    return Door("coefficient bank", good.words.tobytes() + struct.pack("<I", good.crc), read, lies)


class _Code:
    """The compiled law, as far as it takes banks."""

    def __init__(self, made: Any) -> None:
        folder, library = made.folder, made.folder / "bank.so"
        command = [shutil.which("cc") or "gcc", *FLAGS, "-fPIC", "-shared", "controller.c", "-o", library]
        subprocess.run(command, cwd=folder, check=True)
        self._calls = ctypes.CDLL(str(library))
        self._calls.controller_load_bank.restype = ctypes.c_bool
        self.words = bank_of(made.law).words.size
        self._state, self._pair = ctypes.create_string_buffer(1 << 16), ctypes.create_string_buffer(8 * self.words)
        self._calls.controller_init(self._state, None)
        self._calls.controller_attach(self._state, self._pair)

    def takes(self, words: Any) -> bool:
        given = words[:-1].astype("<u4").tobytes()
        return bool(self._calls.controller_load_bank(self._state, given, ctypes.c_uint32(int(words[-1]))))
