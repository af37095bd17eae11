"""Second-order sections g prod (1 + b1 z^-1 + b2 z^-2) / (1 + a1 z^-1 + a2 z^-2), as LIGO's filter modules run them."""

from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray, frozen
from ultraquiet._base.errors import InputError
from ultraquiet.deploy.law.realisation import realisation
from ultraquiet.linalg.zeros import invariant_zeros
from ultraquiet.values.state_space import StateSpace

# Sections have no pure delay: their first numerator coefficient is one. A zero at infinity is put at -1/DELAY instead,
# which changes the response by at most this share of its size for each sample of delay.
DELAY = 2.0**-44


@dataclass(frozen=True, eq=False)
class FotonSections:
    """A gain and rows a1, a2, b1, b2, `(sections, 4)`, run one after the other."""

    gain: float
    rows: FloatArray

    def frequency_response(self, f_hz: FloatArray, rate_hz: float) -> ComplexArray:
        """Return the response at frequencies in Hz, `(nf,)`."""
        z = np.exp(-2j * np.pi * np.asarray(f_hz) / rate_hz)  # z^-1
        response = np.full(z.shape, complex(self.gain))
        for a1, a2, b1, b2 in self.rows:
            response = response * ((1.0 + (b1 + b2 * z) * z) / (1.0 + (a1 + a2 * z) * z))
        return response

    def state_space(self, rate_hz: float) -> StateSpace:
        """Return the same filter as a system of one input and one output."""
        size = 2 * len(self.rows)
        A, B, C, D = np.zeros((size, size)), np.zeros((size, 1)), np.zeros((1, size)), np.ones((1, 1))
        gain = self.gain
        for k, (a1, a2, b1, b2) in enumerate(self.rows):
            at = slice(2 * k, 2 * k + 2)
            # Numerators of a delay are huge and the gain tiny: each section gets its share, so that the entries are
            # of one size.
            share = 1.0 / max(1.0, abs(b1), abs(b2))
            gain /= share
            own, seen = _block(a1, a2, b1 - a1, b2 - a2)
            A[2 * k, :] += C[0]
            A[at, at] = own
            B[2 * k] = D[0]
            C, D = C * share, D * share
            C[0, at] += share * seen
        return StateSpace(A, B, C * gain, D * gain, rate_hz=rate_hz)


def _block(a1: float, a2: float, c1: float, c2: float) -> tuple[FloatArray, FloatArray]:
    """Return A and C of (c1 z + c2) / (z^2 + a1 z + a2), driven at the first state: a rotation for complex poles."""
    half, square = -0.5 * a1, a2 - 0.25 * a1 * a1
    if square <= 0:
        return np.array([[-a1, -a2], [1.0, 0.0]]), np.array([c1, c2])
    turn = float(np.sqrt(square))
    return np.array([[half, turn], [-turn, half]]), np.array([c1, -(c2 + c1 * half) / turn])


def cascade(law: StateSpace) -> list[FotonSections]:
    """Return a scalar law as one chain of sections: zeros beside the poles they are nearest to.

    Raises:
        InputError: a law of several inputs or outputs.
    """
    _scalar(law)
    poles = law.poles() if law.states else np.zeros(0, dtype=np.complex128)
    zeros = invariant_zeros(law.A, law.B, law.C, law.D)
    if not np.any(law.B) or not np.any(law.C) or not np.any(_response(law)):
        return [_gain(float(law.D[0, 0]))]
    late = len(poles) - len(zeros)
    zeros = np.concatenate([zeros, np.full(late, -1.0 / DELAY)])
    below, above = _quadratics(poles), _quadratics(zeros)
    below.sort(key=lambda pair: 1.0 - abs(pair[1]))
    rows = []
    for coefficients, root in below:
        near = min(range(len(above)), key=lambda k: abs(above[k][1] - root))
        rows.append([*coefficients, *above.pop(near)[0]])
    chain = FotonSections(1.0, frozen(np.array(rows)))
    # The gain that fits best where the law is large.
    f_hz, rate_hz = _grid(law), float(law.rate_hz or 0)
    expected, actual = _response(law), chain.frequency_response(f_hz, rate_hz)
    gain = float(np.real(np.vdot(actual, expected)) / np.real(np.vdot(actual, actual)))
    return [FotonSections(gain, chain.rows)]


def modal_sum(law: StateSpace) -> list[FotonSections]:
    """Return a scalar law as sections whose outputs are added: one for each mode, one for the direct gain.

    Raises:
        InputError: several inputs or outputs, or poles that coincide.
    """
    _scalar(law)
    terms = [_gain(float(law.D[0, 0]))] if law.D[0, 0] else []
    if law.states:
        parts = realisation(law, "modal")
        for k, A in enumerate(parts.blocks):
            B, C = parts.B[2 * k : 2 * k + 2, 0], parts.C[0, 2 * k : 2 * k + 2]
            if A[0, 1] == 0 and A[1, 0] == 0:
                terms += [_first(A[i, i], B[i] * C[i]) for i in range(2)]
            else:
                terms.append(_second(A, B, C))
    driven = [one for one in terms if one.gain]
    return driven or [_gain(0.0)]


def _first(pole: float, residue: float) -> FotonSections:
    return FotonSections(residue * DELAY, frozen(np.array([[-pole, 0.0, 1.0 / DELAY, 0.0]])))


def _second(A: FloatArray, B: FloatArray, C: FloatArray) -> FotonSections:
    """Return C (z I - A)^-1 B; the numerator is beta1 z^-1 + beta2 z^-2 by Cramer's rule."""
    trace = A[0, 0] + A[1, 1]
    beta1, beta2 = float(C @ B), float(C @ (A - trace * np.eye(2)) @ B)
    gain = DELAY * max(abs(beta1), abs(beta2))
    if gain == 0:
        return _gain(0.0)
    determinant = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    return FotonSections(gain, frozen(np.array([[-trace, determinant, beta1 / gain, beta2 / gain]])))


def _gain(value: float) -> FotonSections:
    return FotonSections(value, frozen(np.zeros((1, 4))))


def _quadratics(roots: ComplexArray) -> list[tuple[tuple[float, float], complex]]:
    """Return 1 + c1 z^-1 + c2 z^-2 for pairs of roots with the root that stands for each; reals go in pairs, sorted."""
    upper = roots[roots.imag > 0]
    factors = [((float(-2 * r.real), float(abs(r) ** 2)), complex(r)) for r in upper]
    reals = np.sort(roots[roots.imag == 0].real)[::-1].tolist()
    if len(reals) % 2:
        reals.append(0.0)
    factors += [((-(p + q), p * q), complex(p)) for p, q in zip(reals[::2], reals[1::2], strict=True)]
    return factors


def _grid(law: StateSpace) -> FloatArray:
    rate_hz = float(law.rate_hz or 0)
    return np.geomspace(1e-4, 0.499, 200) * rate_hz


def _response(law: StateSpace) -> ComplexArray:
    return law.frequency_response(_grid(law))[0, 0]


def _scalar(law: StateSpace) -> None:
    if law.D.shape != (1, 1):
        raise InputError(f"foton: a filter has one input and one output, got a law of shape {law.D.shape}.")
