"""Where a loop is closed: the bench of a study file, or a linear model."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ultraquiet._base.errors import InputError
from ultraquiet.cli.loop.loaded import loaded_plant, require_fit

if TYPE_CHECKING:
    from ultraquiet.bench import Bench
    from ultraquiet.values import StateSpace, Status

WHO = "simulate"
DURATION_S = 2.0  # of every disturbance where nobody says


@dataclass(frozen=True, eq=False)
class LoopPlace:
    """A bench with what it is called, and what a study or a model says of disturbances there.

    `model` is the plant when the bench is a model of one: then stability is known without a run.
    """

    bench: "Bench"
    name: str
    tones_hz: tuple[float, ...]
    band_hz: tuple[float, float] | None
    amplitude: float
    duration_s: float
    model: "StateSpace | None" = None
    notes: tuple[str, ...] = ()

    def stability(self, law: "StateSpace") -> "Status":
        """Return whether the loop is stable there: computed for a model, watched on a bench."""
        from ultraquiet.simulate import check_stability
        from ultraquiet.values import Status, StatusWord
        from ultraquiet.values.interconnect import feedback

        if self.model is not None:
            require_fit(WHO, self.model, law)
        if self.model is None or getattr(self.bench, "delayed", False):
            return check_stability(self.bench, law).status
        if feedback(self.model, law).is_stable():
            return Status(StatusWord.OK, "The loop with this model is stable.")
        return Status(StatusWord.UNSTABLE, "The loop with this model is unstable; nothing was measured.")


def place_of(study: Path | None, model: Path | None, unit: str | None) -> LoopPlace:
    """Return the place that was asked for, one and no more."""
    if (study is None) == (model is None):
        given = "both were given" if study is not None else "neither was given"
        raise InputError(f"{WHO}: a loop runs on --bench STUDY.toml or on --plant MODEL; {given}.")
    if model is not None:
        if unit is not None:
            raise InputError(f"{WHO}: a model has no units; --unit '{unit}' goes with --bench.")
        return _of_model(model)
    assert study is not None
    return _of_study(study, unit)


def _of_model(path: Path) -> LoopPlace:
    from ultraquiet.analyse.plant_scale import even_plant
    from ultraquiet.bench import LinearBench
    from ultraquiet.pipeline.preflight import usual_amplitude

    model = loaded_plant(path, WHO)
    bench = LinearBench(model)
    low, high = even_plant(model).band_hz
    tones = (low, (low * high) ** 0.5, high)
    notes = ("the model answers within a sample: its loop here has one sample of delay more",) if bench.delayed else ()
    return LoopPlace(
        bench,
        str(path),
        tuple(map(_three_digits, tones)),
        (low, high),
        usual_amplitude(bench),
        DURATION_S,
        model,
        notes,
    )


def _of_study(path: Path, unit: str | None) -> LoopPlace:
    from ultraquiet.pipeline import load_study
    from ultraquiet.pipeline.preflight import as_unit, usual_amplitude
    from ultraquiet.pipeline.tables.blending import in_modes
    from ultraquiet.pipeline.walk import bench_of

    study = load_study(path)
    bench, loop = bench_of(study, path.parent), study.closed_loop
    if bench is None:
        raise InputError(f"{WHO}: '{path}' names records and no bench that could run; take --plant MODEL.")
    chosen = unit or next(iter(loop.units), None)
    if chosen is not None:
        bench = as_unit(bench, chosen)
    name = str(path) if chosen is None else f"{path}, unit {chosen}"
    notes: tuple[str, ...] = ()
    if study.blending is not None:
        bench = in_modes(bench, study.blending, beside=path.parent)
        notes = ("the loop is closed in the modes of [blending], from all sensors: no record says which are dead",)
    amplitude = loop.amplitude or usual_amplitude(bench)
    duration_s = loop.duration_s or DURATION_S
    return LoopPlace(bench, name, tuple(loop.tones_hz), loop.band_hz, amplitude, duration_s, notes=notes)


def _three_digits(f_hz: float) -> float:
    return float(f"{f_hz:.3g}")
