"""A control rate that is a fraction of the sampling rate: what it filters, holds and delays."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet.linalg import response
from ultraquiet.values.interconnect import series
from ultraquiet.values.record import Record
from ultraquiet.values.state_space import StateSpace

# Filter that both sides of a record with free commands go through, so that it cancels: half its length in control
# samples, and where it ends as a share of the control rate's Nyquist frequency.
COMMON_HALF, COMMON_STOP = 16, 0.8


@dataclass(frozen=True)
class Decimation:
    """Every `factor`-th sample is a control sample: readings are averaged and decimated, commands are held.

    Readings go through `averages` running means of `factor` samples each, H(z) = [(1 + ... + z^-(N-1)) / N]^a, a
    cascaded integrator-comb filter. Its zeros stand on every multiple of the control rate, so that what would fold onto
    low frequencies is gone: from 0.9 of the control rate folded onto 0.1, -37 dB with two averages and N = 4. It delays
    by `filter_delay_samples` = a (N - 1) / 2 samples. A command formed from the readings of control sample m acts
    `latency` samples later and is held for N. Filter, hold and latency belong to the plant that a controller meets.

    Args:
        factor: N, samples of the bench in a control sample.
        averages: a; more of them fold less and delay more.
        latency: samples of the bench between reading and action, 1 to N; a whole control sample when absent, as on
            every bench of this package. The time to compute must fit into it.

    Raises:
        InputError: numbers that are not whole or out of range.

    >>> Decimation(4).taps.tolist(), Decimation(4).filter_delay_samples
    ([0.0625, 0.125, 0.1875, 0.25, 0.1875, 0.125, 0.0625], 3.0)

    Reference: E. B. Hogenauer, IEEE Trans. ASSP 29 (1981) 155-162, doi:10.1109/TASSP.1981.1163535.
    """

    factor: int
    averages: int = 2
    latency: int | None = None
    taps: FloatArray = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        N = whole("Decimation", "factor", self.factor, 1)
        averages = whole("Decimation", "averages", self.averages, 0, 8)
        if self.latency is not None:
            whole("Decimation", "latency", self.latency, 1, N)
        # Counted in whole numbers and divided once: the same bits everywhere.
        counts = np.ones(1, dtype=np.int64)
        for _ in range(averages):
            counts = np.convolve(counts, np.ones(N, dtype=np.int64))
        taps = counts / float(N**averages)
        taps.setflags(write=False)
        object.__setattr__(self, "taps", taps)

    @classmethod
    def to(cls, control_rate_hz: float, rate_hz: float, averages: int = 2, latency: int | None = None) -> "Decimation":
        """Return the decimation from a bench's rate to a control rate.

        Raises:
            InputError: the rates are not in a whole ratio.

        >>> Decimation.to(2000.0, 8000.0).factor
        4
        """
        ratio = rate_hz / control_rate_hz if control_rate_hz > 0 else 0.0
        factor = round(ratio)
        if factor < 1 or abs(ratio - factor) > 1e-9 * factor:
            near = ", ".join(f"{rate_hz / n:g}" for n in sorted({max(1, int(ratio)), int(ratio) + 1}))
            raise InputError(
                f"Decimation: a control rate of {control_rate_hz:g} Hz is no whole fraction of the bench's "
                f"{rate_hz:g} Hz; the nearest are {near} Hz."
            )
        return cls(factor, averages, latency)

    @property
    def wait(self) -> int:
        """Samples by which the held commands come later than the reading they are formed from."""
        return (self.factor if self.latency is None else self.latency) - 1

    @property
    def filter_delay_samples(self) -> float:
        """Delay of the readings in samples of the bench, the same at all frequencies."""
        return (self.taps.size - 1) / 2

    def frequency_response(self, f_hz: ArrayLike, rate_hz: float) -> ComplexArray:
        """Return the filter's response at `f_hz` `(nf,)`, at the bench's `rate_hz`."""
        z = response.points(frequency_array("Decimation.frequency_response", f_hz), rate_hz)
        delayed = z[None, :] ** -np.arange(self.taps.size)[:, None]
        return np.asarray(self.taps @ delayed, dtype=np.complex128)

    def readings(self, outputs: FloatArray) -> FloatArray:
        """Return readings `(ny, n)` filtered from rest and decimated, `(ny, ceil(n / N))`: samples 0, N, 2N, ..."""
        before = np.zeros((outputs.shape[0], self.taps.size - 1))
        padded, n = np.hstack([before, outputs]), outputs.shape[1]
        return self.filtered([padded[:, self.taps.size - 1 - j :][:, : n : self.factor] for j in range(self.taps.size)])

    def filtered(self, past: list[FloatArray]) -> FloatArray:
        """Return sum_j taps[j] past[j], `past[j]` being the readings j samples ago; one order of summing everywhere."""
        out = self.taps[0] * past[0]
        for tap, reading in zip(self.taps[1:], past[1:], strict=True):
            out = out + tap * reading
        return out

    def held(self, commands: FloatArray) -> FloatArray:
        """Return control samples of commands `(nu, m)` as the bench is sent them, `(nu, m N)`: late by `wait`, held."""
        fast = np.repeat(commands, self.factor, axis=1)
        late = np.zeros_like(fast)
        late[:, self.wait :] = fast[:, : fast.shape[1] - self.wait]
        return late

    def plant(self, plant: StateSpace) -> StateSpace:
        """Return the plant that a controller at the control rate meets: filter, hold and latency around G; exact.

        Raises:
            InputError: a plant in continuous time.
        """
        if plant.rate_hz is None:
            raise InputError("Decimation.plant: the plant is in continuous time; discretise it at the bench's rate.")
        fast = series(plant, self._filter(len(plant.sensors), plant.rate_hz))
        nu, waiting = plant.D.shape[1], int(self.wait > 0)
        step, late, now = np.eye(fast.states), np.zeros_like(fast.B), np.zeros_like(fast.B)
        for i in range(self.factor - 1, -1, -1):  # the state after a control sample: sum of A^(N-1-i) B u(i)
            if i < self.wait:
                late = late + step @ fast.B
            else:
                now = now + step @ fast.B
            step = step @ fast.A
        rate_hz, wires = plant.rate_hz / self.factor, (plant.actuators, plant.sensors)
        if not waiting:
            return StateSpace(step, now, fast.C, fast.D, rate_hz, *wires)
        # The command before stays in force until the new one acts: it is a state.
        A = np.block([[step, late], [np.zeros((nu, fast.states + nu))]])
        zero = np.zeros_like(fast.D)
        return StateSpace(A, np.vstack([now, np.eye(nu)]), np.hstack([fast.C, fast.D]), zero, rate_hz, *wires)

    def record(self, record: Record) -> Record:
        """Return a record of the bench at the control rate, with the plant that a controller meets between its ends.

        Commands that were held as `held` holds them are taken one by one, and the readings as a controller would have
        had them: exact. Of commands that moved freely both sides are first low-passed alike, which cancels, and the
        readings are delayed and averaged as the hold would have. What a hold adds besides is missing: its images, which
        fold back through the filter. With two averages that is 0.2 % of the plant's gain up there at 0.1 of the control
        rate, 3 % at 0.25; record through held commands where that counts. The provenance says which (`held`).
        """
        frames, N = record.samples // self.factor, self.factor
        if frames < 2:
            raise InputError(f"Decimation.record: {record.samples} samples hold fewer than two control samples of {N}.")
        taken = record.inputs[:, self.wait : self.wait + (frames - 1) * N + 1 : N]
        settings = {"factor": N, "averages": self.averages, "wait": self.wait}
        n = frames * N
        is_held = np.array_equal(self.held(taken)[:, self.wait :], record.inputs[:, self.wait : n])
        if is_held and not record.inputs[:, : self.wait].any():
            u, y = taken, self.readings(record.outputs[:, :n])
        else:
            is_held, u, y = False, self._common(record.inputs[:, :n]), self._as_held(record.outputs[:, :n])
        made = Provenance("decimation.record", {**settings, "held": is_held}, parents=(record.hash,))
        return Record(u, y, record.rate_hz / N, record.actuators, record.sensors, made)

    def _common(self, signals: FloatArray) -> FloatArray:
        """Return signals through the low-pass that both sides share, decimated."""
        half = COMMON_HALF * self.factor
        k = np.arange(-half, half + 1)
        taps = np.sinc(COMMON_STOP * k / self.factor) * np.blackman(k.size)
        taps /= taps.sum()
        n = signals.shape[1]
        return np.stack([np.convolve(row, taps)[:n] for row in signals])[:, :: self.factor]

    def _as_held(self, outputs: FloatArray) -> FloatArray:
        """Return readings through the filter and, as if the commands had been held, through hold and latency."""
        hold = np.concatenate([np.zeros(self.wait), np.full(self.factor, 1.0 / self.factor)])
        taps, n = np.convolve(self.taps, hold), outputs.shape[1]
        return self._common(np.stack([np.convolve(row, taps)[:n] for row in outputs]))

    def _filter(self, ny: int, rate_hz: float) -> StateSpace:
        """Return the filter over `ny` channels, a state for every reading that is remembered."""
        past = self.taps.size - 1
        one = np.eye(ny)
        A = np.kron(np.eye(past, k=-1), one)
        B = np.kron(np.eye(past)[:, :1], one) if past else np.zeros((0, ny))
        C = np.kron(self.taps[None, 1:], one) if past else np.zeros((ny, 0))
        return StateSpace(A, B, C, self.taps[0] * one, rate_hz)
