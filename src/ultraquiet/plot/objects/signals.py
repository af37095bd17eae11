"""Test signals as figures: a stretch of time, and the spectrum of it."""

import numpy as np

from ultraquiet._base.shown import draws
from ultraquiet._base.shown.line import counted
from ultraquiet.plot.figure import Figure, Line, Panel
from ultraquiet.plot.spectra import HZ
from ultraquiet.signals import Signal

PERIODS, FEWEST = 20.0, 4096  # of the slowest frequency shown, and samples
UNIT = "the actuator's unit"  # a signal has no other
OVERSAMPLED = 8.0
FLOOR = 1e-12
HIGHEST = ("stop_hz", "frequency_hz")


@draws(Signal)
def signal_figure(signal: Signal) -> Figure:
    """The signal at eight times its highest frequency (one that names none: at 1 Hz) over some periods, seed 0."""
    named = [getattr(signal, name, None) for name in HIGHEST]
    # one that names no frequency follows the rate: any rate shows it
    rate_hz = max((OVERSAMPLED * float(f) for f in named if f is not None), default=1.0)
    samples = max(FEWEST, int(getattr(signal, "period_samples", 0) or 0))
    values = signal.generate(samples=samples, rate_hz=rate_hz, seed=0)
    power = np.abs(np.fft.rfft(values) / samples) ** 2
    f_hz = np.fft.rfftfreq(samples, 1.0 / rate_hz)
    db = 10.0 * np.log10(np.maximum(power, power.max(initial=0.0) * FLOOR + np.finfo(float).tiny))
    panels = [
        Panel([Line.of(np.arange(samples) / rate_hz, values)], type(signal).__name__, "time (s)", f"command ({UNIT})"),
        Panel([Line.of(f_hz[1:], db[1:])], "power of each line", HZ, f"dB re ({UNIT})²", x_log=True),
    ]
    caption = f"{counted(samples, 'sample')} at {rate_hz:g} Hz, seed 0."
    return Figure("signal", type(signal).__name__, caption, panels, 2, (8.0, 2.4))
