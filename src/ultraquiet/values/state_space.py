"""A linear system in state space, continuous or discrete."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array, frozen, rate, real_array
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet._base.provenance import ByContents, Provenance, content_hash
from ultraquiet._base.shown import Shown, counted
from ultraquiet._base.shown.grid import gain_curve
from ultraquiet.linalg import realize, response
from ultraquiet.linalg.modes import boundary
from ultraquiet.values.channel import Channel, channels
from ultraquiet.values.frequency_response import FrequencyResponse
from ultraquiet.values.joined.algebra import Algebra, Matrices, Wires
from ultraquiet.values.neighbours.systems import SystemNeighbours

MANY = 20  # states, above which poles are worth being kept: fewer are found as quickly as their contents are compared


@dataclass(frozen=True, init=False, eq=False)
class StateSpace(Shown, Algebra, SystemNeighbours):
    """x' = A x + B u, y = C x + D u, where x' is the derivative (`rate_hz=None`) or the next sample.

    Args:
        A, B, C, D: real matrices `(n, n)`, `(n, nu)`, `(ny, n)`, `(ny, nu)`; n = 0 is a static gain.
        rate_hz: sampling rate; None for continuous time.
        actuators, sensors: channels or names of inputs and outputs; numbered when absent.
        provenance: how the system was made.

    Raises:
        InputError: shapes that do not fit together, NaN or infinite entries.

    >>> lag = StateSpace([[0.5]], [[0.5]], [[1.0]], [[0.0]], rate_hz=1.0)
    >>> complex(lag.frequency_response([0.0])[0, 0, 0])
    (1+0j)
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    rate_hz: float | None
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]
    provenance: Provenance = field(default_factory=Provenance)

    def __init__(
        self,
        A: ArrayLike,
        B: ArrayLike,
        C: ArrayLike,
        D: ArrayLike,
        rate_hz: float | None = None,
        actuators: Sequence[Channel | str] | None = None,
        sensors: Sequence[Channel | str] | None = None,
        provenance: Provenance | None = None,
    ) -> None:
        a, b, c, d = (real_array("StateSpace", k, v, 2) for k, v in zip("ABCD", (A, B, C, D), strict=True))
        n, (ny, nu) = a.shape[0], d.shape
        if a.shape != (n, n) or b.shape != (n, nu) or c.shape != (ny, n):
            shapes = ", ".join(f"{k} {m.shape}" for k, m in zip("ABCD", (a, b, c, d), strict=True))
            raise InputError(f"StateSpace: the shapes {shapes} do not fit; D sets (ny, nu), A must be square.")
        put = object.__setattr__
        for key, matrix in zip("ABCD", (a, b, c, d), strict=True):
            put(self, key, frozen(matrix))
        put(self, "rate_hz", rate("StateSpace", rate_hz))
        put(self, "actuators", channels("StateSpace", actuators, nu, "input"))
        put(self, "sensors", channels("StateSpace", sensors, ny, "output"))
        put(self, "provenance", provenance or Provenance())

    @property
    def states(self) -> int:
        """Number of states."""
        return self.A.shape[0]

    @property
    def hash(self) -> str:
        """Content hash of matrices and rate."""
        return content_hash(self.A, self.B, self.C, self.D, self.rate_hz)

    def _in_a_line(self) -> str:
        rate_hz = "continuous" if self.rate_hz is None else f"{self.rate_hz:g} Hz"
        wires = f"{counted(len(self.actuators), 'input')}, {counted(len(self.sensors), 'output')}"
        return f"{counted(self.states, 'state')}, {wires}, {rate_hz}"

    def _as_curve(self) -> tuple[str, FloatArray]:
        return gain_curve(self)

    def frequency_response(self, f_hz: ArrayLike) -> ComplexArray:
        """Return C (zI - A)^-1 B + D at `f_hz` (Hz), `(ny, nu, nf)`; z = exp(j 2 pi f / rate), or s = j 2 pi f."""
        f = frequency_array("StateSpace.frequency_response", f_hz)
        return response.frequency_response(self.A, self.B, self.C, self.D, response.points(f, self.rate_hz))

    def response(self, f_hz: ArrayLike) -> FrequencyResponse:
        """Return the response at `f_hz` (Hz) with this system's channels, as a measured one has them."""
        made = Provenance("model", parents=(self.hash,))
        values = self.frequency_response(f_hz)
        return FrequencyResponse(f_hz, values, None, "model", self.actuators, self.sensors, made)

    def _joined(self, matrices: Matrices, wires: Wires) -> "StateSpace":
        return StateSpace(*matrices, self.rate_hz, *wires)

    def poles(self) -> ComplexArray:
        """Return the eigenvalues of A (in z, or in rad/s for continuous time)."""
        if self.states <= MANY:
            return np.linalg.eigvals(self.A).astype(np.complex128)
        return _poles(ByContents(self.A, content_hash(self.A))).copy()

    def is_stable(self) -> bool:
        """Return whether every pole lies inside the stability region, by more than the rounding of A decides."""
        poles = self.poles()
        inside = bool(np.all(poles.real < 0) if self.rate_hz is None else np.all(np.abs(poles) < 1))
        return inside and not self._on_boundary().size

    def boundary_hz(self) -> FloatArray:
        """Return the frequencies in Hz of poles that no digit of A tells from the stability boundary, rising.

        0 Hz is an integrator. Units of inputs, outputs, states and time do not count. Such a system is not stable: what
        it does to a lasting input of that frequency grows without end, or as good as that.

        >>> StateSpace([[1.0, 0.0], [1.0, 0.5]], [[1.0], [0.0]], [[0.0, 1.0]], [[0.0]], rate_hz=1.0).boundary_hz()
        array([0.])
        """
        points = self._on_boundary()
        turns = points.imag if self.rate_hz is None else np.angle(points) * self.rate_hz
        return np.unique(np.abs(turns) / (2 * np.pi))

    def _on_boundary(self) -> ComplexArray:
        return _on_boundary(ByContents(self.A, content_hash(self.A)), self.rate_hz is not None)

    def simulate(self, inputs: ArrayLike, x0: ArrayLike | None = None) -> FloatArray:
        """Return the outputs `(ny, n)` to inputs `(nu, n)`, from state `x0` (zero when absent); discrete time only."""
        if self.rate_hz is None:
            raise InputError("StateSpace.simulate: the system is in continuous time; discretise it first.")
        u = real_array("StateSpace.simulate", "inputs", inputs, 2)
        if u.shape[0] != self.B.shape[1]:
            raise InputError(f"StateSpace.simulate: got {u.shape[0]} inputs, the system has {self.B.shape[1]}.")
        start = np.zeros(self.states) if x0 is None else real_array("StateSpace.simulate", "x0", x0, 1)
        return response.simulate(self.A, self.B, self.C, self.D, u, start)

    def state_space(self) -> "StateSpace":
        """Return this system itself, so that every model answers to the same name."""
        return self

    @classmethod
    def from_descriptor(
        cls,
        E: ArrayLike,
        A: ArrayLike,
        B: ArrayLike,
        C: ArrayLike,
        D: ArrayLike,
        rate_hz: float | None = None,
    ) -> "StateSpace":
        """Return E x' = A x + B u, y = C x + D u without its E.

        Algebraic equations (E without full rank) are solved for the variables that they fix, which become direct terms.

        Args:
            E: real matrix `(n, n)`, of any rank.
            A: `(n, n)`.
            B: `(n, nu)`.
            C: `(ny, n)`.
            D: `(ny, nu)`.
            rate_hz: sampling rate; None for continuous time.

        Raises:
            InputError: shapes that do not fit, or algebraic equations that fix nothing (index above one).

        >>> two = StateSpace.from_descriptor([[1, 0], [0, 0]], [[-1, 1], [0, -1]], [[0], [2]], [[1, 0]], [[0]])
        >>> two.states, round(float(two.frequency_response([0.0])[0, 0, 0].real), 12)
        (1, 2.0)

        Dai 1989, Singular Control Systems, section 1.3, doi:10.1007/BFb0002475.
        """
        explicit = cls(A, B, C, D, rate_hz)
        e = real_array("StateSpace.from_descriptor", "E", E, 2)
        if e.shape != explicit.A.shape:
            raise InputError(f"StateSpace.from_descriptor: 'E' must have the shape of A, {explicit.A.shape}.")
        try:
            return cls(*realize.explicit(e, explicit.A, explicit.B, explicit.C, explicit.D), rate_hz)
        except NumericalError as error:
            raise InputError(f"StateSpace.from_descriptor: {error}") from None


# Whether a loop is stable, where its lines lie and what its margins are is asked one after the other.
@lru_cache(maxsize=64)
def _poles(A: ByContents[FloatArray]) -> ComplexArray:
    return np.linalg.eigvals(A.value).astype(np.complex128)


@lru_cache(maxsize=64)
def _on_boundary(A: ByContents[FloatArray], discrete: bool) -> ComplexArray:
    return frozen(boundary.on_boundary(A.value, _poles(A), discrete))
