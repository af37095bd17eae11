"""A bench of few lines that remembers how it was used, and the list it runs."""

import numpy as np

from ultraquiet import experiments
from ultraquiet.values import Channel, Record

LIST = """\
title = "three chirps, a tone and silence"
[[commands]]
do = "configure"
samples = 256
[[commands]]
do = "excite"
name = "chirp"
signal = { method = "chirp", start_hz = 5.0, stop_hz = 100.0 }
[[commands]]
do = "wait"
seconds = 2.5
[[commands]]
do = "excite"
name = "tone"
actuator = 2
samples = 100
signal = { method = "tone", frequency_hz = 60.0, amplitude_v = 10.0 }
[[commands]]
do = "record"
name = "quiet"
"""


class Fake:
    """Two actuators, three sensors, y = gain (u + d) from one sample before, and a count of runs."""

    rate_hz = 1000.0
    actuators = (Channel("a", "V", -25.0, 25.0), Channel("b", "V", -25.0, 25.0))
    sensors = (Channel("x"), Channel("y"), Channel("z"))
    gain = np.array([[1.0, 0.0], [0.0, 2.0], [0.5, 0.5]])

    def __init__(self):
        self.calls = []

    def run(self, actuation, disturbance=None, controller=None):
        self.calls.append((actuation, disturbance, controller))
        total = actuation if disturbance is None else actuation + disturbance
        y = np.zeros((3, total.shape[1]))
        y[:, 1:] = self.gain @ total[:, :-1]
        return Record(actuation, y, self.rate_hz, self.actuators, self.sensors)


def run(text, folder, bench, **kwargs):
    return experiments.run(experiments.parse(text, bench, folder=folder), folder, sleep=lambda _: None, **kwargs)
