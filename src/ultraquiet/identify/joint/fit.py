"""From tied data sets to models with their evidence: clusters, the best of several starts, one fit per output."""

import os
from collections.abc import Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, whole
from ultraquiet.identify import chance
from ultraquiet.identify.feedback import free_of_inputs
from ultraquiet.identify.joint.initial_models import starts
from ultraquiet.identify.joint.search import JointMinimum, Part, Problem, covariance_root, posed, search
from ultraquiet.identify.prediction_error.damping_policy import CONVERGED
from ultraquiet.identify.prediction_error.fit import REPAIRS, SETTLED, Fit, judged, simulated, verdict
from ultraquiet.identify.prediction_error.initial_models import ChannelData
from ultraquiet.identify.prediction_error.model_table import modelled
from ultraquiet.identify.prediction_error.parameterisation import delta
from ultraquiet.identify.prediction_error.race import PROMISING, TEST_LAGS, TOLERANCE, TRIAL_STEPS, Search
from ultraquiet.identify.prediction_error.structure import ROW_A, ROW_C, ROW_D, ROW_FIRST
from ultraquiet.identify.result import SIGNIFICANCE, noiseless
from ultraquiet.linalg import portmanteau, prediction

LEAST_STARTS = 3  # a residual of too large a noise model can pass in a minimum 3 % too high
SAME = 1.0  # in the criterion, twice the logarithm of the likelihood: minima nearer than this are one


def fit_parts(parts: Sequence[Part], how: Search, rate_hz: float, workers: int | None) -> dict[int, Fit]:
    """Return one fit per group of sets; sets that share nothing are searched apart, in threads."""
    clusters = _clusters(parts)
    if workers is not None:
        whole("identify", "workers", workers, 0)
    count = workers or os.cpu_count() or 1
    inner = count if len(clusters) == 1 and len(parts) > 1 else 1
    with ThreadPoolExecutor(min(count, len(clusters))) as pool:
        cluster_fits = pool.map(lambda cluster: _fit_cluster(cluster, how, rate_hz, inner), clusters)
        return {group: fit for fits in cluster_fits for group, fit in fits.items()}


def _clusters(parts: Sequence[Part]) -> list[list[Part]]:
    """Return the sets in lists between which no polynomial and no variance is shared."""
    lists: list[tuple[set[Hashable], list[Part]]] = []
    for part in parts:
        tied: set[Hashable] = {("group", part.group)}
        tied |= {
            part.keys[row] for row in range(part.parameterisation.rows) if part.parameterisation.free(row) is not None
        }
        touched = [one for one in lists if one[0] & tied]
        lists = [one for one in lists if not one[0] & tied]
        lists.append(
            (set.union(tied, *(k for k, _ in touched)), [p for _, members in touched for p in members] + [part])
        )
    return [members for _, members in lists]


def _fit_cluster(parts: list[Part], how: Search, rate_hz: float, workers: int) -> dict[int, Fit]:
    problem = posed(parts)
    best, tried = _best(problem, how, workers)
    clipped = how.repair and any(part.data.clipped for part in parts)
    for _ in range(REPAIRS if clipped else 0):
        moved, problem = _mended(problem, best, how, rate_hz)
        if moved < SETTLED:
            break
        again = search(problem, best.tables, how.max_iterations, TOLERANCE, workers)
        best = replace(again, iterations=best.iterations + again.iterations)
    root = covariance_root(problem, best.normal)
    return {
        group: _group_fit(
            problem, best, [k for k, p in enumerate(parts) if p.group == group], root, how, rate_hz, tried
        )
        for group in {part.group for part in parts}
    }


def _best(problem: Problem, how: Search, workers: int) -> tuple[JointMinimum, int]:
    """Search from the first start to its end, from the others while they promise more; see `fit_channel`.

    A minimum that starts of two horizons lead to is taken for the lowest one, whether its residual passes or not.
    """
    best, tried, origin = None, 0, 0
    margin = sum(part.data.y.size for part in problem.parts) * np.log(PROMISING)
    for rows, tables in starts(problem.parts, how, workers):
        tried += 1
        steps = how.max_iterations if best is None else min(TRIAL_STEPS, how.max_iterations)
        minimum = search(problem, tables, steps, TOLERANCE, workers)
        if best is not None and minimum.state != CONVERGED and minimum.criterion < best.criterion + margin:
            more = search(problem, minimum.tables, how.max_iterations - minimum.iterations, TOLERANCE, workers)
            minimum = replace(more, iterations=minimum.iterations + more.iterations)
        agreed = (
            best is not None
            and rows != origin
            and minimum.state == CONVERGED
            and abs(minimum.criterion - best.criterion) < SAME
        )
        if best is None or minimum.criterion < best.criterion:
            best, origin = minimum, rows
        if best.state == CONVERGED and (agreed or (tried >= LEAST_STARTS and _passes(problem, best))):
            break
    assert best is not None
    return best, tried


