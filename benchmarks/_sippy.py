"""Box-Jenkins fits by sippy_unipi (LGPL), run by its own interpreter: `python _sippy.py GIVEN.npz LEFT.npz`."""

import contextlib
import io
import sys
import time

import numpy as np


def coefficients(function) -> tuple[np.ndarray, np.ndarray]:
    """Return numerator and denominator in powers of q^-1."""
    num, den = np.atleast_1d(function.num[0][0]), np.atleast_1d(function.den[0][0])
    return np.concatenate([np.zeros(den.size - num.size), num]), den


def main(source: str, target: str) -> None:
    from sippy_unipi import system_identification  # pyright: ignore[reportMissingImports]

    given = np.load(source)
    order, left = int(given["order"]), {}
    for k, (u, y) in enumerate(zip(given["u"], given["y"], strict=True)):
        started = time.perf_counter()
        with contextlib.redirect_stdout(io.StringIO()):
            # Its delay counts beyond the one sample that B begins with.
            orders = [order, order, order, order, 0]
            model = system_identification(y[None], u[None], "BJ", BJ_orders=orders, max_iterations=300)
        left[f"seconds_{k}"] = np.array(time.perf_counter() - started)
        left[f"b_{k}"], left[f"f_{k}"] = coefficients(model.G)
        left[f"c_{k}"], left[f"d_{k}"] = coefficients(model.H)
    np.savez(target, **left)


if __name__ == "__main__":
    main(*sys.argv[1:])
