"""The hexapod's grey box: eq. (10) with a sum of modes in the place of its one mass on a spring."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import ClassVar

import numpy as np

from ultraquiet._base.constraints import FloatArray, between, positive, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.identify.grey_box.data import SpectralLines, of_record, of_response, parents
from ultraquiet.identify.grey_box.least_squares import Minimum, chi_squared, identifiability, search
from ultraquiet.identify.grey_box.modal_basis import SHARED, Channels, modes_of, residue_terms
from ultraquiet.identify.grey_box.modal_result import ModalFit, names, share, verdict
from ultraquiet.identify.grey_box.realisation import realised
from ultraquiet.identify.grey_box.record import fitted_to_record
from ultraquiet.identify.record_checks import usable
from ultraquiet.identify.result import SIGNIFICANCE, Result
from ultraquiet.values import FrequencyResponse, Record
from ultraquiet.values.handed_over.kinds import takes_values

WHO = "StructuredModal"
# Where the search begins: the paper's geophone and filter (sections 2.1 and 3.1), the real pole of its eq. (12).
NOMINAL: Mapping[str, float] = {
    "circuit_hz": 100.0,
    "geophone_hz": 12.0,
    "geophone_damping": 0.7,
    "filter_hz": 1000.0,
    "filter_damping": float(np.sqrt(0.5)),
    "stack_hz": 1500.0,
    "stack_damping": 0.01,
}
DEFAULT_KNOWN = ("filter_hz", "filter_damping", "stack_damping")
# A symbol is sought this factor either way of its guess when no bounds are given; narrow enough that no mode takes the
# geophone's place.
BOUND_FACTORS = {"circuit_hz": 5.0}
BOUND_FACTOR = 2.0
# Below the rate the strut's resonance may be sought: what it sends down by aliasing sets where two of the three zeros
# at DC go when sampled, to a pair inside the circle. A resonance above the rate would send one outside.
STACK_SHARE = 0.95
DAMPING_BOUNDS = (1e-3, 0.5)
# A new mode is sought on this many frequencies to the band, with these dampings.
GRID = 60
DAMPINGS = (0.02, 0.07, 0.2)
CROWDED = 1e-2  # relative distance of two modes below which they are one
MOST_MODES = 30
MOST_ADDED = 8  # when the number is not given
TRIAL_STEPS = 12
WORTH = 0.03  # a mode that lowers the sum of squares by less is not added


@register("identify", "structured-modal")
@dataclass(frozen=True)
class StructuredModal:
    """Eq. (10) with modes: G_c(s) = s^3 [E + sum_k R_k / (s^2 + 2 zeta_k w_k s + w_k^2)] / (amplifier geophone filter).

    From eq. (10): the geophone, the real pole of the circuit, and so the three zeros at s = 0, kept exactly whatever
    the data say. The extension: the one mass on a spring gives way to modes shared by all channels, with a real
    residue matrix each, and a stiffness E for all that resonates beyond the band. Residues follow by linear least
    squares for every trial of the shared parameters (variable projection).

    Residues need not be symmetric: the geophones read motion against space while the stacks push against the base, so
    that pairs may be exchanged on a rigid floor alone.

    Args:
        modes: how many; None adds modes until the Bayesian criterion rises.
        general: whether damping may be other than proportional, as that of viscoelastic stages is: R_k + s S_k.
        known: symbol -> value that is not sought, of circuit_hz, geophone_hz, geophone_damping, filter_hz,
            filter_damping. The filter of section 3.1 unless given otherwise.
        guess: symbol -> where the search begins; the paper's figures where absent.
        bounds: symbol -> (least, largest); a factor 2 either way of the guess where absent, 5
            for circuit_hz, anything between band and rate for stack_hz.
        modes_hz: where the search for modes begins; found in the data when absent.
        band_hz: lines outside are left out.
        delay: samples from command to first effect: one by the hold, another by the computer.
        floor: share of a response added to its deviation, for what no sum of modes catches, like a stage whose
            stiffness depends on frequency.
        smooth_lines: the variances of a response are averaged over so many neighbouring lines.
        iterations: accepted steps at most.
        noise_rounds: how often the noise of a record is read off the residual and the fit weighted by it.
        repair: whether readings at a sensor's limits are replaced by the model's in rounds.

    >>> f_hz = np.linspace(2.0, 200.0, 200)
    >>> x = np.log([90.0, 12.5, 0.6, 1000.0, np.sqrt(0.5), 1500.0, 0.01, 30.0, 0.05])
    >>> from ultraquiet.identify.grey_box.modal_basis import basis
    >>> G = (basis(x, f_hz, 3500.0, 2, general=False) @ [0.3, 1.0])[None, None]
    >>> fit = StructuredModal(modes=1).identify_response(FrequencyResponse(f_hz, G), 3500.0)
    >>> round(float(fit.modes_hz[0]), 3), round(fit.parameters["geophone_hz"], 3)
    (30.0, 12.5)

    Reference: eq. (10) of the paper; Golub and Pereyra 1973, doi:10.1137/0710036 (variable projection).
    """

    name: ClassVar[str] = "structured-modal"

    modes: int | None = None
    general: bool = True
    known: Mapping[str, float] = field(default_factory=lambda: {s: NOMINAL[s] for s in DEFAULT_KNOWN})
    guess: Mapping[str, float] = field(default_factory=dict[str, float])
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])
    modes_hz: tuple[float, ...] = ()
    band_hz: tuple[float, float] = (0.5, 250.0)
    delay: int = 2
    floor: float = 0.01
    smooth_lines: int = 9
    iterations: int = 60
    noise_rounds: int = 2
    repair: bool = True

    def __post_init__(self) -> None:
        if self.modes is not None:
            whole(WHO, "modes", self.modes, 0, MOST_MODES)
        for name in ("known", "guess", "bounds"):
            for symbol in getattr(self, name):
                if symbol not in SHARED:
                    raise InputError(
                        f"{WHO}: '{name}' names '{symbol}', which it does not have; its symbols are "
                        f"{', '.join(SHARED)}, the modes it finds itself."
                    )
        for symbol, value in {**self.guess, **self.known}.items():
            positive(WHO, symbol, value)
            if symbol in self.bounds:
                between(WHO, symbol, value, *self.bounds[symbol])
        for f in self.modes_hz:
            positive(WHO, "modes_hz", f, "Hz")
        whole(WHO, "delay", self.delay, 1)
        between(WHO, "floor", self.floor, 0.0, 1.0)
        whole(WHO, "smooth_lines", self.smooth_lines, 1)
        whole(WHO, "iterations", self.iterations, 1)
        whole(WHO, "noise_rounds", self.noise_rounds, 0)

    @takes_values
    def identify(self, record: Record) -> Result:
        """Return the model of a record in which one input moves; `details["fit"]` holds the `ModalFit`.

        Raises:
            InputError: several inputs move, too few samples, a constant signal, a band without lines.
        """
        usable(WHO, record, len(SHARED) + 3 * (self.modes or 2), 64)

        def fit(record: Record, outputs: FloatArray, start: ModalFit | None) -> ModalFit:
            lines = of_record(WHO, record, self.band_hz, outputs)
            return self._of_lines([lines], record, None if start is None else start.logarithms)

        return fitted_to_record(self, record, fit)

    @single_threaded
    @takes_values
    def identify_response(self, response: FrequencyResponse, rate_hz: float) -> ModalFit:
        """Return the model of a measured response `(ny, nu, nf)`, weighted by its variance and the floor.

        Raises:
            InputError: too few lines, lines that begin above the geophone's suspension.
        """
        lines = of_response(WHO, response, rate_hz, self.band_hz, self.floor, self.smooth_lines)
        channels = Channels(lines, self.delay, self.general, response.variance is not None)
        return self._judged(channels, *self._sought(channels), response)

    def _of_lines(
        self, columns: Sequence[Sequence[SpectralLines]], source: Record, start: FloatArray | None
    ) -> ModalFit:
        """Return the fit of records, one column each, their noise read off the residual."""
        channels = Channels(list(zip(*columns, strict=True)), self.delay, self.general)
        x = self._sought(channels)[0].x if start is None else start
        free = self._free(x)
        for _ in range(self.noise_rounds):
            channels = self._weighted(channels, x)
            x = self._refined(channels, x, free, self.iterations).x
        minimum = self._refined(channels, x, free, self.iterations)
        return self._judged(channels, minimum, free, source)

    def _weighted(self, channels: Channels, x: FloatArray) -> Channels:
        at = channels.solved(x)
        ny, nu = channels.shape
        out = []
        for c, e in zip(channels.flat, at.residuals, strict=True):
            n = c.f_hz.size
            error = (e[:n] + 1j * e[n:]) * c.deviation / np.sqrt(2.0)
            out.append(c.with_noise_of(error, at.residues[0].size + 1))
        return Channels([out[i * nu : (i + 1) * nu] for i in range(ny)], channels.delay, self.general)

    def _start(self) -> FloatArray:
        return np.log([self.known.get(s, self.guess.get(s, NOMINAL[s])) for s in SHARED])

    def _sought(self, channels: Channels) -> tuple[Minimum, np.ndarray]:
        """Add modes one by one where they lower the misfit most, and refine all that is shared."""
        self._check(channels)
        x = np.concatenate([self._start(), *(np.log([m, DAMPINGS[1]]) for m in self.modes_hz)])
        best = self._refined(channels, x, self._free(x), TRIAL_STEPS)
        score = self._criterion(channels, best)
        most = MOST_ADDED if self.modes is None else self.modes
        with task("modes", most) as progress:
            while modes_of(best.x) < most:
                wider = self._with_another(channels, best.x)
                now = self._criterion(channels, wider)
                better = now < score and wider.loss < (1.0 - WORTH) * best.loss and not _crowded(wider.x)
                if self.modes is None and not better:
                    break
                best, score = wider, now
                progress.advance(note=f"{modes_of(best.x)} modes")
        free = self._free(best.x)
        return self._refined(channels, best.x, free, self.iterations), free

    def _with_another(self, channels: Channels, x: FloatArray) -> Minimum:
        """Return the best with one mode more, what is shared begun where it stands and where it began.

        With a mode too few what is shared may have gone far to stand in for it.
        """
        f = channels.flat[0].f_hz
        candidates = []
        for shared in (x[: len(SHARED)], self._start()):
            wider = np.concatenate([shared, x[len(SHARED) :]])
            wider = np.concatenate([wider, self._next(channels, wider, f)])
            candidates.append(self._refined(channels, wider, self._free(wider), TRIAL_STEPS))
        return min(candidates, key=lambda candidate: candidate.loss)

    def _criterion(self, channels: Channels, at: Minimum) -> float:
        """Return the Bayesian criterion; where the noise is not known yet, its size is one more unknown."""
        n, functions = channels.count, 1 + modes_of(at.x) * (2 if self.general else 1)
        price = (at.x.size + len(channels.flat) * functions) * float(np.log(n))
        if channels.noise_known:
            return at.loss + price
        return n * float(np.log(max(at.loss, np.finfo(float).tiny) / n)) + price

    def _next(self, channels: Channels, x: FloatArray, f: FloatArray) -> FloatArray:
        at = channels.solved(x)
        grid = [(m, max(z, _narrowest(f, m))) for m in np.geomspace(f[0], f[-1], GRID + 2)[1:-1] for z in DAMPINGS]
        return np.log(max(grid, key=lambda mode: channels.gain(at, x, *mode)))

    def _free(self, x: FloatArray) -> np.ndarray:
        free = np.ones(x.size, dtype=bool)
        free[: len(SHARED)] = [s not in self.known for s in SHARED]
        return free

    def _bounds(self, x: FloatArray, channels: Channels) -> tuple[FloatArray, FloatArray]:
        start, f = self._start(), channels.flat[0].f_hz
        wide = {}
        for s, v in zip(SHARED, np.exp(start).tolist(), strict=True):
            factor = BOUND_FACTORS.get(s, BOUND_FACTOR)
            wide[s] = (v / factor, v * factor)
        wide["stack_hz"] = (f[-1], STACK_SHARE * channels.flat[0].rate_hz)
        shared = [self.bounds.get(s, wide[s]) for s in SHARED]
        modes = modes_of(x)
        both = np.log([*shared, *[(f[0], f[-1]), DAMPING_BOUNDS] * modes])
        both[len(SHARED) + 1 :: 2, 0] = np.log([_narrowest(f, m) for m in np.exp(x[len(SHARED) :: 2])])
        return both[:, 0], both[:, 1]

    def _refined(self, channels: Channels, x: FloatArray, free: np.ndarray, iterations: int) -> Minimum:
        low, high = self._bounds(x, channels)

        def whole_of(part: FloatArray) -> FloatArray:
            full = x.copy()
            full[free] = part
            return full

        minimum = search(
            lambda part: channels.residual(whole_of(part)),
            x[free],
            low[free],
            high[free],
            iterations,
            lambda part: channels.jacobian(whole_of(part), free),
        )
        return replace(minimum, x=whole_of(minimum.x))

    def _ordered(self, residues: FloatArray, order: np.ndarray) -> FloatArray:
        each = 2 if self.general else 1
        return residues[np.concatenate([[0], *(1 + each * k + np.arange(each) for k in order)]).astype(int)]

    def _check(self, channels: Channels) -> None:
        f = channels.flat[0].f_hz
        needed = len(SHARED) + 4 * (1 if self.modes is None else self.modes)
        if f.size < needed:
            raise InputError(f"{WHO}: {f.size} lines in the band are too few, {needed} are needed; measure more lines.")
        suspension_hz = float(np.exp(self._start()[1]))
        if "geophone_hz" not in self.known and f[0] > suspension_hz:
            raise InputError(
                f"{WHO}: the lines begin at {f[0]:g} Hz, above the geophone's suspension (guessed at "
                f"{suspension_hz:.3g} Hz), which is read from them; measure below it, or give geophone_hz and "
                f"geophone_damping in 'known'."
            )

    def _judged(
        self,
        channels: Channels,
        minimum: Minimum,
        free: np.ndarray,
        source: FrequencyResponse | Record,
    ) -> ModalFit:
        x, at = minimum.x, channels.solved(minimum.x)
        ny, nu = channels.shape
        residues = np.moveaxis(np.array(at.residues).reshape(ny, nu, -1), 2, 0)
        spare = max(1, channels.count - int(free.sum()) - residues.size)
        p_value = chi_squared(minimum.loss, spare) if channels.noise_known else float("nan")
        loose = minimum.loss / spare if not p_value >= SIGNIFICANCE else 1.0
        every = names(x)
        determined = identifiability(minimum.jacobian, tuple(n for n, f in zip(every, free, strict=True) if f), loose)
        deviation = np.zeros(x.size)
        deviation[free] = np.where(determined.unbounded, np.inf, np.sqrt(np.diag(determined.covariance)))
        deviation *= np.exp(x)
        order = np.argsort(x[len(SHARED) :: 2])
        modes, spread = (v[len(SHARED) :].reshape(-1, 2)[order] for v in (np.exp(x), deviation))
        error = np.array([share(c, e) for c, e in zip(channels.flat, at.residuals, strict=True)]).reshape(ny, nu)
        provenance = Provenance(self.name, asdict(self), parents=parents(source), versions=versions())
        rate_hz = channels.flat[0].rate_hz
        model = realised(
            residue_terms(x, residues, rate_hz, self.general),
            self.delay,
            rate_hz,
            source.actuators,
            source.sensors,
            provenance,
        )
        return ModalFit(
            model=model,
            status=verdict(minimum, p_value, error),
            parameters=dict(zip(SHARED, np.exp(x[: len(SHARED)]).tolist(), strict=True)),
            deviations=dict(zip(SHARED, deviation[: len(SHARED)].tolist(), strict=True)),
            modes_hz=modes[:, 0],
            modes_damping=modes[:, 1],
            modes_deviation=spread.T,
            residues=self._ordered(residues, order),
            covariance=determined.covariance,
            free=tuple(n for n, f in zip(every, free, strict=True) if f),
            error=error,
            p_value=p_value,
            delay=self.delay,
            iterations=minimum.iterations,
            logarithms=x,
        )


def _narrowest(f: FloatArray, mode_hz: float) -> float:
    """Return the least damping of a mode that neighbouring lines still see: its width, 2 zeta f, spans their distance.

    A narrower one would serve to meet a single line, its noise included.
    """
    k = int(np.clip(np.searchsorted(f, mode_hz), 1, f.size - 1))
    return float(np.clip((f[k] - f[k - 1]) / (2.0 * mode_hz), *DAMPING_BOUNDS))


def _crowded(x: FloatArray) -> bool:
    """Return whether two modes stand in one place, as they do where modes are not what is missing."""
    return bool(np.any(np.diff(np.sort(x[len(SHARED) :: 2])) < CROWDED))
