"""Hardware with seconds between its frames: what nobody stated about time fits the rate."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError, InterlockError
from ultraquiet.bench import Hardware, Interlocks
from ultraquiet.values import Channel


class SlowClock:
    """A machine's clock that moves by what a frame takes, as many periods as are listed and then one each."""

    def __init__(self, rate_hz, periods):
        self.now_s, self.rate_hz, self.periods = 0.0, rate_hz, list(periods)

    def perf_counter(self):
        return self.now_s

    def wait(self):
        self.now_s += (self.periods.pop(0) if self.periods else 1.0) / self.rate_hz


def slow_bench(rate_hz, written, nu=2, wait=None, **limits):
    pushes = [Channel(f"push {i}", "V", -10.0, 10.0) for i in range(nu)]
    return Hardware(written.append, lambda: written[-1][:1], rate_hz, pushes, ["speed"], Interlocks(**limits), wait)


@pytest.mark.parametrize("rate_hz", [0.01, 1.0, 5.0])
@pytest.mark.parametrize(("periods", "tripped"), [((), False), ((0.0, 1.0, 2.5), False), ((1.0, 3.1), True)])
def test_frames_of_a_slow_rate_have_their_time_and_one_that_hangs_is_not_trusted(
    rate_hz, periods, tripped, monkeypatch
):
    clock, written = SlowClock(rate_hz, periods), []
    monkeypatch.setattr("ultraquiet.bench.hardware.bench.time", clock)
    bench = slow_bench(rate_hz, written, wait=clock.wait)
    if tripped:
        with pytest.raises(InterlockError, match="the interlock 'frame' ended the run at sample 1"):
            bench.run(np.ones((2, 6)))
    else:
        assert bench.run(np.ones((2, 6))).outputs[0].tolist() == [0.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    assert written[-1].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(("rate_hz", "frame_s"), [(1.0, 0.5), (1.0, 1.0), (1000.0, 1e-3)])
def test_an_interlock_that_every_frame_would_trip_is_refused_beforehand(rate_hz, frame_s):
    written = []
    with pytest.raises(InputError, match=rf"the interlock 'frame_s' allows {frame_s:g} s; allow a few frames"):
        slow_bench(rate_hz, written, frame_s=frame_s)
    assert not written
    slow_bench(rate_hz, written, frame_s=3 * frame_s)
