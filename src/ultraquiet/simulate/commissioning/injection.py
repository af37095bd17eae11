"""What a loop answers to injections at its commands: both sensitivities from readings and commands alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.bench import Bench, Streaming
from ultraquiet.simulate.kick import rooms
from ultraquiet.values import Record, StateSpace
from ultraquiet.values.channel import at_limits
from ultraquiet.values.controller import Controller

WHO = "commission"
PERIODS = 2  # measured; what they differ by is noise
NEAR = 9  # lines that share an estimate of noise
LOWERINGS = 12  # of an injection that drives a reading to its limit, where no more is seen of how far it would go
PER_OCTAVE, MANY = 16, 8  # lines of an injection, and of one stretch at least


def lines_over(band_hz: tuple[float, float], per_octave: int, samples: int, rate_hz: float) -> FloatArray:
    """Return lines of a period of so many samples, evenly over the logarithm of a band."""
    count = max(MANY, round(per_octave * np.log2(band_hz[1] / band_hz[0])))
    wanted = np.geomspace(band_hz[0] * samples / rate_hz, band_hz[1] * samples / rate_hz, count)
    return np.unique(np.clip(np.rint(wanted), 1, (samples - 1) // 2))


@dataclass(frozen=True, eq=False)
class Injection:
    """The same period of sines for every actuator in turn: `lines` of the period, at `f_hz`, and its signal of peak 1.

    Phases are Schroeder's, which keep the peak low.
    """

    f_hz: FloatArray
    lines: np.ndarray[Any, np.dtype[np.int64]]
    period: FloatArray

    @classmethod
    def at(cls, lines: FloatArray, samples: int, rate_hz: float) -> "Injection":
        """Return these lines, rising whole numbers, of a period of so many samples."""
        whole = np.rint(lines).astype(np.int64)
        phase = -np.pi * np.arange(whole.size) * (np.arange(whole.size) - 1) / whole.size
        spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
        spectrum[whole] = np.exp(1j * phase)
        signal = np.fft.irfft(spectrum, samples)
        return cls(whole * rate_hz / samples, whole, signal / np.abs(signal).max())

    @classmethod
    def passes(cls, edges_hz: Sequence[float], seconds: float, rate_hz: float) -> "list[Injection]":
        """Return an injection for each stretch between edges: what is loud in one must not quieten the rest."""
        n = round(seconds * rate_hz)
        found = [lines_over(band, PER_OCTAVE, n, rate_hz) for band in pairwise(edges_hz)]
        return [cls.at(lines, n, rate_hz) for lines in found if lines.size]

    def run(self, settle: int) -> FloatArray:
        """Return the signal of a run: `settle` samples, then the periods that are measured."""
        samples = settle + PERIODS * self.period.size
        return self.period[(np.arange(samples) - settle) % self.period.size]

    def amplitudes(self, signals: FloatArray) -> ComplexArray:
        """Return what each of the last periods holds at the lines, `(period, channel, line)`."""
        n = self.period.size
        last = signals[:, -PERIODS * n :].reshape(len(signals), PERIODS, n)
        return np.moveaxis(np.fft.rfft(last, axis=2)[:, :, self.lines], 1, 0) * (2.0 / n)


@dataclass(frozen=True, eq=False)
class MeasuredLoop:
    """Both sensitivities over `f_hz`, and the deviation that noise leaves of the largest singular value of each.

    `at_input` `(nu, nu, nf)` = (I - K G)^-1 is what the commands are of what was injected; `at_output` `(ny, ny, nf)`
    = (I - G K)^-1 = I + G (I - K G)^-1 K, with K as the commands show it, or as it is known.
    """

    f_hz: FloatArray
    at_input: ComplexArray
    at_output: ComplexArray
    deviation: FloatArray

    def ends(self) -> dict[str, ComplexArray]:
        """Return the sensitivity at each end of the plant."""
        return {"input": self.at_input, "output": self.at_output}


@dataclass(frozen=True, eq=False)
class MeasuredResponse:
    """G `(ny, nu, nf)` over `f_hz` without a law, and the variance of each entry that noise leaves."""

    f_hz: FloatArray
    G: ComplexArray
    variance: FloatArray


def measured_response(bench: Bench, injection: Injection, levels: FloatArray, settle: int) -> MeasuredResponse:
    """Inject at each actuator in turn, no law running, and return the response from commands to readings."""
    nu, ny, n = len(bench.actuators), len(bench.sensors), injection.lines.size
    answered = np.empty((PERIODS, ny, nu, n), dtype=np.complex128)
    signal = injection.run(settle)
    for j in range(nu):
        actuation = np.zeros((nu, signal.size))
        actuation[j] = levels[j] * signal
        record = bench.run(actuation)
        # differs from G U = Y: commands that a limit has cut would be told by the record, so it is asked
        answered[:, :, j] = injection.amplitudes(record.outputs) / injection.amplitudes(record.inputs)[:, j, None]
    G = answered.mean(axis=0)
    each = np.abs(answered[0] - answered[1]) ** 2 / (2 * PERIODS)
    # Two periods tell little of one entry: noise is that of all entries of a sensor near a line.
    smooth = np.stack([np.convolve(row.mean(axis=0), np.ones(NEAR) / NEAR, mode="same") for row in each])
    variance = np.maximum(np.repeat(smooth[:, None], nu, axis=1), np.finfo(float).tiny)
    return MeasuredResponse(injection.f_hz, G, variance)


class Halted(Exception):  # noqa: N818 - it ends a run on purpose and is told, not raised to a caller
    """A run was faded out because a reading or a command stood at its limit; the message says which."""


def measured_loop(
    bench: Bench, law: StateSpace | Controller, injection: Injection, levels: FloatArray, settle: int, ramp: int
) -> MeasuredLoop:
    """Inject at each actuator in turn, the law running, and return both sensitivities.

    Raises:
        Halted: a reading or a command met its limit; the run was faded out within `ramp` samples.
    """
    nu, ny, n = len(bench.actuators), len(bench.sensors), injection.lines.size
    sent, answered = (np.empty((PERIODS, k, nu, n), dtype=np.complex128) for k in (nu, ny))
    signal = injection.run(settle)
    for j in range(nu):
        actuation = np.zeros((nu, signal.size))
        actuation[j] = levels[j] * signal
        record = _watched(bench, actuation, law, ramp)
        r = levels[j] * injection.amplitudes(signal[None])[0, 0]
        sent[:, :, j] = injection.amplitudes(record.inputs) / r
        answered[:, :, j] = injection.amplitudes(record.outputs) / r
    U, Y = (np.moveaxis(x.mean(axis=0), 2, 0) for x in (sent, answered))
    K = _known(law, injection.f_hz, U, Y)
    dU, dY = (np.moveaxis(x[0] - x[1], 2, 0) / 2 for x in (sent, answered))
    # What the two periods differ by is twice the error of their mean; its Frobenius norm bounds the singular value.
    deviation = np.maximum(np.linalg.norm(dU, axis=(1, 2)), np.linalg.norm(dY @ K, axis=(1, 2)))
    at_output = np.eye(ny) + Y @ K
    return MeasuredLoop(injection.f_hz, np.moveaxis(U, 0, 2), np.moveaxis(at_output, 0, 2), deviation)


def _known(law: StateSpace | Controller, f_hz: FloatArray, U: ComplexArray, Y: ComplexArray) -> ComplexArray:
    """Return K `(nf, nu, ny)`: that of a linear law, else what commands beside the injection are of readings."""
    linear = law if isinstance(law, StateSpace) else getattr(law, "law", None)
    if isinstance(linear, StateSpace):
        return np.moveaxis(linear.frequency_response(f_hz), 2, 0)
    return np.asarray((U - np.eye(U.shape[1])) @ np.linalg.pinv(Y), dtype=np.complex128)


def _watched(bench: Bench, actuation: FloatArray, law: StateSpace | Controller, ramp: int) -> Record:
    """Run the bench; one that streams is faded out as soon as a reading or a command stands at its limit.

    A command that is cut answers the injection as if there were hardly a loop, whatever the loop does.
    """
    if not isinstance(bench, Streaming):
        record = bench.run(actuation, controller=law)
        _within_limits(bench, at_limits(record.outputs, bench.sensors), at_limits(record.inputs, bench.actuators))
        return record
    halted = False

    def stop() -> bool:
        return halted

    blocks: list[Any] = []
    for block in bench.stream(actuation, controller=law, stop=stop, ramp_samples=ramp):
        blocks.append(block)
        met = np.concatenate([block.limited_readings, block.limited_commands])
        halted = halted or bool(np.any(met)) or not np.isfinite(block.readings).all()
    if halted:
        met = (sum(getattr(block, name) for block in blocks) for name in ("limited_readings", "limited_commands"))
        _within_limits(bench, *(np.asarray(each) for each in met))
        raise Halted("readings left the finite numbers")
    u, y = (np.concatenate([getattr(block, name) for block in blocks], axis=1) for name in ("command", "readings"))
    return Record(u, y, bench.rate_hz, bench.actuators, bench.sensors)


def _within_limits(bench: Bench, readings: NDArray[np.int64], commands: NDArray[np.int64]) -> None:
    """Tell which channel met its limit, by how many samples of each did."""
    for what, wires, counts in (("the reading", bench.sensors, readings), ("the command", bench.actuators, commands)):
        if np.any(counts):
            raise Halted(f"{what} of '{wires[int(np.argmax(counts))].name}' met its limit")


def joined(parts: Sequence[MeasuredLoop]) -> MeasuredLoop:
    """Return what several injections measured as one, by frequency."""
    f = np.concatenate([part.f_hz for part in parts])
    _, order = np.unique(f, return_index=True)
    at_input, at_output = (
        np.concatenate([getattr(part, name) for part in parts], axis=2) for name in ("at_input", "at_output")
    )
    deviation = np.concatenate([part.deviation for part in parts])
    return MeasuredLoop(f[order], at_input[:, :, order], at_output[:, :, order], deviation[order])


def open_levels(bench: Bench, injection: Injection, share: float, settle: int, most: FloatArray) -> FloatArray:
    """Return a level for each actuator, `most` at most, at which no reading exceeds `share` of its range without a law.

    Raises:
        InputError: an actuator that moves no sensor, or reaches a limit however little is sent to it.
    """
    levels = most.copy()
    for j in range(levels.size):
        for _ in range(LOWERINGS):
            actuation = np.zeros((levels.size, injection.period.size + settle))
            actuation[j] = levels[j] * injection.run(settle)[: actuation.shape[1]]
            y = bench.run(actuation).outputs
            if not y.any():
                raise InputError(f"{WHO}: '{bench.actuators[j].name}' moves no sensor.")
            clipped = np.any(at_limits(y, bench.sensors))
            levels[j] *= share if clipped else min(1.0, share / max(_used(bench, y), share))
            if not clipped:
                break
        else:
            raise InputError(
                f"{WHO}: a reading stands at its limit however little '{bench.actuators[j].name}' is sent."
            )
    return levels


def _used(bench: Bench, y: FloatArray) -> float:
    """Return the largest share of a reading's range that was used, about zero or where the reading rests."""
    centre, room = rooms(bench.sensors, y.mean(axis=1))
    swing = np.abs(y - centre[:, None]).max(axis=1)
    return float(np.max(np.where(np.isfinite(room), swing / room, 0.0)))
