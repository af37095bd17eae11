"""The words of the setting `structure`: `repeated` and `decentralised`, the older `alike` and `apart` beside them."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.design import BandAttenuation, Decoupled, FixedStructure, LeadLag, Notch, Skyhook
from ultraquiet.values import StateSpace

METHODS = (BandAttenuation, FixedStructure, LeadLag, Notch, Skyhook)
PAIRS = [
    (method, old, new)
    for method in METHODS
    for old, new in (("alike", "repeated"), ("apart", "decentralised"))
    if (method, old) != (BandAttenuation, "apart")
]


@pytest.fixture
def two_channels():
    one = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    return StateSpace(*(np.kron(np.eye(2), getattr(one, key)) for key in "ABCD"), rate_hz=3500.0)


@pytest.mark.parametrize(("method", "old", "new"), PAIRS)
def test_older_words_stand_for_the_new(method, old, new):
    assert method(structure=old) == method(structure=new)
    assert method(structure=old).structure == new


@pytest.mark.parametrize("method", METHODS)
def test_another_word_is_refused_with_those_that_do(method):
    with pytest.raises(InputError, match=r"'structure' must be one of .*'repeated'.*got 'same'"):
        method(structure="same")


def test_older_words_give_the_same_law(two_channels):
    def response(method, word, **settings):
        return method(structure=word, **settings).design(two_channels).controller.frequency_response([10.0, 100.0])

    apart, decentralised = (response(LeadLag, word, gain=(-0.5, -0.4)) for word in ("apart", "decentralised"))
    np.testing.assert_array_equal(apart, decentralised)
    alike, repeated = (response(BandAttenuation, word, order=2) for word in ("alike", "repeated"))
    np.testing.assert_array_equal(alike, repeated)


def test_a_block_of_a_decoupled_plant_is_designed_whole(two_channels):
    settings = {"structure": "alike", "order": 2}
    assert Decoupled(settings=settings)._method(two_channels, two_channels).structure == "full"
