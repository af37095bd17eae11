"""SLICOT's AB09AD through slycot (GPL), run by its own interpreter: `python _ab09ad.py GIVEN.npz LEFT.npz`."""

import sys
import time

import numpy as np


def main(source: str, target: str) -> None:
    import slycot  # pyright: ignore[reportMissingImports]

    given = np.load(source)
    left = {}
    for name in str(given["names"]).split(" "):
        A, B, C = (given[f"{name}_{k}"] for k in "ABC")
        spent, order, reduced = [], 0, []
        for _ in range(int(given[f"{name}_repeats"])):
            copies = [np.array(M, order="F") for M in (A, B, C)]
            started = time.process_time()
            order, *reduced = slycot.ab09ad(
                "C", "B", "S", A.shape[0], B.shape[1], C.shape[0], *copies, nr=int(given[f"{name}_order"])
            )
            spent.append(time.process_time() - started)
        left[f"{name}_seconds"], left[f"{name}_order"] = np.array(min(spent)), np.array(order)
        left |= {f"{name}_{k}": np.asarray(m) for k, m in zip("ABC", reduced, strict=False)}
    np.savez(target, **left)


if __name__ == "__main__":
    main(*sys.argv[1:])
