"""A study of two masses on springs, a few seconds long: every stage, 2x2, in newtons; and walks that die on demand.

python small_study.py STUDY: a warm process whose children run the study, driven by lines of JSON.
"""

import json
import os
import signal
import sys
import tempfile
import traceback
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from ultraquiet import pipeline
from ultraquiet._base.registry import registered
from ultraquiet.report import stills
from ultraquiet.values import Channel, Record, StateSpace

RATE_HZ = 500.0
LIST = """
title = "two masses"
[[commands]]
do = "configure"
samples = 1000
[[commands]]
do = "excite"
name = "noise"
actuator = "each"
signal = { method = "noise", stop_hz = 200.0, peak_v = 20.0 }
[[commands]]
do = "excite"
name = "judge"
actuator = "each"
signal = { method = "prbs", stop_hz = 150.0, level_v = 10.0 }
[[commands]]
do = "excite"
name = "all"
actuator = "all"
signal = { method = "noise", stop_hz = 200.0, peak_v = 20.0 }
"""
STUDY = """
[study]
title = "two masses"
seed = 1
[bench]
method = "two-masses"
[experiment]
list = "list.toml"
[identify]
structures = ["arx"]
orders = [4]
records = "noise"
held_out = "judge"
[plant]
method = "subspace"
records = ["all"]
order = 4
[controllers.calm.design]
method = "lqg"
band_hz = [20.0, 60.0]
control_weight = 1e-2
[closed_loop]
tones_hz = [20.0]
duration_s = 1.0
band_hz = [20.0, 60.0]
"""


@dataclass(frozen=True)
class TwoMasses:
    """Two masses on springs, forces in, velocities out, sampled exactly; linear, so that a run is a filter."""

    masses_kg: tuple[float, float] = (2.0, 3.0)
    noise: float = 1e-4
    seed: int = 0

    side_by_side = True
    rate_hz = RATE_HZ
    actuators = tuple(Channel(f"shaker {k}", "N", -5e3, 5e3) for k in (1, 2))
    sensors = tuple(Channel(f"mass {k}", "m/s") for k in (1, 2))

    def matrices(self):
        """A, B, C of x+ = A x + B f, y = C x."""
        M, D, K = np.diag(self.masses_kg), [[60.0, -20.0], [-20.0, 50.0]], [[9e4, -3e4], [-3e4, 7e4]]
        A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
        E = expm(np.block([[A, np.vstack([np.zeros((2, 2)), np.linalg.inv(M)])], [np.zeros((2, 6))]]) / RATE_HZ)
        return E[:4, :4], E[:4, 4:], 20.0 * np.eye(4)[2:]

    def run(self, actuation, disturbance=None, controller=None, run_index=0):
        """y[k] = C x[k] + noise; the force is command[k-1] + disturbance[k], the command actuation + K y."""
        u = np.asarray(actuation, dtype=float)
        d = np.zeros_like(u) if disturbance is None else np.asarray(disturbance, dtype=float)
        v = self.noise * np.random.default_rng([self.seed, run_index or 0]).standard_normal(u.shape)
        law = controller or StateSpace(np.zeros((1, 1)), np.zeros((1, 2)), np.zeros((2, 1)), np.zeros((2, 2)), RATE_HZ)
        A, B, C = self.matrices()
        # States: plant, the command held for one sample, the law; inputs: actuation, disturbance, noise.
        n, m = 4, law.A.shape[0]
        F = np.block(
            [
                [A, B, np.zeros((n, m))],
                [law.D @ C, np.zeros((2, 2)), law.C],
                [law.B @ C, np.zeros((m, 2)), law.A],
            ]
        )
        G = np.block(
            [
                [np.zeros((n, 2)), B, np.zeros((n, 2))],
                [np.eye(2), np.zeros((2, 2)), law.D],
                [np.zeros((m, 4)), law.B],
            ]
        )
        x = filtered(F, G, np.vstack([u, d, v]))
        y = C @ x[:n] + v
        command = u + (law.D @ y + law.C @ x[n + 2 :])
        return Record(command, y, RATE_HZ, self.actuators, self.sensors)


def filtered(F, G, u):
    """States of x+ = F x + G u from rest, one mode at a time; equal modes are told apart by a hair."""
    F = F + 1e-12 * np.diag(np.arange(len(F)))
    modes, T = np.linalg.eig(F)
    driven = np.linalg.solve(T, G.astype(complex)) @ u
    z = np.array([lfilter([0.0, 1.0], [1.0, -mode], row) for mode, row in zip(modes, driven, strict=True)])
    return (T @ z).real


def written(folder: Path) -> Path:
    """Write list and study into a folder and return the study's file."""
    (folder / "list.toml").write_text(LIST)
    (folder / "study.toml").write_text(STUDY)
    return folder / "study.toml"


def walk(study: Path, folder: Path, **more):
    """Run the study as `ultraquiet run` does."""
    with known():
        return pipeline.walk(pipeline.load_study(study), folder, study.parent, **more)


def known():
    """Have the bench of the study known within a block: other tests ask which benches there are."""
    return registered("bench", "two-masses", TwoMasses)


def dying(folder: Path, death: int, told: Path | None = None) -> None:
    """Kill this process the `death`-th time it is about to change something below a folder; note all such times."""
    count, place, changing = [0], str(folder.absolute()), os.O_WRONLY | os.O_RDWR | os.O_CREAT
    acts = {"os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.link", "os.truncate", "shutil.rmtree"}

    def watch(event, arguments):
        if event == "open" and not (isinstance(arguments[2], int) and arguments[2] & changing):
            return
        if (event != "open" and event not in acts) or not str(arguments[0]).startswith(place):
            return
        count[0] += 1
        if told is not None:
            with os.fdopen(os.open(told, os.O_WRONLY | os.O_APPEND | os.O_CREAT), "w") as file:
                file.write(f"{event} {arguments[0]}\n")
        if count[0] == death:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(watch)


def child(study: Path, folder: Path, death: int, told: str | None) -> int:
    """Run the study in a process of its own that starts warm, and return its number; see `dying`."""
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            if death:
                dying(folder, death, told and Path(told))
            walk(study, folder, say=lambda _: None)
            code = 0
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(code)
    return pid


if __name__ == "__main__":
    # A figure touches no file but the report's, and drawing it is most of what a run takes that finds all stages made.
    stills.draw_small_png = lambda *_, **__: b""
    stills.MANY = sys.maxsize  # no second process, which would draw in earnest
    with tempfile.TemporaryDirectory() as warm:  # what is imported late would be imported by every child again
        walk(Path(sys.argv[1]), Path(warm) / "out", say=lambda _: None)
    print("ready", flush=True)
    for line in sys.stdin:
        folder, death, told = json.loads(line)
        pid = child(Path(sys.argv[1]), Path(folder), death, told)
        print(pid, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
