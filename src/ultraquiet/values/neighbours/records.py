"""Records for pandas and xarray."""

from typing import Any, Self, cast

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.values.channel import Channel
from ultraquiet.values.neighbours.labels import FIELDS, channels_from, needed, rows
from ultraquiet.values.neighbours.systems import wire_coords, wires_of

LEVELS = ("role", *FIELDS)
UNEVEN = 1e-6  # of a step: how far a clock may stray from an even one and be called it


class RecordNeighbours:
    """Samples on one clock in other packages' tables; every bit of the samples is kept."""

    inputs: FloatArray
    outputs: FloatArray
    rate_hz: float
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]

    def to_pandas(self) -> Any:
        """Return a table over `time_s`, columns labelled with role, name, unit and limits (needs `pandas`)."""
        pd = needed("pandas")
        sides = (("input", self.actuators), ("output", self.sensors))
        columns = [(role, *row) for role, wires in sides for row in rows(wires)]
        time = pd.Index(np.arange(self.inputs.shape[1]) / self.rate_hz, name="time_s")
        samples = np.vstack([self.inputs, self.outputs]).T
        table = pd.DataFrame(samples, time, pd.MultiIndex.from_tuples(columns, names=LEVELS))
        table.attrs["rate_hz"] = self.rate_hz
        return table

    @classmethod
    def from_pandas(cls, table: Any, rate_hz: float | None = None, inputs: Any = None, outputs: Any = None) -> Self:
        """Return the record of a table.

        Args:
            table: as `to_pandas` makes it, or any with a column a channel.
            rate_hz: samples per second, when neither `attrs` nor the index (seconds, even) says it.
            inputs: labels of the columns that go in, of a table that is not labelled as `to_pandas` does.
            outputs: likewise of those that come out.

        Raises:
            InputError: no telling what goes in and what comes out, or no rate.
        """
        rate = _rate(table, rate_hz)
        if tuple(table.columns.names) == LEVELS:
            keys = [tuple(each) for each in table.columns.tolist()]
            samples = table.to_numpy(dtype=np.float64).T
            sides = [[k for k, key in enumerate(keys) if key[0] == role] for role in ("input", "output")]
            ends = [channels_from(keys[k][1:] for k in side) for side in sides]
            return cast("Self", cast("Any", cls)(samples[sides[0]], samples[sides[1]], rate, *ends))
        if inputs is None or outputs is None:
            raise InputError("Record.from_pandas: say which columns are 'inputs' and which are 'outputs'.")
        u, y = ([chosen] if isinstance(chosen, str) else list(chosen) for chosen in (inputs, outputs))
        if missing := [each for each in (*u, *y) if each not in table.columns]:
            known = ", ".join(map(str, table.columns))
            raise InputError(f"Record.from_pandas: there is no column {missing[0]!r}; there are {known}.")
        sides = (table[each].to_numpy(dtype=np.float64).T for each in (u, y))
        names = ([Channel(str(each), "") for each in side] for side in (u, y))
        return cast("Self", cast("Any", cls)(*sides, rate, *names))

    def to_xarray(self) -> Any:
        """Return a Dataset of `inputs` and `outputs` over channel and `time_s`, units too (needs `xarray`)."""
        data = {"inputs": (("input", "time_s"), self.inputs), "outputs": (("output", "time_s"), self.outputs)}
        coords: dict[str, Any] = {
            **wire_coords(self.actuators, self.sensors),
            "time_s": np.arange(self.inputs.shape[1]) / self.rate_hz,
        }
        return needed("xarray").Dataset(data, coords, {"rate_hz": self.rate_hz})

    @classmethod
    def from_xarray(cls, data: Any) -> Self:
        """Return the record of such a Dataset."""
        u, y = (data[f"{axis}s"].transpose(axis, "time_s").to_numpy() for axis in ("input", "output"))
        rate = data.attrs.get("rate_hz") or _even(data["time_s"].to_numpy(), "from_xarray")
        return cast("Self", cast("Any", cls)(u, y, rate, wires_of(data, "input"), wires_of(data, "output")))


def _rate(table: Any, rate_hz: float | None) -> float:
    return float(rate_hz or table.attrs.get("rate_hz") or _even(table.index.to_numpy(), "from_pandas"))


def _even(time_s: Any, who: str) -> float:
    """Return the rate of an even clock in seconds."""
    if time_s.size > 1 and time_s.dtype.kind == "f":
        step = float(time_s[-1] - time_s[0]) / (time_s.size - 1)
        if step > 0 and np.abs(np.diff(time_s) - step).max() <= UNEVEN * step:
            return float(f"{1.0 / step:.12g}")
    raise InputError(f"Record.{who}: the time is not an even clock in seconds; give a 'rate_hz'.")
