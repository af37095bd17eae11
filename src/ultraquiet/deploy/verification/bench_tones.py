"""The compiled code on a bench beside the law it came from: what attenuation it keeps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import FloatArray, between, positive, tone_below_nyquist
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.bench import Bench
from ultraquiet.deploy.verification.rounded_loop import LOSS_DB, own_frequencies
from ultraquiet.values.controller import Controller
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

MEASURED_SHARE = 0.5  # of a run; before it the loop settles
SLOWEST = 2.0  # periods that are measured of the slowest tone nobody asked for
DURATION_S, SAMPLES = 2.0, 40  # of a run whose length nobody chose, whichever is longer
BESIDE = 4  # lines to either side of a tone, by which what is there without it is told
SILENT = 2 * np.finfo(float).tiny  # what stands for the amplitude of nothing, and no more
UNLIKELY = 4.0  # standard deviations of a loss that noise alone does not make; eight lines tell one to a quarter


@dataclass(frozen=True, eq=False)
class OnBench(Shown):
    """Reduction of tones in dB, `(tones, ny)`, by the float64 law and by the code.

    reduction_db = -20 log10(|y closed| / |y open|). `same_noise` tells whether both met the same noise. `noise_db` is
    the loss that noise may feign, one per tone: four standard deviations of what noise leaves of the difference of both
    runs. The same noise leaves nothing, until a converter or friction takes the runs apart.
    `heard`, `(tones, ny)`, tells which sensors hear the disturbance above their noise without a law; worst channels are
    the worst of these, of all where none does.
    """

    tones_hz: tuple[float, ...]
    law_db: FloatArray
    code_db: FloatArray
    same_noise: bool
    noise_db: FloatArray
    heard: NDArray[np.bool_]

    @property
    def worst_law_db(self) -> FloatArray:
        """Worst channel with the float64 law, one per tone."""
        return _audible(self.law_db, self.heard).min(axis=1)

    @property
    def worst_code_db(self) -> FloatArray:
        """Worst channel with the code, one per tone."""
        return _audible(self.code_db, self.heard).min(axis=1)

    @property
    def loss_db(self) -> FloatArray:
        """What the worst channel loses through the code, one per tone; negative where it gains."""
        return self.worst_law_db - self.worst_code_db

    @property
    def status(self) -> Status:
        """`ok` and `degraded` beyond noise: no tone loses half a decibel, or one does; else `not measured`."""
        loss, noise = np.nan_to_num(self.loss_db, nan=np.inf), np.nan_to_num(self.noise_db)
        worst = float(loss.max())
        tones = ", ".join(f"{db:.1f} dB at {f:g} Hz" for f, db in zip(self.tones_hz, self.worst_code_db, strict=True))
        sentence = (
            f"On the bench the code reaches {tones} and loses at most {max(worst, 0.0):.3f} dB to the float64 law."
        )
        if (loss - noise >= LOSS_DB).any():
            return Status(StatusWord.DEGRADED, sentence)
        unknown = [f"{noise[k]:.1f} dB at {self.tones_hz[k]:g} Hz" for k in np.flatnonzero(loss + noise >= LOSS_DB)]
        if not unknown:
            return Status(StatusWord.OK, sentence)
        said = f"{sentence} Noise alone may feign {', '.join(unknown)}; louder tones or longer runs tell."
        return Status(StatusWord.NOT_MEASURED, said)


def on_bench(
    bench: Bench | Callable[[], Bench],
    law: StateSpace,
    code: Controller,
    tones_hz: Sequence[float] | None = None,
    amplitude_v: float = 1.0,
    duration_s: float | None = None,
    plant: StateSpace | None = None,
) -> OnBench:
    """Disturb all actuators with a tone and compare what the law and its code leave of it.

    Args:
        bench: any bench, or a function that makes one. A bench with a seed, and one that is made, starts anew for every
            run, so law and code meet the same noise.
        law: the law as designed; the bench runs it in float64.
        code: what shall be deployed: the compiled code, or a `Processor`.
        tones_hz: tones in Hz; ends and middle of the plant's own band when absent, of the law's where no plant is
            given, as far as runs are long enough.
        amplitude_v: amplitude of each tone at the plant's input, in the unit of its actuators.
        duration_s: length of each run; its second half is measured. When absent two seconds, or 40 samples where these
            take longer.
        plant: G, whose band tells what tones to take.

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
        tones_hz = _own_tones(law if plant is None else plant, duration_s)
    if np.ndim(tones_hz) != 1 or not tones_hz:
        raise InputError(f"on_bench: 'tones_hz' must be a list of tones, got {tones_hz!r}.")
    fresh, same = _maker(bench)
    rows = [_compared(fresh, law, code, f, amplitude_v, duration_s) for f in tones_hz]
    law_db, code_db, noise_db, heard = (np.array(column) for column in zip(*rows, strict=True))
    tones = tuple(float(f) for f in tones_hz)
    return OnBench(tones, law_db, code_db, same, _worst_noise(noise_db, law_db, code_db, heard), heard)


