"""Where a joint search begins: poles from a subspace of one of its sets, the rest by least squares over all of them."""

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet.identify.joint.search import JointMinimum, Part, posed, search
from ultraquiet.identify.prediction_error.damping_policy import LEAST_DAMPING
from ultraquiet.identify.prediction_error.initial_models import NOISE_RADIUS, RADIUS, noise_start
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.race import Search
from ultraquiet.identify.prediction_error.structure import ROW_A, ROW_C, ROW_D, b_rows, f_rows
from ultraquiet.linalg.polynomial_roots import mirrored_inside, stabilised

LINEAR_STEPS = 3  # the first solves a linear problem, the others settle the weights of the groups
LINEAR_TOLERANCE = 1e-3
# Sets whose subspaces are compared at the first horizon and at later ones, and how many of them are searched from:
# those of a class are alike but for their noise.
SOURCES, LATER_SOURCES, TRIED = 6, 2, 2


def starts(parts: Sequence[Part], how: Search, workers: int) -> Iterator[tuple[int, list[FloatArray]]]:
    """Yield the horizon (0: none) and one table per set, horizon by horizon, of each the most promising first."""
    equation_error = parts[0].parameterisation.denominator == "a"
    if equation_error and parts[0].parameterisation.c == 0 and parts[0].parameterisation.d == 0:
        yield 0, _all_linear(parts, how, workers)
        return
    chosen = list(parts[:: -(-len(parts) // SOURCES)])
    fallback = True
    for rows in how.horizons:
        candidates = [s for s in (_from_poles(parts, source, rows, how, workers) for source in chosen) if s is not None]
        for ended, tables in sorted(candidates, key=lambda s: s[0].criterion)[:TRIED]:
            fallback = fallback and not np.isfinite(ended.criterion)
            yield rows, tables
        chosen = chosen[:LATER_SOURCES]
    if equation_error:
        yield 0, _all_linear(parts, how, workers)
    elif fallback:
        yield 0, _from_least_squares(parts, how, workers)


def _from_poles(
    parts: Sequence[Part], source: Part, rows: int, how: Search, workers: int
) -> tuple[JointMinimum, list[FloatArray]] | None:
    outputs = [_output_error(part, how) for part in parts]
    tables: list[FloatArray] = []
    for part in outputs:
        table = part.parameterisation.empty(part.data.gain)
        for row in f_rows(part.parameterisation.inputs):
            if part.parameterisation.free(row) is None:
                continue
            roots = source.data.poles(int(part.parameterisation.degree()[row]), rows)
            if roots is None:
                return None
            part.parameterisation.with_poles(table, row, mirrored_inside(roots, RADIUS))
        tables.append(table)
    return _completed(parts, outputs, tables, workers)


def _completed(
    parts: Sequence[Part], outputs: Sequence[Part], tables: list[FloatArray], workers: int
) -> tuple[JointMinimum, list[FloatArray]]:
    """Return B by least squares over all sets for poles that are given, C and D from what remains."""
    plant = posed(outputs, lambda letter: letter == "b")
    ended = search(plant, tables, LINEAR_STEPS, LINEAR_TOLERANCE, workers, LEAST_DAMPING)
    out = [_as_wanted(part, table) for part, table in zip(parts, ended.tables, strict=True)]
    held: dict[Hashable, FloatArray] = {}
    for part, table, rest in zip(parts, out, ended.residuals, strict=True):
        _with_noise(part, table, rest, held)
    return ended, out


def _with_noise(part: Part, table: FloatArray, rest: FloatArray, held: dict[Hashable, FloatArray]) -> None:
    """Write the starts of C and D into the table; sets that share them take the first one's."""
    parameterisation = part.parameterisation
    wanted = [
        row
        for row in (ROW_C, ROW_D)
        if parameterisation.free(row) is not None and not (row == ROW_C and parameterisation.a)
    ]
    if not wanted:
        return
    if any(part.keys[row] not in held for row in wanted):
        for row, p in zip((ROW_C, ROW_D), noise_start(rest, parameterisation.c, parameterisation.d), strict=True):
            held.setdefault(part.keys[row], p)
    for row in wanted:
        table[row, : held[part.keys[row]].size] = held[part.keys[row]]


def _output_error(part: Part, how: Search) -> Part:
    """Return the set with a model without noise whose poles are those of the plant (ARMAX: its A as every F)."""
    own = part.parameterisation
    degree = own.f if own.denominator == "f" else tuple(own.a for _ in own.b)
    fixed = {k: v for k, v in own.fixed.items() if k in ("b", "f")}
    if "a" in own.fixed:
        fixed["f"] = own.fixed["a"]
    parameterisation = Parameterisation(0, 0, 0, own.b, degree, own.delay, own.zeros_at_dc, own.known, fixed)
    return replace(part, parameterisation=parameterisation, states=parameterisation.states(how.estimate, how.offset))


def _as_wanted(part: Part, table: FloatArray) -> FloatArray:
    """Return an output-error model's table in the set's own parameterisation, C near A when there is an A."""
    parameterisation = part.parameterisation
    out = parameterisation.empty(part.data.gain)
    width = min(out.shape[1], table.shape[1])
    out[b_rows(parameterisation.inputs), :width] = table[b_rows(parameterisation.inputs), :width]
    first = table[f_rows(parameterisation.inputs)[0]]
    if parameterisation.denominator == "f":
        out[f_rows(parameterisation.inputs), :width] = table[f_rows(parameterisation.inputs), :width]
        return out
    out[ROW_A, :width] = first[:width]
    if parameterisation.free(ROW_C) is not None:
        c = stabilised(
            stabilised(first[: parameterisation.a + 1], NOISE_RADIUS)[: parameterisation.c + 1], NOISE_RADIUS
        )
        out[ROW_C, : c.size] = c
    return out


def _all_linear(parts: Sequence[Part], how: Search, workers: int) -> list[FloatArray]:
    """Return A and B of the equation-error model."""
    problem = posed(parts, lambda letter: letter in "ab")
    empty = [part.parameterisation.empty(part.data.gain) for part in parts]
    return search(problem, empty, LINEAR_STEPS, LINEAR_TOLERANCE, workers, LEAST_DAMPING).tables


def _from_least_squares(parts: Sequence[Part], how: Search, workers: int) -> list[FloatArray]:
    """Return a start for records too short for a subspace: the poles of an equation-error model."""
    own = parts[0]
    degree = max(own.parameterisation.f)
    parameterisation = Parameterisation(
        degree, 0, 0, own.parameterisation.b, tuple(0 for _ in own.parameterisation.f), own.parameterisation.delay
    )
    alone = replace(own, parameterisation=parameterisation, states=parameterisation.states(how.estimate, how.offset))
    a = stabilised(_all_linear([alone], how, 1)[0][ROW_A, : degree + 1], RADIUS)
    outputs = [_output_error(part, how) for part in parts]
    tables: list[FloatArray] = []
    for part in outputs:
        table = part.parameterisation.empty(part.data.gain)
        for row in f_rows(part.parameterisation.inputs):
            if part.parameterisation.free(row) is not None:
                roots = np.sort_complex(np.roots(a).astype(np.complex128))[::-1][
                    : int(part.parameterisation.degree()[row])
                ]
                part.parameterisation.with_poles(table, row, roots)
        tables.append(table)
    return _completed(parts, outputs, tables, workers)[1]
