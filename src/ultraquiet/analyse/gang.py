"""The gang of six: every way from a disturbance to a signal of the loop, direction by direction."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import ComplexArray, FloatArray, frequency_array
from ultraquiet._base.errors import InputError
from ultraquiet.analyse.margins import default_grid
from ultraquiet.analyse.norms import hinf_norm
from ultraquiet.analyse.peaks import response_at
from ultraquiet.linalg.response import principal_gains
from ultraquiet.values.door import takes_systems
from ultraquiet.values.interconnect import lft, series
from ultraquiet.values.joined.wires import unswapped
from ultraquiet.values.state_space import StateSpace


@dataclass(frozen=True, eq=False)
class Peak:
    """The largest gain of a system: how much, at which frequency, from which direction to which.

    Attributes:
        gain: largest singular value over frequency; infinite for an unstable loop.
        f_hz: where it is reached.
        inputs, outputs: unit vectors of the input that is amplified most, and of what comes out, complex; empty for an
            unstable loop.
    """

    gain: float
    f_hz: float
    inputs: ComplexArray
    outputs: ComplexArray

    @property
    def gain_db(self) -> float:
        """20 log10 of the gain."""
        return 20 * float(np.log10(self.gain)) if self.gain > 0 else -np.inf


@dataclass(frozen=True, eq=False)
class Gang:
    """All closed-loop responses with u = K y and y = G u, positive feedback as everywhere in this package.

    Attributes:
        So: (I - G K)^-1, disturbance at the outputs to outputs.
        To: G K (I - G K)^-1, minus what is called T with negative feedback; So - To = I.
        Si: (I - K G)^-1, disturbance at the inputs to the plant's inputs.
        Ti: K G (I - K G)^-1; Si - Ti = I.
        KSo: K (I - G K)^-1, disturbance or noise at the outputs to commands; equal to Si K.
        GSi: G (I - K G)^-1, disturbance at the inputs to outputs; equal to So G.
        reference: `GSiF` and `SiF`, from a reference that a prefilter F adds to the commands, u = K y + F r, to outputs
            and to commands; empty without prefilter.
        stable: whether the loop is.
    """

    So: StateSpace
    To: StateSpace
    Si: StateSpace
    Ti: StateSpace
    KSo: StateSpace
    GSi: StateSpace
    reference: Mapping[str, StateSpace]
    stable: bool

    @property
    def members(self) -> dict[str, StateSpace]:
        """All responses by name."""
        names = ("So", "To", "Si", "Ti", "KSo", "GSi")
        return {**{name: getattr(self, name) for name in names}, **self.reference}

    def singular_values(self, f_hz: ArrayLike | None = None) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return frequencies in Hz and the singular values `(directions, nf)` of every member, largest first."""
        f = default_grid(self.So) if f_hz is None else frequency_array("Gang", f_hz)
        return f, {name: _sizes(system, f) for name, system in self.members.items()}

    def peaks(self) -> dict[str, Peak]:
        """Return the largest gain of every member, exactly, with its frequency and directions."""
        return {name: peak_gain(system) for name, system in self.members.items()}


@takes_systems
def gang_of_four(plant: StateSpace, controller: StateSpace) -> dict[str, StateSpace]:
    """Return S, T, KS and GS of a loop at the plant's outputs.

    S = (I - G K)^-1, T = G K S = S - I, KS = K S, GS = S G, with u = K y.

    Args:
        plant: G.
        controller: K, its sign inside.

    Raises:
        InputError: shapes or rates that do not fit.

    S weighs disturbances at the sensors, GS those at the actuators, KS is what noise costs in command, T what an error
    of the plant's gain meets.

    >>> G = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=100.0)
    >>> four = gang_of_four(G, StateSpace([[0.0]], [[0.0]], [[0.0]], [[-0.5]], rate_hz=100.0))
    >>> {name: float(system.frequency_response([0.0])[0, 0, 0].real) for name, system in four.items()}
    {'S': 0.5, 'T': -0.5, 'KS': -0.25, 'GS': 1.0}

    Reference: Åström and Murray, Feedback Systems, 2nd ed., section 12.1.
    """
    six = gang_of_six(plant, controller)
    return {"S": six.So, "T": six.To, "KS": six.KSo, "GS": six.GSi}


