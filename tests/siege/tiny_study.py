"""A study of one mass on a spring: one shaker, one sensor, a second of record, every stage in less than a second.

Its bench runs one thing at a time, so the whole walk is one process: every call into the system is its own. What never
touches the folder is done once for all walks of a siege (`swift`).
"""

import os
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from ultraquiet import pipeline
from ultraquiet._base.provenance import content_hash
from ultraquiet._base.registry import registered
from ultraquiet.pipeline.stage import Cache
from ultraquiet.report import stills
from ultraquiet.values import Channel, Record

RATE_HZ = 500.0
LIST = """
title = "one mass"
[[commands]]
do = "configure"
samples = 500
[[commands]]
do = "excite"
name = "noise"
actuator = "each"
signal = { method = "noise", stop_hz = 100.0, peak_v = 20.0 }
[[commands]]
do = "excite"
name = "judge"
actuator = "each"
signal = { method = "prbs", stop_hz = 80.0, level_v = 10.0 }
"""
STUDY = """
[study]
title = "one mass"
seed = 1
[bench]
method = "one-mass"
[experiment]
list = "list.toml"
[identify]
structures = ["arx"]
orders = [2]
records = "noise"
held_out = "judge"
[plant]
method = "subspace"
records = ["noise"]
order = 2
[controllers.calm.design]
method = "lqg"
band_hz = [20.0, 60.0]
control_weight = 1e-2
[closed_loop]
tones_hz = [20.0]
duration_s = 0.5
band_hz = [20.0, 60.0]
"""


@dataclass(frozen=True)
class OneMass:
    """y = v + noise of a mass on a spring, y+ = a y + b y- + c (u + d), sampled; forces in, velocity out."""

    noise: float = 1e-4
    seed: int = 0

    rate_hz = RATE_HZ
    actuators = (Channel("shaker", "N", -100.0, 100.0),)
    sensors = (Channel("mass", "m/s"),)

    def run(self, actuation, disturbance=None, controller=None, run_index=0):
        """The force is command[k-1] + disturbance[k], the command actuation + K y."""
        u = np.asarray(actuation, dtype=float)
        d = np.zeros_like(u) if disturbance is None else np.asarray(disturbance, dtype=float)
        v = self.noise * np.random.default_rng([self.seed, run_index or 0]).standard_normal(u.shape)
        poles = 0.95 * np.exp(2j * np.pi * 35.0 / RATE_HZ * np.array([1, -1]))
        a, b = np.poly(poles).real, np.array([0.0, 0.02, -0.02])
        if controller is None:
            force = np.concatenate([np.zeros((1, 1)), u[:, :-1]], axis=1) + d
            return Record(u, lfilter(b, a, force) + v, RATE_HZ, self.actuators, self.sensors)
        return self._closed(u, d, v, (a, b), controller)

    def _closed(self, u, d, v, plant, law):
        (_, a1, a2), (_, b1, b2) = plant
        x, y, f, sent = np.zeros(law.A.shape[0]), [0.0, 0.0], [0.0, 0.0], 0.0
        commands, readings = np.zeros_like(u), np.zeros_like(u)
        for k in range(u.shape[1]):
            now = b1 * f[0] + b2 * f[1] - a1 * y[0] - a2 * y[1]
            y, f = [now, y[0]], [sent + d[0, k], f[0]]
            readings[0, k] = seen = now + v[0, k]
            sent = commands[0, k] = u[0, k] + float(law.C[0] @ x) + law.D[0, 0] * seen
            x = law.A @ x + law.B[:, 0] * seen
        return Record(commands, readings, RATE_HZ, self.actuators, self.sensors)


def written(folder: Path) -> Path:
    """Write list and study into a folder and return the study's file."""
    (folder / "list.toml").write_text(LIST)
    (folder / "study.toml").write_text(STUDY)
    return folder / "study.toml"


def swift() -> None:
    """Compute and draw nothing twice in this process and its children, and find no compiler.

    An outcome is remembered by the whole key of its stage: a stage that took up a false file would have another key,
    and compute. A process that does more than this afterwards puts everything back (`swiftly`).
    """
    drawn, draw, outcomes, stage = [], stills.draw_small_png, {}, Cache.stage

    def first(*given):
        if not drawn:
            drawn.append(draw(*given))
        return drawn[0]

    def recalled(self, name, room, key, compute, kind=dict, writes=None):
        known = (name, content_hash(key))

        def remembered():
            if known not in outcomes:
                outcomes[known] = compute()
            return outcomes[known]

        return stage(self, name, room, key, compute if writes else remembered, kind, writes)

    stills.draw_small_png, Cache.stage = first, recalled
    stills.MANY = sys.maxsize  # no second process, which would draw in earnest
    os.environ["PATH"] = ""
    os.environ.pop("CC", None)


@contextmanager
def swiftly():
    """Be `swift` for the length of a block."""
    before = stills.draw_small_png, Cache.stage, stills.MANY, dict(os.environ)
    swift()
    try:
        yield
    finally:
        stills.draw_small_png, Cache.stage, stills.MANY, environment = before
        os.environ.update(environment)


def walk(study: Path, folder: Path):
    """Run the study with nothing said."""
    with registered("bench", "one-mass", OneMass):  # other tests ask which benches there are
        return pipeline.walk(pipeline.load_study(study), folder, study.parent, say=lambda _: None)
