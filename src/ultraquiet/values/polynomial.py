"""Polynomial models: transfer functions in the delay operator with a model of the noise."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array, frozen, positive, real_array
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.shown import Shown, counted
from ultraquiet._base.shown.grid import gain_curve
from ultraquiet.linalg import realize
from ultraquiet.values.channel import Channel, channels
from ultraquiet.values.frequency_response import FrequencyResponse
from ultraquiet.values.state_space import StateSpace


@dataclass(frozen=True, init=False, eq=False)
class PolynomialModel(Shown):
    """A(q) y = sum_j B_j(q) / F_j(q) u_j + C(q) / D(q) e, one output, `nu` inputs, q^-1 the unit delay.

    Every array holds the coefficients of q^0, q^-1, q^-2, ...; A, F_j, C and D begin with one, leading zeros of B_j are
    its delay. `noise_variance` is that of e, in squared output units.

    Raises:
        InputError: a monic polynomial that does not begin with one, unequal numbers of B and F.

    >>> lag = PolynomialModel(b=[[0.0, 0.5]], f=[[1.0, -0.5]], rate_hz=1.0)
    >>> complex(lag.frequency_response([0.0])[0, 0, 0])
    (1+0j)
    """

    b: tuple[FloatArray, ...]
    f: tuple[FloatArray, ...]
    a: FloatArray
    c: FloatArray
    d: FloatArray
    rate_hz: float
    noise_variance: float

    def __init__(
        self,
        b: Sequence[ArrayLike],
        f: Sequence[ArrayLike],
        rate_hz: float,
        a: ArrayLike = (1.0,),
        c: ArrayLike = (1.0,),
        d: ArrayLike = (1.0,),
        noise_variance: float = 0.0,
    ) -> None:
        if len(b) != len(f) or not b:
            raise InputError(f"PolynomialModel: got {len(b)} numerators B and {len(f)} denominators F.")
        put = object.__setattr__
        put(self, "b", tuple(_polynomial("b", p, monic=False) for p in b))
        put(self, "f", tuple(_polynomial("f", p) for p in f))
        for name, value in (("a", a), ("c", c), ("d", d)):
            put(self, name, _polynomial(name, value))
        put(self, "rate_hz", positive("PolynomialModel", "rate_hz", rate_hz, "Hz"))
        put(self, "noise_variance", float(noise_variance))

    def _in_a_line(self) -> str:
        orders = ", ".join(f"{name} {p.size - 1}" for name, p in (("A", self.a), ("C", self.c), ("D", self.d)))
        return f"{counted(len(self.b), 'input')}, orders F {self.f[0].size - 1}, {orders}, {self.rate_hz:g} Hz"

    def _as_curve(self) -> tuple[str, FloatArray]:
        return gain_curve(self)

    def denominator(self, j: int) -> FloatArray:
        """Return A F_j, the denominator from input j."""
        return np.convolve(self.a, self.f[j])

    def frequency_response(self, f_hz: ArrayLike) -> ComplexArray:
        """Return B_j / (A F_j) at `f_hz` (Hz), `(1, nu, nf)`."""
        w = self._delay(f_hz)
        return np.stack([_at(b, w) / _at(self.denominator(j), w) for j, b in enumerate(self.b)])[np.newaxis]

    def response(self, f_hz: ArrayLike) -> FrequencyResponse:
        """Return the response at `f_hz` (Hz) as a measured one would be, channels numbered."""
        return FrequencyResponse(f_hz, self.frequency_response(f_hz), estimator="model")

    def noise_response(self, f_hz: ArrayLike) -> ComplexArray:
        """Return the noise filter C / (A D) at `f_hz` (Hz), `(nf,)`."""
        w = self._delay(f_hz)
        return _at(self.c, w) / (_at(self.a, w) * _at(self.d, w))

    def poles(self, j: int) -> ComplexArray:
        """Return the poles in z from input j."""
        return np.roots(self.denominator(j)).astype(np.complex128)

    def zeros(self, j: int) -> ComplexArray:
        """Return the zeros in z from input j, without those of the delay."""
        return np.roots(np.trim_zeros(self.b[j], "f")).astype(np.complex128)

    def is_stable(self) -> bool:
        """Return whether every pole from every input lies inside the unit circle."""
        return all(_inside(self.denominator(j)) for j in range(len(self.b)))

    def is_invertible(self) -> bool:
        """Return whether the noise filter and its inverse are stable, so that one-step predictions exist."""
        return _inside(self.c) and _inside(self.d) and _inside(self.a)

    def state_space(self) -> StateSpace:
        """Return the path from the inputs as a system of second-order sections (the noise path is left out)."""
        A, B, C, D = realize.parallel_inputs([realize.sections(b, self.denominator(j)) for j, b in enumerate(self.b)])
        return StateSpace(A, B, C, D, rate_hz=self.rate_hz)

    def _delay(self, f_hz: ArrayLike) -> ComplexArray:
        f = frequency_array("PolynomialModel", f_hz)
        angle = -2.0 * np.longdouble(np.pi) * f.astype(np.longdouble) / np.longdouble(self.rate_hz)
        return np.cos(angle) + 1j * np.sin(angle)


@dataclass(frozen=True, init=False, eq=False)
class PolynomialMatrix(Shown):
    """A transfer matrix of polynomial models.

    `rows[i]` are the models of output i, side by side; their inputs, counted together, are the `nu` inputs. One record
    of all inputs gives one model a row; one record per actuator gives `nu` models a row, each with its own noise.
    """

    rows: tuple[tuple[PolynomialModel, ...], ...]
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]
    provenance: Provenance = field(default_factory=Provenance)

    def __init__(
        self,
        rows: Sequence[Sequence[PolynomialModel]],
        actuators: Sequence[Channel | str] | None = None,
        sensors: Sequence[Channel | str] | None = None,
        provenance: Provenance | None = None,
    ) -> None:
        counts = {sum(len(m.b) for m in row) for row in rows}
        if len(counts) != 1:
            raise InputError(f"PolynomialMatrix: rows must cover equally many inputs, got {sorted(counts)}.")
        rates = {m.rate_hz for row in rows for m in row}
        if len(rates) != 1:
            raise InputError(f"PolynomialMatrix: all models must share one rate, got {sorted(rates)} Hz.")
        put = object.__setattr__
        put(self, "rows", tuple(tuple(row) for row in rows))
        put(self, "actuators", channels("PolynomialMatrix", actuators, counts.pop(), "input"))
        put(self, "sensors", channels("PolynomialMatrix", sensors, len(self.rows), "output"))
        put(self, "provenance", provenance or Provenance())

    @property
    def rate_hz(self) -> float:
        """Sampling rate in Hz."""
        return self.rows[0][0].rate_hz

    def _in_a_line(self) -> str:
        order = self.rows[0][0].f[0].size + self.rows[0][0].a.size - 2
        wires = f"{counted(len(self.actuators), 'input')}, {counted(len(self.sensors), 'output')}"
        return f"{wires}, order {order}, {self.rate_hz:g} Hz"

    def _as_curve(self) -> tuple[str, FloatArray]:
        return gain_curve(self)

    def frequency_response(self, f_hz: ArrayLike) -> ComplexArray:
        """Return the response at `f_hz` (Hz), `(ny, nu, nf)`."""
        return np.concatenate(
            [np.concatenate([m.frequency_response(f_hz) for m in row], axis=1) for row in self.rows], axis=0
        )

    def response(self, f_hz: ArrayLike) -> FrequencyResponse:
        """Return the response at `f_hz` (Hz) with this model's channels, as a measured one has them."""
        values = self.frequency_response(f_hz)
        return FrequencyResponse(f_hz, values, None, "model", self.actuators, self.sensors)

    def is_stable(self) -> bool:
        """Return whether every channel is stable."""
        return all(m.is_stable() for row in self.rows for m in row)

    def is_invertible(self) -> bool:
        """Return whether every noise model is stable and invertible."""
        return all(m.is_invertible() for row in self.rows for m in row)

    def state_space(self) -> StateSpace:
        """Return the whole matrix as one system in well-scaled modal coordinates, states channel by channel."""
        grid = [[realize.sections(b, m.denominator(j)) for m in row for j, b in enumerate(m.b)] for row in self.rows]
        A, B, C, D = realize.grid(grid)
        return StateSpace(A, B, C, D, self.rate_hz, self.actuators, self.sensors, self.provenance)


def _polynomial(name: str, value: ArrayLike, monic: bool = True) -> FloatArray:
    p = real_array("PolynomialModel", name, value, 1)
    if p.size == 0 or (monic and p[0] != 1.0):
        raise InputError(f"PolynomialModel: '{name}' must hold coefficients beginning with one, got {p}.")
    return frozen(p)


def _at(p: FloatArray, w: ComplexArray) -> ComplexArray:
    # Near w = 1 the terms of a fifth-order polynomial at 3.5 kHz cancel to one part in a million: extended precision
    # keeps the sum good to 1e-11, double would leave 1e-8.
    value = np.zeros(w.shape, dtype=np.clongdouble)
    for coefficient in p[::-1]:
        value = value * w + coefficient
    return value.astype(np.complex128)


def _inside(p: FloatArray) -> bool:
    return bool(np.all(np.abs(realize.roots(p)) < 1.0))
