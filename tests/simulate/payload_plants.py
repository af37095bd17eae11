"""A base that is shaken, a payload on two struts: a linear bench in any units, and the same without its instruments."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from ultraquiet.bench import LinearBench
from ultraquiet.values import Channel, StateSpace

RATE_HZ = 500.0
STRUTS, SHAKER, PUSHER = ("strut a", "strut b"), "shaker", "pusher"
LISTENED, UNDER = ("payload left", "payload right"), ("base left", "base right")


def plant(newtons: float = 1.0, metres: float = 1.0) -> StateSpace:
    """Velocities of base and payload, two axes each, to forces; one unit of force is `newtons`, of speed `metres`/s."""
    M = np.diag([30.0, 20.0, 4.0, 6.0])
    link = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.array([[9e4, 1e4], [1e4, 7e4]]))
    K = link + np.diag([3e4, 2e4, 0.0, 0.0])
    D = 4e-4 * K + np.diag([200.0, 150.0, 8.0, 8.0])
    W = np.linalg.inv(M)
    A = np.block([[np.zeros((4, 4)), np.eye(4)], [-W @ K, -W @ D]])
    forces = np.array([[-1.0, 0, 0.7, 0], [0, -1.0, 0.3, 0], [1.0, 0, 0, 0.8], [0, 1.0, 0, 0.6]])
    B = np.vstack([np.zeros((4, 4)), W @ forces]) * newtons
    E = expm(np.block([[A, B], [np.zeros((4, 12))]]) / RATE_HZ)
    moving = np.hstack([np.zeros((4, 4)), np.eye(4)]) / metres
    C = np.vstack([moving[2:] - 0.2 * moving[:2], moving[2:], moving[:2]])
    wires = [Channel(name, "kN", -1e3 / newtons, 1e3 / newtons) for name in (*STRUTS, SHAKER, PUSHER)]
    sensors = [Channel(name, "um/s") for name in ("strut a", "strut b", *LISTENED, *UNDER)]
    return StateSpace(E[:8, :8], E[:8, 8:], C, np.zeros((6, 4)), RATE_HZ, wires, sensors)


@dataclass(frozen=True)
class Mounted:
    """The bench as it is controlled: two struts; `instrumented()` has shaker, pusher and all sensors."""

    newtons: float = 1.0
    metres: float = 1.0
    rate_hz = RATE_HZ

    @property
    def full(self):
        return LinearBench(plant(self.newtons, self.metres))

    @property
    def actuators(self):
        return self.full.actuators[:2]

    @property
    def sensors(self):
        return self.full.sensors[:2]

    def instrumented(self):
        return self.full

    def run(self, actuation, disturbance=None, controller=None):
        raise AssertionError("the bench was to be run with its instruments")


def law(newtons: float = 1.0, metres: float = 1.0) -> StateSpace:
    """Velocity feedback through a low pass, a little different on each strut."""
    K = -np.array([[260.0, 20.0], [0.0, 200.0]]) * metres / newtons
    return StateSpace(0.6 * np.eye(2), 0.4 * np.eye(2), K, np.zeros((2, 2)), RATE_HZ)


def heard(model: StateSpace, K: StateSpace, f_hz, source: int):
    """Responses of the payload's sensors to one actuator, open and closed, `(2, nf)` each, by algebra."""
    G, Kf = model.frequency_response(f_hz), K.frequency_response(f_hz)
    opened, closed = G[2:4, source], np.empty((2, f_hz.size), complex)
    for k in range(f_hz.size):
        y = np.linalg.solve(np.eye(2) - G[:2, :2, k] @ Kf[:, :, k], G[:2, source, k])
        closed[:, k] = G[2:4, source, k] + G[2:4, :2, k] @ Kf[:, :, k] @ y
    return opened, closed
