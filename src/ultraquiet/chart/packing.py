"""From figures to the JSON that the script draws: every array once, as float32."""

import base64
import hashlib
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.errors import InputError
from ultraquiet.chart.spec import Chart, ChartPanel, Curve, HeatMap, MovingShape, Scene

ARRAYS = ("x", "y", "low", "high")


class Packing:
    """The arrays of a page by name, each once however many curves show it; `data` is what `Uq.data` takes.

    >>> packing = Packing()
    >>> packing.name_of([1.0, 2.0]) == packing.name_of([1.0, 2.0])
    True
    >>> packing.data
    {'a0': 'AACAPwAAAEA='}
    """

    def __init__(self) -> None:
        self.data: dict[str, str] = {}
        self._names: dict[bytes, str] = {}

    def name_of(self, values: ArrayLike) -> str:
        """Return the name under which the page holds an array."""
        raw = np.ascontiguousarray(np.ravel(values), dtype="<f4").tobytes()
        key = hashlib.sha256(raw).digest()
        if key not in self._names:
            self._names[key] = f"a{len(self._names)}"
            self.data[self._names[key]] = base64.b64encode(raw).decode()
        return self._names[key]

    def spec(self, figure: Chart | ChartPanel | Scene) -> dict[str, Any]:
        """Return a figure as JSON's types, its arrays by name.

        Raises:
            InputError: a curve's arrays differ in length.
        """
        return self._plain(figure)

    def whole(self, figure: Chart | ChartPanel) -> dict[str, Any]:
        """Return a figure as JSON's types with all of this packing's arrays in it, for a page that draws it alone."""
        return {**self.spec(figure), "data": dict(self.data)}

    def _plain(self, value: Any) -> Any:
        if isinstance(value, Curve):
            return self._curve(value)
        if isinstance(value, HeatMap | MovingShape | Scene):
            return self._shown(value)
        if is_dataclass(value):
            plain = {f.name: self._plain(getattr(value, f.name)) for f in fields(value)}
            unset = {f.name for f in fields(value) if f.default == 0}  # where zero says nothing; a mark may stand at it
            kept = {k: v for k, v in plain.items() if v is not None and v is not False and v not in ("", [])}
            return {k: v for k, v in kept.items() if v != 0 or k not in unset}
        if isinstance(value, list | tuple):
            return [self._plain(each) for each in value]
        return value.item() if isinstance(value, np.generic) else value

    def _shown(self, shown: HeatMap | MovingShape | Scene) -> dict[str, Any]:
        """Return what is no curve, its arrays by name."""
        if isinstance(shown, MovingShape):
            return {"name": shown.name, "re": self.name_of(shown.re), "im": self.name_of(shown.im)}
        if isinstance(shown, Scene):
            shapes = [self._shown(shape) for shape in shown.shapes]
            lines = [[int(a), int(b)] for a, b in shown.lines]
            said = {"name": shown.name, "title": shown.title, "caption": shown.caption}
            return {**said, "points": self.name_of(shown.points), "lines": lines, "shapes": shapes}
        nx, ny, nz = (np.size(part) for part in (shown.x, shown.y, shown.z))
        if nx * ny != nz:
            raise InputError(f"map {shown.name!r}: x {nx} times y {ny} values are needed, got {nz}.")
        arrays = {key: self.name_of(getattr(shown, key)) for key in ("x", "y", "z")}
        return {"name": shown.name, "range": list(shown.range), **arrays}

    def _curve(self, curve: Curve) -> dict[str, Any]:
        sizes = {key: np.size(part) for key in ARRAYS if (part := getattr(curve, key)) is not None}
        if len(set(sizes.values())) > 1:
            words = ", ".join(f"{key} {n}" for key, n in sizes.items())
            raise InputError(f"curve {curve.name!r}: its arrays must have one length, got {words}.")
        arrays = {key: self.name_of(getattr(curve, key)) for key in sizes}
        names = (f.name for f in fields(curve) if f.name not in ARRAYS)
        words = {name: value for name in names if (value := getattr(curve, name))}
        return {**words, **arrays}
