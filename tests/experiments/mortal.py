"""A warm process that forks others and kills them in the middle of their work; jobs as JSON lines in, fates out.

A fork starts in milliseconds, so hundreds of processes can die in a test. What a victim wants to have told before it
dies it puts into shared memory: how many samples its bench had handed over, and when its clock began.
"""

import json
import mmap
import os
import signal
import sys
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ultraquiet import experiments, files
from ultraquiet._base.provenance import Provenance
from ultraquiet.bench import Block
from ultraquiet.values import Channel, Record

RATE_HZ = 3500.0
ROWS = 12
BLOCK = 175  # 50 ms
PACKET_S = 0.005  # how often a converter's driver hands over what it has
ACTUATORS = tuple(Channel(f"u{k}", "V", -25.0, 25.0) for k in range(6))
SENSORS = tuple(Channel(f"y{k}", "V") for k in range(6))


def counter(run, first, count, rows=ROWS):
    """Samples that say whose they are, and where they belong: exact in doubles, all different."""
    return run * 2.0**32 + np.arange(first, first + count) + np.arange(rows)[:, None] / 16.0


def header(samples=0):
    return files.log_header(ACTUATORS, SENSORS, RATE_HZ, samples, Provenance("kill"))


def paced(told):
    """Yield the places of packets as time goes by; each is told before it is used."""
    begun, handed = time.monotonic(), 0
    told[1] = begun
    while True:
        time.sleep(PACKET_S)
        due = int((time.monotonic() - begun) * RATE_HZ)
        while handed < due:
            count = min(due - handed, BLOCK - handed % BLOCK)
            handed += count
            told[0] = handed
            yield handed


def stream(job, told):
    """Write counted samples at the pace of a bench, for ever."""
    with files.LogWriter(job["path"], header()) as log:
        for handed in paced(told):
            if handed % BLOCK == 0:
                log.append(counter(job["run"], handed - BLOCK, BLOCK))


def rush(job, told):
    """Write counted samples as fast as the disk takes them, so that every kill strikes while something is written."""
    with files.LogWriter(job["path"], header()) as log:
        while True:
            told[0] = log.samples + job["block"]
            log.append(counter(job["run"], log.samples, job["block"]))


def finalise(job, told):
    files.finalise(job["path"], job["path"].removesuffix("log") + "h5")
    told[3] = time.monotonic()


@dataclass
class Paced:
    """A bench in real time whose readings count; what it excites is written down before it moves."""

    told: object
    diary: str
    pace: bool = True
    rate_hz = RATE_HZ
    actuators = ACTUATORS[:2]
    sensors = SENSORS[:3]
    provenance = Provenance("paced", {"unit": "none"})

    def run(self, actuation, disturbance=None, controller=None):
        raise AssertionError("a bench that streams is streamed")

    def stream(self, actuation, disturbance=None, controller=None, *, run_index=None, stop=None, **_):
        handle = os.open(self.diary, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.write(handle, f"{run_index}\n".encode())
        os.close(handle)
        samples, none = actuation.shape[1], np.zeros(3, dtype=np.int64)
        self.told[0] = 0
        for handed in paced(self.told) if self.pace else range(BLOCK, samples + BLOCK, BLOCK):
            if handed % BLOCK == 0 or handed >= samples:
                part = slice((handed - 1) // BLOCK * BLOCK, min(handed, samples))
                readings = counter(run_index, part.start, part.stop - part.start, 3)
                yield Block(actuation[:, part], readings, none[:2], none)
            if handed >= samples:
                return


def listed(text, told, diary, pace=True):
    return experiments.parse(text, Paced(told, diary, pace))


def execute(job, told):
    plan = listed(job["text"], told, job["diary"])
    experiments.run(plan, job["path"], resume=True, repeat=job["repeat"], sleep=lambda _: None)


WORKS = {work.__name__: work for work in (stream, rush, finalise, execute)}


def born(job, told):
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        WORKS[job["work"]](job, told)
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def fate(job, pid, born_s, told):
    """Kill a process and say what it had told."""
    os.kill(pid, signal.SIGKILL)
    died = time.monotonic()
    _, status = os.waitpid(pid, 0)
    took = told[3] - born_s if told[3] else None
    due = int((died - told[1]) * RATE_HZ) if told[1] else 0
    return {
        **job,
        "told": int(told[0]),
        "due": due,
        "took": took,
        "code": os.waitstatus_to_exitcode(status),
    }


def campaign(jobs, width):
    """Run jobs side by side, `width` at once, each until its time `after` has come."""
    memory = np.frombuffer(mmap.mmap(-1, 4 * 8 * len(jobs)), dtype=np.float64).reshape(-1, 4)
    waiting, alive, fates = list(enumerate(jobs)), [], []
    while waiting or alive:
        while waiting and len(alive) < width:
            k, job = waiting.pop(0)
            born_s = time.monotonic()
            alive.append((born_s + job["after"], k, born(job, memory[k]), born_s))
        alive.sort()
        at, k, pid, born_s = alive.pop(0)
        time.sleep(max(at - time.monotonic(), 0.0))
        fates.append(fate(jobs[k], pid, born_s, memory[k]))
    return fates


def warm():
    """Do everything once: what is imported late would be imported by every victim again."""
    place = Path(sys.argv[1])
    told = np.zeros(4)
    plan = listed('[[commands]]\ndo = "record"\nname = "warm"\nsamples = 700\n', told, str(place / "warm.txt"), False)
    record = experiments.run(plan, place)["warm"]
    assert isinstance(record, Record)
    with files.LogWriter(place / "one.log", header()) as log:
        log.append(counter(0, 0, BLOCK))
        log.close()
    finalise({"path": str(place / "one.log")}, told)


if __name__ == "__main__":
    warm()
    print("ready", flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        print(json.dumps(campaign(asked["jobs"], asked["width"])), flush=True)
