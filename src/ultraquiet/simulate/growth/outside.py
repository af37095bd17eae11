"""Tones that a loop holds because something outside it hums or drifts, and not because a mode of it rings."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.bench import Bench
from ultraquiet.simulate.free_response import tones_hz
from ultraquiet.simulate.kick import Burst, FreeResponse, kicked, near, tones_alone
from ultraquiet.simulate.loop import disturb
from ultraquiet.values import StateSpace
from ultraquiet.values.controller import Controller

# A tone comes from outside where a burst at its frequency makes so many times as much of it: a mode that noise rings
# louder than any burst allowed cannot be told from a hum; and where the loop makes at most so many times as much of it
# as the bench without a law: a mode near it that hardly decays would make more.
HEARD, AMPLIFIED = 5.0, 10.0


def hums_of(
    bench: Bench, law: StateSpace | Controller, burst: Burst, found: FreeResponse, f_hz: Iterable[float]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return those of the frequencies in doubt at which the bench hums without a law too, and those told from modes.

    Mains, a pump, a drifting offset: a loop answers them for ever and may be as stable as any. One is told from a mode
    of the loop by three signs: readings hold it without a law; a burst makes much more of it, which dies; the loop
    makes no more of it than a well damped one may.

    Args:
        bench: any bench.
        law: what closes the loop.
        burst: its `samples` are those of the shortest record.
        found: a record in which these frequencies are in doubt.
        f_hz: the frequencies.

    Returns:
        Both in Hz, the second among the first.
    """
    f_hz, samples, rate = tuple(f_hz), found.response.shape[1], bench.rate_hz
    if not f_hz:
        return (), ()
    opened = _at_rest(bench, samples)
    held = _held_hz(opened, rate)
    doubted = tuple(f for f in f_hz if near(f, held, samples, rate))
    if not doubted:
        return (), ()
    closed = _at_rest(bench, samples, law)
    unit = np.sqrt(np.mean(closed**2, axis=1, keepdims=True)) + np.finfo(float).tiny
    return doubted, tuple(
        f
        for f in doubted
        if _size(closed / unit, f, rate) <= AMPLIFIED * _size(opened / unit, f, rate)
        and _dies(bench, law, replace(burst, length=min(burst.length, samples // 2)), f, unit, closed)
    )


def _dies(
    bench: Bench, law: StateSpace | Controller, burst: Burst, f_hz: float, unit: FloatArray, closed: FloatArray
) -> bool:
    """Return whether the loudest burst at a tone's frequency makes much more of it, and nothing of that stays.

    A slow mode of the loop at the very frequency goes on ringing: whether it grows, nobody may leave out.
    """
    tones = replace(tones_alone(bench, law, burst, (f_hz,)), samples=closed.shape[1] - burst.length)
    after = np.subtract(*(run.outputs for run in kicked(bench, law, tones).runs)) / 2 / unit
    made, left = (_size(part, f_hz, bench.rate_hz) for part in (after[:, : burst.length], after[:, -burst.length :]))
    return made >= HEARD * max(_loudest(closed / unit, f_hz, bench.rate_hz, burst.length), left)


def hums_at_rest(bench: Bench, samples: int) -> tuple[float, ...]:
    """Return the tones that a bench holds in so many samples without a law, Hz, clearest first."""
    return _held_hz(_at_rest(bench, samples), bench.rate_hz)


def _held_hz(readings: FloatArray, rate_hz: float) -> tuple[float, ...]:
    """Return the tones that readings hold; none where they are no numbers."""
    return tones_hz(readings, rate_hz) if np.isfinite(readings).all() else ()


def _at_rest(bench: Bench, samples: int, law: StateSpace | Controller | None = None) -> FloatArray:
    """Return what nobody drives, about its mean."""
    readings = disturb(bench, np.zeros((len(bench.actuators), samples)), law).outputs
    return readings - readings.mean(axis=1, keepdims=True)


def _size(x: FloatArray, f_hz: float, rate_hz: float) -> float:
    """Return the size of a tone over all channels, seen through Hann's window."""
    window = np.hanning(x.shape[1])
    turning = np.exp(-2j * np.pi * f_hz / rate_hz * np.arange(x.shape[1]))
    return float(np.linalg.norm(x @ (window * turning)) / window.sum())


def _loudest(x: FloatArray, f_hz: float, rate_hz: float, length: int) -> float:
    """Return the largest size of a tone in parts of so many samples."""
    parts = range(0, max(x.shape[1] - length, 0) + 1, max(length // 2, 1))
    return max(_size(x[:, at : at + length], f_hz, rate_hz) for at in parts)
