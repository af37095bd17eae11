"""A bench of a user's own that can be drawn: one mass on a spring, linear, in any units."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from ultraquiet.bench import LinearBench
from ultraquiet.values import StateSpace

RATE_HZ = 200.0
LAW = StateSpace([[0.5]], [[0.5]], [[-80.0]], [[0.0]], RATE_HZ)


@dataclass(frozen=True)
class Drawable:
    """Stiffness and mass differ from bench to bench; the delay makes a stiff and light one unstable with the law."""

    stiffness: float = 1e3
    mass: float = 1.0
    gain: float = 1.0
    rate_hz = RATE_HZ

    def drawn(self, seed):
        k, m = np.random.default_rng(seed).uniform(0.5, 1.5, 2)
        return Drawable(1e3 * k, m, self.gain)

    def drawn_parameters(self):
        return {"stiffness": self.stiffness, "mass": self.mass}

    def linear_model(self):
        A = np.array([[0.0, 1.0], [-self.stiffness / self.mass, -2.0 / self.mass]])
        E = expm(np.block([[A, np.array([[0.0], [1.0 / self.mass]])], [np.zeros((1, 3))]]) / RATE_HZ)
        late = np.vstack([E[:2], np.zeros((1, 3))])
        return StateSpace(late, [[0.0], [0.0], [1.0]], [[0.0, self.gain, 0.0]], [[0.0]], RATE_HZ)

    @property
    def actuators(self):
        return self.linear_model().actuators

    @property
    def sensors(self):
        return self.linear_model().sensors

    def run(self, actuation, disturbance=None, controller=None):
        return LinearBench(self.linear_model()).run(actuation, disturbance, controller)
