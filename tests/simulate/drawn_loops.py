"""Loops drawn at random whose slowest pair has a modulus that is asked for, as benches."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import erfc

import ultraquiet as uq
from ultraquiet._base.compiled import compiled
from ultraquiet._base.errors import InputError

RATE_HZ = 1000.0
FAR = 1e12  # limits away from zero: as good as beyond any
SHAPES = ((1, 1), (2, 2), (4, 3), (3, 5))


@dataclass(frozen=True)
class DrawnLoop:
    """A bench, a law that closes it, and the truth.

    `growth_per_s` and `f_hz` are those of the slowest pole; `clipped` is the share of the time for which the noise of
    the readings alone asks a command of the linear loop for more than its range, a minute after it was closed.
    """

    bench: "LinearBench"
    law: uq.StateSpace
    growth_per_s: float
    f_hz: float
    clipped: float


def drawn_loop(rng, modulus, noise=0.0, limited=True, unit=1.0):
    """Return a loop of drawn size; `noise` and range of a reading are in multiples of `unit`."""
    ny, nu = SHAPES[rng.integers(len(SHAPES))]
    (A, B, C), K = drawn_plant(rng, ny, nu, modulus)
    poles = np.linalg.eigvals(closed(A, B, C, K))
    slowest = poles[np.argmax(np.abs(poles))]
    law = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), K / unit, RATE_HZ)
    bench = LinearBench(
        A,
        B,
        unit * C,
        noise * unit,
        np.random.default_rng(rng.integers(2**32)),
        (25.0, 10.0 * unit) if limited else (np.inf, np.inf),
    )
    f_hz = abs(np.angle(slowest)) * RATE_HZ / (2 * np.pi)
    clipped = clipped_share(A, B, C, K, noise, bench.actuators[0].high)
    return DrawnLoop(bench, law, np.log(np.abs(slowest)) * RATE_HZ, f_hz, clipped)


def drawn_plant(rng, ny, nu, modulus):
    """Return modes, and the gains with which the slowest pair of their loop has this modulus."""
    while True:
        A, B, C = modal(rng, ny, nu)
        K = rng.standard_normal((nu, ny))
        if (gain := gain_for(A, B, C, K, modulus)) is not None:
            return (A, B, C), gain * K


def clipped_share(A, B, C, K, noise, limit):
    """Return the share of the time for which noise alone drives the loudest command of a loop over a limit by then.

    What noise heaps up in 2 n samples is sum F^k Q F'^k: that of n of them, and once more as the loop carries it on.
    """
    step = closed(A, B, C, K)
    fed = noise * np.vstack([np.zeros((A.shape[0], C.shape[0])), K])
    states = fed @ fed.T
    for _ in range(math.ceil(math.log2(60.0 * RATE_HZ))):
        if np.diag(states).max() > (FAR * limit) ** 2:  # it has run away by then
            break
        states, step = states + step @ states @ step.T, step @ step
    rms = float(np.sqrt(np.diag(states)[A.shape[0] :].max()))
    return float(erfc(limit / rms / np.sqrt(2))) if rms > 0 else 0.0


def modal(rng, ny, nu):
    """Return lightly damped modes with random shapes, about one reading per command at the resonances."""
    f, zeta = np.exp(rng.uniform(np.log(2.0), np.log(300.0), 4)), np.exp(rng.uniform(np.log(0.005), np.log(0.05), 4))
    A, B, C = np.zeros((8, 8)), np.zeros((8, nu)), np.zeros((ny, 8))
    for k, (f_k, zeta_k) in enumerate(zip(f, zeta, strict=True)):
        s = 2 * np.pi * f_k / RATE_HZ * (-zeta_k + 1j * np.sqrt(1 - zeta_k**2))
        z = np.exp(s)
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[z.real, z.imag], [-z.imag, z.real]]
        B[2 * k : 2 * k + 2] = np.sqrt(1 - abs(z)) * rng.standard_normal((2, nu))
        C[:, 2 * k : 2 * k + 2] = np.sqrt(1 - abs(z)) * rng.standard_normal((ny, 2))
    return A, B, C


def closed(A, B, C, K):
    """Return the loop's matrix; the command acts one sample late."""
    nu = B.shape[1]
    return np.block([[A, B], [K @ C, np.zeros((nu, nu))]])


def gain_for(A, B, C, K, modulus):
    """Return the smallest gain at which the largest pole, a pair, has this modulus; None where there is none."""

    def excess(g):
        return np.abs(np.linalg.eigvals(closed(A, B, C, g * K))).max() - modulus

    gains = np.geomspace(1e-3, 1e3, 120)
    values = [excess(g) for g in gains]
    for low, high, a, b in zip(gains, gains[1:], values, values[1:], strict=False):
        if a < 0 < b:
            g = brentq(excess, low, high, xtol=1e-16, rtol=1e-15)
            poles = np.linalg.eigvals(closed(A, B, C, g * K))
            return g if abs(poles[np.argmax(np.abs(poles))].imag) > 1e-3 else None
    return None


