"""A sum of modes behind amplifier, geophone, filter and hold: the basis, its slopes, and residues by least squares."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.identify.grey_box.data import SpectralLines
from ultraquiet.identify.grey_box.strut_equation import fractions, responses_behind_hold, separated

# Order of the shared logarithms; frequency and damping of every mode follow in pairs.
SHARED = (
    "circuit_hz",
    "geophone_hz",
    "geophone_damping",
    "filter_hz",
    "filter_damping",
    "stack_hz",
    "stack_damping",
)
SHARED_POLES = 5  # amplifier one, geophone two, filter two
ZEROS_AT_DC = 3
REFERENCE_HZ = 50.0  # residues are gains at this frequency, had every mode its resonance far above
STEP = 1e-5


class Terms(NamedTuple):
    """gain s^zeros / prod (s - p) for k functions, `(k,)`, `(k,)` and `(k, n)`, p in rad/s."""

    gains: FloatArray
    zeros: np.ndarray
    poles: ComplexArray

    def response(self, f_hz: FloatArray, rate_hz: float, delay: int) -> ComplexArray:
        """Return the responses behind the hold and the delay, `(nf, k)`."""
        late = np.exp(-2j * np.pi * f_hz * (delay - 1) / rate_hz)
        return responses_behind_hold(self.gains, self.zeros, self.poles, f_hz, rate_hz) * late[:, None]


def joined(parts: Sequence[Terms]) -> Terms:
    """Return several groups of functions as one."""
    return Terms(*(np.concatenate(v) for v in zip(*parts, strict=True)))


def modes_of(x: FloatArray) -> int:
    """Return how many modes the parameters hold."""
    return (x.size - len(SHARED)) // 2


def terms_of(x: FloatArray, mode: int | None, general: bool) -> Terms:
    """Return the functions of one mode: R alone, or R and s S where its damping need not be proportional.

    `mode` None is the stack, beyond the band, with an R alone.
    """
    circuit_hz, geophone_hz, geophone_damping, filter_hz, filter_damping, *stack = np.exp(x[: len(SHARED)])
    f, zeta = stack if mode is None else np.exp(x[len(SHARED) + 2 * mode :][:2])
    parts = [np.array([-2 * np.pi * circuit_hz])]
    parts += [_pair(geophone_hz, geophone_damping), _pair(filter_hz, filter_damping), _pair(f, zeta)]
    gain = 2 * np.pi * circuit_hz * (2 * np.pi * filter_hz) ** 2 * (2 * np.pi * f) ** 2 / (2 * np.pi * REFERENCE_HZ)
    p = separated(np.concatenate(parts).astype(np.complex128))
    count = 2 if general and mode is not None else 1
    gains = np.array([gain, gain / (2 * np.pi * f)])[:count]
    return Terms(gains, ZEROS_AT_DC + np.arange(count), np.tile(p, (count, 1)))


def all_terms(x: FloatArray, general: bool) -> Terms:
    """Return all functions: that of the stack first, then those of the modes."""
    return joined([terms_of(x, m, general) for m in (None, *range(modes_of(x)))])


def _pair(f_hz: float, zeta: float) -> ComplexArray:
    root = np.sqrt(complex(zeta**2 - 1.0))
    return np.array([-zeta + root, -zeta - root], dtype=np.complex128) * (2 * np.pi * f_hz)


def basis(x: FloatArray, f_hz: FloatArray, rate_hz: float, delay: int, general: bool) -> ComplexArray:
    """Return all functions, `(nf, k)`."""
    return all_terms(x, general).response(f_hz, rate_hz, delay)


def slopes(
    x: FloatArray, free: np.ndarray, f_hz: FloatArray, rate_hz: float, delay: int, general: bool
) -> list[ComplexArray]:
    """Return d basis / d x_k for the free parameters, each `(nf, k)`, by central differences."""
    each = 2 if general else 1
    sides, places = [], []
    for k in np.flatnonzero(free):
        step = np.zeros(x.size)
        step[k] = STEP
        m = (int(k) - len(SHARED)) // 2
        whole = k < len(SHARED)
        sides += [all_terms(x + s, general) if whole else terms_of(x + s, m, general) for s in (step, -step)]
        places.append(slice(None) if whole else slice(1 + each * m, 1 + each * (m + 1)))
    values = joined(sides).response(f_hz, rate_hz, delay)
    parts = np.split(values, np.cumsum([len(s.gains) for s in sides])[:-1], axis=1)
    out = []
    for place, up, down in zip(places, parts[::2], parts[1::2], strict=True):
        slope = np.zeros((f_hz.size, 1 + each * modes_of(x)), dtype=np.complex128)
        slope[:, place] = (up - down) / (2 * STEP)
        out.append(slope)
    return out


@dataclass(frozen=True, eq=False)
class Channels:
    """All channels of a matrix, `[output][input]`, and whether the deviations of their lines are those of the noise."""

    lines: Sequence[Sequence[SpectralLines]]
    delay: int
    general: bool
    noise_known: bool = False

    @property
    def flat(self) -> list[SpectralLines]:
        """The channels, row by row."""
        return [c for row in self.lines for c in row]

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs."""
        return len(self.lines), len(self.lines[0])

    @property
    def count(self) -> int:
        """Real numbers to be met."""
        return sum(2 * c.f_hz.size for c in self.flat)

    def solved(self, x: FloatArray) -> "Solved":
        """Return residues and residuals for shared parameters x."""
        phis: dict[int, ComplexArray] = {}
        out = []
        for c in self.flat:
            if id(c.f_hz) not in phis:
                phis[id(c.f_hz)] = basis(x, c.f_hz, c.rate_hz, self.delay, self.general)
            out.append(_channel(c, phis[id(c.f_hz)], self._memory(x, c), c.scaled(c.y)))
        return Solved(*(list(v) for v in zip(*out, strict=True)))

    def _memory(self, x: FloatArray, c: SpectralLines) -> FloatArray:
        if not c.transient:
            return np.zeros((2 * c.f_hz.size, 0))
        return c.memory(self.poles(x, c.rate_hz), self.delay)

    def poles(self, x: FloatArray, rate_hz: float) -> ComplexArray:
        """Return every pole in z, once."""
        own = [terms_of(x, m, False).poles[0, SHARED_POLES:] for m in (None, *range(modes_of(x)))]
        shared = terms_of(x, None, False).poles[0, :SHARED_POLES]
        return np.exp(np.concatenate([shared, *own]) / rate_hz)

    def residual(self, x: FloatArray) -> FloatArray:
        """Return all residuals in units of their deviation."""
        return np.concatenate(self.solved(x).residuals)

    def jacobian(self, x: FloatArray, free: np.ndarray) -> FloatArray:
        """Return the slope of the residual with the residues always solved for, `(count, free)`.

        Kaufman's form of variable projection, doi:10.1007/BF01932995: the change of the projection is left out, which
        vanishes with the residual.
        """
        at = self.solved(x)
        rows, known = [], {}
        for c, r, Q in zip(self.flat, at.residues, at.spans, strict=True):
            if id(c.f_hz) not in known:
                known[id(c.f_hz)] = slopes(x, free, c.f_hz, c.rate_hz, self.delay, self.general)
            J = np.stack([c.scaled(c.u * (d @ r)) for d in known[id(c.f_hz)]], axis=1)
            rows.append(-(J - Q @ (Q.T @ J)))
        return np.concatenate(rows)

    def gain(self, at: "Solved", x: FloatArray, f_hz: float, zeta: float) -> float:
        """Return how far one more mode would lower the sum of squares."""
        trial = np.concatenate([x[: len(SHARED)], np.log([f_hz, zeta])])
        total, known = 0.0, {}
        for c, e, Q in zip(self.flat, at.residuals, at.spans, strict=True):
            if id(c.f_hz) not in known:
                known[id(c.f_hz)] = terms_of(trial, 0, self.general).response(c.f_hz, c.rate_hz, self.delay)
            v = c.scaled(c.u[:, None] * known[id(c.f_hz)])
            v, _ = np.linalg.qr(v - Q @ (Q.T @ v))
            total += float(np.sum((v.T @ e) ** 2))
        return total


