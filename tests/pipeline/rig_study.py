"""A study of a rig behind two callbacks: its bench, its list and the study file."""

RIG = '''
"""A rig of two callbacks, its card a simulation, and the same rig played back."""

from pathlib import Path

import numpy as np
import ultraquiet as uq

W = 2 * np.pi * np.array([12.0, 37.0])
INTERLOCKS = uq.bench.Interlocks(frame_s=600.0)  # a card without a clock: a busy machine trips nothing
SHAPES = np.array([[0.6, 0.8], [0.8, -0.6]])


class Card:
    """Two masses behind converters: what was put out last acts until the next frame."""

    def __init__(self, rate_hz):
        angles = W / rate_hz
        self.blocks = [np.exp(-0.03 * a) * np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) for a in angles]
        self.state, self.noise = np.zeros((2, 2)), np.random.default_rng(5)

    def put(self, newtons):
        drive = SHAPES.T @ newtons
        self.state = np.array([self.blocks[k] @ self.state[k] + np.array([0.01 * drive[k], 0.0]) for k in range(2)])

    def get(self):
        return SHAPES @ self.state[:, 0] + 1e-5 * self.noise.standard_normal(2)


def make(rate_hz=500.0):
    card = Card(rate_hz)
    forces = [uq.Channel(f"{side} force", "N", -30.0, 30.0) for side in ("left", "right")]
    speeds = [uq.Channel(f"{side} mass", "m/s") for side in ("left", "right")]
    return uq.bench.Hardware(card.put, card.get, rate_hz, forces, speeds, INTERLOCKS, wait=lambda: 0)


def played(folder):
    return uq.bench.Replay(tuple(uq.files.load(p) for p in sorted(Path(folder).rglob("*.h5"))))
'''
LIST = """
title = "rig"
[[commands]]
do = "configure"
samples = 3000
[[commands]]
do = "excite"
name = "rough"
actuator = "each"
signal = { method = "noise", stop_hz = 150.0, peak_v = 20.0 }
[[commands]]
do = "excite"
name = "sines"
actuator = "each"
signal = { method = "multisine", start_hz = 1.0, stop_hz = 200.0, period_samples = 1000, peak_v = 20.0 }
"""
STUDY = """
[study]
title = "The rig"
seed = 3
[bench]
object = "rig.py:make"
[experiment]
list = "list.toml"
[plant]
method = "rational"
records = ["sines"]
period_samples = 1000
[controllers.calm.design]
method = "lqg"
[closed_loop]
tones_hz = [17.0]
"""