def _compared(
    fresh: Callable[[], Any], law: StateSpace, code: Controller, f_hz: float, amplitude_v: float, duration_s: float
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return reductions by law and by code, what noise may feign between them, in dB, and who hears the tone."""
    ran = []
    for controller in (None, law, code):
        bench = fresh()
        f = tone_below_nyquist("on_bench", "tones_hz", f_hz, bench.rate_hz)
        between("on_bench", "tones_hz", f, 1.0 / (MEASURED_SHARE * duration_s), bench.rate_hz / 2, "Hz")
        phase = 2 * np.pi * f * np.arange(int(duration_s * bench.rate_hz)) / bench.rate_hz
        d = np.tile(amplitude_v * np.sin(phase), (len(bench.actuators), 1))
        if controller is code:
            code.reset()
        ran.append(bench.run(np.zeros_like(d), disturbance=d, controller=controller))
    (opened, noise), (by_law, _), (by_code, _) = (_amplitude(r.outputs, f_hz, r.rate_hz) for r in ran)
    _, apart = _amplitude(ran[2].outputs - ran[1].outputs, f_hz, ran[1].rate_hz)
    feigned_db = UNLIKELY * 20 / np.log(10) * apart / np.minimum(by_law, by_code)
    heard = opened > np.maximum(UNLIKELY * noise, SILENT)
    return 20 * np.log10(opened / by_law), 20 * np.log10(opened / by_code), feigned_db, heard


def _worst_noise(noise_db: FloatArray, law_db: FloatArray, code_db: FloatArray, heard: NDArray[np.bool_]) -> FloatArray:
    """Return what noise may feign at the sensors where law and code are worst, the larger of both, one per tone."""
    ends = [_audible(reduced, heard).argmin(axis=1)[:, None] for reduced in (law_db, code_db)]
    return np.maximum(*(np.take_along_axis(noise_db, end, axis=1)[:, 0] for end in ends))


def _audible(reduced_db: FloatArray, heard: NDArray[np.bool_]) -> FloatArray:
    """Return the reductions, infinite at sensors that do not hear a tone which others do."""
    return np.where(heard | ~heard.any(axis=1, keepdims=True), reduced_db, np.inf)


def _own_tones(system: StateSpace, duration_s: float) -> list[float]:
    """Return ends and middle of a system's own band, none slower than a run tells."""
    slowest_hz, rate = SLOWEST / (MEASURED_SHARE * duration_s), system.rate_hz or np.inf
    if slowest_hz >= rate / 2:
        raise InputError(
            f"on_bench: 'duration_s' = {duration_s:g} s holds no tone below Nyquist's {rate / 2:g} Hz; make it longer, "
            f"{SAMPLES / rate:g} s."
        )
    return sorted({max(float(f), slowest_hz) for f in own_frequencies(system)})


def _maker(bench: Any) -> tuple[Callable[[], Any], bool]:
    if not hasattr(bench, "run") and callable(bench):
        return bench, True
    if is_dataclass(bench) and not isinstance(bench, type) and any(each.name == "seed" for each in fields(bench)):
        return lambda: replace(bench), True
    return lambda: bench, False


def _amplitude(signals: FloatArray, f_hz: float, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return a tone's amplitude in each row over the second half of its samples, and its standard deviation.

    Tone and mean are fitted; what is left at the lines beside the tone is what noise does to it. The median of them
    passes over harmonics; the median size of Gaussian noise is sqrt(2 ln 2) deviations of either of its parts.
    """
    half = signals[:, int(signals.shape[1] * (1 - MEASURED_SHARE)) :].T
    size, left = _fitted(half, f_hz, rate_hz)
    line_hz = rate_hz / len(half)
    lines = f_hz + line_hz * np.arange(-BESIDE, len(half) // 2)
    told = (lines > line_hz / 2) & (lines < (rate_hz - line_hz) / 2) & (np.abs(lines - f_hz) > line_hz / 2)
    noise = np.array([_fitted(left, f, rate_hz)[0] for f in lines[told][: 2 * BESIDE]])
    return np.maximum(size, SILENT), np.median(noise, axis=0) / np.sqrt(2 * np.log(2))


def _fitted(outputs: FloatArray, f_hz: float, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return a tone's amplitude in each column, fitted with a mean, and what is left without both."""
    angle = 2 * np.pi * f_hz * np.arange(len(outputs)) / rate_hz
    basis = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=1)
    fitted, *_ = np.linalg.lstsq(basis, outputs, rcond=None)
    return np.hypot(fitted[0], fitted[1]), outputs - basis @ fitted
