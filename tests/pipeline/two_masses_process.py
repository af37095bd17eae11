"""The two masses of `small_study` behind the line protocol: python two_masses_process.py DIARY; a line for each run."""

import sys

import numpy as np
from small_study import RATE_HZ, TwoMasses


def serve(diary):
    """Answer line by line until the driver ends."""
    A, B, C = TwoMasses().matrices()
    x, rng = np.zeros(4), np.random.default_rng(0)
    for line in sys.stdin:
        word, *rest = line.split()
        if word == "hello":
            print("ultraquiet-plant 1", f"rate {RATE_HZ}", "numbers hex", "ahead 256", sep="\n")
            for k in (1, 2):
                print(f"actuator N -5000 5000 shaker {k}")
            for k in (1, 2):
                print(f"sensor m/s -inf inf mass {k}")
            print("ready")
        elif word == "step":
            n = [float.fromhex(number) for number in rest]
            y = C @ x + 1e-4 * rng.standard_normal(2)
            x = A @ x + B @ [n[0] + n[2], n[1] + n[3]]
            print("y", *[value.hex() for value in y.tolist()])
        else:
            if word == "reset":
                x, rng = np.zeros(4), np.random.default_rng(int(rest[0]))
                with open(diary, "a") as file:
                    file.write(line)
            print("ok")
        sys.stdout.flush()


if __name__ == "__main__":
    serve(sys.argv[1])
