"""The self-test of whole-number code: calls, and the digests that the twin leaves."""

from typing import Any

import numpy as np

from ultraquiet.deploy.c_code.self_test import FNV_BASIS, FNV_PRIME, LCG_FACTOR, LCG_STEP, MASK
from ultraquiet.deploy.fixed_point.law import FixedLaw, Whole
from ultraquiet.deploy.fixed_point.twin import FixedTwin


def self_test(law: FixedLaw, corners: Whole, edges: int) -> list[dict[str, Any]]:
    """Return the self-test's calls with the digests the twin leaves.

    A law may never meet a limit of its commands or states from rest, with measurements in range. From the corners every
    limit that the code holds is met: by commands alone (CORNER), for their states may leave the range that a bound
    proves from rest, and by a whole step (EDGE) where the code limits the states too.

    Args:
        law: the law in whole numbers.
        corners: states and measurements, `(corners, n + ny)`, of `reach.all_corners`.
        edges: how many of them, the last, are followed by a whole step.
    """
    full = 2**law.ramp_bits
    part = max(min(full // 2, 40), 1)
    plan = [
        ("INIT", 0),
        ("RUN", 3),
        ("ENABLE", 0),
        ("RUN", part),
        ("DISABLE", 0),
        ("RUN", max(part // 2, 1)),
        ("ENABLE", 0),
    ]
    plan += [("RUN", full + 100), ("HIGH", 60), ("LOW", 60), ("RUN", 40), ("DISABLE", 0), ("RUN", full + 2)]
    plan += [("ENABLE", 0), ("RUN", 20)]
    plan += [("CORNER", k) for k in range(len(corners) - edges)]
    plan += [("EDGE", k) for k in range(len(corners) - edges, len(corners))]
    plan += [("RUN", 1), ("INIT", 0), ("ENABLE", 0), ("RUN", 2)]
    twin, random, digest, rows = FixedTwin(law), 1, FNV_BASIS, []
    twin.init()
    for op, count in plan:
        if op in ("INIT", "ENABLE", "DISABLE"):
            getattr(twin, op.lower())()
        folded: list[int] = []
        if op in ("CORNER", "EDGE"):
            twin.x = corners[count, : law.states]
            folded += twin.output(corners[count, law.states :]).tolist()
            if op == "EDGE":
                twin.update()
            else:
                twin.x = np.zeros_like(twin.x)
        for _ in range(count if op in ("RUN", "HIGH", "LOW") else 0):
            y = np.zeros(law.inputs, np.int64)
            for j in range(law.inputs):
                random = (random * LCG_FACTOR + LCG_STEP) & MASK
                y[j] = ((random >> 8) - 8388607) * 256 if law.bits == 32 else (random >> 16) - 32768
            folded += twin.output(y if op == "RUN" else np.full_like(y, law.top if op == "HIGH" else -law.top)).tolist()
            twin.update()
        folded += [*twin.x.tolist(), *twin.y.tolist(), int(twin.on), twin.level, twin.clipped, twin.limited]
        for value in folded:
            digest = ((digest ^ (value & MASK)) * FNV_PRIME) & MASK
        rows.append({"op": op, "count": count, "digest": digest})
    return rows