@dataclass(frozen=True, eq=False)
class Solved:
    """For each channel: residues `(1 + modes,)`, what remains, and an orthonormal basis of all that was fitted."""

    residues: list[FloatArray]
    residuals: list[FloatArray]
    spans: list[FloatArray]

    @property
    def loss(self) -> float:
        """Sum of squares over all channels."""
        return float(sum(e @ e for e in self.residuals))


def _channel(
    c: SpectralLines, phi: ComplexArray, memory: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    A = c.scaled(c.u[:, None] * phi)
    size = np.linalg.norm(A, axis=0)
    A = A / size - memory @ (memory.T @ (A / size))
    y = y - memory @ (memory.T @ y)
    U, s, Vt = np.linalg.svd(A, full_matrices=False)
    strong = s > 1e-10 * s[0]
    U = U[:, strong]
    along = U.T @ y
    return Vt[strong].T @ (along / s[strong]) / size, y - U @ along, np.hstack([memory, U])


def residue_terms(
    x: FloatArray, residues: FloatArray, rate_hz: float, general: bool
) -> list[tuple[ComplexArray, ComplexArray]]:
    """Return poles and matrix residues in z of every function times its residues `(k, ny, nu)`."""
    terms = all_terms(x, general)
    poles, weights = fractions(terms.gains, terms.zeros, terms.poles, rate_hz)
    return [(p, w[:, None, None] * R) for p, w, R in zip(poles, weights, residues, strict=True)]
