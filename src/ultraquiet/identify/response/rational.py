"""State space from a measured frequency response: a weighted rational fit with common poles."""

from dataclasses import asdict, dataclass, field

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, between, positive, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.progress import task
from ultraquiet._base.provenance import Provenance, versions
from ultraquiet._base.registry import register
from ultraquiet._base.threads import single_threaded
from ultraquiet.identify import chance
from ultraquiet.identify.record_checks import usable
from ultraquiet.identify.response.data import told_by_lines
from ultraquiet.identify.response.even_units import EvenUnits
from ultraquiet.identify.response.fewest_modes import Thinning, about, fewest, rise, settled
from ultraquiet.identify.response.follows_inputs import MISSED, unless_followed
from ultraquiet.identify.response.resolution import blurred
from ultraquiet.identify.result import Result, worst
from ultraquiet.identify.searched_order import Auto, SearchedOrder
from ultraquiet.linalg import pole_residue, vector_fitting
from ultraquiet.linalg.innovation import unknown_past
from ultraquiet.linalg.modes import rank_one
from ultraquiet.linalg.prediction import fit_percent
from ultraquiet.linalg.response import points
from ultraquiet.spectra import frf
from ultraquiet.values import FrequencyResponse, Record, StateSpace, Status, StatusWord
from ultraquiet.values.handed_over.kinds import takes_values

ORDERS = tuple(range(4, 33, 2))
# Tried when the held-out error still falls at the last of those, until two in turn do not lower it.
HIGHER_ORDERS = (36, 40, 44, 48, 54, 60, 66, 72, 80, 90, 100)
PATIENCE = 2
# Lines used: at least and at most, and the gains that all channels of them make between. A narrow mode of one channel
# shows at a few lines only; of many channels, each says where it is.
LINES, GAINS = (500, 2000), 4000
LINES_PER_POLE = 3  # fitted lines that a pole takes
# The smallest order is taken whose held-out error exceeds the best by less than this share of the floor, or of the best
# where noise that nobody measured lies above the floor (root of the difference of squares): spare poles have nothing to
# do but to ring at noise.
WORTH = 0.3
# Nor does a smaller order miss a line by so many times that share more: a mode heard at few lines weighs little among
# all of them.
NOTICED = 33.0
# Starting poles: this relative damping, from the lowest line to the highest.
START_DAMPING = 0.1
# Nearer to the response than this share of the floor nothing is gained by a state.
EXACT = 1e-4
# A line whose noise is this share of its response is left out: it tells little, and its pole would be noise.
HIDDEN = 0.3
SECOND = 1e-9
# An order that misses the held-out lines by more than this share of the response has not caught the plant.
POOR = 0.2


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """A system fitted to a response.

    Attributes:
        model: stable, discrete, in modal blocks: modes of rank one, which began as `order` poles shared by all
            channels; or, where they would save no state, those poles, each as often as its residue has rank.
        status: `ok`, or `poor fit` with the error.
        order: number of common poles.
        error: weighted RMS error relative to the response, at lines used for the fit and at held-out ones; before
            the last fit, to all lines.
        errors_by_order: held-out error of every order tried.
        poles_by_order: poles in z of every order tried, from the fitted half of the lines.
    """

    model: StateSpace
    status: Status
    order: int
    error: tuple[float, float]
    errors_by_order: dict[int, float]
    poles_by_order: dict[int, ComplexArray] = field(default_factory=dict[int, ComplexArray])


