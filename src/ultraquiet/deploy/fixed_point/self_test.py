"""The self-test of whole-number code: calls, and the digests that the twin leaves."""

from typing import Any

import numpy as np

from ultraquiet.deploy.c_code.self_test import FNV_BASIS, FNV_PRIME, LCG_FACTOR, LCG_STEP, MASK
from ultraquiet.deploy.fixed_point.law import FixedLaw, Whole
from ultraquiet.deploy.fixed_point.twin import FixedTwin


def corner(law: FixedLaw) -> Whole | None:
    """Return the states and measurements, `(n + ny,)`, that carry a command beyond its range and no sum beyond its own.

    A law whose states no measurement in range can fill may never meet a limit of its commands by itself; from here
    both are met. None where none can be: the limits of such a law are idle.
    """
    rows = np.hstack([law.C.T, law.D])
    sizes = [int(size) for size in np.abs(rows).sum(axis=1)]
    downs = [law.bits - 2 + int(shift) for shift in law.shift_u]
    top, most = 2 ** (law.bits - 1) - 1, 2 ** (2 * law.bits - 1) - 1
    size = min(top, *((most - (1 << (d - 1))) // max(s, 1) for s, d in zip(sizes, downs, strict=True)))
    reached = [(size * s + (1 << (d - 1))) >> d for s, d in zip(sizes, downs, strict=True)]
    furthest = int(np.argmax(reached))
    return size * np.sign(rows[furthest]) if reached[furthest] > top else None


def self_test(law: FixedLaw) -> list[dict[str, Any]]:
    """Return the self-test's calls with the digests the twin leaves."""
    full = 2**law.ramp_bits
    part = max(min(full // 2, 40), 1)
    plan = [("RUN", 3), ("ENABLE", 0), ("RUN", part), ("DISABLE", 0), ("RUN", max(part // 2, 1)), ("ENABLE", 0)]
    plan += [("RUN", full + 100), ("HIGH", 60), ("LOW", 60), ("RUN", 40), ("DISABLE", 0), ("RUN", full + 2)]
    plan += [("ENABLE", 0), ("RUN", 20)]
    if law.saturates:  # states at their ranges' corners, which a turn of the block carries beyond
        plan += [("PUSH", 0), ("RUN", 1), ("PUSH", 1), ("RUN", 1)]
    ends = corner(law)
    if ends is not None:
        plan += [("CORNER", 1), ("CORNER", 0)]
    twin, random, digest, rows = FixedTwin(law), 1, FNV_BASIS, []
    twin.init()
    top = 2 ** (law.bits - 1) - 1
    for op, count in plan:
        if op in ("ENABLE", "DISABLE"):
            getattr(twin, op.lower())()
        if op == "PUSH":
            twin.x = np.where(np.arange(law.states) * count % 2 == 0, top, -top)
        folded: list[int] = []
        if op == "CORNER" and ends is not None:
            held = ends if count else -ends
            twin.x = held[: law.states]
            folded += twin.output(held[law.states :]).tolist()
            twin.x = np.zeros_like(twin.x)
        for _ in range(count if op in ("RUN", "HIGH", "LOW") else 0):
            y = np.zeros(law.inputs, np.int64)
            for j in range(law.inputs):
                random = (random * LCG_FACTOR + LCG_STEP) & MASK
                y[j] = ((random >> 8) - 8388607) * 256 if law.bits == 32 else (random >> 16) - 32768
            folded += twin.output(y if op == "RUN" else np.full_like(y, top if op == "HIGH" else -top)).tolist()
            twin.update()
        folded += [*twin.x.tolist(), twin.level, twin.clipped, twin.limited]
        for value in folded:
            digest = ((digest ^ (value & MASK)) * FNV_PRIME) & MASK
        rows.append({"op": op, "count": count, "digest": digest})
    return rows
