"""What is free in one output's polynomials and what is known: orders and delays per input, zeros, poles, factors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import comb
from typing import Any

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, one_of, real_array, whole
from ultraquiet._base.errors import InputError
from ultraquiet.identify.prediction_error.structure import (
    ROW_A,
    ROW_C,
    ROW_D,
    ROW_FIRST,
    IntArray,
    Structure,
    b_rows,
    f_rows,
)
from ultraquiet.linalg.polynomial_roots import monic_from_roots

LONGEST_PAST = 60  # initial conditions of one path; what an input did longer before the record is taken as zero


@dataclass(frozen=True, eq=False)
class Parameterisation:
    """The polynomials of one output: their lengths, and the parts of them that are given.

    Args:
        a, c, d: degrees of A, C and D.
        b: coefficients of B per input, known zeros counted.
        f: degree of F per input, known poles counted.
        delay: samples from each input to its first effect.
        zeros_at_dc: known zeros at z = 1, B = (1 - q^-1)^k B'.
        known: factor of every F (of A where there is no F), monic in q^-1.
        fixed: whole polynomials by the letters a, b, c, d, f; B in the units of the record, without its delay.
        past_inputs: whether what each input did before the record is unknown as far as its B and delay reach, or only
            as far as its F remembers.
    """

    a: int
    c: int
    d: int
    b: tuple[int, ...]
    f: tuple[int, ...]
    delay: tuple[int, ...]
    zeros_at_dc: int = 0
    known: FloatArray = field(default_factory=lambda: np.ones(1))
    fixed: Mapping[str, FloatArray] = field(default_factory=dict)
    past_inputs: bool = True

    @classmethod
    def alike(cls, structure: Structure, inputs: int) -> "Parameterisation":
        """Return the simple case: inputs of one order and delay, nothing known."""
        k = structure
        return cls(k.a, k.c, k.d, (k.b,) * inputs, (k.f,) * inputs, (k.delay,) * inputs, past_inputs=False)

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return len(self.b)

    @property
    def rows(self) -> int:
        """Rows of the kernels' table."""
        return ROW_FIRST + 2 * self.inputs

    def degree(self) -> IntArray:
        """Return the coefficients of each row of the table that are not ones or zeros by definition."""
        paired = [n for pair in zip(self.b, self.f, strict=True) for n in pair]
        return np.array([self.a, self.c, self.d, *paired], dtype=np.int64)

    def lag(self) -> IntArray:
        """Return the power of q^-1 of each row's first such coefficient."""
        return np.array([1, 1, 1, *[n for k in self.delay for n in (k, 1)]], dtype=np.int64)

    def states(self, estimate: bool, offset: bool) -> IntArray:
        """Return the unknown initial conditions of each row, the constant last.

        What the noise filter and a path without F remember of the past reaches the residual through 1 / C, for as many
        samples as their longest tap.
        """
        out = np.zeros(self.rows + 1, dtype=np.int64)
        if estimate:
            past = [max(0, b + k - 1) for b, k in zip(self.b, self.delay, strict=True)]
            past = [min(LONGEST_PAST, p) for p in past] if self.past_inputs else past
            straight = [self.d + p for p, f in zip(past, self.f, strict=True) if f == 0]
            out[ROW_C] = max(self.c, self.a + self.d, *straight, 0)
            reach = past if self.past_inputs else [0] * self.inputs
            out[f_rows(self.inputs)] = [max(f, p) if f else 0 for f, p in zip(self.f, reach, strict=True)]
        out[-1] = int(offset)
        return out

    def letter(self, row: int) -> str:
        """Return which polynomial stands in a row."""
        if row in (ROW_A, ROW_C, ROW_D):
            return {ROW_A: "a", ROW_C: "c", ROW_D: "d"}[row]
        return "b" if (row - ROW_FIRST) % 2 == 0 else "f"

    def free(self, row: int) -> FloatArray | None:
        """Return the `(degree, unknowns)` map from a row's unknowns to its coefficients in the kernels' delta basis.

        None for a row that is given or empty. A factor (1 - q^-1)^k shifts the delta basis by k, exactly.
        """
        count, letter = int(self.degree()[row]), self.letter(row)
        if count == 0 or letter in self.fixed:
            return None
        if letter == "b":
            return np.eye(count)[:, self.zeros_at_dc :]
        factor = self.known if letter == self.denominator else np.ones(1)
        known_order = factor.size - 1
        if known_order == count:
            return None
        columns = [np.convolve(delta(count - known_order)[:, k], factor) for k in range(count - known_order)]
        return delta(count) @ np.stack(columns, axis=1)

    @property
    def denominator(self) -> str:
        """The polynomial that holds the poles."""
        return "f" if any(self.f) else "a"

    def unknowns(self) -> int:
        """Return the number of coefficients to be estimated."""
        maps = (self.free(row) for row in range(self.rows))
        return sum(m.shape[1] for m in maps if m is not None)

    def empty(self, gain: FloatArray | None = None) -> FloatArray:
        """Return the table with what is known in it and nothing else.

        `gain` is output unit by input unit, `(nu,)`; it matters to a B that is given.
        """
        table = np.zeros((self.rows, int(self.degree().max()) + 1))
        table[[ROW_A, ROW_C, ROW_D, *f_rows(self.inputs)], 0] = 1.0
        for row in (ROW_A, *f_rows(self.inputs)):
            if self.letter(row) == self.denominator:
                table[row, : self.known.size] = self.known
        for row in range(self.rows):
            known_part = self.fixed.get(self.letter(row))
            if known_part is not None:
                table[row, : known_part.size] = known_part
        if gain is not None:
            table[b_rows(self.inputs)] /= gain[:, None]
        return table

    def with_poles(self, table: FloatArray, row: int, roots: ComplexArray) -> None:
        """Write into a row the known factor and the roots that are left when those nearest to its own are taken out."""
        left = roots
        for pole in np.roots(self.known):
            left = np.delete(left, np.argmin(np.abs(left - pole)))
        polynomial = np.convolve(self.known, monic_from_roots(left))
        table[row] = 0.0
        table[row, : polynomial.size] = polynomial


