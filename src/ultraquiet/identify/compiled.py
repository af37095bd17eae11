"""How the room's kernels are compiled: once into numba's cache, without the GIL, sums in the order they are written."""

from typing import Any

from numba import njit

FLUSH = 1e-140  # its square is still a normal number; denormal tails of decaying responses cost 20 times the work

compiled: Any = njit(cache=True, nogil=True, fastmath=False)