class LinearBench:
    """What `wrapped` makes, stepped by compiled code and under laws without memory alone: a minute in milliseconds.

    `hum`: size, Hz and offset of what every reading holds besides, in its unit; the phase is another one in every run.
    `dead`: force below which no actuator moves.
    """

    real_time = False
    hum = (0.0, 0.0, 0.0)
    dead = 0.0

    def __init__(self, A, B, C, noise, rng, limits):
        self._plant, self._noise, self._rng = (A, B, C), noise, rng
        self.rate_hz = RATE_HZ
        self.actuators, self.sensors = wires(B.shape[1], C.shape[0], limits)
        ny, nu = C.shape[0], B.shape[1]
        self._open = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), np.zeros((nu, ny)), RATE_HZ)

    @property
    def modes_hz(self):
        """The plant's own frequencies."""
        return np.abs(np.angle(np.linalg.eigvals(self._plant[0])[::2])) * RATE_HZ / (2 * np.pi)

    def noise(self, samples):
        """Return what readings hold besides, `(samples, ny)`."""
        shape = (samples, len(self.sensors))
        return self._noise * self._rng.standard_normal(shape) if self._noise else np.zeros(shape)

    def run(self, actuation, disturbance=None, controller=None):
        """Return the record of one run from rest."""
        u = np.asarray(actuation, dtype=float)
        law = self._open if controller is None else controller
        d = np.zeros_like(u) if disturbance is None else np.asarray(disturbance, dtype=float)
        ny, nu = len(self.sensors), len(self.actuators)
        if not isinstance(law, uq.StateSpace) or law.states or law.D.shape != (nu, ny):
            raise InputError(f"LinearBench.run: the law must be a matrix ({nu}, {ny}).")
        noise = self.noise(u.shape[1])
        size, f_hz, offset = self.hum
        if size:
            angle = 2 * np.pi * f_hz * np.arange(u.shape[1]) / RATE_HZ + self._rng.uniform(0, 2 * np.pi)
            noise = noise + size * np.sin(angle)[:, None]
        noise = noise + offset
        low, high = (np.array([getattr(c, end) for c in self.actuators]) for end in ("low", "high"))
        given = [np.ascontiguousarray(x) for x in (*self._plant, law.D, u.T, d.T, noise, low, high)]
        commands, readings = stepped(*given, self.dead)
        return uq.Record(commands.T, readings.T, self.rate_hz, self.actuators, self.sensors)


@compiled
def stepped(A, B, C, K, u, d, noise, low, high, dead):  # pragma: no cover - compiled
    """Return commands and readings, `(samples, nu)` and `(samples, ny)`: y = C x + e, x = A x + B (held + d).

    What is less than `dead` of held + d does nothing, and so much of what is more.
    """
    samples, nu = u.shape
    ny, n = C.shape
    commands, readings = np.zeros((samples, nu)), np.zeros((samples, ny))
    state, following = np.zeros(n), np.zeros(n)
    held = np.zeros(nu)
    for k in range(samples):
        for i in range(ny):
            total = noise[k, i]
            for j in range(n):
                total += C[i, j] * state[j]
            readings[k, i] = total
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += A[i, j] * state[j]
            for j in range(nu):
                force = held[j] + d[k, j]
                if abs(force) > dead:
                    total += B[i, j] * (force - math.copysign(dead, force))
            following[i] = total
        state[:] = following
        for i in range(nu):
            total = u[k, i]
            for j in range(ny):
                total += K[i, j] * readings[k, j]
            held[i] = min(max(total, low[i]), high[i])
            commands[k, i] = held[i]
    return commands, readings


def wires(nu, ny, limits):
    """Return the channels of a bench."""
    actuators = tuple(uq.Channel(f"actuator {i + 1}", "V", -limits[0], limits[0]) for i in range(nu))
    return actuators, tuple(uq.Channel(f"sensor {i + 1}", "V", -limits[1], limits[1]) for i in range(ny))


def wrapped(A, B, C, noise, rng, limits):
    """Return the plant as a bench with white noise on its readings."""
    state = np.zeros(len(A))

    def step(u, d):
        nonlocal state
        y = C @ state
        state = A @ state + B @ (u + d)
        return y + noise * rng.standard_normal(y.size) if noise else y

    def reset():
        nonlocal state
        state = np.zeros(len(A))

    return uq.bench.Wrapped(step, reset, RATE_HZ, *wires(B.shape[1], C.shape[0], limits))
