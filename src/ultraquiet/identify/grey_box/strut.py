"""Eq. (10) of the paper fitted with its own symbols: values, bounds, covariance, and what the data cannot tell."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import ClassVar

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, positive, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.identify.grey_box import strut_equation as strut
from ultraquiet.identify.grey_box.data import SpectralLines, of_record, of_response, parents
from ultraquiet.identify.grey_box.least_squares import (
    SHARE,
    Identifiability,
    Minimum,
    chi_squared,
    identifiability,
    search,
)
from ultraquiet.identify.grey_box.realisation import realised
from ultraquiet.identify.grey_box.record import fitted_to_record
from ultraquiet.identify.grey_box.strut_result import StructuredFit, physical, verdict
from ultraquiet.identify.record_checks import usable
from ultraquiet.identify.result import SIGNIFICANCE, Result
from ultraquiet.values import FrequencyResponse, Record
from ultraquiet.values.handed_over.kinds import takes_values

WHO = "Structured"
BOUND_FACTOR = 1e3  # a free symbol is sought this factor below and above its guess when no bounds are given
CORNERS = (1.0, 0.2, 5.0)  # starts: the circuit's resistance times these
TRIAL_STEPS = 12
DELAYS = range(1, 5)  # tried when the delay is to be estimated
LINES_PER_PARAMETER = 2
DERIVED_STEP = 1e-6


@register("identify", "structured")
@dataclass(frozen=True)
class Structured:
    """V_out / V_in of one strut, eq. (10), with hold, anti-alias filter and delay, in the paper's symbols.

    G_c(s) = +- m_g K s^3 / (m_g s^2 + b_g s + k_g) (n / C) / [(m_p s^2 + b_p s + k_p)(1/C + 1/C_M + R_M s)
    + (n^2 / C)(1/C_M + R_M s)] F(s), F the two-pole filter; G(z) = z^(1 - delay) (G_c behind a zero-order hold).
    The sum of |Y - G U|^2 / variance over the lines is minimised in the logarithms of the free symbols. Three zeros
    stand at s = 0 whatever the data say, so no zero is spent on noise at low frequencies.

    Eq. (10) has 11 symbols and six coefficients: at most six combinations can be told, and the fit says which. Give
    what a data sheet tells in `known`; symbols that remain untold keep their guess, with an infinite deviation.

    Args:
        known: symbol -> value that is not sought. The filter of section 3.1 unless given otherwise.
        guess: symbol -> where the search begins; `strut_equation.NOMINAL` where absent.
        bounds: symbol -> (least, largest); a factor 1000 either way of the guess where absent.
        band_hz: lines outside are left out.
        delay: samples from command to first effect: one by the hold, another by the computer. None tries 1 to 4.
        floor: share of a response added to its deviation, for what no model of this kind catches.
        smooth_lines: the variances of a response are averaged over so many neighbouring lines.
        iterations: accepted steps at most.
        noise_rounds: how often the noise of a record is read off the residual and the fit weighted by it.
        repair: whether readings at a sensor's limits are replaced by the model's in rounds; see `PolynomialMethod`.

    Raises:
        InputError: an unknown symbol, a guess or known value outside its bounds.

    >>> truth = {**strut.NOMINAL, "k_g": 50.0}
    >>> f_hz = np.linspace(1.0, 250.0, 300)
    >>> factors = strut.factors(truth)
    >>> G = strut.response_behind_hold(factors.gain, 3, factors.poles(), f_hz, 3500.0)[None, None]
    >>> known = {s: truth[s] for s in strut.SYMBOLS if s not in ("b_g", "k_g", "R_M")}
    >>> fit = Structured(known=known, delay=1).identify_response(FrequencyResponse(f_hz, G), 3500.0)
    >>> {s: round(fit.parameters[s], 4) for s in fit.free}
    {'b_g': 1.0, 'k_g': 50.0, 'R_M': 200.0}

    Reference: eqs. (2) to (10) of the paper; Pintelon and Schoukens 2012, chapter 9, doi:10.1002/9781118287422.
    """

    name: ClassVar[str] = "structured"

    known: Mapping[str, float] = field(default_factory=lambda: {s: strut.NOMINAL[s] for s in strut.FILTER})
    guess: Mapping[str, float] = field(default_factory=dict[str, float])
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])
    band_hz: tuple[float, float] = (0.5, 250.0)
    delay: int | None = 2
    floor: float = 0.0
    smooth_lines: int = 9
    iterations: int = 60
    noise_rounds: int = 3
    repair: bool = True

    def __post_init__(self) -> None:
        for name in ("known", "guess", "bounds"):
            for symbol in getattr(self, name):
                if symbol not in strut.SYMBOLS:
                    raise InputError(
                        f"{WHO}: '{name}' names '{symbol}', which eq. (10) does not have; its symbols are "
                        f"{', '.join(strut.SYMBOLS)}."
                    )
        for symbol, value in {**self.guess, **self.known}.items():
            positive(WHO, symbol, value, strut.UNITS[symbol])
            low, high = self.bounds_of(symbol)
            between(WHO, symbol, value, low, high, strut.UNITS[symbol])
        for symbol in self.bounds:
            low, high = self.bounds_of(symbol)
            if not 0 < low < high:
                raise InputError(f"{WHO}: the bounds of '{symbol}' must rise from above zero, got {low:g} to {high:g}.")
        if not self.free:
            raise InputError(f"{WHO}: every symbol is known, nothing is left to identify; leave some out of 'known'.")
        if self.delay is not None:
            whole(WHO, "delay", self.delay, 1)
        between(WHO, "floor", self.floor, 0.0, 1.0)
        whole(WHO, "smooth_lines", self.smooth_lines, 1)
        whole(WHO, "iterations", self.iterations, 1)
        whole(WHO, "noise_rounds", self.noise_rounds, 1)

    @property
    def free(self) -> tuple[str, ...]:
        """The symbols that are sought."""
        return tuple(s for s in strut.SYMBOLS if s not in self.known)

    @takes_values
    def identify(self, record: Record) -> Result:
        """Return the model of a record of one strut: one actuator, one sensor.

        The noise need not be white: its spectrum is read off the residual. `details["fit"]` holds the `StructuredFit`.

        Raises:
            InputError: more than one input or output, too few samples, a constant signal, a band without lines.
        """
        if len(record.actuators) != 1 or len(record.sensors) != 1:
            raise InputError(
                f"{WHO}: eq. (10) is one strut, from one actuator to one sensor, but the record has "
                f"{len(record.actuators)} and {len(record.sensors)}; pick a pair with record.pick([k], [k]), or take "
                f"'structured-modal' for the whole hexapod."
            )
        usable(WHO, record, len(self.free), 64)
        return fitted_to_record(self, record, self._fit_record)

    @single_threaded
    @takes_values
    def identify_response(self, response: FrequencyResponse, rate_hz: float) -> StructuredFit:
        """Return the model of a measured response `(1, 1, nf)`, weighted by its variance.

        Raises:
            InputError: more than one channel, too few lines, lines that begin above the geophone's suspension.
        """
        if response.values.shape[:2] != (1, 1):
            ny, nu = response.values.shape[:2]
            raise InputError(f"{WHO}: eq. (10) is one strut, but the response is {ny} x {nu}; give it one channel.")
        lines = of_response(WHO, response, rate_hz, self.band_hz, self.floor, self.smooth_lines)[0][0]
        minimum, polarity, delay = self._best(lines)
        noise_known = response.variance is not None
        return self._judged(lines, minimum, polarity, delay, noise_known, response)

    def _fit_record(self, record: Record, outputs: FloatArray, start: StructuredFit | None) -> StructuredFit:
        (lines,) = of_record(WHO, record, self.band_hz, outputs)
        if start is None:
            minimum, polarity, delay = self._best(lines)
        else:
            polarity, delay = start.polarity, start.delay
            x = np.log([start.parameters[s] for s in self.free])
            minimum = self._search(lines, x, polarity, delay, self.iterations)
        for _ in range(self.noise_rounds):
            error = lines.y - lines.u * self._response(minimum.x, polarity, delay, lines)
            free_error = lines.without_memory(error, self._poles(minimum.x, lines.rate_hz), delay)
            lines = lines.with_noise_of(free_error, len(self.free))
            minimum = self._search(lines, minimum.x, polarity, delay, self.iterations)
        return self._judged(lines, minimum, polarity, delay, False, record)

    def bounds_of(self, symbol: str) -> tuple[float, float]:
        """Return the least and the largest value that the search gives a symbol, in its own unit."""
        if symbol in self.bounds:
            low, high = self.bounds[symbol]
            return float(low), float(high)
        if symbol in self.known:
            return 0.0, np.inf
        start = self.guess.get(symbol, strut.NOMINAL[symbol])
        return start / BOUND_FACTOR, start * BOUND_FACTOR

    def _start(self) -> dict[str, float]:
        """Return the guess of every free symbol, nominal ones moved into given bounds."""
        return {s: float(np.clip(self.guess.get(s, strut.NOMINAL[s]), *self.bounds_of(s))) for s in self.free}

    def _values(self, x: FloatArray) -> dict[str, float]:
        sought = dict(zip(self.free, np.exp(x).tolist(), strict=True))
        return {s: float(self.known[s]) if s in self.known else sought[s] for s in strut.SYMBOLS}

    def _poles(self, x: FloatArray, rate_hz: float) -> ComplexArray:
        return np.asarray(np.exp(strut.factors(self._values(x)).poles() / rate_hz), dtype=np.complex128)

    def _response(self, x: FloatArray, polarity: int, delay: int, lines: SpectralLines) -> ComplexArray:
        f = strut.factors(self._values(x))
        late = np.exp(-2j * np.pi * lines.f_hz * (delay - 1) / lines.rate_hz)
        return polarity * late * strut.response_behind_hold(f.gain, 3, f.poles(), lines.f_hz, lines.rate_hz)

    def _best(self, lines: SpectralLines) -> tuple[Minimum, int, int]:
        """Search from several starts for a few steps, from the best of them to the end."""
        self._check(lines)
        candidates = []
        for delay in DELAYS if self.delay is None else (self.delay,):
            for corner in CORNERS if "R_M" in self.free else (1.0,):
                x, polarity = self._aligned(lines, delay, corner)
                candidates.append((self._search(lines, x, polarity, delay, TRIAL_STEPS), polarity, delay))
        best, polarity, delay = min(candidates, key=lambda t: t[0].loss)
        return self._search(lines, best.x, polarity, delay, self.iterations), polarity, delay

    def _check(self, lines: SpectralLines) -> None:
        needed = LINES_PER_PARAMETER * len(self.free)
        if lines.f_hz.size < needed:
            raise InputError(
                f"{WHO}: {lines.f_hz.size} lines in the band are too few for {len(self.free)} free symbols, which need "
                f"{needed}; measure more lines or give more symbols in 'known'."
            )
        value = {**self._start(), **self.known}
        suspension_hz = float(np.sqrt(value["k_g"] / value["m_g"]) / (2 * np.pi))
        sought = [s for s in ("m_g", "b_g", "k_g") if s in self.free]
        if sought and lines.f_hz[0] > suspension_hz:
            raise InputError(
                f"{WHO}: the lines begin at {lines.f_hz[0]:g} Hz, above the geophone's suspension (guessed at "
                f"{suspension_hz:.3g} Hz), which {', '.join(sought)} are read from; measure below it, or give "
                f"m_g, b_g and k_g in 'known'."
            )

    def _aligned(self, lines: SpectralLines, delay: int, corner: float) -> tuple[FloatArray, int]:
        """Return a start whose gain meets the data, as far as K is free, and the polarity."""
        start = self._start()
        if "R_M" in start:
            start["R_M"] = float(np.clip(corner * start["R_M"], *self.bounds_of("R_M")))
        x = np.log(list(start.values()))
        G = lines.scaled(lines.u * self._response(x, 1, delay, lines))
        share = float(G @ lines.scaled(lines.y)) / float(G @ G)
        if "K" in start and share != 0.0:
            start["K"] = float(np.clip(abs(share) * start["K"], *self.bounds_of("K")))
        return np.log(list(start.values())), 1 if share >= 0 else -1

    def _search(self, lines: SpectralLines, x: FloatArray, polarity: int, delay: int, iterations: int) -> Minimum:
        bounds = np.log([self.bounds_of(s) for s in self.free])

        def residual(x: FloatArray) -> FloatArray:
            r = lines.scaled(lines.y - lines.u * self._response(x, polarity, delay, lines))
            Q = lines.memory(self._poles(x, lines.rate_hz), delay)
            return r - Q @ (Q.T @ r)

        return search(residual, x, bounds[:, 0], bounds[:, 1], iterations)

    def _judged(
        self,
        lines: SpectralLines,
        minimum: Minimum,
        polarity: int,
        delay: int,
        noise_known: bool,
        source: FrequencyResponse | Record,
    ) -> StructuredFit:
        spare = max(1, minimum.residual.size - len(self.free))
        p_value = chi_squared(minimum.loss, spare) if noise_known else float("nan")
        loose = minimum.loss / spare if not p_value >= SIGNIFICANCE else 1.0
        determined = identifiability(minimum.jacobian, self.free, loose)
        values = self._values(minimum.x)
        sizes = np.array([values[s] for s in self.free])
        covariance = physical(determined, sizes)
        G = lines.u * self._response(minimum.x, polarity, delay, lines)
        error = float(np.linalg.norm(minimum.residual) / np.linalg.norm(lines.scaled(G)))
        bounds = {s: self.bounds_of(s) for s in self.free}
        status = verdict(bounds, minimum, p_value, error, determined, noise_known)
        spread = dict(zip(self.free, np.sqrt(np.diag(covariance)).tolist(), strict=True))
        deviations = {str(s): float(spread.get(s, 0.0)) for s in strut.SYMBOLS}
        provenance = Provenance(self.name, asdict(self), parents=parents(source), versions=versions())
        f = strut.factors(values)
        gain = np.array([polarity * f.gain])
        (poles,), (weights,) = strut.fractions(gain, np.array([3]), f.poles()[None], lines.rate_hz)
        model = realised(
            [(poles, weights[:, None, None])], delay, lines.rate_hz, source.actuators, source.sensors, provenance
        )
        return StructuredFit(
            model=model,
            status=status,
            parameters=values,
            deviations=deviations,
            free=self.free,
            covariance=covariance,
            combinations=determined.combinations,
            quantities=self._quantities(minimum.x, determined),
            polarity=polarity,
            delay=delay,
            error=error,
            p_value=p_value,
            iterations=minimum.iterations,
        )

    def _quantities(self, x: FloatArray, determined: Identifiability) -> dict[str, tuple[float, float]]:
        """Return each derived quantity with the deviation that the covariance gives it, to first order."""
        centre = strut.quantities(self._values(x))
        slopes = np.zeros((len(centre), x.size))
        for k in range(x.size):
            step = np.zeros(x.size)
            step[k] = DERIVED_STEP
            up, down = (strut.quantities(self._values(x + s)) for s in (step, -step))
            slopes[:, k] = [(up[q] - down[q]) / (2 * DERIVED_STEP) for q in centre]
        variance, size = np.einsum("qi,ij,qj->q", slopes, determined.covariance, slopes), np.abs(list(centre.values()))
        undetermined = np.linalg.norm(slopes @ determined.silent, axis=1) > SHARE * np.linalg.norm(slopes, axis=1)
        deviation = np.where(undetermined | (variance > size**2), np.inf, np.sqrt(variance))
        return {q: (v, float(d)) for (q, v), d in zip(centre.items(), deviation, strict=True)}
