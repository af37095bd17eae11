"""One law on many plants: counted, ordered and bounded as it should be."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError, RateError
from ultraquiet._base.progress import listening
from ultraquiet.analyse import loop_margins, monte_carlo, peak_sensitivity, wilson_interval
from ultraquiet.testing.problems import damped_plant, observer_law
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import gain, sensitivity

BAND_HZ = (10.0, 60.0)


def scaled(plant, factor):
    return StateSpace(plant.A, plant.B, factor * plant.C, plant.D, plant.rate_hz)


def test_figures_are_those_of_each_loop(seed):
    plant = damped_plant(seed)
    law = observer_law(plant)
    plants = [scaled(plant, factor) for factor in (0.5, 1.0, 1.2)]
    found = monte_carlo(iter(plants), law, BAND_HZ)
    for k, one in enumerate(plants):
        assert found.figures["peak_sensitivity_db"][k] == peak_sensitivity(one, law)[0]
        margins = [loop_margins(one, law, side) for side in ("output", "input")]
        assert found.figures["delay_margin_s"][k] == min(m.delay_s.min() for m in margins)
        f = np.linspace(*BAND_HZ, 20_000)
        S = np.moveaxis(sensitivity(one, law).frequency_response(f), 2, 0)
        worst = -20 * np.log10(np.linalg.norm(S, 2, axis=(1, 2)).max())
        assert found.figures["worst_direction_db"][k] == pytest.approx(worst, abs=1e-4)
    assert found.worst == int(np.argmax(found.figures["peak_sensitivity_db"]))
    assert found.worst_case is plants[found.worst]
    print(found.status(), found.summary())


def test_unstable_cases_count_at_their_worst(seed):
    plant = damped_plant(seed)
    law = observer_law(plant)
    up = 10 ** (loop_margins(plant, law).gain_up_db.min() / 20)
    factor = 100 * up if np.isfinite(up) else -100.0
    found = monte_carlo([plant, scaled(plant, factor), plant], law)
    assert found.stable.tolist() == [True, False, True]
    assert found.worst == 1
    assert found.share_stable == pytest.approx(2 / 3)
    assert found.quantile("peak_sensitivity_db", 1.0) == np.inf
    assert found.quantile("worst_direction_db", 0.0) == -np.inf
    assert found.quantile("disk_margin", 0.0) == found.quantile("delay_margin_s", 0.0) == 0.0
    assert found.status().word == "unstable"
    assert "on 1 of 3 cases" in found.status().sentence
    # without a band the worst direction is the peak itself
    assert found.figures["worst_direction_db"][0] == -found.figures["peak_sensitivity_db"][0]


def test_wilson_interval_covers(rng):
    """At 40 trials of 97 % the interval holds the truth nearly as often as it says, at its ends too."""
    truth, trials, draws = 0.97, 40, 4000
    seen = rng.binomial(trials, truth, draws)
    table = [wilson_interval(k, trials) for k in range(trials + 1)]
    held = np.mean([table[k][0] <= truth <= table[k][1] for k in seen])
    print(f"held {held:.1%}")
    assert 0.92 < held < 0.99
    assert table[0][0] == 0.0
    assert table[-1][1] == 1.0
    assert wilson_interval(8, 10)[0] == pytest.approx(0.490, abs=5e-4)
    assert wilson_interval(8, 10)[1] == pytest.approx(0.943, abs=5e-4)


def test_progress_is_told():
    told = []

    class Listener:
        def start(self, title, total):
            told.append((title, total))
            return 1

        def advance(self, key, steps, note):
            told.append(note)

        def finish(self, key):
            told.append("end")

    plant = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], rate_hz=10.0)
    with listening(Listener()):
        monte_carlo([plant, plant], gain([[-0.1]], 10.0))
    assert told == [("loops", 2), "plant 1", "plant 2", "end"]


def test_what_does_not_fit_is_refused():
    plant, law = gain([[1.0]], 10.0), gain([[-0.5]], 10.0)
    with pytest.raises(InputError, match="give at least one plant"):
        monte_carlo([], law)
    with pytest.raises(RateError):
        monte_carlo([gain([[1.0]], 20.0)], law)
    with pytest.raises(InputError, match="'band_hz' must lie"):
        monte_carlo([plant], law, (5.0, 2.0))
    for beyond in ((4.0, 5.1), (6.0, 7.0)):
        with pytest.raises(InputError, match="beyond Nyquist's 5 Hz; end it lower"):
            monte_carlo([plant], law, beyond)
    with pytest.raises(InputError, match="no figure 'delay'"):
        monte_carlo([plant], law).quantile("delay", 0.5)
    assert monte_carlo([plant], law, (0.0, 5.0)).figures["worst_direction_db"][0] == pytest.approx(20 * np.log10(1.5))