def delta(count: int) -> FloatArray:
    """Return the matrix of the binomials (1 - q^-1)^k in powers of q^-1, a column each; it is its own inverse."""
    return np.array([[(-1.0) ** m * comb(k, m) for k in range(count)] for m in range(count)]).reshape(count, count)


def each(value: "int | Sequence[int] | None") -> tuple[int, ...]:
    """Return a setting as a tuple: one for all inputs, or one per input."""
    if value is None:
        return ()
    return tuple(value) if isinstance(value, Sequence) else (value,)


def laid_out(method: Any, inputs: int) -> Parameterisation:
    """Return the polynomials that a method's settings ask for with so many inputs.

    Raises:
        InputError: settings per input that are not one per input, more known zeros or poles than the orders hold.
    """
    who, structure = type(method).__name__, method.structure()

    def per_input(name: str, common: int) -> tuple[int, ...]:
        values = each(getattr(method, name, None))
        if len(values) > 1 and len(values) != inputs:
            raise InputError(
                f"{who}: '{name}' has {len(values)} values for {inputs} inputs; give one, or one for each."
            )
        return (values or (common,)) * (1 if len(values) > 1 else inputs)

    fixed = {letter: np.asarray(p, dtype=np.float64) for letter, p in (method.fixed or {}).items()}
    degree = {k: getattr(structure, k) for k in "acd"} | {k: p.size - 1 for k, p in fixed.items() if k in "acd"}
    b = (fixed["b"].size,) * inputs if "b" in fixed else per_input("b_order", structure.b)
    f = (0,) * inputs if structure.f == 0 else per_input("f_order", structure.f)
    f = (fixed["f"].size - 1,) * inputs if "f" in fixed else f
    poles = complex_poles(who, method.known_poles)
    known = np.real(np.poly(poles)) if poles.size else np.ones(1)
    out = Parameterisation(
        degree["a"],
        degree["c"],
        degree["d"],
        b,
        f,
        per_input("delay", structure.delay),
        method.zeros_at_dc,
        known.astype(np.float64),
        fixed,
    )
    least = min(out.f) if out.denominator == "f" else out.a
    if "b" not in fixed and min(b) <= method.zeros_at_dc:
        raise InputError(
            f"{who}: {min(b)} coefficients of B hold no {method.zeros_at_dc} zeros at z = 1; raise 'b_order'."
        )
    if known.size - 1 > least:
        raise InputError(f"{who}: an order of {least} holds no {known.size - 1} known poles; raise the order.")
    return out


def complex_poles(who: str, poles: Any) -> ComplexArray:
    """Return poles given as complex numbers, or as pairs of real and imaginary part as files hold them."""
    try:
        array = np.asarray(poles).astype(np.complex128)
    except (TypeError, ValueError):
        array = np.zeros((), dtype=np.complex128)
    if array.ndim not in (1, 2) or array.shape[1:] not in ((), (2,)):
        raise InputError(
            f"{who}: 'known_poles' must be a list of complex numbers or of pairs of real ones, got {poles!r}."
        )
    return array[:, 0] + 1j * array[:, 1] if array.ndim == 2 else array


LETTERS = "abcdf"


def check_known(method: Any) -> None:
    """Refuse known zeros, poles or polynomials that no real, stable model has."""
    who = type(method).__name__
    whole(who, "zeros_at_dc", method.zeros_at_dc, 0)
    poles = complex_poles(who, method.known_poles)
    if np.any(np.abs(poles) >= 1.0):
        raise InputError(
            f"{who}: 'known_poles' must lie inside the unit circle of z, got {poles[np.abs(poles) >= 1][0]}."
        )
    if not np.allclose(np.sort_complex(poles), np.sort_complex(poles.conj()), rtol=0.0, atol=1e-12):
        raise InputError(f"{who}: 'known_poles' must come in conjugate pairs.")
    if not isinstance(method.fixed or {}, Mapping):
        raise InputError(
            f"{who}: 'fixed' must be polynomials by their letters, {{'c': [1.0, ...]}}, got {method.fixed!r}."
        )
    for letter, polynomial in (method.fixed or {}).items():
        one_of(who, "fixed", letter, tuple(LETTERS))
        p = real_array(who, f"fixed['{letter}']", polynomial, 1)
        if p.size == 0 or (letter != "b" and p[0] != 1.0):
            raise InputError(f"{who}: fixed['{letter}'] must hold coefficients beginning with one, got {p}.")
        if letter in "cdf" and p.size > 1 and np.abs(np.roots(p)).max() >= 1.0:
            raise InputError(f"{who}: fixed['{letter}'] must have its roots inside the unit circle.")
        present = {"a": method.structure().a, "f": method.structure().f}
        if present.get(letter, 1) == 0:
            raise InputError(f"{who}: there is no '{letter}' to fix in this structure.")
