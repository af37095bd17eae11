"""A law whose channels stand in another order than its plant's is refused: wire by wire the loop is another one."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.bench.linear import LinearBench
from ultraquiet.design.loop_analysis import analyse_loop
from ultraquiet.values.interconnect import feedback, sensitivity

BAND_HZ = (1.0, 10.0)
VERDICTS = {
    "analyse_loop": lambda G, K: analyse_loop(G, K, BAND_HZ),
    "peak_sensitivity": uq.analyse.peak_sensitivity,
    "loop_margins": uq.analyse.loop_margins,
    "disk_margin": lambda G, K: uq.analyse.disk_margin(G, K, "both"),
    "band_attenuation": lambda G, K: uq.analyse.band_attenuation(G, K, BAND_HZ),
    "gang_of_six": uq.analyse.gang_of_six,
    "monte_carlo": lambda G, K: uq.analyse.monte_carlo([G], K),
    "distance": lambda G, K: uq.limits.distance(G, K, BAND_HZ),
    "feedback": feedback,
    "sensitivity": sensitivity,
    "operator": lambda G, K: G.feedback(K),
    "reduce": lambda G, K: uq.reduce.Balanced(states=0).reduce(K, G),
    "reanalysis": lambda G, K: uq.deploy.reanalysis(K, K, G, [5.0]),
    "check_stability": lambda G, K: uq.simulate.check_stability(LinearBench(G), K),
    "measure_sensitivity": lambda G, K: uq.simulate.measure_sensitivity(LinearBench(G), K),
}


def loop(ny, nu, scale):
    """A stable plant, and a small law of its wires."""
    rng = np.random.default_rng(ny + nu)
    forces, speeds = [f"force {k}" for k in range(nu)], [f"speed {k}" for k in range(ny)]
    B, C = rng.standard_normal((2, nu)), scale * rng.standard_normal((ny, 2))
    G = uq.StateSpace(0.5 * np.eye(2), B, C, np.zeros((ny, nu)), 100.0, forces, speeds)
    D = 0.01 / scale * rng.standard_normal((nu, ny))
    K = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), D, 100.0, speeds, forces)
    return G, K


@pytest.mark.parametrize("verdict", VERDICTS)
@pytest.mark.parametrize(("ny", "nu", "scale"), [(4, 3, 1e-9), (3, 5, 1e9)])
def test_a_law_with_its_wires_swapped_is_refused(verdict, ny, nu, scale):
    G, K = loop(ny, nu, scale)
    readings, commands = ([c.name for c in wires] for wires in (K.actuators, K.sensors))
    for swapped in (K.pick(inputs=readings[::-1]), K.pick(outputs=commands[1:] + commands[:1])):
        with pytest.raises(InputError, match=r"wires swapped; put the controller's channels in the .*'s order"):
            VERDICTS[verdict](G, swapped)


@pytest.mark.parametrize(("ny", "nu", "scale"), [(1, 1, 1.0), (4, 3, 1e-9), (3, 5, 1e9)])
def test_names_that_say_nothing_of_the_order_are_no_matter(ny, nu, scale):
    G, K = loop(ny, nu, scale)
    numbered = uq.StateSpace(K.A, K.B, K.C, K.D, K.rate_hz)
    others = uq.StateSpace(K.A, K.B, K.C, K.D, K.rate_hz, ["y"] * ny, ["u"] * nu)
    peaks = [uq.analyse.peak_sensitivity(G, law) for law in (K, numbered, others)]
    assert peaks[0] == peaks[1] == peaks[2]
    assert uq.analyse.peak_sensitivity(numbered, G) == uq.analyse.peak_sensitivity(K, G)
