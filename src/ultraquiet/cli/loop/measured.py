"""What a loop was measured to do, as tables with the channels' names and units, and as JSON."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ultraquiet._base.constraints import positive, rising_band, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown.line import several_of
from ultraquiet.cli.loop.facts import decibels, seconds
from ultraquiet.cli.loop.places import WHO, LoopPlace
from ultraquiet.cli.output.text_table import TextTable
from ultraquiet.pipeline.preflight import MOST_SAMPLES

if TYPE_CHECKING:
    from ultraquiet.simulate import Attenuation, NoiseReduction, StepReduction
    from ultraquiet.values import StateSpace

DEFAULT = "default"
PERIODS = 16.0  # of the lowest tone, or line of the band, in a run whose length nobody asked for


@dataclass(frozen=True)
class Wanted:
    """What is to be measured, checked before anything runs."""

    tones_hz: tuple[float, ...]
    noise: bool
    step: bool
    band_hz: tuple[float, float] | None
    amplitude: float
    duration_s: float
    seed: int

    @classmethod
    def of(
        cls,
        place: LoopPlace,
        tones: str | None,
        noise: bool,
        step: bool,
        otherwise: str | None,
        band_hz: tuple[float, float] | None,
        amplitude: float | None,
        duration_s: float | None,
        seed: int,
    ) -> "Wanted":
        """Return what the words of the command line ask for at a place."""
        asked = otherwise if tones is None else tones
        tones_hz = () if asked is None else place.tones_hz if asked == DEFAULT else _tones(asked, place.bench.rate_hz)
        band = place.band_hz if band_hz is None else rising_band(WHO, band_hz, place.bench.rate_hz)
        if noise and band is None:
            raise InputError(f"{WHO}: the study names no band for the noise; give --band LOW HIGH, in Hz.")
        size = place.amplitude if amplitude is None else positive(WHO, "--amplitude", amplitude)
        slowest: list[float] = [PERIODS / place.duration_s, *tones_hz, *([band[0]] if noise and band else [])]
        length = PERIODS / min(slowest) if duration_s is None else positive(WHO, "--duration", duration_s, "s")
        longest_s = MOST_SAMPLES / (place.bench.rate_hz * (len(place.bench.actuators) + len(place.bench.sensors)))
        if length > longest_s:
            raise InputError(f"{WHO}: '--duration' may be {longest_s:.3g} s at most, got {length:g}.")
        return cls(tones_hz, noise, step, band, size, length, whole(WHO, "--seed", seed, 0))


@dataclass(frozen=True, eq=False)
class LoopMeasured:
    """What was measured; None where it was not asked for."""

    tones: "Attenuation | None"
    noise: "NoiseReduction | None"
    step: "StepReduction | None"
    amplitude: float
    duration_s: float

    def grids(self, place: LoopPlace) -> Iterator[TextTable]:
        """Yield a table for each thing measured."""
        if self.tones is not None:
            yield _tone_grid(self.tones, place, self.amplitude)
        if self.noise is not None:
            yield _noise_grid(self.noise, place, self.amplitude)
        if self.step is not None:
            yield _step_grid(self.step, place)

    def remarks(self) -> Iterator[str]:
        """Yield a sentence for every tone of which a sensor shows no more than its range, or that had not settled."""
        t = self.tones
        if t is None:
            return
        for f, names, settled, run in zip(t.tones_hz, t.cut, t.settled, t.closed, strict=True):
            if names:
                who = ", ".join(f"'{name}'" for name in names)
                stood = several_of(len(names), "stands", "stand")
                yield f"at {f:g} Hz {who} {stood} at an end of the range, which cuts the tone off; lower --amplitude"
            if not settled:
                yield f"at {f:g} Hz the tone was still changing after {run.duration_s:.3g} s; a longer --duration waits"

    def facts(self, place: LoopPlace) -> dict[str, Any]:
        """Return everything measured by channel name."""
        facts: dict[str, Any] = {"channels": {"actuators": place.bench.actuators, "sensors": place.bench.sensors}}
        if self.tones is not None:
            t = self.tones
            facts["tones"] = [
                {
                    "f_hz": f,
                    "settled": t.settled[k],
                    "sensors": _by_name(place, reduction_db=t.reduction_db[k], open=t.open_v[k], closed=t.closed_v[k]),
                }
                for k, f in enumerate(t.tones_hz)
            ]
        if self.noise is not None:
            n = self.noise
            rms = _by_name(place, open_rms=n.open_rms, closed_rms=n.closed_rms, reduction_db=n.reduction_db)
            facts["noise"] = {"band_hz": n.band_hz, "sensors": rms}
        if self.step is not None:
            s = self.step
            names = ("open_peak", "closed_peak", "open_settling_s", "closed_settling_s", "open_final", "closed_final")
            facts["step"] = {
                "amplitude": s.amplitude,
                "actuators": {
                    actuator.name: _by_name(place, **{name: getattr(s, name)[:, k] for name in names})
                    for k, actuator in enumerate(place.bench.actuators)
                },
            }
        return facts


def measure(place: LoopPlace, law: "StateSpace", wanted: Wanted) -> LoopMeasured:
    """Run what was asked for."""
    from ultraquiet import simulate

    bench, size, length = place.bench, wanted.amplitude, wanted.duration_s
    tones = simulate.attenuation(bench, law, wanted.tones_hz, size, length) if wanted.tones_hz else None
    noise = (
        simulate.noise_reduction(bench, law, wanted.band_hz, size, length, wanted.seed)
        if wanted.noise and wanted.band_hz
        else None
    )
    step = simulate.step_reduction(bench, law, size, length) if wanted.step else None
    return LoopMeasured(tones, noise, step, size, length)


def _tones(text: str, rate_hz: float) -> tuple[float, ...]:
    try:
        tones = tuple(float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"{WHO}: '--tones' must be frequencies in Hz, 20,47.5 say, got '{text}'.") from None
    for f in tones:
        if not 0 < f < rate_hz / 2:
            raise InputError(f"{WHO}: '--tones' must lie between 0 and {rate_hz / 2:g} Hz, got {f:g}.")
    return tones


def _by_name(place: LoopPlace, **columns: Any) -> dict[str, Any]:
    return {
        sensor.name: {"unit": sensor.unit, **{key: float(values[k]) for key, values in columns.items()}}
        for k, sensor in enumerate(place.bench.sensors)
    }


def _sized(size: float, place: LoopPlace) -> str:
    """Return a size with the unit that all actuators share, without one where they share none."""
    units = {wire.unit for wire in place.bench.actuators}
    return f"{size:g} {units.pop()}".strip() if len(units) == 1 else f"{size:g}"


def _tone_grid(t: "Attenuation", place: LoopPlace, size: float) -> TextTable:
    grid = TextTable(
        ("tone", "sensor", "unit", "open", "closed", "reduction"),
        f"tones of {_sized(size, place)} at all actuators, amplitudes",
    )
    for k, f in enumerate(t.tones_hz):
        for i, sensor in enumerate(place.bench.sensors):
            levels = (f"{t.open_v[k, i]:.4g}", f"{t.closed_v[k, i]:.4g}")
            grid.add(f"{f:g} Hz", sensor.name, sensor.unit, *levels, decibels(t.reduction_db[k, i]))
    return grid


def _noise_grid(n: "NoiseReduction", place: LoopPlace, size: float) -> TextTable:
    title = f"noise of {_sized(size, place)} RMS at all actuators, {n.band_hz[0]:.4g} to {n.band_hz[1]:.4g} Hz, RMS"
    grid = TextTable(("sensor", "unit", "open", "closed", "reduction"), title)
    for i, sensor in enumerate(place.bench.sensors):
        levels = (f"{n.open_rms[i]:.4g}", f"{n.closed_rms[i]:.4g}")
        grid.add(sensor.name, sensor.unit, *levels, decibels(n.reduction_db[i]))
    return grid


def _step_grid(s: "StepReduction", place: LoopPlace) -> TextTable:
    heads = ("actuator", "sensor", "unit", "peak open", "peak closed", "settles open", "settles closed")
    grid = TextTable(heads, f"step of {_sized(s.amplitude, place)} at each actuator, to 2 % of the peak")
    for k, actuator in enumerate(place.bench.actuators):
        for i, sensor in enumerate(place.bench.sensors):
            peaks = (f"{s.open_peak[i, k]:.4g}", f"{s.closed_peak[i, k]:.4g}")
            times = (_settling(s.open_settling_s[i, k]), _settling(s.closed_settling_s[i, k]))
            grid.add(actuator.name, sensor.name, sensor.unit, *peaks, *times)
    return grid


def _settling(time_s: float) -> str:
    return seconds(time_s) if np.isfinite(time_s) else "not yet"
