"""A warm process that forks others, whose calls into the system fail one after another; jobs as JSON lines in and out.

python siege_works.py FOLDER [tiny], started with LD_PRELOAD=faulty.so; with `tiny` it is warm for the tiny study.
"""

import ctypes
import json
import os
import sys
import time
import traceback
from pathlib import Path

import numpy as np
import tiny_study

sys.path.insert(0, str(Path(__file__).parents[1] / "pipeline"))
import small_study  # beside the tests of studies

from ultraquiet import experiments, files
from ultraquiet._base.errors import UltraquietError
from ultraquiet._base.provenance import Provenance
from ultraquiet.bench import Block
from ultraquiet.experiments import journal
from ultraquiet.experiments.measure import recover
from ultraquiet.values import Channel, Record

RATE_HZ, BLOCK = 3500.0, 175
NOTHING, EIO, ENOSPC, SHORT, KILL = range(5)
LIST = """
[[commands]]
do = "record"
name = "first"
samples = 1400
[[commands]]
do = "record"
name = "second"
samples = 700
"""


def readings(run, samples):
    """Readings that say whose they are and where they belong."""
    return run * 1000.0 + np.arange(samples) / 4096.0 + np.arange(3)[:, None]


class Counting:
    """A bench whose readings count, as fast as asked or in real time."""

    rate_hz = RATE_HZ
    actuators = (Channel("a", "V", -5.0, 5.0), Channel("b", "V", -5.0, 5.0))
    sensors = (Channel("x"), Channel("y"), Channel("z"))
    provenance = Provenance("counting", {})

    def __init__(self, pace=False):
        self.pace = pace

    def run(self, actuation, disturbance=None, controller=None):
        """Never called: a bench that streams is streamed."""
        raise AssertionError

    def stream(self, actuation, disturbance=None, controller=None, *, run_index=None, stop=None, **_):
        """Hand over blocks of 50 ms."""
        none, samples = np.zeros(3, dtype=np.int64), actuation.shape[1]
        for start in range(0, samples, BLOCK):
            if self.pace:
                time.sleep(BLOCK / RATE_HZ)
            part = slice(start, min(start + BLOCK, samples))
            yield Block(actuation[:, part], readings(run_index, samples)[:, part], none[:2], none)


def record(place, pace=False, repeat=()):
    """Execute the list, going on where it was left."""
    plan = experiments.parse(LIST, Counting(pace))
    experiments.run(plan, place, resume=True, repeat=repeat, sleep=lambda _: None)


def resume(place, between=lambda place: None):
    """Go on with a list that was stopped, as somebody would who reads what is said."""
    recover(place)
    between(place)
    record(place, repeat=[name for name in journal.begun(place) if not (place / f"{name}.h5").exists()])


def convert(place, suffix=".mat"):
    """Write a record over another one."""
    given = files.read_record(place.parent / "source.h5")
    files.export_record(given, place / f"out{suffix}")


def source():
    """A record to convert."""
    return Record(readings(1, 500)[:1], readings(2, 500), RATE_HZ)


def study(place):
    """Walk a small study of two masses, every stage, with nothing said."""
    small_study.walk(small_study.written(place.parent), place, say=lambda _: None)


def tiny(place):
    """Walk the study of one mass, every stage; swift where the process was warmed for it."""
    tiny_study.walk(tiny_study.written(place.parent), place)


WORKS = {
    "record": record,
    "resume": resume,
    "paced": lambda place: record(place, True),
    "convert": convert,
    "study": study,
    "tiny": tiny,
}


def forked(job):
    """Do one job in a child, armed; return how it ended and how many calls it made."""
    reads, writes = os.pipe()
    child = os.fork()
    if child:
        os.close(writes)
        said = b"".join(iter(lambda: os.read(reads, 65536), b""))
        os.close(reads)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        return {"code": code, **(json.loads(said) if said else {})}
    library = ctypes.CDLL(None)
    trace = os.open(job["trace"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600) if job.get("trace") else -1
    place = Path(job["place"])
    library.faulty_arm(str(place).encode(), ctypes.c_long(job["at"]), job["kind"], trace)
    fate = {"fate": "done"}
    try:
        WORKS[job["work"]](place)
    except UltraquietError as error:
        fate = {"fate": "sentence", "said": str(error)}
    except BaseException:
        fate = {"fate": "TRACEBACK", "said": traceback.format_exc()[-1500:]}
    library.faulty_calls.restype = ctypes.c_long
    os.write(writes, json.dumps({**fate, "calls": library.faulty_calls()}).encode())
    os._exit(0)


if __name__ == "__main__":
    warm = Path(sys.argv[1])
    if "tiny" in sys.argv[2:]:
        tiny_study.swift()
        tiny(warm / "study")
    else:
        record(warm)
        files.save(source(), warm / "source.h5")
        files.export_record(files.read_record(warm / "source.h5"), warm / "out.mat")
    print("ready", flush=True)
    for line in sys.stdin:
        print(json.dumps(forked(json.loads(line))), flush=True)
