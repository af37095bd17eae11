"""The law as it will stand in the code: rounded coefficients, limits, ramp."""

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from ultraquiet._base.constraints import FloatArray, real_array, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import content_hash
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.law.realisation import DELTA_FORMS, turned
from ultraquiet.values.channel import Channel
from ultraquiet.values.joined.algebra import is_singular
from ultraquiet.values.state_space import StateSpace

Rounded = NDArray[Any]

# Targets that CMake keeps for itself; names that begin with `cmake` are its variables' too.
CMAKES_OWN = ("all", "clean", "edit_cache", "help", "install", "package", "package_source", "rebuild_cache", "test")
# Headers of C (ISO/IEC 9899:2024) and those that the C libraries' own include: a NAME.h on the path would hide them.
HEADERS = (
    "assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "iso646", "limits", "locale", "math",
    "setjmp", "signal", "stdalign", "stdarg", "stdatomic", "stdbit", "stdbool", "stdckdint", "stddef", "stdint",
    "stdio", "stdlib", "stdnoreturn", "string", "tgmath", "threads", "time", "uchar", "wchar", "wctype", "alloca",
    "endian", "features", "newlib", "strings", "xlocale",
)  # fmt: skip
# Four frames of 286 us: the ramp out begins before the slowest isolated mode has seen a tenth of its period.
OVERRUN_LIMIT = 4

DTYPES = {"float32": np.float32, "float64": np.float64}


@dataclass(frozen=True, eq=False)
class Law(Shown):
    """Everything the code is made of. Arrays have the code's own precision and are read-only.

    x+ = A x + B y + L (sat(u) - u), u = C x + D y, with A in blocks (A - I when `form` is `delta`); `L` is None without
    anti-windup. `limits` is `(nu, 2)`, low and high, and so is `excitation`, the range of what may be added to the
    command before them; the command is scaled by `level / ramp_steps` while it ramps. `overrun_limit` overruns in a row
    latch a fault.
    """

    name: str
    precision: str
    form: str
    blocks: tuple[Rounded, ...]
    B: Rounded
    C: Rounded
    D: Rounded
    L: Rounded | None
    limits: Rounded
    ramp_steps: int
    rate_hz: float
    order: int
    channels: tuple[int, ...] = ()
    turn_in: Rounded | None = None
    turn_out: Rounded | None = None
    excitation: Rounded = field(default_factory=lambda: np.zeros((0, 2)))
    overrun_limit: int = OVERRUN_LIMIT

    @property
    def inputs(self) -> int:
        """Number of measurements."""
        return (self.D if self.turn_in is None else self.turn_in).shape[1]

    @property
    def outputs(self) -> int:
        """Number of commands."""
        return (self.D if self.turn_out is None else self.turn_out).shape[0]

    @property
    def turned(self) -> bool:
        """True for a bank between transforms, u = S v, z = T y; B, C and D are then those between z and v."""
        return self.turn_in is not None

    @property
    def known_limits(self) -> FloatArray:
        """Low and high of each command as stated, `(nu, 2)`, infinite where nobody stated one."""
        limits = self.limits.astype(np.float64)
        return np.where(np.abs(limits) == open_end(self.precision), np.copysign(np.inf, limits), limits)

    @property
    def states(self) -> int:
        """Number of stored states, padding included."""
        return self.B.shape[0]

    @property
    def delta(self) -> bool:
        """True when the blocks hold A - I."""
        return self.form in DELTA_FORMS

    @property
    def dtype(self) -> type[np.floating[Any]]:
        """NumPy type of the code's numbers."""
        return DTYPES[self.precision]

    @property
    def coefficients(self) -> int:
        """Number of stored constants."""
        anti_windup = 0 if self.L is None else self.L.size
        gains = self.B.size + self.C.size + self.D.size
        if self.channels:
            gains = 2 * self.states + len(self.channels)
            gains += sum(T.size for T in (self.turn_in, self.turn_out) if T is not None)
            anti_windup = self.states if anti_windup and not self.turned else anti_windup
        ranges = self.limits.size + self.excitation.size
        return sum(b.size for b in self.blocks) + gains + anti_windup + ranges

    @property
    def held_numbers(self) -> int:
        """Number of reals in one instance of the code: states, measurements, commands at each stage."""
        return self.states + self.inputs + (4 if self.L is None else 5) * self.outputs

    @property
    def hash(self) -> str:
        """SHA-256 of every rounded coefficient and setting."""
        L = np.zeros(0) if self.L is None else self.L
        settings = [
            self.precision,
            self.form,
            self.ramp_steps,
            self.rate_hz,
            self.order,
            self.overrun_limit,
            *self.channels,
        ]
        turns = [T for T in (self.turn_in, self.turn_out) if T is not None]
        return content_hash(*self.blocks, self.B, self.C, self.D, L, self.limits, self.excitation, *turns, settings)

    def state_space(self) -> StateSpace:
        """Return the linear law with its rounded coefficients, for an analysis in float64."""
        A = np.asarray(block_diag(*[b.astype(np.float64) for b in self.blocks]))
        if self.delta:
            A = A + np.eye(self.states)
        return turned(A, self.B, self.C, self.D, self.turn_in, self.turn_out, self.rate_hz)


