"""Which channels of a transfer matrix are one function, or have the same poles: symmetry as a table of labels."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.errors import InputError
from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
from ultraquiet.identify.prediction_error.structure import ROW_A, ROW_C, ROW_D, IntArray, b_rows, f_rows
from ultraquiet.values import Channel

NAMES = ("threefold", "rotation", "symmetric", "poles", "poles-by-input", "poles-by-output", "noise")
STRUTS = 6


@dataclass(frozen=True, eq=False)
class Ties:
    """Ties between the channels of a matrix.

    Attributes:
        functions: `(ny, nu)` labels; channels of one label have the same B and F.
        poles: `(ny, nu)` labels; channels of one label have the same F.
        noise: whether all outputs have the same C and D.
    """

    functions: IntArray
    poles: IntArray
    noise: bool

    @classmethod
    def of(cls, ties: "str | Sequence[str] | ArrayLike | None", outputs: int, inputs: int) -> "Ties":
        """Return the ties that names or a table of labels ask for; see `identify_joint`."""
        names, functions = _read(ties, outputs, inputs)
        tied = _Ties(functions)
        for name in names:
            if name == "symmetric":
                _square(name, outputs, inputs)
                tied.join(functions.T)
            elif name in ("threefold", "rotation"):
                _square(name, outputs, inputs, STRUTS)
                turned = np.roll(np.roll(functions, 2, axis=0), 2, axis=1)
                tied.join(turned)
                if name == "threefold":
                    mirror = (1 - np.arange(STRUTS)) % STRUTS
                    tied.join(functions[np.ix_(mirror, mirror)])
        labels = tied.labels()
        poles = _Ties(labels)
        grid = np.arange(outputs)[:, None], np.arange(inputs)[None, :]
        for name, same in (
            ("poles", np.zeros((outputs, inputs))),
            ("poles-by-output", grid[0] + 0 * grid[1]),
            ("poles-by-input", grid[1] + 0 * grid[0]),
        ):
            if name in names:
                poles.tie(same)
        return cls(labels, poles.labels(), "noise" in names)

    def keys(self, output: int, inputs: Sequence[int], parameterisation: Parameterisation) -> tuple[Hashable, ...]:
        """Return the key of each row of the table of an output driven by the given inputs."""
        own = (output, *inputs)
        out: list[Hashable] = [None] * parameterisation.rows
        out[ROW_C], out[ROW_D] = ("c", () if self.noise else own), ("d", () if self.noise else own)
        labels = {int(self.poles[output, j]) for j in inputs}
        out[ROW_A] = ("a", labels.pop()) if len(labels) == 1 else ("a", own)
        for j, b, f in zip(inputs, b_rows(parameterisation.inputs), f_rows(parameterisation.inputs), strict=True):
            out[b], out[f] = ("b", int(self.functions[output, j])), ("f", int(self.poles[output, j]))
        return tuple(out)

    def check(self, who: str, sensors: Sequence[Channel], actuators: Sequence[Channel]) -> None:
        """Refuse ties between channels that are read or driven in different units."""
        for label in np.unique(self.functions):
            places = np.argwhere(self.functions == label)
            for wires, axis, kind in ((sensors, 0, "sensor"), (actuators, 1, "actuator")):
                units = {wires[p[axis]].unit: wires[p[axis]].name for p in places}
                if len(units) > 1:
                    (u, first), (v, second) = list(units.items())[:2]
                    raise InputError(
                        f"{who}: {kind}s '{first}' in '{u}' and '{second}' in '{v}' cannot share a transfer function; "
                        f"convert them to one unit, or leave them out of the tie."
                    )


class _Ties:
    """Classes of equal channels that grow as relations are added."""

    def __init__(self, labels: IntArray) -> None:
        self._held = labels.copy()

    def join(self, other: IntArray) -> None:
        """Make one class of every channel and the one that stands in its place in `other` (a rearrangement)."""
        for a, b in zip(self._start.ravel(), other.ravel(), strict=True):
            self._one(int(a), int(b))

    def tie(self, same: Any) -> None:
        """Make one class of the channels with equal numbers."""
        for value in np.unique(same):
            members = self._start[same == value]
            for b in members[1:]:
                self._one(int(members[0]), int(b))

    @property
    def _start(self) -> IntArray:
        if not hasattr(self, "_first"):
            self._first = self._held.copy()
        return self._first

    def _one(self, a: int, b: int) -> None:
        x, y = self._held[self._start == a][0], self._held[self._start == b][0]
        self._held[self._held == y] = x

    def labels(self) -> IntArray:
        """Return the classes, numbered from zero in the order of their first channels."""
        _, first, back = np.unique(self._held.ravel(), return_index=True, return_inverse=True)
        rank = np.argsort(np.argsort(first))
        return rank[back].reshape(self._held.shape).astype(np.int64)


def same(who: str, ties: Any, share: Any) -> Any:
    """Return the ties under whichever of their two names they were given; `share` is the older one."""
    if ties is not None and share is not None:
        raise InputError(f"{who}: 'share' is the older name of 'ties'; give one of them.")
    return share if ties is None else ties


def _read(ties: Any, outputs: int, inputs: int) -> tuple[tuple[str, ...], IntArray]:
    """Return the names and the table of labels that were given."""
    free = np.arange(outputs * inputs, dtype=np.int64).reshape(outputs, inputs)
    if ties is None:
        return (), free
    names = (ties,) if isinstance(ties, str) else tuple(ties)
    if names and all(isinstance(name, str) for name in names):
        for name in names:
            if name not in NAMES:
                raise InputError(f"ties: '{name}' is unknown; known are {', '.join(NAMES)}, or a table of labels.")
        return names, free
    labels = np.asarray(ties)
    if labels.shape != (outputs, inputs) or not np.issubdtype(labels.dtype, np.integer):
        raise InputError(
            f"ties: labels must be whole numbers, one per channel, ({outputs}, {inputs}); got {labels.dtype} of shape "
            f"{labels.shape}."
        )
    return (), labels.astype(np.int64)


def _square(name: str, outputs: int, inputs: int, wanted: int | None = None) -> None:
    if outputs != inputs or (wanted is not None and outputs != wanted):
        size = f"{wanted} x {wanted}" if wanted else "square"
        raise InputError(f"ties: '{name}' needs a {size} matrix of channels, got {outputs} x {inputs}.")