def _groups(problem: Problem) -> list[list[int]]:
    groups = sorted({part.group for part in problem.parts})
    return [[k for k, part in enumerate(problem.parts) if part.group == g] for g in groups]


def _passes(problem: Problem, found: JointMinimum) -> bool:
    groups = _groups(problem)
    least = min(p for members in groups for p in residual_tests(problem, found.residuals, members))
    return 1.0 - (1.0 - least) ** len(groups) >= SIGNIFICANCE


def residual_tests(problem: Problem, residuals: Sequence[FloatArray], members: Sequence[int]) -> tuple[float, float]:
    """Return the p-values that the residuals of one group's sets are white, and free of their inputs.

    The statistics of the sets are added up. No degrees of freedom are taken off for the noise model: of one that is
    larger than need be, or shared by several groups, only a part is fitted to each residual, and the test must not
    refuse good models more often than it says.
    """
    total, lags_all, crowded, free = 0.0, 0, 0.0, []
    for k in members:
        e, u = residuals[k], problem.parts[k].data.u
        lags = min(TEST_LAGS, e.size // 10)
        total += portmanteau.ljung_box(e, lags).statistic
        lags_all, crowded = lags_all + lags, crowded + lags * lags / e.size
        free.append(free_of_inputs(e, u, lags, min(problem.parts[k].parameterisation.delay) > 0))
    white = portmanteau.whiteness_evidence(total, lags_all, crowded / lags_all).p_value
    return white, portmanteau.sidak(free)


def _group_fit(
    problem: Problem, best: JointMinimum, members: list[int], root: FloatArray, how: Search, rate_hz: float, tried: int
) -> Fit:
    first = members[0]
    part, sets = problem.parts[first], [problem.parts[k].data for k in members]
    evidence = residual_tests(problem, best.residuals, members)
    model = modelled(part.parameterisation, best.tables[first], part.data.gain, rate_hz, float(best.variance[first]))
    local = _to_units(part, problem.places[first].free) @ problem.places[first].map
    spread = local @ root[problem.places[first].index]
    misses = [data.recorded - np.clip(simulated(data, model, how), data.low, data.high) for data in sets]
    samples = sum(data.recorded.size for data in sets)
    past = sum(int(problem.parts[k].states.sum()) for k in members)
    power = sum(float(np.sum((data.recorded - data.recorded.mean()) ** 2)) for data in sets) / samples
    status, silent = judged(
        noiseless(model.noise_variance / max(power, np.finfo(float).tiny))
        or verdict(best.state, best.iterations, evidence),
        evidence[1],
        model,
        lambda: chance.explained_together([(data.recorded, miss) for data, miss in zip(sets, misses, strict=True)]),
        samples,
        problem.places[first].index.size + past,
    )
    return Fit(
        model,
        status,
        _fit_percent(sets, misses),
        model.noise_variance,
        spread @ spread.T,
        whiteness_p=evidence[0],
        correlation_p=evidence[1],
        iterations=best.iterations,
        starts=tried,
        repaired=sum(data.clipped for data in sets) if how.repair else 0,
        silent=silent,
        past=past,
    )


def _to_units(part: Part, free: "np.ndarray[Any, np.dtype[np.bool_]]") -> FloatArray:
    """Return the map from a step in the delta basis to all coefficients in units of the record, in `Result`'s order.

    Coefficients that are given have rows of zeros: they do not vary.
    """
    parameterisation = part.parameterisation
    rows = [ROW_A, *range(ROW_FIRST, parameterisation.rows), ROW_C, ROW_D]
    degree = parameterisation.degree()
    T = np.zeros((int(degree.sum()), int(degree[free].sum())))
    at, to = 0, 0
    for row in rows:
        n = int(degree[row])
        if free[row]:
            unit = float(part.data.gain[(row - ROW_FIRST) // 2]) if parameterisation.letter(row) == "b" else 1.0
            T[to : to + n, at : at + n] = unit * delta(n)
            at += n
        to += n
    return T


def _fit_percent(sets: Sequence[ChannelData], misses: Sequence[FloatArray]) -> float:
    """Return the simulated fit over all records, each against its own mean."""
    y = np.concatenate([data.recorded - data.recorded.mean() for data in sets])
    return prediction.fit_percent(y, y - np.concatenate(misses))


def _mended(problem: Problem, best: JointMinimum, how: Search, rate_hz: float) -> tuple[float, Problem]:
    """Return how far clipped readings moved, relative to the record, and the problem with them replaced."""
    moved, parts = 0.0, []
    for part, table, variance in zip(problem.parts, best.tables, best.variance, strict=True):
        model = modelled(part.parameterisation, table, part.data.gain, rate_hz, float(variance))
        data = part.data.repaired(simulated(part.data, model, how))
        moved = max(moved, float(np.linalg.norm(data.y - part.data.y) / np.linalg.norm(data.y)))
        parts.append(replace(part, data=data))
    return moved, replace(problem, parts=tuple(parts))