@register("identify", "rational")
@dataclass(frozen=True)
class Rational(SearchedOrder):
    """Fit G(z) = z^(1 - delay) sum_k R_k / (z - p_k) to a frequency response, relative to its size.

    Sensors and actuators are first given units in which their gains are alike in size, so that none is missed for the
    unit that it is recorded in. The error at a line is divided by the RMS gain g(f) of the response there and by
    sqrt(floor^2 + (sigma/g)^2), sigma the noise of the line: weak bands count as much as strong ones, noisy lines less.
    Every other line is held out, to choose the order and to judge the fit.

    A mode of a structure has one shape at the sensors and one at the actuators, a residue of rank one; noise makes the
    rank full. So of all directions of all residues only those stay whose loss the held-out lines would notice, poles
    and directions of what stays being fitted once more, together: a mode then costs two states.

    Args:
        order: number of common poles; chosen on held-out lines when "auto" or None.
        delay: samples before the first response, at least one.
        iterations: relocations of the poles.
        floor: relative error below which precision is not worth having.
        most_lines: lines used at most, half of them spaced evenly in frequency and half in its logarithm. None: 500,
            and up to 2000 where there are fewer than eight channels, for each has less to tell.
        rank_tolerance: residue directions that matter less than this share of the response are left out where no
            smaller set of modes meets the response.
        zeros_at_dc: zeros that every channel is known to have at z = 1. Of several at s = 0 a hold leaves one;
            the images of the spectrum move the rest: one of the three of eq. (10) stays. More would bend the lowest
            lines.

    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal((1, 8000))
    >>> plant = StateSpace([[0.9, 0.2], [-0.2, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], rate_hz=100.0)
    >>> bool(Rational(order=2).identify(Record(u, plant.simulate(u), 100.0)).fit_percent[0] > 98)
    True

    References: see `ultraquiet.linalg.vector_fitting` and `ultraquiet.linalg.modes.rank_one`.
    """

    order: int | Auto | None = None
    delay: int = 1
    iterations: int = 8
    floor: float = 0.01
    most_lines: int | None = None
    rank_tolerance: float = 1e-3
    zeros_at_dc: int = 0

    def __post_init__(self) -> None:
        self.settle_order()
        whole("Rational", "delay", self.delay, 1)
        whole("Rational", "iterations", self.iterations, 1)
        if self.most_lines is not None:
            whole("Rational", "most_lines", self.most_lines, 8)
        whole("Rational", "zeros_at_dc", self.zeros_at_dc, 0, min(8, (self.given_order or ORDERS[-1]) - 1))
        between("Rational", "floor", self.floor, 1e-6, 1.0)
        between("Rational", "rank_tolerance", self.rank_tolerance, 0.0, 0.5)

    @takes_values
    def identify(self, record: Record) -> Result:
        """Estimate the H1 response of a record and fit it; fit periodic ones by `identify_response` instead."""
        usable("Rational", record, (self.given_order or max(ORDERS)) * (len(record.actuators) + 1), 64)
        response = frf(record)
        fitted = self.identify_response(response, record.rate_hz)
        simulated = fitted.model.simulate(record.inputs)
        simulated = simulated + unknown_past(fitted.model.A, fitted.model.C, record.outputs - simulated)
        residual = record.outputs - simulated
        fits = np.array([fit_percent(y, m) for y, m in zip(record.outputs, simulated, strict=True)])
        blur = blurred(fitted.model, response)
        status = fitted.status if blur is None else blur
        limit = max(MISSED, self.floor, fitted.error[1])
        statuses = [
            unless_followed(_simulated(status, fit), e, y, record.inputs, record.rate_hz, limit)
            for fit, e, y in zip(fits, residual, record.outputs, strict=True)
        ]
        ny, numbers = len(record.sensors), chance.numbers_of(fitted.model.states, len(record.actuators))
        statuses = [
            chance.unless_silent(status, chance.explained(y, e), y.size, numbers)
            for status, y, e in zip(statuses, record.outputs, residual, strict=True)
        ]
        unknown = np.full(ny, np.nan)
        provenance = Provenance("rational", asdict(self), parents=(record.hash,), versions=versions())
        return Result(
            model=fitted.model,
            status=worst(statuses),
            fit_percent=fits,
            loss=np.mean(residual**2, axis=1),
            covariance=np.full((ny, 0, 0), np.nan),
            whiteness_p=unknown,
            correlation_p=unknown,
            iterations=np.full(ny, self.iterations),
            statuses=tuple(statuses),
            provenance=provenance,
            details={"order": fitted.order, "error": fitted.error},
            no_band="no band: lines are weighed by the response, not by their noise; take 'weighted-rational'.",
        )

    @takes_values
    @single_threaded
    def identify_response(self, response: FrequencyResponse, rate_hz: float) -> ResponseFit:
        """Fit a measured response, as `spectra.frf` or `spectra.periodic_response` give it.

        Args:
            response: `(ny, nu, nf)` below half the rate; its `variance` weighs the lines when it is there.
            rate_hz: sampling rate of the system wanted.

        Raises:
            InputError: lines beyond half the rate, too few lines for the order or too far apart for the delay, a
                response that is zero, or one of which no residue reaches `rank_tolerance`.
        """
        f, G, weight, units = _checked(self, response, rate_hz)
        told_by_lines("Rational", "delay", (self.delay - 1) / rate_hz, response.f_hz)
        z = points(f, rate_hz)
        H = G * z ** (self.delay - 1)
        used = np.arange(f.size) % 2 == 0
        slowest = float(2 * np.pi * f[0] / rate_hz)
        fitted = rank_one.Samples(z[used], H[:, :, used], weight[used], self.zeros_at_dc, slowest)
        held_out = rank_one.Samples(z[~used], H[:, :, ~used], weight[~used])
        whole = rank_one.Samples(z, H, weight, self.zeros_at_dc, slowest)
        fits, known = _by_order(self, fitted, held_out, f, rate_hz)
        errors_by_order = {n: held_out.rms(lines) for n, lines in known.items()}
        best = min(errors_by_order, key=lambda n: errors_by_order[n])
        worth = WORTH * max(self.floor, errors_by_order[best])
        near, noticed = np.hypot(errors_by_order[best], worth), NOTICED * worth
        chosen = min(n for n, e in errors_by_order.items() if e <= near and rise(known[n], known[best]) <= noticed)
        goal = max(errors_by_order[chosen], EXACT * self.floor)
        blocks = _realised(self, _fitted(self, whole, fits[chosen].poles), z, weight)
        model = _assembled(self, [units.undone(b) for b in blocks], rate_hz, response)
        error = fits[chosen].error, errors_by_order[chosen]
        thinning = Thinning(fitted, held_out, goal, worth, known[chosen], about(known[best]))
        lean = fewest([fits[n] for n in sorted({chosen, best})], thinning)
        if lean is not None and lean.modes.poles.size + G.shape[1] * (self.delay - 1) <= model.states:
            blocks = _blocks(settled(lean.modes, whole, worth))
            model = _assembled(self, [units.undone(b) for b in blocks], rate_hz, response)
            error = fitted.error(lean.modes), lean.held_out
        poles = {n: fit.poles for n, fit in fits.items()}
        return ResponseFit(model, _verdict(error[1]), chosen, error, errors_by_order, poles)


