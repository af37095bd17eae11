"""One run of the simulated loop: where plant and controller stand, carried from block to block."""

from collections.abc import Callable, Iterator

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import RunawayError
from ultraquiet._base.progress import require_wanted
from ultraquiet.bench._abstract import Block, IntArray, fade
from ultraquiet.bench.columns import turned
from ultraquiet.bench.hexapod.laws import WHO, FeedbackLaw, Limits, LostError, Plant


class Simulation:
    """One run from rest.

    Args:
        plants: the plant as the kernels take it and the samples for which it holds, from a given sample on.
        law: what closes the loop.
        limits: where signals saturate.
        actuation, disturbance: `(nu, n)`.
        noise: draws the noise of the next samples, `(m, ny)`.
        plays_on: how many of the actuators, the leading ones, have hysteresis.
    """

    def __init__(
        self,
        plants: Callable[[int], tuple[Plant, int]],
        law: FeedbackLaw,
        limits: Limits,
        actuation: FloatArray,
        disturbance: FloatArray,
        noise: Callable[[int], FloatArray],
        plays_on: int,
    ) -> None:
        self._plants, self._law, self._limits, self._noise = plants, law, limits, noise
        self._u, self._d = turned(actuation), turned(disturbance)
        self._gain = np.ones(len(self._u))
        plant, _ = plants(0)
        nu = self._u.shape[1]
        self._state = np.zeros(len(plant[0][0])), np.zeros(nu), np.zeros((plays_on, plant[4].size))
        self._k, self._end = 0, len(self._u)

    @property
    def samples(self) -> int:
        """How many samples are to be sent."""
        return len(self._u)

    def blocks(self, block_samples: int, stop: Callable[[], bool] | None, ramp_samples: int) -> Iterator[Block]:
        """Yield the run in blocks; once `stop` says yes, everything sent fades to zero and the run ends."""
        fading = False
        while self._k < self._end:
            require_wanted()
            if stop is not None and not fading and stop():
                fading = True
                self._end = min(self._end, self._k + ramp_samples)
                self._gain[self._k :] = fade(len(self._u) - self._k, ramp_samples)
            block, lost = self._take(min(block_samples, self._end - self._k))
            if block is not None:
                yield block
            if lost is not None:
                raise lost.error or RunawayError(
                    f"{WHO}: at sample {self._k} the controller's command was no longer a finite number; "
                    f"it is unstable by itself or with this bench."
                )

    def _take(self, samples: int) -> tuple[Block | None, LostError | None]:
        """Run on by `samples`: what was measured, and what broke it off."""
        nu, ny, done, lost = self._u.shape[1], len(self._limits.reading_v), 0, None
        command, y, limited = np.empty((samples, nu)), np.empty((samples, ny)), np.zeros((2, nu))
        while done < samples and lost is None:
            plant, holds = self._plants(self._k)
            part, now = slice(done, min(samples, done + holds)), slice(self._k, self._k + min(samples - done, holds))
            signals = self._u[now], self._d[now], self._noise(now.stop - now.start), self._gain[now]
            try:
                self._law.advance(plant, signals, self._limits, self._state, (command[part], y[part], limited))
                advanced = now.stop - now.start
            except LostError as caught:
                lost, advanced = caught, caught.sample
            done += advanced
            self._k += advanced
        return (self._block(command[:done], y[:done], limited.astype(np.int64)) if done else None), lost

    def _block(self, command: FloatArray, y: FloatArray, limited: IntArray) -> Block:
        met = np.count_nonzero(np.abs(y) >= self._limits.reading_v, axis=0)
        stacks = len(self._state[2])
        further = {"limited_stacks": limited[1, :stacks], "limited_proof_masses": limited[1, stacks:]}
        return Block(turned(command), turned(y), limited[0], met, further=further)
