"""Figures on their way to the browser: one binary frame each, its arrays as float32 behind its specification."""

import json
from collections import OrderedDict
from threading import Lock
from typing import Any

import numpy as np

from ultraquiet.chart.packing import Packing
from ultraquiet.chart.spec import Chart, ChartPanel, Scene

KEPT = 400
BYTES = 4  # of a float32, at whose multiples the browser's arrays must begin


class _Arrays(Packing):
    """A packing whose arrays stay bytes."""

    def __init__(self) -> None:
        super().__init__()
        self.raw: list[bytes] = []

    def name_of(self, values: Any) -> str:
        """Return the name under which the frame holds an array."""
        raw = np.ascontiguousarray(np.ravel(values), dtype="<f4").tobytes()
        name = self._names.get(raw)
        if name is None:
            name = self._names[raw] = f"f{len(self.raw)}"
            self.raw.append(raw)
        return name


def packed(figure: Chart | ChartPanel | Scene) -> bytes:
    """Return a figure as a frame: the length of its head, the head (JSON), the arrays one after the other.

    The head holds `spec`, and `arrays`: name and number of values of each. It is padded so that arrays are aligned.
    """
    arrays = _Arrays()
    spec = arrays.spec(figure)
    table = [[f"f{k}", len(raw) // BYTES] for k, raw in enumerate(arrays.raw)]
    head = json.dumps({"spec": spec, "arrays": table}).encode()
    head += b" " * (-len(head) % BYTES)
    return b"".join([len(head).to_bytes(BYTES, "little"), head, *arrays.raw])


class FrameStore:
    """The frames that pages may fetch, the latest kept."""

    def __init__(self) -> None:
        self._kept: OrderedDict[str, bytes] = OrderedDict()
        self._lock, self._count = Lock(), 0

    def put(self, frame: bytes) -> str:
        """Keep a frame and return its name."""
        with self._lock:
            self._count += 1
            name = f"{self._count:x}"
            self._kept[name] = frame
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return name

    def get(self, name: str) -> bytes | None:
        """Return a frame; None when it is no longer kept."""
        return self._kept.get(name)