def _by_order(
    method: Rational, fitted: rank_one.Samples, held_out: rank_one.Samples, f: FloatArray, rate_hz: float
) -> tuple[dict[int, vector_fitting.PoleResidueFit], dict[int, FloatArray]]:
    """Return fits with residues of full rank and their errors at each of the lines held out."""
    fits: dict[int, vector_fitting.PoleResidueFit] = {}
    known: dict[int, FloatArray] = {}
    errors: list[float] = []
    orders = ORDERS + HIGHER_ORDERS if method.given_order is None else (method.given_order,)
    orders = tuple(n for n in orders if n * LINES_PER_POLE <= fitted.z.size)
    with task("rational fit", sum(n <= ORDERS[-1] for n in orders) or 1) as progress:
        for n in orders:
            if n in HIGHER_ORDERS and method.given_order is None and not _falling(errors, WORTH * method.floor):
                break
            start = _starting_poles(n, f, rate_hz)
            fits[n] = _fitted(method, fitted, start)
            known[n] = _errors(fits[n], held_out)
            errors.append(held_out.rms(known[n]))
            progress.advance(note=f"order {n}: {errors[-1]:.4f}")
    return fits, known


def _fitted(method: Rational, samples: rank_one.Samples, start: ComplexArray) -> vector_fitting.PoleResidueFit:
    zeros = samples.zeros_at_one
    return vector_fitting.fit(samples.z, samples.H, samples.weight, start, method.iterations, zeros, samples.slowest)


def _falling(errors: list[float], worth: float) -> bool:
    """Return whether one of the last orders was worth more than all before them."""
    before, last = errors[:-PATIENCE], errors[-PATIENCE:]
    return not before or np.hypot(min(last), worth) < min(before)


