"""SLICOT's SB10AD through slycot (GPL), run by its own interpreter: `python _slycot.py GIVEN.npz LEFT.npz`."""

import sys
import time

import numpy as np


def main(source: str, target: str) -> None:
    import slycot  # pyright: ignore[reportMissingImports]

    given = np.load(source)
    left = {}
    for name in str(given["names"]).split(" "):
        A, B, C, D = (np.asfortranarray(given[f"{name}_{k}"]) for k in "ABCD")
        sizes = A.shape[0], B.shape[1], C.shape[0], int(given[f"{name}_controls"]), int(given[f"{name}_measurements"])
        spent, level, law = [], np.nan, []
        for _ in range(int(given["repeats"])):
            started = time.process_time()
            try:
                # job 1: bisection between the level given and the largest that the direct terms rule out
                level, *law = slycot.sb10ad(
                    *sizes, float(given[f"{name}_start"]), A, B, C, D, job=1, gtol=float(given[f"{name}_tolerance"])
                )
            except (ArithmeticError, ValueError, slycot.exceptions.SlycotError):
                level, law = np.nan, []
                break
            spent.append(time.process_time() - started)
        left[f"{name}_seconds"] = np.array(min(spent, default=np.nan))
        left[f"{name}_gamma"] = np.array(level)
        left |= {f"{name}_{k}": np.asarray(m) for k, m in zip("ABCD", law, strict=False)}
    np.savez(target, **left)


if __name__ == "__main__":
    main(*sys.argv[1:])
