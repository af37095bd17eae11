"""Best linear approximation: the response a linear model can catch, with noise and nonlinear distortion told apart."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array, frozen, same_rate, whole
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet.spectra.detection import Detection, detection
from ultraquiet.spectra.local_polynomial import scatter_about_smooth
from ultraquiet.spectra.periodic import evened_inputs, excited_lines, inverse_of_inputs, steady_periods
from ultraquiet.values import FrequencyResponse, Record, Status, StatusWord
from ultraquiet.values.handed_over.kinds import takes_values

WHO = "best_linear"
# Variance ratios from so few draws scatter; distortion is called present when it exceeds the noise by this factor.
VISIBLE = 2.0
# Weights from fewer periods or realisations than this cost a rational fit more than a tenth of its precision
# (Pintelon and Schoukens 2012, section 9.13: at least six).
ENOUGH = 6
# An excited line of a measured input stands this many standard deviations above its own noise.
ABOVE_NOISE = 6.0
# Beyond this condition of the inputs' matrix a line cannot tell the actuators apart.
APART = 1e6


@dataclass(frozen=True, eq=False)
class BestLinear:
    """The response, and what disturbs it.

    Attributes:
        response: mean over realisations, its `variance` that of the mean: noise and distortion together.
        noise: `(ny, nu, nf)` variance of the response of one realisation through noise, squared gain units.
        distortion: `(ny, nu, nf)` the same through nonlinear distortion: how far another random-phase excitation of
            the same spectrum would move the response. NaN where neither realisations nor detection lines tell it.
        noise_of_mean: `(ny, nu, nf)` share of `response.variance` that is noise; longer records lower it, only more
            realisations lower the rest.
        detection: distortion at lines that were not excited, odd and even told apart, or None.
        realisations, periods: how many were averaged.
        status: `ok`, or `few data`, with a sentence of advice.
    """

    response: FrequencyResponse
    noise: FloatArray
    distortion: FloatArray
    noise_of_mean: FloatArray
    detection: Detection | None
    realisations: int
    periods: int
    status: Status


@takes_values
def best_linear(
    records: Record | Sequence[Record] | Sequence[Sequence[Record]],
    period_samples: int,
    settle_periods: int = 1,
    lines_hz: ArrayLike | None = None,
) -> BestLinear:
    """Return the best linear approximation G(f) with its noise and its nonlinear distortion.

    G_m = Y_m U_m^-1 for each realisation m, the columns of U_m the mean spectra of its experiments; G is their mean.
    What the periods of one realisation disagree in is noise; what realisations disagree in beyond that is distortion.
    With one realisation of an odd multisine, lines left out (`Multisine(odd=True, detection_group=4)`) show the
    distortion instead, which is then taken over to the excited lines beside them; without such lines it is what the
    gains of neighbouring lines scatter about a smooth response.

    Args:
        records: one record a realisation; for `nu` moving inputs `nu` records each (one actuator at a time, or
            `signals.orthogonal_multisines`), as a nested sequence or one after another.
        period_samples: length of one period in samples.
        settle_periods: periods left out at the start, while transients die.
        lines_hz: excited lines; found in the inputs when absent.

    Raises:
        InputError: fewer than two whole periods, an input that does not repeat, only 0 Hz excited, records that do not
            make whole realisations, inputs that cannot be told apart.

    >>> import ultraquiet as uq
    >>> signal = uq.signals.Multisine(start_hz=5, stop_hz=40, period_samples=100, peak=10)
    >>> u = [signal.generate(500, rate_hz=100.0, seed=k) for k in range(3)]
    >>> result = best_linear([uq.Record(v, v + 1e-3 * v**3, 100.0) for v in u], period_samples=100)
    >>> bool((result.noise < 1e-20).all()), bool((result.distortion > 1e-6).any()), result.realisations
    (True, True, 3)

    Reference: R. Pintelon, J. Schoukens, System Identification (2012), sections 4.3 and 7.3,
    doi:10.1002/9781118287422; T. D'haene, R. Pintelon, J. Schoukens, E. Van Gheem, IEEE Trans. Instrum. Meas. 54 (2005)
    1494-1500.
    """
    period = whole(WHO, "period_samples", period_samples, 2)
    groups, inputs = _realisations(records)
    first = groups[0][0]
    spectra = [[_steady(r, m, e, period, settle_periods) for e, r in enumerate(g)] for m, g in enumerate(groups)]
    lines = _lines(spectra, inputs, first, period, lines_hz)
    singles = [_realisation([(U[inputs], Y) for U, Y in group], lines) for group in spectra]
    G = np.array([g for g, _ in singles])
    noise = np.mean([v for _, v in singles], axis=0)
    M, P = len(groups), min(U.shape[1] for group in spectra for U, _ in group)
    unexcited = detection([pair for group in spectra for pair in group], lines, first.rate_hz / period)
    if M > 1:
        total = np.var(G, axis=0, ddof=1)
        distortion = np.maximum(total - noise, 0.0)
        # The scatter of few realisations may by chance fall below what noise alone brings.
        variance = np.maximum(total, noise) / M
    else:
        distortion = _of_one(unexcited, spectra[0], inputs, lines, noise)
        variance = noise + np.nan_to_num(distortion)
    text = f"best linear approximation, {M} realisations, {P} periods of {period} samples, {settle_periods} left out"
    response = FrequencyResponse(
        lines * first.rate_hz / period,
        G.mean(axis=0),
        estimator=text,
        actuators=[first.actuators[j] for j in inputs],
        sensors=first.sensors,
        provenance=Provenance(
            "spectra.best_linear", {"period_samples": period}, parents=tuple(r.hash for g in groups for r in g)
        ),
        variance=variance,
    )
    status = _advice(noise, distortion, unexcited, M, P)
    return BestLinear(response, frozen(noise), frozen(distortion), frozen(noise / M), unexcited, M, P, status)


def _realisations(
    records: Record | Sequence[Record] | Sequence[Sequence[Record]],
) -> tuple[list[list[Record]], list[int]]:
    """Return the records grouped by realisation, and which inputs move."""
    nested = [records] if isinstance(records, Record) else list(records)
    groups = [[r] if isinstance(r, Record) else list(r) for r in nested]
    flat = [r for g in groups for r in g]
    if not flat:
        raise InputError(f"{WHO}: no records were given; it needs one per moving input and realisation.")
    for r in flat:
        same_rate(WHO, "the first record", flat[0].rate_hz, "another", r.rate_hz)
        if (len(r.actuators), len(r.sensors)) != (len(flat[0].actuators), len(flat[0].sensors)):
            raise InputError(f"{WHO}: all records must have the same actuators and sensors.")
    inputs = [j for j in range(len(flat[0].actuators)) if any(np.ptp(r.inputs[j]) > 0 for r in flat)]
    if not inputs:
        raise InputError(f"{WHO}: no input moves in any record; a constant (0 Hz) excites nothing.")
    if all(isinstance(r, Record) for r in nested):
        groups = [flat[k : k + len(inputs)] for k in range(0, len(flat), len(inputs))]
    if any(len(g) < len(inputs) for g in groups):
        raise InputError(
            f"{WHO}: {len(inputs)} inputs move, so each realisation takes {len(inputs)} records, "
            f"but one has {min(len(g) for g in groups)}."
        )
    return groups, inputs


def _steady(record: Record, m: int, e: int, period: int, settle: int) -> tuple[ComplexArray, ComplexArray]:
    return steady_periods(WHO, f"record {e + 1} of realisation {m + 1}", record, period, settle)


def _lines(
    spectra: list[list[tuple[ComplexArray, ComplexArray]]],
    inputs: list[int],
    first: Record,
    period: int,
    lines_hz: ArrayLike | None,
) -> np.ndarray:
    """Return the numbers of the excited lines."""
    if lines_hz is not None:
        exact = frequency_array(WHO, lines_hz) * period / first.rate_hz
        lines = np.rint(exact).astype(int)
        if np.abs(exact - lines).max(initial=0.0) > 1e-6 * period or lines.min(initial=1) < 1:
            raise InputError(
                f"{WHO}: 'lines_hz' must be multiples of {first.rate_hz / period:g} Hz above 0; 0 Hz is an offset."
            )
        lines = lines[lines < period / 2]
        if not lines.size:
            raise InputError(f"{WHO}: 'lines_hz' must hold a line below half the rate, {first.rate_hz / 2:g} Hz.")
        return lines
    alive = np.ones(period // 2 + 1, dtype=bool)
    for group in spectra:
        excited = np.zeros_like(alive)
        for U, _ in group:
            mean = U[inputs].mean(axis=1)
            noise = U[inputs].var(axis=1, ddof=1) / U.shape[1]
            clear = np.abs(mean) > ABOVE_NOISE * np.sqrt(noise)
            excited |= excited_lines(np.abs(mean) * clear)
        alive &= excited
    lines = np.flatnonzero(alive)
    lines = lines[lines < period / 2]
    if not lines.size:
        raise InputError(f"{WHO}: no line above 0 Hz is excited in all realisations; excite them all alike.")
    return lines


def _realisation(
    experiments: list[tuple[ComplexArray, ComplexArray]], lines: np.ndarray
) -> tuple[ComplexArray, FloatArray]:
    """Return the gains of one realisation and their variance through noise, `(ny, nu, nf)` each."""
    U = np.stack([U.mean(axis=1)[:, lines] for U, _ in experiments], axis=1)  # (nu, experiments, nf)
    Y = np.stack([Y.mean(axis=1)[:, lines] for _, Y in experiments], axis=1)
    u, y = np.moveaxis(U, 2, 0), np.moveaxis(Y, 2, 0)
    even, _ = evened_inputs(u)
    condition = np.linalg.cond(even)
    if condition.max() > APART:
        raise InputError(
            f"{WHO}: the inputs cannot be told apart at line {lines[int(condition.argmax())]}; excite them one after "
            f"another or by orthogonal_multisines."
        )
    inverse = inverse_of_inputs(u)  # (nf, experiments, nu)
    G = y @ inverse
    variance = np.zeros(G.shape, dtype=np.float64)
    for e, (own, out) in enumerate(experiments):
        # Periods of measured inputs differ as well: what counts is the part of y that G u does not tell.
        miss = out[:, :, lines] - np.einsum("fij,jpf->ipf", G, own[:, :, lines])
        scatter = miss.var(axis=1, ddof=1) / miss.shape[1]
        variance += scatter.T[:, :, np.newaxis] * np.abs(inverse[:, np.newaxis, e]) ** 2
    return np.moveaxis(G, 0, 2).astype(np.complex128), np.moveaxis(variance, 0, 2)


def _of_one(
    unexcited: Detection | None,
    group: list[tuple[ComplexArray, ComplexArray]],
    inputs: list[int],
    lines: np.ndarray,
    noise: FloatArray,
) -> FloatArray:
    """Return the distortion of a single realisation's gains, or NaN where too few lines tell it.

    Detection lines show it; without them, what neighbouring lines scatter about a smooth response shows it. Where a
    resonance is narrower than a few lines its curvature is counted in.
    """
    if unexcited is not None and unexcited.odd_hz.size:
        u = np.moveaxis(np.stack([U[inputs].mean(axis=1)[:, lines] for U, _ in group], axis=1), 2, 0)
        share = np.sum(np.abs(inverse_of_inputs(u)) ** 2, axis=1).T  # (nu, nf)
        return unexcited.carried_to(lines)[:, np.newaxis] * share[np.newaxis]
    U = np.stack([U[inputs].mean(axis=1)[:, lines] for U, _ in group])
    Y = np.stack([Y.mean(axis=1)[:, lines] for _, Y in group])
    scatter = scatter_about_smooth(U, Y)
    if scatter is None:
        return np.full(noise.shape, np.nan)
    return np.maximum(scatter - noise, 0.0)


@np.errstate(over="ignore")  # over nothing at all
def _advice(noise: FloatArray, distortion: FloatArray, unexcited: Detection | None, M: int, P: int) -> Status:
    quiet, loud = np.median(noise, axis=2), np.median(np.nan_to_num(distortion), axis=2)
    ratio = float(np.max(loud / np.maximum(quiet, np.finfo(float).tiny)))
    if M == 1 and np.isnan(distortion).all():
        return Status(
            StatusWord.FEW_DATA,
            "One realisation of so few lines tells noise alone; for distortion add realisations or take "
            "Multisine(odd=True, detection_group=4).",
        )
    kind = "" if unexcited is None else f" {unexcited.sentence}"
    if ratio > VISIBLE:
        advice = (
            f"Distortion stands {10 * np.log10(ratio):.0f} dB above noise where it is worst: more periods will not "
            f"help; average more realisations or lower the excitation.{kind}"
        )
    else:
        advice = f"Noise stands above distortion: longer records or a larger excitation sharpen the response.{kind}"
    if M > 1 and M < ENOUGH:
        few = f"{M} realisations give a variance good within a factor of {1 + np.sqrt(2 / (M - 1)):.1f}, take {ENOUGH}."
        return Status(StatusWord.FEW_DATA, f"{few} {advice}")
    if M == 1 and P < ENOUGH:
        return Status(StatusWord.FEW_DATA, f"{P} periods make a rough weight for a fit, take {ENOUGH}. {advice}")
    return Status(StatusWord.OK, advice)