@takes_systems
def gang_of_six(plant: StateSpace, controller: StateSpace, prefilter: StateSpace | None = None) -> Gang:
    """Return both sensitivities, both complementary ones, K So and G Si, and with a prefilter the way of a reference.

    Args:
        plant: G.
        controller: K, its sign inside.
        prefilter: F, what a reference adds to the commands: u = K y + F r.

    Raises:
        InputError: shapes or rates that do not fit, a loop that is not well posed.

    For several channels the inputs' side differs from the outputs': a loop that looks safe at its sensors may be on the
    verge at its actuators.

    >>> G = StateSpace([[0.5]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]], rate_hz=100.0)
    >>> six = gang_of_six(G, StateSpace([[0.0]], [[0.0]], [[0.0], [0.0]], [[-0.5], [0.0]], rate_hz=100.0))
    >>> six.So.D.shape, six.Si.D.shape, {name: round(peak.gain, 3) for name, peak in six.peaks().items()}["So"]
    ((1, 1), (2, 2), 1.5)

    Reference: Skogestad and Postlethwaite, Multivariable Feedback Control, 2nd ed., section 4.7.
    """
    ny, nu = plant.D.shape
    if controller.D.shape != (nu, ny):
        raise InputError(
            f"gang: the controller must take {ny} outputs and give {nu} commands, "
            f"got one from {controller.D.shape[1]} to {controller.D.shape[0]}."
        )
    unswapped("gang", controller, plant)
    P = _opened(plant)
    loop = lft(P, controller, measurements=ny, controls=nu)
    y, v, u = slice(0, ny), slice(ny, ny + nu), slice(ny + nu, ny + 2 * nu)
    at_y, at_u = slice(0, ny), slice(ny, ny + nu)
    Si, KSo, GSi, So = _part(loop, v, at_u), _part(loop, u, at_y), _part(loop, y, at_u), _part(loop, y, at_y)
    reference: dict[str, StateSpace] = {}
    if prefilter is not None:
        reference = _reference(GSi, Si, prefilter)
    To = StateSpace(So.A, So.B, So.C, So.D - np.eye(ny), So.rate_hz)
    return Gang(So, To, Si, _part(loop, u, at_u), KSo, GSi, reference, loop.is_stable())


def peak_gain(system: StateSpace) -> Peak:
    """Return the largest gain over frequency with its directions.

    Args:
        system: any; an unstable one has an infinite peak.

    >>> peak_gain(StateSpace([[-1.0]], [[1.0]], [[2.0]], [[0.0]])).gain_db.__round__(2)
    6.02
    """
    gain, f_hz = hinf_norm(system)
    none = np.zeros(0, dtype=np.complex128)
    if not np.isfinite(gain):
        return Peak(gain, f_hz, none, none)
    here = system.frequency_response([f_hz])[:, :, 0] if np.isfinite(f_hz) else system.D.astype(np.complex128)
    U, _, Vh = np.linalg.svd(here)
    return Peak(gain, f_hz, Vh[0].conj(), U[:, 0])


def _sizes(system: StateSpace, f: FloatArray) -> FloatArray:
    """Return singular values `(directions, nf)`, by modes: some hundred times faster than by triangular solves."""
    return principal_gains(response_at(system)(f))


def _opened(plant: StateSpace) -> StateSpace:
    """Return the system from (w at y, w at u, command) to (y, plant's input, command, y measured)."""
    ny, nu = plant.D.shape
    n, one = plant.states, np.eye(nu)
    B = np.hstack([np.zeros((n, ny)), plant.B, plant.B])
    C = np.vstack([plant.C, np.zeros((2 * nu, n)), plant.C])
    seen = np.hstack([np.eye(ny), plant.D, plant.D])
    driven = np.hstack([np.zeros((nu, ny)), one, one])
    command = np.hstack([np.zeros((nu, ny + nu)), one])
    return StateSpace(plant.A, B, C, np.vstack([seen, driven, command, seen]), plant.rate_hz)


def _part(loop: StateSpace, rows: slice, columns: slice) -> StateSpace:
    return StateSpace(loop.A, loop.B[:, columns], loop.C[rows], loop.D[rows, columns], loop.rate_hz)


def _reference(GSi: StateSpace, Si: StateSpace, prefilter: StateSpace) -> dict[str, StateSpace]:
    if prefilter.D.shape[0] != Si.D.shape[1]:
        raise InputError(
            f"gang: the prefilter must give {Si.D.shape[1]} commands, it gives {prefilter.D.shape[0]} signals."
        )
    return {"GSiF": series(prefilter, GSi), "SiF": series(prefilter, Si)}