def open_end(precision: str) -> float:
    """Return the limit that stands where none is known: the root of the type's largest number, 2^64 or 2^512.

    No actuator comes near it, and the arithmetic around it does not overflow: the self-test still goes there, so that
    no guard is left without its proof.

    >>> open_end("float32") == 2.0**64
    True
    """
    return float(2.0 ** (np.finfo(DTYPES[precision]).maxexp // 2))


def own_limits(controller: StateSpace) -> FloatArray:
    """Return the limits of a law's commands as its channels have them, `(nu, 2)`; infinite where they have none.

    Raises:
        InputError: a range without zero, where every ramp ends.

    >>> own_limits(StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=10.0)).tolist()
    [[-inf, inf]]
    """
    own = np.array([[wire.low, wire.high] for wire in controller.sensors], dtype=np.float64)
    require_zero(own, "the channels of the law")
    return own


def actuator_limits(limits_v: ArrayLike, outputs: int, what: str = "limits_v") -> FloatArray:
    """Return limits as `(nu, 2)` from one number, one per actuator (both symmetric), or a low and a high for each.

    >>> actuator_limits(25.0, 2).tolist()
    [[-25.0, 25.0], [-25.0, 25.0]]
    """
    try:
        values = np.asarray(limits_v, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"deploy: '{what}' must be numbers in the unit of the commands, got {limits_v!r} ({error})."
        ) from None
    if values.ndim < 2:
        size = real_array("deploy", what, np.broadcast_to(values, (outputs,)) if values.size == 1 else values, 1)
        values = np.stack([-size, size], axis=1)
    limits = real_array("deploy", what, values, 2)
    if limits.shape != (outputs, 2):
        raise InputError(f"deploy: '{what}' must be one number, ({outputs},) or ({outputs}, 2), got {limits.shape}.")
    require_zero(limits, f"'{what}'")
    return limits


def within(wire: Channel, low: float, high: float) -> str:
    """Return a channel with the range that the code keeps it in.

    >>> within(Channel("coil", "N"), -3.0, 4.0), within(Channel("coil", "N"), -np.inf, 4.0)
    ('coil -3 to 4 N', 'coil (N), limited above at 4 only')
    """
    if np.isfinite([low, high]).all():
        return f"{wire.name} {low:g} to {high:g} {wire.unit}".rstrip()
    ends = [f"{word} {end:g} only" for word, end in (("below at", low), ("above at", high)) if np.isfinite(end)]
    return f"{wire.label}, {'not limited' if not ends else f'limited {ends[0]}'}"


def require_zero(limits: FloatArray, where: str) -> None:
    """Refuse ranges, `(nu, 2)`, that are empty or do not hold zero.

    Raises:
        InputError: with all of them.
    """
    if np.any(limits[:, 0] > 0) or np.any(limits[:, 1] < 0) or np.any(limits[:, 0] >= limits[:, 1]):
        raise InputError(
            f"deploy: each actuator's range in {where} must hold 0, where the ramp ends, got {limits.tolist()}."
        )


def require_discrete(controller: StateSpace, name: str) -> None:
    """Refuse what no code can be generated for: no discrete law with measurements and commands, or no C name.

    Raises:
        InputError: the first of these that fails.
    """
    if not isinstance(controller, StateSpace):
        raise InputError(f"deploy: 'controller' must be a StateSpace, got {type(controller).__name__}.")
    if controller.rate_hz is None:
        raise InputError("deploy: the controller is in continuous time; discretise it at the bench's rate first.")
    if 0 in controller.D.shape:
        raise InputError(f"deploy: a controller needs measurements and commands, got D of shape {controller.D.shape}.")
    if not isinstance(name, str) or not re.fullmatch(r"[a-z][a-z0-9_]{0,30}", name):
        raise InputError(f"deploy: 'name' must be a C identifier of small letters, digits and _, got {name!r}.")
    if name in CMAKES_OWN or name.startswith("cmake"):
        raise InputError(f"deploy: 'name' {name!r} is one that CMake keeps for itself; take another.")
    if name in HEADERS:
        raise InputError(f"deploy: 'name' {name!r} would hide the header <{name}.h> of C; take another.")


def require_plant(plant: StateSpace | None) -> None:
    """Refuse a plant that is no state space.

    Raises:
        InputError: with its type.
    """
    if plant is not None and not isinstance(plant, StateSpace):
        raise InputError(f"deploy: 'plant' must be a StateSpace, got {type(plant).__name__}.")


def loop_coupling(plant: StateSpace, controller: StateSpace) -> FloatArray:
    """Return (I - D_G D_K)^-1, by which the readings of the loop y = G u + d, u = K y answer at once, `(ny, ny)`.

    Raises:
        InputError: another rate, sizes that do not fit, an ill-posed loop.
    """
    same_rate("deploy", "the controller", controller.rate_hz, "the plant", plant.rate_hz)
    if plant.D.shape != controller.D.T.shape:
        raise InputError(
            f"deploy: a plant {plant.D.shape} does not close a loop with a controller {controller.D.shape}."
        )
    at_once = np.eye(plant.D.shape[0]) - plant.D @ controller.D
    if is_singular(at_once, plant.D, controller.D):
        raise InputError("deploy: the loop with this plant is ill-posed, I - D_G D_K is singular.")
    return np.asarray(np.linalg.inv(at_once), dtype=np.float64)


def require_floating(who: str, made: object) -> None:
    """Refuse what is no deployment of a floating-point law, such as whole-number code.

    Raises:
        InputError: with what was given.
    """
    if not isinstance(getattr(made, "law", None), Law):
        raise InputError(f"{who}: needs what `generate` returned, got {type(made).__name__}.")
