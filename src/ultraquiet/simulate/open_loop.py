"""What a bench does without a law, measured once for all laws."""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from ultraquiet.bench import Bench
from ultraquiet.simulate.sweeps.band import OpenBand
from ultraquiet.simulate.sweeps.clock import SweepClock

# Length of a run: seconds, and the least and most samples to which it is doubled or halved.
RUN_S, FEWEST, MOST = 16.0, 1 << 13, 1 << 17
# Periods of the lowest line in a run; the highest as a share of the Nyquist frequency; where the two bands meet, as a
# share of the octaves; by how much the runs of the faster one are shorter.
LOWEST_PERIODS, HIGHEST, SPLIT, FASTER = 64.0, 0.96, 0.33, 4
FINER, FINER_FAST = 4, 4  # lines between those of a run, in either band
OVERLAP = 1.1  # of the bands, where each fades
EDGE = 1.05  # where a sweep fades in and out
BELOW = 0.7  # where a band below begins, over where the one above does
FEWEST_PERIODS = 20.0  # of its lowest line in a run: fewer, and the short runs do not tell the lines of a band apart


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """A bench in open loop; runs are made when they are first asked for. Give one object to all laws of a bench.

    Slow and fast frequencies are swept by themselves: fast ones die soon, and noise is heard for less long.

    Args:
        bench: as it will be closed.
        seconds: length of each run; 16 s when absent, more or less where the rate asks for it.
    """

    bench: Bench
    seconds: float | None = None
    _below: dict[tuple[float, int], OpenBand] = field(default_factory=dict[Any, Any], init=False, repr=False)

    @cached_property
    def bands(self) -> tuple[OpenBand, OpenBand]:
        """The slower and the faster half."""
        seconds, rate = self.seconds or RUN_S, self.bench.rate_hz
        while self.seconds is None and seconds * rate < FEWEST:
            seconds *= 2
        while self.seconds is None and seconds * rate > MOST:
            seconds /= 2
        low, high = LOWEST_PERIODS / seconds, HIGHEST * rate / 2
        between = low * (high / low) ** SPLIT
        slow = SweepClock(round(seconds * rate), rate, low, OVERLAP * between, FINER, even=False)
        fast = SweepClock(round(seconds * rate / FASTER), rate, between / OVERLAP, high, FINER_FAST)
        return OpenBand(self.bench, slow).as_fine_as_it_rings(), OpenBand(self.bench, fast).as_fine_as_it_rings()

    def downwards(self, to_hz: float | None = None) -> Iterator[OpenBand]:
        """Bands below, one after the other: runs for few frequencies, for loops that amplify most down there.

        They end where a run is too short; runs that lines at `to_hz` need are longer, up to those of other benches.
        """
        band, sweep = self.bands[0], self.bands[0].sweep
        while True:
            low_hz, samples = band.sweep.low_hz, sweep.samples
            fewest = FEWEST_PERIODS * band.sweep.rate_hz / (BELOW * low_hz)
            while to_hz is not None and to_hz < EDGE * low_hz and samples < fewest and 2 * samples <= MOST:
                samples *= 2
            if samples < fewest:
                return
            key, limits = (low_hz, samples), {"low_hz": BELOW * low_hz, "high_hz": OVERLAP * low_hz}
            if key not in self._below:
                self._below[key] = OpenBand(self.bench, replace(sweep, samples=samples, **limits)).as_fine_as_it_rings()
            yield (band := self._below[key])

    def apart(self) -> "OpenLoop":
        """Return this open loop, measured, on a copy of its bench as it stands then.

        A bench draws its noise by the number of the run: on a copy of its own no law's figures hang on which other laws
        ran before. What cannot be copied, a process or hardware, stays what it is.
        """
        for band in self.bands:
            _ = band.response, band.deviation, band.units, band.noise
        try:
            bench = deepcopy(self.bench)
        except (TypeError, ValueError):
            return self
        alone = OpenLoop(bench, self.seconds)
        alone.__dict__["bands"] = tuple(_on(band, bench) for band in self.bands)
        return alone


def _on(band: OpenBand, bench: Bench) -> OpenBand:
    """Return a band with what was measured of it, on another bench."""
    other = OpenBand(bench, band.sweep)
    other.__dict__.update({key: value for key, value in band.__dict__.items() if key not in ("bench", "sweep")})
    if "short" in band.__dict__:
        other.__dict__["short"] = _on(band.short, bench)
    return other
