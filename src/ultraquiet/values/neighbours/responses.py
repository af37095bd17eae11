"""Frequency responses for python-control, pandas and xarray."""

from typing import Any, Self, cast

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet.values.channel import Channel
from ultraquiet.values.neighbours.labels import FIELDS, channels_from, channels_of, labels, needed, rows
from ultraquiet.values.neighbours.systems import wire_coords, wires_of

QUALITIES = ("values", "coherence", "variance")
LEVELS = ("quantity", *(f"{end}_{field}" for end in ("output", "input") for field in FIELDS))


class ResponseNeighbours:
    """Complex gains over frequency in other packages' objects."""

    f_hz: FloatArray
    values: ComplexArray
    coherence: FloatArray | None
    variance: FloatArray | None
    estimator: str
    actuators: tuple[Channel, ...]
    sensors: tuple[Channel, ...]

    def to_control(self) -> Any:
        """Return a python-control `FrequencyResponseData` over rad/s, its labels `name [unit]` (needs `control`).

        Coherence, variance and limits have no place there.
        """
        ends = {"inputs": labels(self.actuators), "outputs": labels(self.sensors)}
        return needed("control").frd(self.values, 2.0 * np.pi * self.f_hz, **ends)

    @classmethod
    def from_control(cls, response: Any) -> Self:
        """Return python-control's frequency response data."""
        f_hz = np.asarray(response.omega, dtype=np.float64) / (2.0 * np.pi)
        values = response.frdata if hasattr(response, "frdata") else response.fresp
        ends = (channels_of(response.input_labels), channels_of(response.output_labels))
        return cast("Self", cast("Any", cls)(f_hz, values, None, "python-control", *ends))

    def to_pandas(self) -> Any:
        """Return a table over `f_hz`, a column for each quantity of each element (needs `pandas`)."""
        pd = needed("pandas")
        columns: list[tuple[Any, ...]] = []
        data: list[Any] = []
        for quantity in QUALITIES:
            if (held := getattr(self, quantity)) is None:
                continue
            for i, y in enumerate(rows(self.sensors)):
                for j, u in enumerate(rows(self.actuators)):
                    columns.append((quantity, *y, *u))
                    data.append(pd.Series(held[i, j]))
        table = pd.concat(data, axis=1) if data else pd.DataFrame()
        table.columns = pd.MultiIndex.from_tuples(columns, names=LEVELS)
        table.index = pd.Index(self.f_hz, name="f_hz")
        table.attrs["estimator"] = self.estimator
        return table

    @classmethod
    def from_pandas(cls, table: Any) -> Self:
        """Return the response of such a table.

        Raises:
            InputError: columns that are not labelled as `to_pandas` does.
        """
        if tuple(table.columns.names) != LEVELS:
            raise InputError(f"FrequencyResponse.from_pandas: columns must be labelled {', '.join(LEVELS)}.")
        keys = [tuple(each) for each in table.columns.tolist()]
        of_values = [key for key in keys if key[0] == "values"]
        n = len(FIELDS)
        outputs = list(dict.fromkeys(key[1 : 1 + n] for key in of_values))
        inputs = list(dict.fromkeys(key[1 + n :] for key in of_values))
        shape = (len(outputs), len(inputs), len(table.index))
        if len(of_values) != shape[0] * shape[1]:
            raise InputError("FrequencyResponse.from_pandas: channels of one name and unit cannot be told apart.")
        parts: dict[str, Any] = dict.fromkeys(QUALITIES)
        for quantity in QUALITIES:
            held = [k for k, key in enumerate(keys) if key[0] == quantity]
            if held:
                parts[quantity] = np.stack([table.iloc[:, k].to_numpy() for k in held]).reshape(shape)
        ends = (channels_from(inputs), channels_from(outputs))
        estimator = str(table.attrs.get("estimator", ""))
        made = cast("Any", cls)(
            table.index.to_numpy(), parts["values"], parts["coherence"], estimator, *ends, variance=parts["variance"]
        )
        return cast("Self", made)

    def to_xarray(self) -> Any:
        """Return a Dataset over `output`, `input` and `f_hz`, with units and limits (needs `xarray`)."""
        held = {key: getattr(self, key) for key in QUALITIES}
        # "values" is a method of a Dataset
        data = {
            "response" if key == "values" else key: (("output", "input", "f_hz"), each)
            for key, each in held.items()
            if each is not None
        }
        coords = {**wire_coords(self.actuators, self.sensors), "f_hz": self.f_hz}
        return needed("xarray").Dataset(data, coords, {"estimator": self.estimator})

    @classmethod
    def from_xarray(cls, data: Any) -> Self:
        """Return the response of such a Dataset."""
        ordered = data.transpose("output", "input", "f_hz", ...)
        coherence, variance = (ordered[key].to_numpy() if key in ordered else None for key in QUALITIES[1:])
        ends = (wires_of(data, "input"), wires_of(data, "output"))
        f_hz, values = ordered["f_hz"].to_numpy(), ordered["response"].to_numpy()
        estimator = str(data.attrs.get("estimator", ""))
        return cast("Self", cast("Any", cls)(f_hz, values, coherence, estimator, *ends, variance=variance))
