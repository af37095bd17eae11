"""One case of a campaign: a bench is drawn, the loop closed on it, and what comes of it is one row of a table."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, one_of, rising_band, whole
from ultraquiet._base.errors import InputError, UltraquietError, UnheardError, blames_no_law
from ultraquiet._base.provenance import content_hash, versions
from ultraquiet._base.threads import one_blas_thread
from ultraquiet.analyse.peaks import beside_poles
from ultraquiet.bench import Bench
from ultraquiet.identify import Rational
from ultraquiet.simulate.campaigns.drawing import WHO, drawn_bench, drawn_parameters
from ultraquiet.simulate.campaigns.told import kinds, told
from ultraquiet.simulate.commissioning.tuning import tune_in_place
from ultraquiet.simulate.sensitivity.measure import measure_sensitivity
from ultraquiet.simulate.stability import check_stability
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import sensitivity

ON = ("truth", "bench")
DRAWN = "drawn: "  # what the columns of parameters begin with
MEASURED = "measured_"  # and those of what was measured besides
EVEN_LINES, BAND_LINES = 240, 60  # over the axis and over the band
SHARP = 0.15  # damping below which a pole of the loop gets lines of its own, so that no needle stands between lines
PEAKS, INNER = 6, 7  # looked at more closely, with so many lines to each side
WIDTHS = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])  # of such a pole
Row = dict[str, Any]


@dataclass(frozen=True)
class Tuning:
    """How a law is made again on each drawn bench, from a record of it: see `tune_in_place`."""

    design: Any
    identify: Rational


@dataclass(frozen=True, eq=False)
class Campaign:
    """What is evaluated: one law on benches drawn from several units in turn.

    Args:
        units: name -> bench that is drawn; cases take them in turn.
        law: u = K y.
        band_hz: where the worst direction counts.
        on: "truth", the linear model of the drawn bench (its `linear_model()`), or "bench", measured on it.
        first_seed: case k is drawn by the seed `first_seed` + k.
        tuning: where given, each bench is recorded and gets a law of its own that begins with `law`.
        measured: so many of the first cases are judged on the truth and measured as well, with the same law.
        bench_key: what defines the units, content of files included, where whoever made them knows; they are asked
            themselves when absent.

    Raises:
        InputError: no units, a bench without a linear model for "truth", a band that does not rise or does not end
            below Nyquist.
    """

    units: tuple[tuple[str, Bench], ...]
    law: StateSpace
    band_hz: tuple[float, float]
    on: str = "truth"
    first_seed: int = 0
    tuning: Tuning | None = None
    measured: int = 0
    bench_key: Any = None

    def __post_init__(self) -> None:
        one_of(WHO, "on", self.on, ON)
        whole(WHO, "first_seed", self.first_seed, 0)
        if whole(WHO, "measured", self.measured, 0) and self.on == "bench":
            raise InputError(f"{WHO}: with on = \"bench\" every case is measured; leave 'measured' away.")
        rising_band(WHO, self.band_hz)
        if not self.units:
            raise InputError(f"{WHO}: give at least one bench.")
        for name, bench in self.units:
            rising_band(WHO, self.band_hz, bench.rate_hz)
            if self.on == "truth" and not callable(getattr(bench, "linear_model", None)):
                raise InputError(
                    f"{WHO}: the bench '{name}' has no linear model, so nothing is known of it but by measuring; take "
                    f'on = "bench".'
                )

    @property
    def digest(self) -> str:
        """What a result depends on besides the number of its case."""
        if self.bench_key is None:
            benches: list[Any] = [(name, told(bench)) for name, bench in self.units]
        else:
            benches = [self.bench_key, *((name, kinds(bench)) for name, bench in self.units)]
        how = (list(self.band_hz), self.on, self.first_seed, told(self.tuning), self.measured, versions())
        return content_hash(benches, self.law.hash, *how)[:16]

    def bench_of(self, case: int) -> tuple[str, Bench]:
        """Return unit and bench of a case, drawn."""
        name, bench = self.units[case % len(self.units)]
        return name, drawn_bench(bench, self.first_seed + case)

    def evaluate(self, case: int) -> Row:
        """Return the row of a case: its number, seed and unit, whether it is stable, figures, status and parameters.

        An unstable loop attenuates by minus infinity and peaks at infinity; so does one of which noise hides all. What
        is measured besides stands in columns of the same names that begin with `measured_`.
        """
        with one_blas_thread():
            unit, bench = self.bench_of(case)
            row: Row = {"case": case, "seed": self.first_seed + case, "unit": unit}
            law, tuned = self._law_of(bench)
            figures = _on_truth(bench, law, self.band_hz) if self.on == "truth" else self._measured(bench, law)
            if case < self.measured:
                figures |= {MEASURED + name: value for name, value in self._measured(bench, law).items()}
            parameters = drawn_parameters(bench)
        return {**row, **figures, **tuned, **{DRAWN + name: value for name, value in parameters.items()}}

    def worst_direction(self, case: int, f_hz: FloatArray) -> FloatArray | None:
        """Return the largest singular value of S of a case at `f_hz`; None where its bench has no linear model."""
        _, bench = self.bench_of(case)
        model = getattr(bench, "linear_model", None)
        if model is None:
            return None
        return _largest(model(), self._law_of(bench)[0], f_hz)

    def _law_of(self, bench: Bench) -> tuple[StateSpace, Row]:
        """Return the law that runs on a bench, and what came of making it there."""
        if self.tuning is None:
            return self.law, {}
        try:
            made = tune_in_place(bench, self.tuning.design, self.band_hz, law=self.law, identify=self.tuning.identify)
        except UltraquietError as error:
            return self.law, {"tuned": f"refused: {error}"}
        if made.law is None or not made.status.ok:
            return self.law, {"tuned": f"as before: {made.status}", "fit_error": made.fit_error}
        return made.law, {"tuned": str(made.status), "fit_error": made.fit_error}

    def _measured(self, bench: Bench, law: StateSpace) -> Row:
        try:
            check = check_stability(bench, law)
        except UltraquietError as error:  # of the bench or of what was asked: the case is lost, the others are not
            return _lost(f"not measured: {error}")
        if not check.status.ok:
            return _lost(str(check.status))
        try:
            found = measure_sensitivity(bench, law, down_to_hz=self.band_hz[0])
            attenuation = found.worst_in_band_db(*self.band_hz)
        except UltraquietError as error:
            if isinstance(error, UnheardError) or error.of_question:
                return {**_lost(f"not measured: The loop settles. {error}"), "stable": True}
            if blames_no_law(error):
                return _lost(f"not measured: {error}")
            # A law that runs away under a stronger disturbance is a finding about the law.
            return _lost(f"unstable: Under disturbances the loop ran away: {error}")
        return {
            "stable": True,
            "attenuation_db": attenuation,
            "peak_db": found.peak_amplification_db(),
            "lines_missing": found.lines_missing,
            "status": str(check.status),
        }


def _on_truth(bench: Any, law: StateSpace, band_hz: tuple[float, float]) -> Row:
    """Close the loop with the linear model: its poles, and S on a grid that holds every sharp pole."""
    plant = bench.linear_model()
    S = sensitivity(plant, law)
    poles, rate = S.poles(), float(plant.rate_hz)
    if not np.all(np.abs(poles) < 1):
        k = int(np.argmax(np.abs(poles)))
        growth, hz = rate * np.log(np.abs(poles[k])), rate * abs(np.angle(poles[k])) / (2 * np.pi)
        return _lost(f"unstable: the linear loop grows by {growth:.3g} a second at {hz:.4g} Hz")
    f = _lines(poles, rate, band_hz)
    size = 20 * np.log10(_largest(plant, law, f))
    nearer = _between(f, size)
    f, size = np.append(f, nearer), np.append(size, 20 * np.log10(_largest(plant, law, nearer)))
    inside = (f >= band_hz[0]) & (f <= band_hz[1])
    return {
        "stable": True,
        "attenuation_db": float(-size[inside].max()),
        "peak_db": float(max(size.max(), 0.0)),
        "lines_missing": 0,
        "status": "ok: the linear loop is stable",
    }


def _lines(poles: ComplexArray, rate_hz: float, band_hz: tuple[float, float]) -> FloatArray:
    own = beside_poles(poles, rate_hz, SHARP, WIDTHS)
    low, top = band_hz[0] / 10, rate_hz / 2
    even = np.geomspace(low, top, EVEN_LINES, endpoint=False)
    lines = np.concatenate([even, own[(own > low) & (own < top)], np.linspace(*band_hz, BAND_LINES)])
    return np.unique(lines[lines < top])


def _between(f_hz: FloatArray, size_db: FloatArray) -> FloatArray:
    """Return lines about the highest peaks, so near to each other that little of a peak is cut off."""
    padded = np.concatenate([[-np.inf], size_db, [-np.inf]])
    tops = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]))
    tops = tops[np.argsort(-size_db[tops])][:PEAKS]
    beside = [f_hz[np.maximum(tops - 1, 0)], f_hz[np.minimum(tops + 1, f_hz.size - 1)]]
    share = np.arange(1, INNER + 1) / (INNER + 1)
    return np.concatenate([(f_hz[tops] + np.outer(share, side - f_hz[tops])).ravel() for side in beside])


def _largest(plant: StateSpace, law: StateSpace, f_hz: FloatArray) -> FloatArray:
    G, K = (np.moveaxis(system.frequency_response(f_hz), 2, 0) for system in (plant, law))
    return np.asarray(np.linalg.norm(np.linalg.inv(np.eye(G.shape[1]) - G @ K), 2, axis=(1, 2)), dtype=np.float64)


def _lost(status: str) -> Row:
    return {"stable": False, "attenuation_db": -np.inf, "peak_db": np.inf, "lines_missing": 0, "status": status}
