"""Mixed sensitivity by python-control over slycot (GPL), run by its own interpreter: GIVEN.npz in, LEFT.npz out."""

import sys
import time

import numpy as np


def main(source: str, target: str) -> None:
    import control  # pyright: ignore[reportMissingImports]

    given = np.load(source)
    G, W1, W2 = (control.ss(*(given[f"{name}_{k}"] for k in "ABCD")) for name in ("plant", "on_s", "on_ks"))
    started = time.process_time()
    K, _, info = control.mixsyn(G, W1, W2)
    seconds = time.process_time() - started
    gamma = info[0] if isinstance(info, tuple | list) else info
    np.savez(target, seconds=seconds, gamma=float(np.ravel(gamma)[0]), A=K.A, B=K.B, C=K.C, D=K.D)


if __name__ == "__main__":
    main(*sys.argv[1:])
