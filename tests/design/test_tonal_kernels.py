"""Every kernel of the adaptive laws against its twin in plain NumPy, sample for sample."""

import numpy as np
import pytest
from tonal_twins import FeedforwardTwin, FilteredXTwin, YoulaTwin

from ultraquiet.design import AdaptiveFeedforward, FilteredXLms, YoulaKucera
from ultraquiet.testing.problems import damped_plant
from ultraquiet.values import StateSpace

PAIRS = [
    (AdaptiveFeedforward(tones_hz=(60.0,), limit=10.0), FeedforwardTwin),
    (AdaptiveFeedforward(tones_hz=(30.0, 60.0), limit=0.05), FeedforwardTwin),
    (YoulaKucera(tones_hz=(60.0,), limit=10.0), YoulaTwin),
    (YoulaKucera(basis="laguerre", order=3, pole_hz=25.0, update_every=1, limit=0.5, leak=1e-3), YoulaTwin),
    (FilteredXLms(taps=20, step=0.3, limit=10.0), FilteredXTwin),
    (FilteredXLms(taps=20, step=0.3, limit=0.05), FilteredXTwin),
]


def stepped(law):
    """Return the bare kernel: the watch over it is tested elsewhere."""

    def step(y):
        law._adapt(y)
        return law._v.copy()

    return step


def closed(plant, d, step):
    """Return the commands of a law in its loop, `(n, nu)`."""
    x, commands = np.zeros(plant.states), []
    for k in range(d.shape[1]):
        commands.append(step(plant.C @ x + d[:, k]))
        x = plant.A @ x + plant.B @ commands[-1]
    return np.array(commands)


@pytest.mark.gate(
    "method0-FeedforwardTwin-False",
    "method1-FeedforwardTwin-True",
    "method2-YoulaTwin-False",
    "method3-YoulaTwin-True",
    "method4-FilteredXTwin-True",
    "method5-FilteredXTwin-False",
)
@pytest.mark.parametrize("direct", [False, True])
@pytest.mark.parametrize(("method", "twin"), PAIRS, ids=lambda v: getattr(v, "__name__", None))
def test_kernel_does_what_its_twin_does(method, twin, direct, seed, rng):
    plant = damped_plant(seed)
    if direct:
        D = 0.01 * rng.standard_normal((2, 2))
        plant = StateSpace(plant.A, plant.B, plant.C, D, plant.rate_hz)
    law = method.design(plant).law
    other = twin(law)
    n = 2500
    t = np.arange(n) / 1000
    f = 58 + 2 * t
    d = np.outer(rng.uniform(0.5, 1, 2), np.sin(2 * np.pi * f * t)) + 0.02 * rng.standard_normal((2, n))
    # each in a loop of its own: an adaptive law alone, on readings given, may be unstable and then shows rounding only
    mine, its = closed(plant, d, stepped(law)), closed(plant, d, other.step)
    # round-off, carried on through two thousand updates of a matrix of covariances, is all that may differ (2e-7 seen)
    gap = np.abs(mine - its).max() / np.abs(its).max()
    print(f"{type(method).__name__}: commands up to {np.abs(its).max():.3f} V, differ by {gap:.1e} of that")
    # laws that hardly moved would agree as well: a thousandth of what cancels the tone where the plant answers most
    strongest = max(np.linalg.norm(plant.frequency_response([x])[:, :, 0], 2) for x in (float(f[0]), float(f[-1])))
    assert np.abs(its).max() > 1e-3 * np.abs(d).max() / strongest
    assert gap < 1e-5
