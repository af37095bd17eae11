"""One scalar law on every channel: compared, on the whole plant, with what it promises for the function they share."""

import numpy as np
import pytest

from ultraquiet.design import BandAttenuation
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import append

RATE = 2000.0
SETTINGS = {"band_hz": (20.0, 80.0), "height": 6.0, "order": 4, "control_limit": 100.0, "structure": "alike"}


def alike_but(spread):
    """Return three equal channels whose differential directions answer `spread` times as strongly as the shared one."""
    pole = np.exp(-2 * np.pi * 60.0 / RATE)
    shared = np.full((3, 3), 1 / 3)
    directions = shared + spread * (np.eye(3) - shared)
    return StateSpace(pole * np.eye(3), np.eye(3), (1 - pole) * directions, np.zeros((3, 3)), RATE)


def test_channels_that_share_one_function_keep_the_promise():
    result = BandAttenuation(**SETTINGS).design(alike_but(1.0))
    assert result.status.ok, result.status
    assert result.details["attenuation_db"] == pytest.approx(result.details["promised_db"], abs=0.1)


@pytest.mark.parametrize(("spread", "word"), [(0.4, "short"), (0.1, "fragile")])  # the worse of both words
def test_directions_that_answer_less_are_said_to_break_it(spread, word):
    result = BandAttenuation(**SETTINGS).design(alike_but(spread))
    assert result.status.word == word
    assert result.controller is not None
    left, promised = result.details["attenuation_db"], result.details["promised_db"]
    assert promised - left > 3.0
    assert f"{left:.1f} dB are left" in result.status.sentence
    assert f"{promised:.1f} dB" in result.status.sentence


@pytest.mark.parametrize(("rate_hz", "pole", "unit"), [(100.0, 1.01, 1.0), (100.0, 1.03, 1e-6), (None, 1.0, 1e5)])
def test_alike_channels_that_are_unstable_get_the_law_of_one(rate_hz, pole, unit):
    one = StateSpace([[pole]], [[0.1 if rate_hz else 1.0]], [[unit]], [[0.0]], rate_hz=rate_hz)
    method = BandAttenuation(band_hz=(1.0, 5.0), structure="repeated", order=2)
    alone, all_of_them = method.design(one), method.design(append(one, one, one))
    f = np.geomspace(0.1, 40.0, 20)
    law = alone.controller.frequency_response(f)[0, 0]
    off = all_of_them.controller.frequency_response(f) - np.eye(3)[:, :, None] * law
    assert alone.status.word == all_of_them.status.word
    # to what the search for the smallest norm leaves open
    assert np.abs(off).max() < 1e-2 * np.abs(law).max()
    assert all_of_them.gamma == pytest.approx(alone.gamma, rel=1e-2)
