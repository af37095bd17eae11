"""SLICOT's examples as printed: inputs from `.dat`, results from `.res` (see data/README.md)."""

import re
from pathlib import Path

import numpy as np

from ultraquiet.values import StateSpace

SLICOT = Path(__file__).parent / "data" / "slicot"
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[DEe][-+]?\d+)?$")


def numbers(text):
    """Return every number of a text, Fortran's D exponents included."""
    return [float(word.replace("D", "E")) for word in text.split() if NUMBER.match(word)]


def slicot(name, rate_hz=None):
    """Return the generalised plant of a SLICOT example, its sizes ny and nu, and the numbers left over."""
    values = numbers((SLICOT / f"{name}.dat").read_text().split("\n", 1)[1])
    n, m, p, nu, ny = (int(v) for v in values[:5])
    rest = values[5:]
    matrices = []
    for rows, columns in ((n, n), (n, m), (p, n), (p, m)):
        matrices.append(np.reshape(rest[: rows * columns], (rows, columns)))
        rest = rest[rows * columns :]
    return StateSpace(*matrices, rate_hz=rate_hz), ny, nu, rest


def printed(name, title, shape):
    """Return the matrix that a SLICOT result prints under a title."""
    text = (SLICOT / f"{name}.res").read_text().split(title, 1)[1]
    return np.reshape(numbers(text)[: shape[0] * shape[1]], shape)
