"""A law that was made for some of a bench's channels, on a bench that shows more of them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.bench import Bench, Blended, Decimated
from ultraquiet.values import Channel, StateSpace
from ultraquiet.values.controller import Controller, MachineStep


def instrumented(bench: Bench, names: Sequence[str], who: str) -> Bench:
    """Return the bench itself or, where it lacks a named channel, with all its instruments wired.

    A bench offers more channels than it is controlled by through a method `instrumented()`, which returns a bench of
    the same kind.

    Raises:
        InputError: there is no such channel, wired or not.
    """
    if isinstance(bench, Blended):
        bench = bench.bench
    if not _lacking(bench, names):
        return bench
    # What stands around a bench passes on what it offers, as that bench has it: at another rate, in other channels.
    wired = None if isinstance(bench, Decimated) else getattr(bench, "instrumented", None)
    full: Bench = bench if wired is None else wired()
    missing = _lacking(full, names)
    if missing:
        known = ", ".join(c.name for c in (*full.actuators, *full.sensors))
        hint = "" if wired is not None else " (a bench with more instruments offers them by a method 'instrumented')"
        raise InputError(f"{who}: the bench has no channel '{missing[0]}'; it has {known}{hint}.")
    return full


def place_of(name: str, channels: Sequence[Channel], who: str, kind: str) -> int:
    """Return the place of a named channel.

    Raises:
        InputError: none has that name.
    """
    for k, channel in enumerate(channels):
        if channel.name == name:
            return k
    raise InputError(f"{who}: there is no {kind} '{name}'; there are {', '.join(c.name for c in channels)}.")


def on_all_channels(
    law: StateSpace | Controller, own: Bench, full: Bench, apart: Sequence[str], who: str, reads: Sequence[str] = ()
) -> StateSpace | Controller:
    """Return a law of a bench's own channels as one of all channels of the bench with its instruments.

    Args:
        law: of as many readings and commands as `own` has, as `full` has, or as `full` has besides those `apart`.
        own: the bench that the law was made for.
        full: the bench on which it runs.
        apart: names of channels that no law takes by itself: shakers and what is only listened to.
        who: opens the sentence of a refusal.
        reads: names of the sensors that it reads, where those are not the own bench's.
    """
    if isinstance(own, Blended):
        law, own = own.on_the_bench(law), own.bench
    shape = _shape(law)
    every = len(full.actuators), len(full.sensors)
    if shape == every or (shape is None and own is full):
        return law
    read = [place_of(name, full.sensors, who, "sensor") for name in reads] or _named(own.sensors, full.sensors)
    drives = _named(own.actuators, full.actuators)
    if shape is not None and shape != (len(drives), len(read)) and not reads:
        read, drives = (
            [k for k, c in enumerate(wires) if c.name not in apart] for wires in (full.sensors, full.actuators)
        )
    if shape is not None and shape != (len(drives), len(read)):
        raise InputError(
            f"{who}: the law takes {shape[1]} readings and gives {shape[0]} commands; the bench offers {len(read)} "
            f"sensors and {len(drives)} actuators besides those that shake and listen."
        )
    if isinstance(law, StateSpace):
        return _padded(law, read, drives, every)
    if not (hasattr(law, "step") and hasattr(law, "reset")):
        raise InputError(f"{who}: a law is a StateSpace or has step(y) and reset(), got {type(law).__name__}.")
    return _OnSome(law, np.array(read), np.array(drives), every, full.rate_hz)


def _padded(law: StateSpace, reads: list[int], drives: list[int], every: tuple[int, int]) -> StateSpace:
    nu, ny = every
    B, C, D = np.zeros((law.states, ny)), np.zeros((nu, law.states)), np.zeros((nu, ny))
    B[:, reads], C[drives] = law.B, law.C
    D[np.ix_(drives, reads)] = law.D
    return StateSpace(law.A, B, C, D, law.rate_hz)


class _OnSome:
    """A controller of some of a bench's channels, stepped with all of them."""

    def __init__(self, law: Controller, reads: Any, drives: Any, every: tuple[int, int], rate_hz: float) -> None:
        self._law, self._reads, self._drives, self._every, self.rate_hz = law, reads, drives, every, rate_hz

    def reset(self) -> None:
        self._law.reset()

    def step(self, y: FloatArray) -> FloatArray:
        u = np.zeros(self._every[0])
        u[self._drives] = self._law.step(y[self._reads])
        return u

    def machine_step(self) -> MachineStep | None:
        inner: MachineStep | None = getattr(self._law, "machine_step", lambda: None)()
        if inner is None or inner.channels != (self._reads.size, self._drives.size):
            return None
        reads, drives = self._reads[inner.reads], self._drives[inner.drives]
        return replace(inner, reads=reads, drives=drives, channels=self._every[::-1], owner=(self, inner.owner))


def _shape(law: StateSpace | Controller) -> tuple[int, int] | None:
    """Return commands and readings of a law, None of a controller that does not tell."""
    held = law if isinstance(law, StateSpace) else getattr(law, "law", None)
    if held is None:
        held = getattr(getattr(law, "library", None), "law", None)
    shape = getattr(getattr(held, "D", None), "shape", None)
    return None if shape is None else (int(shape[0]), int(shape[1]))


def _named(mine: Sequence[Channel], theirs: Sequence[Channel]) -> list[int]:
    names = {c.name: k for k, c in enumerate(theirs)}
    return [names[c.name] for c in mine if c.name in names]


def _lacking(bench: Bench, names: Sequence[str]) -> list[str]:
    there = {c.name for c in (*bench.actuators, *bench.sensors)}
    return [name for name in names if name not in there]
