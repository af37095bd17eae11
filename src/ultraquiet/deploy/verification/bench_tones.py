"""The compiled code on a bench beside the law it came from: what attenuation it keeps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, positive, tone_below_nyquist
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.bench import Bench
from ultraquiet.deploy.verification.rounded_loop import LOSS_DB, own_frequencies
from ultraquiet.values.controller import Controller
from ultraquiet.values.record import Record
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

MEASURED_SHARE = 0.5  # of a run; before it the loop settles
SLOWEST = 2.0  # periods that are measured of the slowest tone nobody asked for
DURATION_S, SAMPLES = 2.0, 40  # of a run whose length nobody chose, whichever is longer


@dataclass(frozen=True, eq=False)
class OnBench(Shown):
    """Reduction of tones in dB, `(tones, ny)`, by the float64 law and by the code.

    reduction_db = -20 log10(|y closed| / |y open|). `same_noise` tells whether both met the same noise.
    """

    tones_hz: tuple[float, ...]
    law_db: FloatArray
    code_db: FloatArray
    same_noise: bool

    @property
    def worst_law_db(self) -> FloatArray:
        """Worst channel with the float64 law, one per tone."""
        return self.law_db.min(axis=1)

    @property
    def worst_code_db(self) -> FloatArray:
        """Worst channel with the code, one per tone."""
        return self.code_db.min(axis=1)

    @property
    def loss_db(self) -> FloatArray:
        """What the worst channel loses through the code, one per tone; negative where it gains."""
        return self.worst_law_db - self.worst_code_db

    @property
    def status(self) -> Status:
        """`ok` when no tone loses half a decibel."""
        worst = float(np.nan_to_num(self.loss_db, nan=np.inf).max())
        tones = ", ".join(f"{db:.1f} dB at {f:g} Hz" for f, db in zip(self.tones_hz, self.worst_code_db, strict=True))
        sentence = (
            f"On the bench the code reaches {tones} and loses at most {max(worst, 0.0):.3f} dB to the float64 law."
        )
        return Status(StatusWord.OK if worst < LOSS_DB else StatusWord.DEGRADED, sentence)


def on_bench(
    bench: Bench | Callable[[], Bench],
    law: StateSpace,
    code: Controller,
    tones_hz: Sequence[float] | None = None,
    amplitude_v: float = 1.0,
    duration_s: float | None = None,
) -> OnBench:
    """Disturb all actuators with a tone and compare what the law and its code leave of it.

    Args:
        bench: any bench, or a function that makes one. A bench with a seed, and one that is made, starts anew for every
            run, so law and code meet the same noise.
        law: the law as designed; the bench runs it in float64.
        code: what shall be deployed: the compiled code, or a `Processor`.
        tones_hz: tones in Hz; ends and middle of the law's own band when absent, as far as runs are long enough.
        amplitude_v: amplitude of each tone at the plant's input, in the unit of its actuators.
        duration_s: length of each run; its second half is measured. When absent two seconds, or 40 samples where these
            take longer.

    Returns:
        `OnBench`.

    Raises:
        InputError: no tone, or one too slow or too fast to be measured; runs too short for any.
    """
    positive("on_bench", "amplitude_v", amplitude_v)
    if duration_s is None:
        duration_s = max(DURATION_S, SAMPLES / (law.rate_hz or np.inf))
    positive("on_bench", "duration_s", duration_s, "s")
    if tones_hz is None:
        tones_hz = _own_tones(law, duration_s)
    if np.ndim(tones_hz) != 1 or not tones_hz:
        raise InputError(f"on_bench: 'tones_hz' must be a list of tones, got {tones_hz!r}.")
    fresh, same = _maker(bench)
    rows: list[list[FloatArray]] = []
    for tone_hz in tones_hz:
        sizes = []
        for controller in (None, law, code):
            fresh_bench = fresh()
            rate = fresh_bench.rate_hz
            f = tone_below_nyquist("on_bench", "tones_hz", tone_hz, rate)
            between("on_bench", "tones_hz", f, 1.0 / (MEASURED_SHARE * duration_s), rate / 2, "Hz")
            phase = 2 * np.pi * f * np.arange(int(duration_s * rate)) / rate
            d = np.tile(amplitude_v * np.sin(phase), (len(fresh_bench.actuators), 1))
            if controller is code:
                code.reset()
            sizes.append(_amplitude(fresh_bench.run(np.zeros_like(d), disturbance=d, controller=controller), f))
        rows.append(sizes)
    opened, by_law, by_code = (np.array(column) for column in zip(*rows, strict=True))
    tones = tuple(float(f) for f in tones_hz)
    return OnBench(tones, 20 * np.log10(opened / by_law), 20 * np.log10(opened / by_code), same)


def _own_tones(law: StateSpace, duration_s: float) -> list[float]:
    """Return ends and middle of the law's own band, none slower than a run tells."""
    slowest_hz, rate = SLOWEST / (MEASURED_SHARE * duration_s), law.rate_hz or np.inf
    if slowest_hz >= rate / 2:
        raise InputError(
            f"on_bench: 'duration_s' = {duration_s:g} s holds no tone below Nyquist's {rate / 2:g} Hz; make it longer, "
            f"{SAMPLES / rate:g} s."
        )
    return [max(float(f), slowest_hz) for f in own_frequencies(law)]


def _maker(bench: Any) -> tuple[Callable[[], Any], bool]:
    if not hasattr(bench, "run") and callable(bench):
        return bench, True
    if is_dataclass(bench) and not isinstance(bench, type) and any(each.name == "seed" for each in fields(bench)):
        return lambda: replace(bench), True
    return lambda: bench, False


def _amplitude(record: Record, f_hz: float) -> FloatArray:
    """Return the tone's amplitude at each sensor, fitted over the second half with the mean removed."""
    start = int(record.samples * (1 - MEASURED_SHARE))
    angle = 2 * np.pi * f_hz * np.arange(start, record.samples) / record.rate_hz
    basis = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=1)
    fitted, *_ = np.linalg.lstsq(basis, record.outputs[:, start:].T, rcond=None)
    return np.maximum(np.hypot(fitted[0], fitted[1]), np.finfo(float).tiny)
