"""Bursts that are lowered until they leave no command at its limits."""

from dataclasses import replace

from ultraquiet.bench import Bench
from ultraquiet.simulate.growth.verdict import CLIPPED_SHARE
from ultraquiet.simulate.kick import Burst, FreeResponse, kicked
from ultraquiet.values import StateSpace
from ultraquiet.values.controller import Controller

# A burst after which commands stay at their limits is lowered to this share, so many times, before the loop is blamed:
# little by little, for a burst far below what the limits allow leaves a slow mode among the noise.
LOWERED_TO, LOWERED = 0.3, 6


def within_limits(
    bench: Bench, law: StateSpace | Controller, burst: Burst, found: FreeResponse
) -> tuple[Burst, FreeResponse]:
    """Lower a burst until what it leaves is no longer clipped: a loop that is stable may stay at limits after one."""
    for _ in range(LOWERED):
        if found.limited <= CLIPPED_SHARE:
            break
        burst = replace(burst, levels=LOWERED_TO * burst.levels)
        found = kicked(bench, law, burst)
    return burst, found
