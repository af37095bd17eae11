"""A mode that a search leaves on the circle between two lines goes where nobody misses it, and stays where it is."""

import numpy as np
import pytest

from ultraquiet.identify.response import fewest_modes
from ultraquiet.identify.response.fewest_modes import settled
from ultraquiet.linalg.modes import rank_one

RATE_HZ, SPARE = 3500.0, 0.003


def samples(rng, poles, spacing_hz=0.5):
    f = np.arange(2.0, 60.0, spacing_hz)
    z = np.exp(2j * np.pi * f / RATE_HZ)
    m = poles.size
    c, b = (rng.normal(size=s) + 1j * rng.normal(size=s) for s in ((3, m), (m, 2)))
    modes = rank_one.of(poles, c, b)
    H = modes.response(z)
    size = np.sqrt(np.mean(np.abs(H) ** 2, axis=(0, 1)))
    noise = 0.01 * size * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    return modes, rank_one.Samples(z, H + noise, 1 / size)


def pole(f_hz, half_width_hz):
    return np.exp(2 * np.pi * (-np.asarray(half_width_hz) + 1j * np.asarray(f_hz)) / RATE_HZ)


def test_a_mode_that_no_line_tells_of_leaves(rng, monkeypatch):
    monkeypatch.setattr(fewest_modes, "FINE_STEPS", 0)  # a search that stands still on the circle
    modes, heard = samples(rng, pole([9.0, 21.0, 40.0], 0.4))
    h = modes.heads()
    spurious = pole([21.2], 1e-5)
    tiny = 1e-5 * (rng.normal(size=(3, 1)) + 1j), rng.normal(size=(1, 2)) + 0j
    begun = rank_one.of(
        np.concatenate([modes.poles[h], spurious]),
        np.hstack([modes.c[:, h], tiny[0]]),
        np.vstack([modes.b[h], tiny[1]]),
    )
    found = settled(begun, heard, SPARE)
    widths = -np.log(np.abs(found.poles[found.heads()])) * RATE_HZ / (2 * np.pi)
    print(f"half-widths {widths} Hz, error {heard.error(found):.4f}")
    assert widths.size == 3
    assert widths.min() > 0.1
    assert heard.error(found) < 0.02


@pytest.mark.parametrize("half_width_hz", [0.0005, 0.002])
def test_a_sharp_mode_that_is_there_stays(rng, half_width_hz):
    modes, heard = samples(rng, pole([9.0, 21.2, 40.0], [0.4, half_width_hz, 0.4]))
    found = settled(modes, heard, SPARE)
    poles = found.poles[found.heads()]
    nearest = np.abs(np.angle(poles) * RATE_HZ / (2 * np.pi) - 21.2).min()
    print(f"{poles.size} modes, the sharp one {nearest:.4f} Hz from where it is")
    assert poles.size == 3
    assert nearest < 0.02