def _checked(
    method: Rational, response: FrequencyResponse, rate_hz: float
) -> tuple[FloatArray, ComplexArray, FloatArray, EvenUnits]:
    """Return lines, gains in even units, weights `(nf,)`, thinned and cleared of lines that say nothing, and units."""
    f = response.f_hz
    positive("Rational", "rate_hz", rate_hz, "Hz")
    if f.size and f[-1] > rate_hz / 2:
        raise InputError(
            f"Rational: lines up to {f[-1]:g} Hz contradict a rate of {rate_hz:g} Hz; half of it is the limit."
        )
    G, variance, units = _evened(response, (f > 0) & (f < rate_hz / 2), method.floor)
    size = np.sqrt(np.mean(np.abs(G) ** 2, axis=(0, 1)) * max(G.shape[:2]))
    noise = np.mean(variance, axis=(0, 1))
    noise_share = noise * max(G.shape[:2]) / np.where(size > 0, size, 1.0) ** 2
    keep = (size > 0) & (f > 0) & (f < rate_hz / 2) & (noise_share < HIDDEN**2)
    most = method.most_lines or int(np.clip(GAINS // (G.shape[0] * G.shape[1]), *LINES))
    keep[keep] = _thin(f[keep], most)
    needed = 8 * (method.given_order or ORDERS[0])
    if np.count_nonzero(keep) < needed:
        raise InputError(
            f"Rational: {np.count_nonzero(keep)} usable lines are too few, "
            f"order {method.given_order or ORDERS[0]} needs {needed}."
        )
    weight = 1.0 / (np.where(size > 0, size, 1.0) * np.sqrt(method.floor**2 + noise_share))
    # The error then reads as a share of the response where noise does not matter.
    return f[keep], G[:, :, keep], weight[keep] * method.floor, units


def _evened(
    response: FrequencyResponse, inside: np.ndarray, floor: float
) -> tuple[ComplexArray, FloatArray, EvenUnits]:
    """Return gains and variance in the units in which they are even at the lines `inside`, and these units."""
    G = response.values
    variance = np.zeros(G.shape) if response.variance is None else response.variance
    units = EvenUnits.of_gains(G[:, :, inside], variance[:, :, inside], floor)
    square = EvenUnits(units.rows**2, units.columns**2)
    return units.evened(G), square.evened(variance.astype(np.complex128)).real, units


def _thin(f: FloatArray, most: int) -> np.ndarray:
    keep = np.ones(f.size, dtype=bool)
    if f.size > most:
        wanted = np.concatenate([np.linspace(f[0], f[-1], most // 2), np.geomspace(f[0], f[-1], most // 2)])
        keep[:] = False
        keep[np.clip(np.searchsorted(f, wanted), 0, f.size - 1)] = True
    return keep


def _starting_poles(order: int, f: FloatArray, rate_hz: float) -> ComplexArray:
    """Return poles spaced evenly in the logarithm of frequency, and one real for an odd order."""
    centres = np.geomspace(max(f[0], f[-1] * 1e-4), f[-1], order // 2)
    upper = np.exp(2 * np.pi * centres / rate_hz * (-START_DAMPING + 1j))
    real = np.full(order % 2, np.exp(-2 * np.pi * np.sqrt(f[0] * f[-1]) / rate_hz))
    return np.concatenate([upper, upper.conj(), real]).astype(np.complex128)


def _errors(fit: vector_fitting.PoleResidueFit, samples: rank_one.Samples) -> FloatArray:
    """Return the weighted error of each sample, as `rank_one.Samples.errors` does of modes of rank one."""
    model = np.einsum("ijk,kf->ijf", fit.residues, 1.0 / (samples.z - fit.poles[:, None]))
    return rank_one.over_channels(np.asarray(samples.weight * (model - samples.H)))


def _verdict(error: float) -> Status:
    if error > POOR:
        return Status(
            StatusWord.POOR_FIT, f"Held-out lines are missed by {100 * error:.0f} % of the response; raise the order."
        )
    return Status(StatusWord.OK, f"Held-out lines are met within {100 * error:.2g} % of the response (RMS).")


def _simulated(status: Status, fit: float) -> Status:
    """Return the verdict on one output: an error larger than the output needs no test."""
    if not status.ok or fit > 0.0:
        return status
    return Status(
        StatusWord.POOR_FIT,
        f"The simulated output fits by {fit:.0f} %, no better than its mean: the response was blurred by leakage, or "
        f"the order is too low; fit a periodic response, or take 'subspace'.",
    )


def _realised(
    method: Rational, fit: vector_fitting.PoleResidueFit, z: ComplexArray, weight: FloatArray
) -> list[pole_residue.Block]:
    """Return real blocks of the poles, each with as many copies as its residue has directions that matter."""
    blocks: list[pole_residue.Block] = []
    k = 0
    while k < fit.poles.size:
        reach = float(np.max(weight / np.abs(z - fit.poles[k])))
        blocks.append(pole_residue.block(fit.poles[k], fit.residues[:, :, k], method.rank_tolerance / reach))
        k += 1 if fit.poles[k].imag == 0 else 2
    if not any(len(A) for A, _, _ in blocks):
        raise InputError(
            f"Rational: no residue of order {fit.poles.size} reaches {method.rank_tolerance:g} of the response, so "
            f"nothing would be left; lower 'rank_tolerance', or measure a response that stands above its noise."
        )
    return blocks


def _blocks(modes: rank_one.RankOneModes) -> list[pole_residue.Block]:
    """Return real blocks of modes of rank one, slowest first."""
    heads = modes.heads()
    heads = heads[np.argsort(np.abs(np.log(modes.poles[heads])), kind="stable")]
    residues = [np.outer(modes.c[:, k], modes.b[k]) for k in heads]
    # the second singular value of an outer product is rounding
    return [
        pole_residue.block(complex(modes.poles[k]), R, SECOND * float(np.linalg.norm(R)))
        for k, R in zip(heads, residues, strict=True)
    ]


def _assembled(
    method: Rational, blocks: list[pole_residue.Block], rate_hz: float, response: FrequencyResponse
) -> StateSpace:
    ny, nu = response.values.shape[:2]
    A, B, C, D = pole_residue.delayed(*pole_residue.joined(blocks), np.zeros((ny, nu)), method.delay - 1)
    provenance = Provenance("rational", asdict(method), parents=response.provenance.parents, versions=versions())
    return StateSpace(A, B, C, D, rate_hz, response.actuators, response.sensors, provenance)
