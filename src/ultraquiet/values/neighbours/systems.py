"""Linear systems for python-control, SciPy, pandas and xarray."""

from collections.abc import Callable, Sequence
from typing import Any, Self, cast

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.values.channel import Channel
from ultraquiet.values.neighbours.labels import FIELDS, channels_from, channels_of, labels, needed, rows

Names = Sequence[Channel | str] | None


class SystemNeighbours:
    """x' = A x + B u, y = C x + D u in other packages' objects; matrices keep every bit."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    rate_hz: float | None
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]

    def to_control(self) -> Any:
        """Return a python-control `StateSpace`, its labels `name [unit]` (needs the package `control`).

        Limits of channels have no place there.
        """
        step_s = 0 if self.rate_hz is None else 1.0 / self.rate_hz
        ends = {"inputs": labels(self.actuators), "outputs": labels(self.sensors)}
        return needed("control").ss(self.A, self.B, self.C, self.D, step_s, **ends)

    @classmethod
    def from_control(cls, system: Any) -> Self:
        """Return a python-control system; transfer functions are realised by python-control.

        Labels become names, what stands in brackets behind them the unit; labels of python-control's own (`u[0]`)
        become numbered channels.

        Raises:
            InputError: a discrete system without a sampling time; a transfer function that has no state-space form or
                that python-control cannot realise.
        """
        if not hasattr(system, "A"):
            ss = needed("control").ss
            system = _realised("StateSpace.from_control", lambda: ss(system))
        if system.dt is True:
            raise InputError("StateSpace.from_control: the system is discrete without a sampling time; give it a dt.")
        ends = (_own(system.input_labels, "u"), _own(system.output_labels, "y"))
        return _made(cls, system, rate_of(system.dt) if system.dt else None, *ends)

    def to_scipy(self) -> Any:
        """Return a `scipy.signal.StateSpace`; `actuators` and `sensors`, added to it here, hold the channels."""
        signal = needed("scipy.signal")
        matrices = (self.A, self.B, self.C, self.D)
        step: dict[str, float] = {} if self.rate_hz is None else {"dt": 1.0 / self.rate_hz}
        system = signal.StateSpace(*matrices, **step)
        system.actuators, system.sensors = self.actuators, self.sensors
        return system

    @classmethod
    def from_scipy(cls, system: Any, actuators: Names = None, sensors: Names = None) -> Self:
        """Return a system of `scipy.signal` in any of its forms.

        Args:
            system: `lti` or `dlti`: state space, transfer function, zeros and poles.
            actuators: channels or names of the inputs; those that `to_scipy` left with the object when absent.
            sensors: likewise of the outputs.

        Raises:
            InputError: a discrete system without a sampling time; a transfer function that has no state-space form.
        """
        form = system if hasattr(system, "A") else _realised("StateSpace.from_scipy", system.to_ss)
        if form.dt is True:
            raise InputError("StateSpace.from_scipy: the system is discrete without a sampling time; give it a dt.")
        ends = (
            given if given is not None else getattr(system, name, None)
            for name, given in (("actuators", actuators), ("sensors", sensors))
        )
        return _made(cls, form, rate_of(form.dt) if form.dt else None, *ends)

    def to_pandas(self) -> Any:
        """Return the matrix [[A, B], [C, D]] as a table: rows are states and outputs, columns states and inputs.

        Both are labelled with role, name, unit and limits; `attrs["rate_hz"]` holds the rate (needs `pandas`).
        """
        pd = needed("pandas")
        states = [("state", f"x{k + 1}", "", -np.inf, np.inf) for k in range(self.A.shape[0])]
        names = ["role", *FIELDS]
        index, columns = (
            pd.MultiIndex.from_tuples([*states, *((role, *row) for row in rows(wires))], names=names)
            for role, wires in (("output", self.sensors), ("input", self.actuators))
        )
        table = pd.DataFrame(np.block([[self.A, self.B], [self.C, self.D]]), index, columns)
        table.attrs["rate_hz"] = self.rate_hz
        return table

    @classmethod
    def from_pandas(cls, table: Any, rate_hz: float | None = None) -> Self:
        """Return the system of such a table; `rate_hz` where `attrs` no longer says it.

        Raises:
            InputError: rows or columns that are not labelled as `to_pandas` does.
        """
        if not {"role", *FIELDS} <= set(table.index.names) & set(table.columns.names):
            raise InputError(
                "StateSpace.from_pandas: rows and columns must be labelled with role, name, unit and limits."
            )
        n = int(np.count_nonzero(table.index.get_level_values("role") == "state"))
        whole = table.to_numpy(dtype=np.float64)
        sensors, actuators = (
            channels_from(tuple(each)[1:] for each in axis.tolist()[n:]) for axis in (table.index, table.columns)
        )
        rate = rate_hz if rate_hz is not None else table.attrs.get("rate_hz")
        A, B, C, D = whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:]
        return cast("Self", cast("Any", cls)(A, B, C, D, rate, actuators, sensors))

    def to_xarray(self) -> Any:
        """Return a Dataset of A, B, C, D over `state`, `input` and `output`, with units and limits (needs `xarray`)."""
        dims = {"A": ("state", "state_"), "B": ("state", "input"), "C": ("output", "state"), "D": ("output", "input")}
        # A's two axes need two names there; both count the same states.
        values = {key: (dims[key], getattr(self, key)) for key in "ABCD"}
        attrs = {} if self.rate_hz is None else {"rate_hz": self.rate_hz}
        return needed("xarray").Dataset(values, wire_coords(self.actuators, self.sensors), attrs)

    @classmethod
    def from_xarray(cls, data: Any) -> Self:
        """Return the system of such a Dataset."""
        ends = (wires_of(data, "input"), wires_of(data, "output"))
        matrices = (data[key].to_numpy() for key in "ABCD")
        return cast("Self", cast("Any", cls)(*matrices, data.attrs.get("rate_hz"), *ends))


def _realised(who: str, realise: Callable[[], Any]) -> Any:
    """Return what another package makes of a transfer function, its refusals as `InputError`.

    Some of several channels are realised by python-control with the help of Slycot alone. Entry by entry would double
    what they share, and a mode that is doubled is one that no law reaches.
    """
    try:
        return realise()
    except (ValueError, NotImplementedError) as why:
        raise InputError(f"{who}: the transfer function has no state-space form here: {why}.") from why


def wire_coords(actuators: Sequence[Channel], sensors: Sequence[Channel]) -> dict[str, Any]:
    """Return coordinates for xarray: names along `input` and `output`, units and limits beside them."""
    coords: dict[str, Any] = {}
    for axis, wires in (("input", actuators), ("output", sensors)):
        coords[axis] = [c.name for c in wires]
        coords.update({f"{axis}_{field}": (axis, [getattr(c, field) for c in wires]) for field in FIELDS[1:]})
    return coords


def wires_of(data: Any, axis: str) -> list[Channel]:
    """Return the channels that stand along an axis of a Dataset; units and limits only where they are said."""
    n = data.sizes[axis]
    names = data[axis].to_numpy() if axis in data.coords else [f"{axis} {k + 1}" for k in range(n)]
    usual = {"unit": "", "low": -np.inf, "high": np.inf}
    columns = [
        data[f"{axis}_{field}"].to_numpy() if f"{axis}_{field}" in data.coords else [value] * n
        for field, value in usual.items()
    ]
    return channels_from(zip(names, *columns, strict=True))


def rate_of(step_s: float) -> float:
    """Return the rate of a sampling time: the round number it came from, when there is one."""
    rate_hz = 1.0 / step_s
    near = float(f"{rate_hz:.12g}")
    return near if 1.0 / near == step_s else rate_hz


def _own(texts: Sequence[str], prefix: str) -> list[Channel] | None:
    """Return channels from labels, none where python-control made them up."""
    made_up = all(text == f"{prefix}[{k}]" for k, text in enumerate(texts))
    return None if made_up else channels_of(texts)


def _made(cls: Any, system: Any, rate_hz: float | None, actuators: Any, sensors: Any) -> Any:
    return cls(system.A, system.B, system.C, system.D, rate_hz, actuators, sensors)
